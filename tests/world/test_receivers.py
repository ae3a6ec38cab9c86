"""Receivers that are off, silent or lossy: what they report, whose numbers they draw, and what they leave alone."""

import dataclasses
import itertools

import numpy as np
import pytest
import torch

from swarmchase.batch.selection import join_chases, pack, select_chases, unpack
from swarmchase.batch.streams import chase_keys
from swarmchase.formation import action_from_choice
from swarmchase.scenario import Scenario, paper_scenario
from swarmchase.world.environment import Environment, State
from swarmchase.world.receivers import GARBAGE_DBM, WRONG_DB, Receivers

FAULTS = {
    "offsets": {"receiver_offset_db": 3.0},
    "silence": {"silent_trackers": 2},
    "losses": {"missing_sample_share": 0.2},
    "bursts": {"missing_sample_share": 0.2, "missing_burst_s": 1.0},
    "all": {"receiver_offset_db": 3.0, "silent_trackers": 1, "missing_sample_share": 0.3},
}
EVERY_FAULT = pytest.mark.parametrize("changes", FAULTS.values(), ids=FAULTS.keys())


def world(**changes: float) -> Scenario:
    return paper_scenario(window_samples=10, **changes)


def sample_times_s(num_chases: int, num_samples: int, sampling_hz: float = 10.0) -> torch.Tensor:
    return (torch.arange(num_samples, dtype=torch.float64) / sampling_hz).expand(num_chases, -1)


def windows(scenario: Scenario, num_chases: int, num_movements: int, first: int = 0) -> list[State]:
    """The states of these chases while they move in the same way."""
    environment = Environment(scenario)
    states = [environment.reset(chase_keys(4, num_chases, first))]
    for movement in range(num_movements):
        choice = torch.tensor([movement % 5, 4, 2, 1]).expand(num_chases, -1)
        states.append(environment.step(states[-1], action_from_choice(scenario, choice))[0])
    return states


def same(one: torch.Tensor, other: torch.Tensor) -> bool:
    """Bit for bit, a missing sample being like any other."""
    return torch.equal(one.view(torch.int32), other.view(torch.int32))


def test_perfect_receivers_report_what_arrives_and_carry_nothing() -> None:
    receivers = Receivers(world())
    state = receivers.begin(chase_keys(4, 3))
    assert set(vars(state).values()) == {None}
    arriving_dbm = torch.randn(3, 10, 6)
    assert receivers.reported_dbm(state, sample_times_s(3, 10), arriving_dbm)[0] is arriving_dbm


def test_by_hand() -> None:
    """Offsets are added to every sample of their tracker, and a silent one reports nothing."""
    receivers = Receivers(world(receiver_offset_db=3, silent_trackers=1))
    state = dataclasses.replace(
        receivers.begin(chase_keys(4, 1)),
        offset_db=torch.tensor([[0.5, -1, 0, 2, 3, -3]]),
        silent=torch.tensor([[False, False, True, False, False, False]]),
    )
    arriving_dbm = torch.tensor([[[-60.0] * 6, [-50.0] * 6]])
    reported_dbm = receivers.reported_dbm(state, sample_times_s(1, 2), arriving_dbm)[0][0]
    assert reported_dbm[:, [0, 1, 3, 4, 5]].tolist() == [[-59.5, -61, -58, -57, -63], [-49.5, -51, -48, -47, -53]]
    assert reported_dbm[:, 2].isnan().all()
    assert (arriving_dbm[0, 0] == -60).all()


def test_offsets_are_uniform_and_each_tracker_s_own() -> None:
    """20,000 chases: a mean of 3 / sqrt(3) / sqrt(20,000) = .012 dB, ranks to .01, correlations to .007."""
    offset_db = Receivers(world(receiver_offset_db=3)).begin(chase_keys(4, 20_000)).offset_db
    assert offset_db is not None
    assert offset_db.abs().max() <= 3
    rank = (torch.arange(20_000) + 0.5) / 20_000
    for tracker in range(6):
        ordered_db = offset_db[:, tracker].sort().values
        assert ((ordered_db + 3) / 6 - rank).abs().max() < 0.02
    assert (torch.corrcoef(offset_db.T) - torch.eye(6)).abs().max() < 0.035


