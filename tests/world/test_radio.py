"""The radio as a function of times and places: what it is made of, added by hand, and how a flight may be cut."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
import torch
from scipy.special import j0

from swarmchase.batch.selection import select_chases
from swarmchase.batch.streams import chase_keys
from swarmchase.channel.fading_process import fading_process
from swarmchase.channel.propagation import ground_reflection_db, unfaded_dbm
from swarmchase.channel.shadowing import Shadowing
from swarmchase.formation import tracker_position_m
from swarmchase.scenario import SPEED_OF_LIGHT_MPS, Scenario, paper_scenario
from swarmchase.world.radio import Radio, RadioState, rssi_dbm

REAL: dict[str, Any] = {
    "continuity": "in_flight",
    "transmit_power_error_db": 6.0,
    "path_loss_exponent_error": 0.5,
    "shadowing_db": 3.0,
    "ground_reflection": 0.5,
    "transmit_duty": 0.4,
    "silence_s": 1.0,
    "between_silences_s": 5.0,
    "receiver_offset_db": 3.0,
    "missing_sample_share": 0.2,
    "missing_burst_s": 0.3,
    "receiver_step_db": 1.0,
    "receiver_floor_dbm": -80.0,
    "receiver_ceiling_dbm": -40.0,
    "wrong_trackers": 1,
    "stuck_trackers": 1,
    "silent_trackers": 1,
    "garbage_share": 0.05,
}


def flight(
    num_chases: int, num_samples: int, sampling_hz: float = 20.0
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(time, target's place, trackers' places): each swarm flies another way, and its target crosses it."""
    time_s = (torch.arange(1, num_samples + 1, dtype=torch.float64) / sampling_hz).expand(num_chases, -1)
    velocity_mps = torch.from_numpy(np.random.default_rng(3).uniform(-8, 8, (num_chases, 3)))
    center_m = (time_s[..., None] * velocity_mps[:, None]).flatten(0, 1)
    trackers_m = tracker_position_m(center_m, torch.full((len(center_m),), 5.0).double())
    target_m = torch.tensor([40.0, -10, 4]) + time_s[..., None] * torch.tensor([0.0, 7, 1])
    return time_s, target_m.double(), trackers_m.unflatten(0, (num_chases, num_samples))


def heard(scenario: Scenario, num_chases: int, num_samples: int = 30) -> tuple[torch.Tensor, RadioState]:
    radio = Radio(scenario)
    return radio.heard_dbm(radio.begin(chase_keys(4, num_chases)), *flight(num_chases, num_samples))


def same(one: torch.Tensor, other: torch.Tensor) -> bool:
    """Bit for bit, a missing sample being like any other."""
    return torch.equal(one.nan_to_num(999.0), other.nan_to_num(999.0))


def test_the_paper_s_radio_carries_its_streams_and_nothing_else() -> None:
    state = Radio(paper_scenario()).begin(chase_keys(1, 2))
    carried = dataclasses.asdict(
        state, dict_factory=lambda parts: {name: part for name, part in parts if part is not None}
    )
    assert {name for name, part in carried.items() if part} == {"fading"}


def test_one_place_is_that_of_all_samples() -> None:
    for changes in ({}, {"continuity": "continuous"}, {"continuity": "in_flight"}, {**REAL, "shadowing_db": 0.0}):
        radio = Radio(paper_scenario(**changes))
        time_s, target_m, trackers_m = (part[:, :1] for part in flight(4, 1))
        time_s = time_s + torch.arange(30) / 20
        once, _ = radio.heard_dbm(radio.begin(chase_keys(4, 4)), time_s, target_m, trackers_m)
        again, _ = radio.heard_dbm(
            radio.begin(chase_keys(4, 4)), time_s, target_m.expand(-1, 30, -1), trackers_m.expand(-1, 30, -1, -1)
        )
        assert once.shape == (4, 30, 6)
        assert same(once, again)


