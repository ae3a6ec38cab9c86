"""The chase against pencil and paper: rewards, ends, the target's distribution, independence of the batch, symmetry."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmchase.batch.selection import pack
from swarmchase.batch.streams import ChaseStreams, chase_keys
from swarmchase.benchmarks import environment as benchmark
from swarmchase.errors import InputError
from swarmchase.formation import Action, action_from_choice
from swarmchase.scenario import load_scenario, paper_scenario
from swarmchase.world.environment import Environment, distance_to_target_m
from swarmchase.world.target import draw_start_m


def vector(*rows):
    return torch.tensor(rows, dtype=torch.float64)


def situation(environment, target_m, center_m=(0, 0, 0), movements=0):
    """A chase of one with the target and the centre where the table has them."""
    state = environment.reset([(0, 0)])
    return replace(
        state,
        target=replace(state.target, position_m=vector(target_m)),
        center_m=vector(center_m),
        movements=torch.tensor([movements]),
    )


def move(displacement_m, spacing_m=5.0):
    return Action(spacing_m=torch.tensor([spacing_m], dtype=torch.float64), displacement_m=vector(displacement_m))


@pytest.fixture(scope="module")
def environment():
    return Environment(paper_scenario())


@pytest.mark.parametrize(
    ("target_m", "center_m", "displacement_m", "reward_m"),
    [
        # Straight at it: 100 m become 96 m, all of it on x.
        ((100, 0, 0), (0, 0, 0), (4, 0, 0), (4, 4, 0, 0)),
        # Straight away from it, on the negative side of an axis.
        ((0, -100, 0), (0, 0, 0), (0, 2, 0), (-2, 0, -2, 0)),
        # Hovering wins nothing.
        ((30, 40, 0), (0, 0, 0), (0, 0, 0), (0, 0, 0, 0)),
        # Over it by a metre: 3 m short becomes 1 m too far, (3, 4) m is 5 m and (-1, 4) m is sqrt(17) m.
        ((3, 0, 4), (0, 0, 0), (4, 0, 0), (5 - 17**0.5, 2, 0, 0)),
        # Past it on x by exactly as much as it was short: no gain on the axis, none in distance.
        ((2, 12, 0), (0, 0, 0), (4, 0, 0), (0, 0, 0, 0)),
        # One axis wins, one loses, one rests; (6, 8, 0) is 10 m, (2, 10, 0) is sqrt(104) m.
        ((6, 8, 5), (0, 0, 5), (4, -2, 0), (10 - 104**0.5, 4, -2, 0)),
        # Eq. (7) needs the centre's own place, not the origin: (10, 0, 0) to (13, 4, 0) is 5 m, then 4 m.
        ((13, 4, 0), (10, 0, 0), (0, 4, 0), (5 - 3, 0, 4, 0)),
    ],
)
def test_reward_is_the_distance_won_and_that_on_each_axis(environment, target_m, center_m, displacement_m, reward_m):
    """Eqs. (7)-(8)."""
    _, outcome = environment.step(situation(environment, target_m, center_m), move(displacement_m))
    assert outcome.reward_m[0].tolist() == pytest.approx(reward_m, abs=1e-12)


@pytest.mark.parametrize(
    ("target_m", "displacement_m", "movements", "ends"),
    [
        ((6, 0, 0), (4, 0, 0), 0, "reached"),  # 2 m left, and 2 m is within th = 2 m
        ((6.000001, 0, 0), (4, 0, 0), 0, ""),  # a micrometre more is not
        ((4, 2, 0), (4, 0, 0), 0, "reached"),  # 2 m left on another axis
        ((5.2, 5.2, 5.2), (4, 4, 4), 0, ""),  # 1.2 m on every axis is 2.08 m
        ((5.1, 5.1, 5.1), (4, 4, 4), 0, "reached"),  # 1.1 m on every axis is 1.91 m
        ((1, 0, 0), (4, 0, 0), 0, ""),  # passing it is not reaching it
        ((100, 0, 0), (4, 0, 0), 498, ""),  # the 499th of 500 movements
        ((100, 0, 0), (4, 0, 0), 499, "truncated"),  # the last: failure
        ((6, 0, 0), (4, 0, 0), 499, "reached"),  # reached with the last one is success
    ],
)
def test_ends(environment, target_m, displacement_m, movements, ends):
    """Algorithm 1: |O_{t+1} - U| <= th is success, MAX_STEPS movements without it failure, never both."""
    before = situation(environment, target_m, movements=movements)
    after, outcome = environment.step(before, move(displacement_m))
    assert (outcome.reached.item(), outcome.truncated.item()) == (ends == "reached", ends == "truncated")
    assert after.movements.tolist() == [movements + 1]


def test_an_untouched_chase_is_truncated_at_exactly_max_steps():
    environment = Environment(paper_scenario(max_movements=3))
    state = environment.reset([(0, 0)])
    ends = []
    for _ in range(3):
        state, outcome = environment.step(state, move((0, 0, 0)))
        ends.append((outcome.reached.item(), outcome.truncated.item()))
    assert ends == [(False, False), (False, False), (False, True)]


def test_a_movement_carries_centre_spacing_path_and_clock(environment):
    state = situation(environment, (0, 0, 100))
    state, _ = environment.step(state, move((4, 0, 0), spacing_m=1.0))
    state, _ = environment.step(state, move((-4, 2, 4), spacing_m=3.0))
    assert state.center_m.tolist() == [[0, 2, 4]]
    assert state.spacing_m.tolist() == [3]
    assert state.path_length_m.tolist() == [4 + 6]  # |(-4, 2, 4)| = 6
    # Three windows of 50 / 10 Hz, the first before any movement, and 10 m at 5 m/s (Section IV, tau).
    assert state.time_s.tolist() == pytest.approx([3 * 5 + 10 / 5])


def test_a_chase_starts_at_the_origin_at_the_initial_spacing(environment):
    state = environment.reset(chase_keys(3, 4))
    assert state.center_m.tolist() == [[0, 0, 0]] * 4
    assert state.spacing_m.tolist() == [5] * 4
    assert state.movements.tolist() == [0] * 4
    assert state.path_length_m.tolist() == [0] * 4
    assert distance_to_target_m(state).tolist() == pytest.approx([100] * 4)


def test_the_window_is_heard_where_the_trackers_are_after_the_movement():
    # Without scattering h = 1, so a window is the path loss alone: 23 - 30 - 26 log10(d / 1 m), Eqs. (1)-(2).
    environment = Environment(paper_scenario(rician_k=1e12))
    after, _ = environment.step(situation(environment, (20, 0, 0)), move((4, 0, 0), spacing_m=2.0))
    distance_m = np.array([14, 18, *[(16**2 + 2**2) ** 0.5] * 4])
    assert after.rssi_dbm[0].numpy() == pytest.approx(np.tile(-7 - 26 * np.log10(distance_m), (50, 1)), abs=1e-3)
    heard_at_m = after.observation().tracker_position_m
    assert heard_at_m[0, 0].tolist() == [[6, 0, 0], [2, 0, 0], [4, 2, 0], [4, -2, 0], [4, 0, 2], [4, 0, -2]]
    assert (heard_at_m == heard_at_m[:, :1]).all()


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (move((4, 0, 0), spacing_m=6.0), "spacing_m = 6.0"),
        (move((1, 0, 0)), "displacement_m = 1.0"),
        (move((0, float("nan"), 0)), "displacement_m = nan"),
        (Action(spacing_m=vector([5, 5])[0], displacement_m=vector((0, 0, 0), (0, 0, 0))), "1 chases"),
    ],
    ids=["spacing", "displacement", "nan", "two chases' action for one"],
)
def test_refuses_an_action_outside_the_action_sets(environment, action, message):
    with pytest.raises(InputError, match=message):
        environment.step(situation(environment, (100, 0, 0)), action)


def test_targets_are_uniform_on_their_sphere():
    """Archimedes: each coordinate of a uniform point on a sphere is uniform on [-R, R], and the others follow suit."""
    num_chases = 120_000
    position_m = draw_start_m(paper_scenario(), chase_keys(1, num_chases)).numpy()
    assert np.linalg.norm(position_m, axis=1) == pytest.approx(np.full(num_chases, 100.0), abs=1e-9)
    rank = (np.arange(num_chases) + 0.5) / num_chases
    generator = np.random.default_rng(0)
    for direction in [*np.eye(3), *generator.standard_normal((3, 3))]:
        along_m = np.sort(position_m @ direction / np.linalg.norm(direction))
        assert np.abs((along_m / 100 + 1) / 2 - rank).max() <= 0.01


WORLDS = [
    {"continuity": continuity, "los_phase": los_phase}
    for continuity, los_phase in itertools.product(["independent", "continuous"], ["common", "independent"])
]
MOVING_WORLDS = [
    {"behaviour": "wander", "target_speed_mps": 5.0, "continuity": "continuous"},
    {**load_scenario("rough").to_dict(), "behaviour": "jink", "target_speed_mps": 8.0, "alert_distance_m": 100.0},
]


def trajectory(environment, keys, choices):
    """Every number of a few movements, by name, for each chase."""
    state = environment.reset(keys)
    steps = [pack(state, "state")]
    for choice in choices:
        action = action_from_choice(environment.scenario, torch.tensor(choice).expand(len(keys), 4))
        state, outcome = environment.step(state, action)
        steps += [pack(state, "state"), pack(outcome, "outcome")]
    return steps


@settings(max_examples=20, deadline=None)
@given(
    batch_and_row=st.integers(1, 150).flatmap(lambda size: st.tuples(st.just(size), st.integers(0, size - 1))),
    first=st.integers(0, 10**6),
    world=st.sampled_from([*WORLDS, *MOVING_WORLDS]),
)
def test_a_chase_is_the_same_alone_and_anywhere_in_any_batch(batch_and_row, first, world):
    """Bit for bit, its random streams included."""
    environment = Environment(paper_scenario(**{**world, "window_samples": 17}))
    size, row = batch_and_row
    choices = [[0, 4, 3, 2], [3, 0, 2, 4]]
    batch = trajectory(environment, chase_keys(9, size, first), choices)
    alone = trajectory(environment, chase_keys(9, 1, first + row), choices)
    for (batch_tensors, batch_streams), (tensors, streams) in zip(batch, alone, strict=True):
        for name, value in tensors.items():
            torch.testing.assert_close(batch_tensors[name][row : row + 1], value, rtol=0, atol=0, equal_nan=True)
        for name, positions in streams.items():
            assert batch_streams[name][row : row + 1] == positions, name


def hovering(continuity, num_movements):
    """Windows heard one after the other at one place, [sample of all windows, tracker]."""
    environment = Environment(paper_scenario(continuity=continuity, sampling_hz=100))
    state = environment.reset([(2, 0)])
    windows_dbm = [state.rssi_dbm[0]]
    for _ in range(num_movements):
        state, _ = environment.step(state, move((0, 0, 0)))
        windows_dbm.append(state.rssi_dbm[0])
    return torch.cat(windows_dbm)


def test_continuous_fading_runs_on_through_a_movement_and_independent_fading_does_not():
    # A swarm that hovers at 100 Hz hears a seamless signal: at a window's seam (every 50 samples) it changes no more
    # than at the largest step within windows. Drawn anew, the seam jumps by decibels.
    continuous_db = hovering("continuous", 20).diff(dim=0).abs().amax(dim=1)
    anew_db = hovering("independent", 20).diff(dim=0).abs().amax(dim=1)
    seams = torch.arange(49, len(anew_db), 50)
    within = torch.ones(len(anew_db), dtype=torch.bool)
    within[seams] = False
    assert continuous_db[seams].median() < 1.5 * continuous_db[within].median()
    assert anew_db[seams].median() > 5 * anew_db[within].median()


def test_continuous_fading_pauses_for_the_travel_time():
    # Moving 4 m at 5 m/s takes 0.8 s, so the window after it begins 0.8 s later than that of a swarm that hovers.
    environment = Environment(paper_scenario(continuity="continuous"))
    start = situation(environment, (1000, 0, 0))
    hovered, _ = environment.step(start, move((0, 0, 0)))
    moved, _ = environment.step(start, move((0, 4, 0)))
    assert (moved.time_s - hovered.time_s).item() == pytest.approx(0.8)
    # The same process: 0.8 s are 8 samples, which the hovering swarm heard and the moving one missed.
    assert torch.allclose(moved.rssi_dbm[:, :42], hovered.rssi_dbm[:, 8:], atol=0.005)


SIGNED_PERMUTATIONS = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in itertools.permutations(range(3))
    for signs in itertools.product([1, -1], repeat=3)
]
"""The 48 rotations and reflections that carry the axes onto the axes."""


def tracker_after(symmetry):
    """Entry u: the tracker that stands where the symmetry carries tracker u."""
    directions = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    return [int(np.flatnonzero((directions == symmetry @ direction).all(axis=1))[0]) for direction in directions]


class TurnedStreams(ChaseStreams):
    """The same random numbers for every chase, carried over by its own symmetry: one row, one symmetry."""

    def standard_normal(self, *shape):
        return self._turned(super().standard_normal(*shape))

    def uniform(self, *shape):
        return self._turned(super().uniform(*shape))

    def _turned(self, values):
        turned = torch.empty_like(values)
        for row, symmetry in enumerate(SIGNED_PERMUTATIONS):
            if values.shape[1] == 3:  # the target's direction
                turned[row] = torch.from_numpy(symmetry).to(values.dtype) @ values[row]
            else:  # six trackers
                turned[row, tracker_after(symmetry)] = values[row]
        return turned


@pytest.mark.parametrize("world", WORLDS, ids=lambda world: "-".join(world.values()))
def test_turning_and_mirroring_the_axes_permutes_trackers_actions_and_rewards_and_changes_nothing_else(
    monkeypatch, world
):
    draw = ChaseStreams.of

    def drawn(_cls, keys, purpose):
        return TurnedStreams.at(draw(keys, purpose).positions(), len(keys))

    monkeypatch.setattr(ChaseStreams, "of", classmethod(drawn))
    environment = Environment(paper_scenario(start_distance_m=12.0, **world))
    symmetries = torch.from_numpy(np.stack(SIGNED_PERMUTATIONS))
    trackers = torch.tensor([tracker_after(symmetry) for symmetry in SIGNED_PERMUTATIONS])
    unturned = next(row for row, symmetry in enumerate(SIGNED_PERMUTATIONS) if (symmetry == np.eye(3)).all())
    chases = len(symmetries)
    assert len(set(map(tuple, trackers.tolist()))) == 48

    def assert_turned(state):
        assert torch.allclose(state.target_position_m, symmetries @ state.target_position_m[unturned])
        assert torch.allclose(state.center_m, symmetries @ state.center_m[unturned])
        heard_dbm = state.rssi_dbm.gather(2, trackers[:, None, :].expand(state.rssi_dbm.shape))
        # Sums over trackers run in another order, and a deep fade amplifies their rounding.
        assert torch.allclose(heard_dbm, state.rssi_dbm[unturned].expand_as(heard_dbm), atol=0.01)

    state = environment.reset([(4, 0)] * chases)
    assert_turned(state)
    # (spacing, displacement): towards the target of chase 0 of run 4, across and away.
    for spacing_m, displacement_m in [
        (1, (4, -2, 0)),
        (2, (-4, 4, 2)),
        (5, (0, 0, -4)),
        (3, (2, 2, 2)),
        (4, (4, 4, 4)),
    ]:
        action = Action(
            spacing_m=torch.full((chases,), spacing_m, dtype=torch.float64),
            displacement_m=symmetries @ vector(displacement_m)[0],
        )
        state, outcome = environment.step(state, action)
        assert_turned(state)
        expected_m = symmetries.abs() @ outcome.reward_m[unturned, 1:]
        assert torch.allclose(outcome.reward_m[:, 1:], expected_m)
        assert torch.allclose(outcome.reward_m[:, 0], outcome.reward_m[unturned, 0].expand(chases))
        assert (outcome.reached == outcome.reached[unturned]).all()
        assert torch.allclose(state.path_length_m, state.path_length_m[unturned].expand(chases))


def test_benchmark_counts_movements_of_every_subject():
    result = benchmark.measure(turn_s=0.001, repeats=1, batch_sizes=(1, 2))
    rates = result["movements_per_s"]
    assert {name: list(rates[name]) for name in rates} == {
        "Environment": ["1", "2"],
        "ChaseVectorEnv": ["1", "2"],
        "SyncVectorEnv": ["1", "2"],
        "ChaseEnv": ["1"],
    }
    assert all(rate > 0 for found in rates.values() for rate in found.values())
    assert json.loads(json.dumps(result)) == result
    shown = benchmark.table(result)
    assert [column.header for column in shown.columns] == ["", "1", "2"]
    assert list(shown.columns[0].cells) == list(rates)
    assert list(shown.columns[2].cells)[-1] == ""