def test_an_offset_stays_the_same_over_a_chase() -> None:
    heard = windows(world(receiver_offset_db=3), 5, 4)
    arriving = windows(world(), 5, 4)
    offset_db = torch.stack([one.rssi_dbm - other.rssi_dbm for one, other in zip(heard, arriving, strict=True)])
    first_db = offset_db[0, :, 0]
    assert offset_db == pytest.approx(first_db[None, :, None].expand_as(offset_db), abs=1e-4)
    assert (first_db.abs() > 0.01).all()
    assert len(first_db.flatten().round(decimals=3).unique()) == 30


@pytest.mark.parametrize("number", [0, 1, 2, 5, 6])
def test_as_many_trackers_are_silent_as_the_scenario_says_and_always_the_same(number: int) -> None:
    states = windows(world(silent_trackers=number), 300, 2)
    silent = torch.stack([one.rssi_dbm.isnan().all(dim=1) for one in states])
    assert (silent.sum(dim=2) == number).all()
    assert (silent == silent[0]).all()
    heard = torch.cat([one.rssi_dbm for one in states])[~silent.flatten(0, 1)[:, None].expand(-1, 10, -1)]
    assert heard.isfinite().all()


def test_any_pair_of_trackers_is_silent_as_often_as_any_other() -> None:
    """15,000 chases, 15 pairs: 1000 each, with a standard deviation of 31."""
    silent = Receivers(world(silent_trackers=2)).begin(chase_keys(4, 15_000)).silent
    assert silent is not None
    counts = [int((silent[:, one] & silent[:, other]).sum()) for one, other in itertools.combinations(range(6), 2)]
    assert sum(counts) == 15_000
    assert max(abs(count - 1000) for count in counts) < 130


@pytest.mark.parametrize("share", [0.01, 0.2, 0.7])
def test_the_share_of_missing_samples(share: float) -> None:
    """Of 108,000 samples; each goes missing whatever happens to those next to it, at any tracker, in any window."""
    states = windows(world(missing_sample_share=share), 600, 2)
    missing = torch.stack([one.rssi_dbm.isnan() for one in states]).double()
    assert missing.numel() == 108_000
    assert missing.mean().item() == pytest.approx(share, abs=4 * (share * (1 - share) / 108_000) ** 0.5)
    for dim in range(4):
        with_next = missing.narrow(dim, 1, missing.shape[dim] - 1) * missing.narrow(dim, 0, missing.shape[dim] - 1)
        assert with_next.mean().item() == pytest.approx(share**2, abs=0.012), dim
    every = torch.stack([one.rssi_dbm for one in windows(world(missing_sample_share=1), 3, 1)])
    assert every.isnan().all()


@pytest.mark.parametrize("continuity", ["independent", "continuous"])
@EVERY_FAULT
def test_faults_change_neither_the_target_nor_the_fading(changes: dict[str, float], continuity: str) -> None:
    """What is reported is what arrives in the world without faults, plus the offset, where it is reported at all."""
    spoilt = windows(world(continuity=continuity, **changes), 8, 3)
    perfect = windows(world(continuity=continuity), 8, 3)
    for one, other in zip(spoilt, perfect, strict=True):
        assert torch.equal(one.target_position_m, other.target_position_m)
        assert pack(one.radio.fading, "fading")[1] == pack(other.radio.fading, "fading")[1]
        offset_db = 0 if one.radio.receivers.offset_db is None else one.radio.receivers.offset_db[:, None]
        reported = one.rssi_dbm.isfinite()
        assert same(one.rssi_dbm[reported], (other.rssi_dbm + offset_db)[reported])
    assert not all(same(one.rssi_dbm, other.rssi_dbm) for one, other in zip(spoilt, perfect, strict=True))


def test_the_seed_decides() -> None:
    scenario = world(**FAULTS["all"])
    once, again, otherwise = (Environment(scenario).reset(chase_keys(seed, 6)).rssi_dbm.isnan() for seed in (4, 4, 5))
    assert torch.equal(once, again)
    assert not torch.equal(once, otherwise)


@EVERY_FAULT
def test_a_chase_is_the_same_alone_and_in_a_batch(changes: dict[str, float]) -> None:
    batch = windows(world(**changes), 9, 2, first=20)
    for row in (0, 5, 8):
        alone = windows(world(**changes), 1, 2, first=20 + row)
        for one, other in zip(batch, alone, strict=True):
            assert same(one.rssi_dbm[row : row + 1], other.rssi_dbm)


