"""Whether what is heard fits one transmitter: swarms that fly to one through the radio of the world, and another one
whose power adds up with it.
"""

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch

from swarmchase.controllers.belief import GAUSSIAN_REACH, Belief
from swarmchase.live.service import second_transmitter
from swarmchase.live.service.pace import Window
from swarmchase.live.service.safety import formation_m
from swarmchase.live.service.sample_window import Levels
from swarmchase.live.service.second_transmitter import ANY, CERTAIN, DISPROVED, ENOUGH, SecondTransmitter
from swarmchase.scenario import Scenario, load_scenario
from swarmchase.world.radio import Radio

FLIGHT, FIELD = load_scenario("flight"), load_scenario("field")
ORIGIN_M = np.array([100.0, -50.0, 20.0])
"""Of the belief's frame, in that of the windows."""
FROM_M, SPEED_MPS = 170.0, 10.0
BESIDE = (0.0, 100.0, 0.0)
"""Another transmitter, seen from the one that is flown to."""


def heard_dbm(scenario: Scenario, seed: int, position_m: np.ndarray, source_m: tuple[float, ...]) -> np.ndarray:
    """What the world's radio reports of a transmitter that stands there [sample, tracker]."""
    radio, time_s = Radio(scenario), torch.arange(len(position_m), dtype=torch.float64) / scenario.sampling_hz
    place_m = torch.tensor(source_m, dtype=torch.float64).expand(1, len(position_m), 3)
    rssi_dbm, _ = radio.heard_dbm(radio.begin([(seed, 0)]), time_s[None], place_m, torch.from_numpy(position_m)[None])
    return rssi_dbm[0].double().numpy()


def judged(
    scenario: Scenario,
    other_m: tuple[float, ...] | None,
    seed: int = 0,
    speed_mps: float = SPEED_MPS,
    told: Scenario | None = None,
    stuck: int | None = None,
    from_m: float = FROM_M,
) -> SecondTransmitter:
    """After a way to a transmitter at the origin of the belief's frame, up to 3 m before it, and a decision there."""
    seconds = (from_m - 3.0) / SPEED_MPS
    time_s = np.arange(int(seconds * scenario.sampling_hz)) / scenario.sampling_hz
    center_m = np.array([-from_m, 0.0, 5.0]) + speed_mps * time_s[:, None] * np.array([1.0, 0.0, 0.0])
    position_m = np.stack([formation_m(one_m, 7.0) for one_m in center_m])
    rssi_dbm = heard_dbm(scenario, seed, position_m, (0.0, 0.0, 0.0))
    if other_m is not None:
        also_dbm = heard_dbm(scenario, seed + 1000, position_m, other_m)
        rssi_dbm = 10 * np.log10(10 ** (rssi_dbm / 10) + 10 ** (also_dbm / 10))
    if stuck is not None:
        rssi_dbm[:, stuck] = rssi_dbm[0, stuck]
    belief = Belief(
        torch.zeros(1, 3, dtype=torch.float64),
        torch.eye(3, dtype=torch.float64)[None],
        torch.tensor([GAUSSIAN_REACH], dtype=torch.float64),
    )
    second = SecondTransmitter(told or scenario)
    size = round(scenario.decision_s * scenario.sampling_hz)
    for first in range(0, len(time_s) - size + 1, size):
        part = slice(first, first + size)
        window = Window(rssi_dbm[part], position_m[part] + ORIGIN_M, center_m[part][-1] + ORIGIN_M, time_s[part])
        second.take(window, ORIGIN_M, belief, first + 2 * size > len(time_s))
    return second


def changed(scenario: Scenario, **changes: Any) -> Scenario:
    return dataclasses.replace(scenario, **changes)


@pytest.mark.parametrize(
    ("scenario", "other_m"),
    [
        (FLIGHT, BESIDE),
        (FLIGHT, (-80.0, 60.0, 0.0)),  # passed on the way
        (FLIGHT, (100.0, 100.0, 10.0)),
        (changed(FLIGHT, sampling_hz=100.0), BESIDE),
        (changed(FLIGHT, rician_k=1.0), BESIDE),
        (changed(FLIGHT, receiver_step_db=1.0, receiver_offset_db=3.0), BESIDE),
        (changed(FLIGHT, missing_sample_share=0.3, missing_burst_s=0.5), BESIDE),
    ],
)
@pytest.mark.parametrize("seed", [0, 1])
def test_two_whose_powers_add_up_do_not_fit_one(scenario: Scenario, other_m: tuple[float, ...], seed: int) -> None:
    second = judged(scenario, other_m, seed)
    assert second.evidence > 0.0
    assert second.is_heard