def test_fading_runs_as_fast_as_they_fly_past_each_other() -> None:
    """The gain of a process that has been told the lengths of the relative ways, from window to window."""
    scenario = paper_scenario(continuity="in_flight", sampling_hz=20)
    time_s, target_m, trackers_m = flight(3, 40)
    relative_m = trackers_m - target_m[:, :, None]
    moved_m = torch.cat([torch.zeros(3, 1, 6), relative_m.diff(dim=1).norm(dim=3)], dim=1)
    process = fading_process(scenario)
    fading, _ = process.gain(process.begin(chase_keys(4, 3)), time_s, moved_m)
    expected = rssi_dbm(scenario, relative_m.norm(dim=3), fading)
    radio = Radio(scenario)
    state, found = radio.begin(chase_keys(4, 3)), []
    for first, end in ((0, 10), (10, 11), (11, 40)):
        piece, state = radio.heard_dbm(state, *(part[:, first:end] for part in (time_s, target_m, trackers_m)))
        found.append(piece)
    assert torch.allclose(torch.cat(found, dim=1), expected, atol=2e-3)


def test_a_swarm_that_flies_beside_its_target_hears_what_one_that_hovers_hears() -> None:
    """Power's autocovariance (6 J0 + J0^2) / 16 at the floor of 1 Hz while both fly at 10 m/s, and at 100 Hz while one
    does."""
    scenario = paper_scenario(continuity="in_flight", sampling_hz=20, spatial_correlation=0)
    num_chases, num_samples = 4_000, 20
    time_s = (torch.arange(num_samples, dtype=torch.float64) / 20).expand(num_chases, -1)
    way_m = time_s[0, :, None] * torch.tensor([6.0, 8, 0]).double()
    spread_m = tracker_position_m(torch.zeros(1, 3).double(), torch.tensor([5.0]).double())[0]
    for target_flies, doppler_hz in ((True, 1.0), (False, 10 * 3e9 / SPEED_OF_LIGHT_MPS)):
        radio = Radio(scenario)
        target_m = (torch.tensor([1e4, 0, 0]) + way_m * target_flies).expand(num_chases, -1, -1)
        trackers_m = (way_m[:, None] + spread_m).expand(num_chases, -1, -1, -1)
        level_dbm, _ = radio.heard_dbm(radio.begin(chase_keys(6, num_chases)), time_s, target_m, trackers_m)
        power = 10 ** ((level_dbm.double() - unfaded_dbm(scenario, torch.tensor(1e4))) / 10)
        deviation = power - power.mean()
        for lag in range(6):
            measured = (deviation[:, : num_samples - lag] * deviation[:, lag:]).mean().item()
            bessel = j0(2 * np.pi * doppler_hz * lag / 20)
            assert measured == pytest.approx((6 * bessel + bessel**2) / 16, abs=0.02), (target_flies, lag)


def test_power_and_exponent_errors_are_each_chase_s_own_uniform_and_stay() -> None:
    """20,000 chases; power adds to every level, the exponent by distance: 10 e log10(d / d_0)."""
    told = paper_scenario(rician_k=1e12, window_samples=1)
    wrong = dataclasses.replace(told, transmit_power_error_db=6.0, path_loss_exponent_error=0.5)
    radio, state = Radio(wrong), Radio(wrong).begin(chase_keys(4, 20_000))
    assert state.errors.power_db is not None
    assert state.errors.exponent is not None
    rank = (torch.arange(20_000) + 0.5) / 20_000
    for error, most in ((state.errors.power_db, 6.0), (state.errors.exponent, 0.5)):
        assert (((error.sort().values + most) / (2 * most)) - rank).abs().max() < 0.02
    assert abs(float(torch.corrcoef(torch.stack([state.errors.power_db, state.errors.exponent]))[0, 1])) < 0.035
    target_m = torch.zeros(20_000, 1, 3).double()
    trackers_m = torch.tensor([0.5, 1, 2, 10, 100, 300]).double()[:, None] * torch.tensor([1.0, 0, 0])
    for _ in range(2):
        level_dbm, state = radio.heard_dbm(
            state, torch.zeros(20_000, 1).double(), target_m, trackers_m.expand(20_000, 1, 6, 3)
        )
        decades = torch.tensor([0.0, 0, math.log10(2), 1, 2, math.log10(300)]).double()
        exponent = told.path_loss_exponent + state.errors.exponent[:, None]
        expected = 23 - 30 + state.errors.power_db[:, None] - 10 * exponent * decades
        assert (level_dbm[:, 0] - expected).abs().max() < 1e-3