@EVERY_FAULT
def test_a_batch_cut_joined_and_filed_goes_on_as_if_nothing_had_been(changes: dict[str, float]) -> None:
    scenario = world(**changes)
    environment = Environment(scenario)
    expected, found = (windows(scenario, 5, 1)[-1] for _ in range(2))
    found = join_chases(select_chases(found, [4, 2]), select_chases(found, [0, 1, 3]))
    tensors, positions = pack(found, "state")
    found = unpack(environment.reset(chase_keys(99, 5)), "state", tensors, positions)
    order = [4, 2, 0, 1, 3]
    choice = torch.tensor([0, 1, 2, 3])
    for _ in range(2):
        expected, _ = environment.step(expected, action_from_choice(scenario, choice.expand(5, -1)))
        found, _ = environment.step(found, action_from_choice(scenario, choice.expand(5, -1)))
        assert same(found.rssi_dbm, expected.rssi_dbm[order])
        for name in ("offset_db", "silent"):
            one, other = getattr(found.radio.receivers, name), getattr(expected.radio.receivers, name)
            assert one is other is None or np.array_equal(one, other[order])


# What real receivers do beside.


def reported(scenario: Scenario, arriving_dbm: torch.Tensor, seed: int = 4) -> torch.Tensor:
    receivers = Receivers(scenario)
    state = receivers.begin(chase_keys(seed, len(arriving_dbm)))
    return receivers.reported_dbm(state, sample_times_s(*arriving_dbm.shape[:2]), arriving_dbm)[0]


def arriving(num_chases: int, num_samples: int) -> torch.Tensor:
    """Levels around -60 dBm, from -100 to -20."""
    drawn = np.random.default_rng(7).uniform(-100, -20, (num_chases, num_samples, 6))
    return torch.from_numpy(drawn).float()


def test_steps_floor_and_ceiling_by_hand() -> None:
    scenario = world(receiver_step_db=2.0, receiver_floor_dbm=-95.0, receiver_ceiling_dbm=-30.5)
    levels_dbm = torch.tensor([[[-95.01, -94.99, -60.9, -61.1, -30.0, -12.0]]])
    found = reported(scenario, levels_dbm)[0, 0]
    assert found[0].isnan()
    assert found[1:].tolist() == [-94, -60, -62, -30.5, -30.5]
    levels_dbm = arriving(20, 30)
    half = reported(world(receiver_step_db=0.5), levels_dbm)
    assert torch.equal(half * 2, (half * 2).round())
    assert (half - levels_dbm).abs().max() <= 0.25 + 1e-5
    assert reported(world(receiver_floor_dbm=-70.0), levels_dbm).nan_to_num(0).min() >= -70
    assert reported(world(receiver_ceiling_dbm=-40.0), levels_dbm).max() == -40


@pytest.mark.parametrize("number", [1, 3, 6])
def test_wrong_trackers_are_off_by_twenty_db_either_way(number: int) -> None:
    levels_dbm = arriving(2_000, 5)
    off_db = (reported(world(wrong_trackers=number), levels_dbm) - levels_dbm).mean(dim=1)
    wrong = off_db.abs() > 10
    assert (wrong.sum(dim=1) == number).all()
    assert off_db[wrong].abs() == pytest.approx(torch.full_like(off_db[wrong], WRONG_DB), abs=1e-3)
    assert (off_db[wrong] > 0).double().mean().item() == pytest.approx(0.5, abs=0.05)
    assert wrong.double().mean(dim=0) == pytest.approx(torch.full((6,), number / 6).double(), abs=0.045)
    assert off_db[~wrong].abs().max().item() < 1e-3 if number < 6 else wrong.all()


def test_a_stuck_tracker_keeps_the_first_level_that_it_has_heard() -> None:
    levels_dbm = arriving(300, 20)
    levels_dbm[:, :3] = torch.nan  # the target begins to transmit late
    levels_dbm[:, 7:9] = torch.nan
    levels_dbm[0, :] = torch.nan  # or never
    found = reported(world(stuck_trackers=2), levels_dbm)
    assert found[:, :3].isnan().all()
    assert found[0].isnan().all()
    stuck = (found[1:, 3:] == levels_dbm[1:, 3:4]).all(dim=1)
    assert (stuck.sum(dim=1) == 2).all()
    others = ~stuck[:, None].expand(-1, 20, -1)
    assert same(found[1:][others], levels_dbm[1:][others])


