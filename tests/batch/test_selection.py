"""Batches of chases taken apart and put together, and the loop that keeps a batch full."""

import json
from dataclasses import dataclass

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmchase.batch.selection import join_chases, pack, select_chases, unpack
from swarmchase.batch.streams import chase_keys
from swarmchase.controllers.random import RandomController
from swarmchase.errors import InputError
from swarmchase.evaluation.chases import ChaseResult, run_chases
from swarmchase.evaluation.statistics import nearest_rank_percentile
from swarmchase.formation import action_from_choice
from swarmchase.scenario import paper_scenario
from swarmchase.world.environment import Environment

LOSSY = {"missing_sample_share": 0.2}
RUNNING = {"continuity": "continuous", "los_phase": "independent"}
REAL = {
    "continuity": "in_flight",
    "los_phase": "independent",
    "transmit_power_error_db": 6.0,
    "path_loss_exponent_error": 0.5,
    "shadowing_db": 3.0,
    "ground_reflection": 0.5,
    "transmit_duty": 0.4,
    "silence_s": 4.0,
    "receiver_offset_db": 3.0,
    "missing_sample_share": 0.2,
    "missing_burst_s": 0.5,
    "receiver_step_db": 1.0,
    "receiver_floor_dbm": -95.0,
    "receiver_ceiling_dbm": -20.0,
    "wrong_trackers": 1,
    "stuck_trackers": 1,
    "silent_trackers": 1,
    "garbage_share": 0.05,
}
WORLDS = [{}, {"los_phase": "independent"}, {"continuity": "continuous"}, LOSSY, RUNNING, REAL]


def fresh(world, num_chases, movements=0):
    """A batch some movements into its chases, on streams of its own."""
    environment = Environment(paper_scenario(window_samples=5, **world))
    state = environment.reset(chase_keys(1, num_chases))
    for movement in range(movements):
        state = moved(environment, state, [[movement % 5, 0, 3, 4]] * num_chases)
    return environment, state


def moved(environment, state, choices):
    return environment.step(state, action_from_choice(environment.scenario, torch.tensor(choices)))[0]


def assert_equal(one, other):
    """Every tensor and every stream of two batches, bit for bit."""
    (tensors, positions), (other_tensors, other_positions) = pack(one, "it"), pack(other, "it")
    assert tensors.keys() == other_tensors.keys()
    for name, tensor in tensors.items():
        assert torch.equal(tensor.nan_to_num(), other_tensors[name].nan_to_num()), name
    assert positions == other_positions


def test_selecting_and_joining_by_hand():
    @dataclass(frozen=True)
    class Inner:
        number: torch.Tensor
        absent: None

    @dataclass(frozen=True)
    class Outer:
        inner: Inner
        row: torch.Tensor

    batch = Outer(Inner(torch.tensor([10, 11, 12]), None), torch.tensor([[0.0, 0.5], [1.0, 1.5], [2.0, 2.5]]))
    chosen = select_chases(batch, [2, 0])
    assert chosen.inner.number.tolist() == [12, 10]
    assert chosen.row.tolist() == [[2, 2.5], [0, 0.5]]
    both = join_chases(chosen, batch)
    assert both.inner.number.tolist() == [12, 10, 10, 11, 12]
    assert both.row[:, 0].tolist() == [2, 0, 0, 1, 2]
    assert both.inner.absent is None
    assert pack(both, "x")[0].keys() == {"x.inner.number", "x.row"}


@settings(max_examples=40, deadline=None)
@given(
    world=st.sampled_from(WORLDS),
    movements=st.integers(0, 2),
    order=st.integers(1, 9).flatmap(lambda num_chases: st.permutations(range(num_chases))),
    cut=st.integers(0, 9),
)
def test_a_batch_cut_and_joined_again_goes_on_as_if_nothing_had_been(world, movements, order, cut):
    cut = min(cut, len(order))
    choices = [[chase % 5, 4 - chase % 5, 2, chase % 3] for chase in range(len(order))]
    environment, untouched = fresh(world, len(order), movements)
    _, batch = fresh(world, len(order), movements)
    assert_equal(select_chases(batch, range(len(order))), untouched)
    joined = join_chases(select_chases(batch, order[:cut]), select_chases(batch, order[cut:]))
    joined = moved(environment, joined, [choices[chase] for chase in order])
    back = select_chases(joined, [order.index(chase) for chase in range(len(order))])
    assert_equal(back, moved(environment, untouched, choices))


@settings(max_examples=40, deadline=None)
@given(world=st.sampled_from(WORLDS), num_chases=st.integers(1, 5), movements=st.integers(0, 2))
def test_a_batch_taken_apart_for_a_file_goes_on_as_if_nothing_had_been(world, num_chases, movements):
    environment, state = fresh(world, num_chases, movements)
    tensors, positions = pack(state, "state")
    tensors = {name: tensor.clone() for name, tensor in tensors.items()}
    positions = json.loads(json.dumps(positions))
    # ``like`` gives the form alone: another run, another moment.
    like = environment.reset(chase_keys(77, num_chases))
    restored = unpack(like, "state", tensors, positions)
    assert_equal(restored, state)
    choices = [[4, 3, 2, 1]] * num_chases
    assert_equal(moved(environment, restored, choices), moved(environment, state, choices))