@pytest.mark.parametrize(
    "scenario",
    [
        FLIGHT,
        changed(FLIGHT, sampling_hz=100.0),
        changed(FLIGHT, rician_k=0.0),
        changed(FLIGHT, rician_k=1.0),
        changed(FLIGHT, rician_k=12.0),
        changed(FLIGHT, rician_k=100.0),
        changed(FLIGHT, spatial_correlation=0.0),
        changed(FLIGHT, transmit_duty=0.4),
        changed(FLIGHT, ground_reflection=0.7),
        FIELD,
        load_scenario("rough"),
    ],
)
@pytest.mark.parametrize("seed", [0, 1])
def test_one_fits_however_it_fades_and_nobody_has_told_how(scenario: Scenario, seed: int) -> None:
    second = judged(scenario, None, seed, told=changed(scenario, rician_k=3.0))
    assert second.evidence <= 0.0
    assert not second.is_heard


@pytest.mark.parametrize(("rician_k", "seed"), [(7.5, 34), (7.5, 39), (9.0, 31)])
def test_little_evidence_is_no_news_where_levels_fade_little(rician_k: float, seed: int) -> None:
    """Beside a transmitter any would be enough, if they faded more."""
    second = judged(changed(FLIGHT, rician_k=rician_k), None, seed)
    assert ANY < second.evidence < ENOUGH
    assert not second.is_heard


@pytest.mark.parametrize("seed", [45, 76])
def test_nor_where_few_intervals_were_weighed(seed: int) -> None:
    """Six of 5 m each, the last of them 15 m before the transmitter."""
    second = judged(FLIGHT, None, seed, from_m=45.0)
    assert ANY < second.evidence < ENOUGH
    assert not second.is_heard


def test_a_receiver_below_whose_floor_fades_are_missing_does_not_make_two_of_one() -> None:
    weak = changed(FLIGHT, transmit_power_dbm=10.0, receiver_floor_dbm=-82.0)
    assert not judged(weak, None).is_heard
    # So it would, were the floor not told: far away only what is loud enough is there.
    assert judged(weak, None, told=changed(weak, receiver_floor_dbm=None)).evidence > 0.0


@pytest.mark.parametrize("stuck", range(6))
def test_a_receiver_that_repeats_its_level_says_nothing_of_fading(stuck: int) -> None:
    assert judged(FLIGHT, None, stuck=stuck).evidence <= 0.0
    assert judged(FLIGHT, BESIDE, stuck=stuck).evidence > 0.0


@pytest.mark.parametrize(("sampling_hz", "counted"), [(20.0, 10), (30.0, 8), (38.0, 10), (42.0, 7)])
def test_no_more_samples_of_an_interval_count_than_are_independent(
    sampling_hz: float, counted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers: set[int] = set()

    def noted(rssi_dbm: Levels, *others: Any) -> Any:
        numbers.add(len(rssi_dbm))
        return log_likelihood(rssi_dbm, *others)

    log_likelihood = second_transmitter._log_likelihood
    monkeypatch.setattr(second_transmitter, "_log_likelihood", noted)
    assert judged(changed(FLIGHT, sampling_hz=sampling_hz), BESIDE).is_heard
    assert numbers == {counted}


def test_a_swarm_that_stands_learns_nothing() -> None:
    second = judged(FLIGHT, BESIDE, speed_mps=0.0)
    assert (second.evidence, second.is_heard) == (0.0, False)


def test_on_the_way_it_takes_more_to_be_told_and_it_stays_told_until_one_alone_explains_it() -> None:
    second = judged(FLIGHT, None)
    window = Window(np.full((10, 6), -60.0), np.zeros((10, 6, 3)), np.zeros(3), np.arange(10) / 20)
    for evidence, is_beside, is_heard in [
        (CERTAIN, False, False),
        (CERTAIN + 0.1, False, True),
        (0.1, False, True),
        (-0.4, True, True),
        (DISPROVED, False, False),
        (-0.4, True, False),
        (0.1, False, False),
        (0.1, True, True),
        (0.0, True, True),
        (DISPROVED - 0.1, True, False),
    ]:
        second.evidence = evidence
        second.take(window, np.zeros(3), None, is_beside)
        assert second.is_heard == is_heard, (evidence, is_beside)