def test_each_part_adds_what_it_says() -> None:
    """With the line of sight alone nothing fades, and the rest can be told apart."""
    told = paper_scenario(rician_k=1e12, continuity="in_flight", sampling_hz=20, shadowing_distance_m=8.0)
    _, target_m, trackers_m = flight(3, 30)
    plain = unfaded_dbm(told, (trackers_m - target_m[:, :, None]).norm(dim=3))
    shadowed = dataclasses.replace(told, shadowing_db=3.0)
    shadowing = Shadowing(shadowed)
    expected = plain + shadowing.added_db(shadowing.begin(chase_keys(4, 3)), target_m, trackers_m)
    assert torch.allclose(heard(shadowed, 3)[0].double(), expected, atol=1e-3)
    reflected = dataclasses.replace(told, ground_reflection=0.5)
    expected = plain + ground_reflection_db(reflected, target_m[:, :, None], trackers_m)
    assert torch.allclose(heard(reflected, 3)[0].double(), expected, atol=1e-3)


def test_a_target_that_pauses_is_heard_by_nobody() -> None:
    level_dbm, _ = heard(paper_scenario(transmit_duty=0.4, frame_s=0.3), 200)
    missing = level_dbm.isnan()
    assert (missing == missing[:, :, :1]).all()
    assert missing.double().mean().item() == pytest.approx(0.6, abs=0.04)
    arriving_dbm, _ = heard(paper_scenario(), 200)
    assert torch.equal(level_dbm[~missing], arriving_dbm[~missing])


@pytest.mark.parametrize("left_out", ["nothing", "continuity", "shadowing_db"])
def test_a_real_radio_is_the_same_in_any_batch_and_goes_on_in_any(left_out: str) -> None:
    scenario = paper_scenario(**{name: value for name, value in REAL.items() if name != left_out})
    radio, keys = Radio(scenario), chase_keys(4, 60)
    ways = flight(60, 100)
    whole = [part[:, :50] for part in ways], [part[:, 50:] for part in ways]
    first, state = radio.heard_dbm(radio.begin(keys), *whole[0])
    second, _ = radio.heard_dbm(state, *whole[1])
    assert 0.2 < first.isfinite().double().mean().item() < 0.8
    for rows in ([0], [59, 3], [17, *range(20, 50)]):
        its_first, its_state = radio.heard_dbm(
            radio.begin([keys[row] for row in rows]), *(part[rows] for part in whole[0])
        )
        assert same(its_first, first[rows])
        its_second, _ = radio.heard_dbm(select_chases(its_state, [0]), *(part[rows[:1]] for part in whole[1]))
        assert same(its_second, second[rows[:1]])


def test_a_real_flight_in_pieces() -> None:
    """All but shadowing, which is interpolated between the ends of a piece, is the same; levels are steps."""
    scenario = paper_scenario(**{**REAL, "shadowing_db": 0.0, "receiver_step_db": 0.0})
    radio, ways = Radio(scenario), flight(20, 60)
    whole, _ = radio.heard_dbm(radio.begin(chase_keys(4, 20)), *ways)
    state, pieces = radio.begin(chase_keys(4, 20)), []
    for first, end in ((0, 1), (1, 30), (30, 59), (59, 60)):
        piece, state = radio.heard_dbm(state, *(part[:, first:end] for part in ways))
        pieces.append(piece)
    found = torch.cat(pieces, dim=1)
    assert torch.equal(found.isnan(), whole.isnan())
    assert torch.allclose(found, whole, atol=5e-3, equal_nan=True)