@pytest.mark.parametrize("share", [0.02, 0.5, 1.0])
def test_garbage_is_what_receivers_have_been_seen_to_report(share: float) -> None:
    """72,000 samples; each value as often as any other."""
    levels_dbm = arriving(600, 20)
    found = reported(world(garbage_share=share), levels_dbm)
    is_garbage = torch.isin(found, torch.tensor(GARBAGE_DBM))
    assert is_garbage.double().mean().item() == pytest.approx(share, abs=0.008)
    assert same(found[~is_garbage], levels_dbm[~is_garbage])
    for value_dbm in GARBAGE_DBM:
        part = (found == value_dbm).double().mean().item()
        assert part == pytest.approx(share / len(GARBAGE_DBM), abs=0.005), value_dbm
    silent = torch.full((600, 20, 6), torch.nan)
    assert reported(world(garbage_share=share), silent).isfinite().double().mean().item() == pytest.approx(
        share, abs=0.008
    )


@pytest.mark.parametrize(("share", "burst_s"), [(0.2, 1.0), (0.5, 0.4), (0.1, 3.0)])
def test_gaps_have_their_share_and_last_as_long_as_they_should(share: float, burst_s: float) -> None:
    """600 chases of 60 s: gaps are each tracker's own, and as many as share x 60 s / their length."""
    scenario = world(missing_sample_share=share, missing_burst_s=burst_s)
    missing = reported(scenario, torch.zeros(600, 600, 6)).isnan()
    assert missing.double().mean().item() == pytest.approx(share, abs=0.012)
    begun = (missing[:, 1:] & ~missing[:, :-1]).sum().item()
    # The chance to be in a gap 0.1 s after none.
    expected = (1 - share) * share * (1 - np.exp(-0.1 / (burst_s * (1 - share)))) * 600 * 599 * 6
    assert begun == pytest.approx(expected, rel=0.05)
    assert (torch.corrcoef(missing.flatten(0, 1).double().T) - torch.eye(6)).abs().max() < 0.05


REAL: dict[str, float] = {
    "receiver_offset_db": 3.0,
    "silent_trackers": 1,
    "missing_sample_share": 0.3,
    "missing_burst_s": 0.5,
    "receiver_step_db": 0.5,
    "receiver_floor_dbm": -90.0,
    "receiver_ceiling_dbm": -30.0,
    "wrong_trackers": 1,
    "stuck_trackers": 2,
    "garbage_share": 0.1,
}


@pytest.mark.parametrize("left_out", ["nothing", "missing_burst_s", "missing_sample_share", "garbage_share"])
def test_what_is_reported_is_the_same_in_pieces_and_in_any_batch(left_out: str) -> None:
    scenario = world(**{name: value for name, value in REAL.items() if name != left_out})
    receivers, keys = Receivers(scenario), chase_keys(4, 12)
    levels_dbm, time_s = arriving(12, 40), sample_times_s(12, 40)
    whole, _ = receivers.reported_dbm(receivers.begin(keys), time_s, levels_dbm)
    for rows in ([0], [11, 4], list(range(12))):
        state, pieces = receivers.begin([keys[row] for row in rows]), []
        for first, end in ((0, 1), (1, 2), (2, 25), (25, 40)):
            piece, state = receivers.reported_dbm(state, time_s[rows, first:end], levels_dbm[rows, first:end])
            pieces.append(piece)
        assert same(torch.cat(pieces, dim=1), whole[rows])


def test_a_new_fault_leaves_the_old_ones_as_they_were() -> None:
    """Offsets and silence are drawn before all that came later."""
    old = Receivers(world(receiver_offset_db=3, silent_trackers=2)).begin(chase_keys(4, 50))
    new = Receivers(world(**{**REAL, "silent_trackers": 2, "wrong_trackers": 0})).begin(chase_keys(4, 50))
    assert old.offset_db is not None
    assert torch.equal(old.offset_db, new.offset_db)
    assert torch.equal(old.silent, new.silent)
