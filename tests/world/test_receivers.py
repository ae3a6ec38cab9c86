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
from swarmchase.world.receivers import Receivers

FAULTS = {
    "offsets": {"receiver_offset_db": 3.0},
    "silence": {"silent_trackers": 2},
    "losses": {"missing_sample_share": 0.2},
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