@pytest.mark.parametrize("lost", ["state.center_m", "state.radio.fading.harmonics", "state.radio.receivers.streams"])
def test_unpacking_names_what_is_missing(lost):
    _, state = fresh({**RUNNING, **LOSSY}, 2)
    tensors, positions = pack(state, "state")
    tensors.pop(lost, None)
    positions.pop(lost, None)
    with pytest.raises(InputError, match=lost):
        unpack(state, "state", tensors, positions)


SPOILED_PARTS = {
    "a chase too few": lambda tensors, positions: tensors.update({"state.center_m": tensors["state.center_m"][:1]}),
    "another type": lambda tensors, positions: tensors.update({"state.center_m": tensors["state.center_m"].float()}),
    "an axis too many": lambda tensors, positions: tensors.update({"state.spacing_m": tensors["state.center_m"]}),
    "a stream too few": lambda tensors, positions: positions["state.radio.receivers.streams"].pop(),
    "streams that are none": lambda tensors, positions: positions.update({"state.radio.receivers.streams": "ab"}),
    "a word too few": lambda tensors, positions: positions["state.radio.receivers.streams"][1]["state"]["state"].pop(),
    "a word too long": lambda tensors, positions: positions["state.radio.receivers.streams"][1].update(
        state={"state": [2**64, 1, 2, 3]}
    ),
    "another generator": lambda tensors, positions: positions["state.radio.receivers.streams"][0].update(
        bit_generator="PCG64"
    ),
    "no number": lambda tensors, positions: positions["state.radio.receivers.streams"][0].update(has_uint32=None),
}


@pytest.mark.parametrize("spoil", SPOILED_PARTS.values(), ids=SPOILED_PARTS.keys())
def test_unpacking_refuses_another_form(spoil):
    _, state = fresh({**RUNNING, **LOSSY}, 2)
    tensors, positions = pack(state, "state")
    spoil(tensors, positions)
    with pytest.raises(InputError, match="resume state lacks state"):
        unpack(state, "state", tensors, positions)


def test_refuses_what_has_no_chases():
    with pytest.raises(TypeError, match="cannot batch a list"):
        select_chases([1, 2], [0])


@pytest.fixture(scope="module")
def near():
    """Chases that the random controller ends both ways: the target 8 m away, at most 30 movements."""
    return paper_scenario(start_distance_m=8.0, max_movements=30, window_samples=2)


def by_hand(scenario, chase):
    """One chase of run 6, alone, movement by movement."""
    environment, controller = Environment(scenario), RandomController(scenario)
    state, memory = environment.reset([(6, chase)]), controller.begin(1, 6, chase)
    reached = False
    while not reached and state.movements.item() < scenario.max_movements:
        action, memory = controller.decide(state.observation(), memory)
        state, outcome = environment.step(state, action)
        reached = outcome.reached.item()
    return ChaseResult(
        6,
        chase,
        *state.target_position_m[0].tolist(),
        movements=state.movements.item() if reached else 31,
        reached=reached,
        path_length_m=state.path_length_m.item(),
    )


@pytest.fixture(scope="module")
def rows_by_hand(near):
    return [by_hand(near, chase) for chase in range(100, 130)]


@pytest.mark.parametrize("batch_size", [1, 7, 64])
def test_the_rows_are_those_of_chases_run_alone_whatever_the_batch(near, rows_by_hand, batch_size):
    rows = list(run_chases(near, RandomController(near), 6, range(100, 130), batch_size))
    assert sorted(rows, key=lambda row: row.chase) == rows_by_hand
    assert {row.reached for row in rows} == {True, False}


def test_no_chases_make_no_rows(near):
    assert list(run_chases(near, RandomController(near), 6, [])) == []


@pytest.mark.parametrize(("chases", "batch_size"), [([0, 2], 8), ([1, 0], 8), ([0, 1], 0)])
def test_refuses_scattered_chases_and_an_empty_batch(near, chases, batch_size):
    with pytest.raises(InputError, match="refused"):
        list(run_chases(near, RandomController(near), 6, chases, batch_size))


@pytest.mark.parametrize(
    ("percent", "value"), [(0, 15), (5, 15), (20, 15), (20.1, 20), (30, 20), (40, 20), (50, 35), (100, 50)]
)
def test_nearest_rank_percentile_by_hand(percent, value):
    assert nearest_rank_percentile([50, 15, 40, 20, 35], percent) == value


def test_nearest_rank_percentile_of_a_hundred_is_the_rank_itself():
    assert [nearest_rank_percentile(range(1, 101), percent) for percent in range(1, 101)] == list(range(1, 101))
