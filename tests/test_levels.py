"""What is a level: by hand, for numbers, arrays and tensors alike, and against what the channel really gives."""

import math

import numpy as np
import pytest
import torch

from swarmchase.batch.streams import chase_keys
from swarmchase.channel.fading import fading_db
from swarmchase.channel.fading_process import first_window
from swarmchase.channel.propagation import unfaded_dbm
from swarmchase.levels import (
    HIGHEST_DBM,
    WILD_DB,
    NoLevel,
    highest_dbm,
    is_level,
    level_or_nan,
    quartile_place,
    why_no_level,
)
from swarmchase.observation import wild_samples
from swarmchase.scenario import Scenario, paper_scenario

NAN, INF = math.nan, math.inf
REPORTED = [
    (-60.0, None),
    (-0.5, None),
    (-200.0, None),
    (50.0, None),
    (NAN, NoLevel.NOTHING_HEARD),
    (0.0, NoLevel.ERROR_VALUE),
    (-0.0, NoLevel.ERROR_VALUE),
    (31.0, NoLevel.ERROR_VALUE),
    (127.0, NoLevel.ERROR_VALUE),
    (-128.0, NoLevel.ERROR_VALUE),
    (121.0, NoLevel.OUT_OF_RANGE),
    (50.5, NoLevel.OUT_OF_RANGE),
    (-200.5, NoLevel.OUT_OF_RANGE),
    (INF, NoLevel.OUT_OF_RANGE),
    (-INF, NoLevel.OUT_OF_RANGE),
]


@pytest.mark.parametrize(("reported_dbm", "reason"), REPORTED)
def test_what_is_a_level_and_why_not(reported_dbm: float, reason: NoLevel | None) -> None:
    assert is_level(reported_dbm) is (reason is None)
    assert level_or_nan(reported_dbm) == pytest.approx(NAN if reason else reported_dbm, nan_ok=True)
    if reason is not None:
        assert why_no_level(reported_dbm) is reason


def test_the_same_rule_for_numbers_arrays_and_tensors() -> None:
    reported = [reported_dbm for reported_dbm, _ in REPORTED]
    expected = [reason is None for _, reason in REPORTED]
    assert [is_level(one_dbm) for one_dbm in reported] == expected
    assert is_level(np.array(reported)).tolist() == expected
    assert is_level(torch.tensor(reported)).tolist() == expected


@pytest.mark.parametrize(
    ("scenario", "expected_dbm"),
    [
        # -7 dBm at d_0, 8.70 dB of fading (20 log10(.8660 + 1.8585)), 6 dB of power, half a step.
        (paper_scenario(), 8.206),
        # Without a line of sight |h|^2 is exponential: 11.40 dB.
        (paper_scenario(rician_k=0.0), 10.904),
        # A BLE beacon, -61 dBm at 1 m, whose receivers are 3 dB apart.
        (paper_scenario(transmit_power_dbm=-21.0, reference_path_loss_db=40.0, receiver_offset_db=3.0), -42.794),
        (paper_scenario(transmit_power_dbm=90.0), HIGHEST_DBM),
    ],
)
def test_the_most_that_a_transmitter_can_give_by_hand(scenario: Scenario, expected_dbm: float) -> None:
    found = highest_dbm(scenario)
    assert found == pytest.approx(expected_dbm, abs=2e-3)
    assert not is_level(17.0, found) or expected_dbm > 17
    if expected_dbm < 17:
        assert why_no_level(17.0) is NoLevel.TOO_STRONG


@pytest.mark.parametrize(("rician_k", "sampling_hz"), [(3.0, 10.0), (3.0, 100.0), (0.0, 10.0), (0.0, 100.0)])
def test_nothing_that_the_told_channel_gives_is_dropped(rician_k: float, sampling_hz: float) -> None:
    """1.5 million samples at d_0, 30,000 windows: none above the ceiling, even without its allowances, none wild."""
    scenario = paper_scenario(rician_k=rician_k, sampling_hz=sampling_hz, spatial_correlation=0.1)
    at_reference_dbm = float(unfaded_dbm(scenario, torch.ones(1)))
    rssi_dbm = at_reference_dbm + fading_db(first_window(scenario, chase_keys(3, 5000))).transpose(1, 2)
    assert is_level(rssi_dbm, highest_dbm(scenario)).all()
    assert (rssi_dbm > highest_dbm(scenario) - 6.5).double().mean() < 4e-6
    assert wild_samples(rssi_dbm) is None


@pytest.mark.parametrize(
    ("window_dbm", "wild"),
    [
        ([-60, -60, -60, -39.9], [3]),
        ([-60, -60, -60, -40], []),
        # The upper quartile of eight is the sixth: two can be told, three make it theirs.
        ([-60, -60, -60, -60, -60, -60, -10, -10], [6, 7]),
        ([-60, -60, -60, -60, -60, -10, -10, -10], []),
        # Deep fades make nobody wild.
        ([-60, -100, -100, -60], []),
        # Of two nobody knows.
        ([-60, -10, NAN, NAN], []),
        ([-60, -10, -61, NAN], [1]),
        ([NAN, NAN, NAN, NAN], []),
    ],
)
def test_wild_samples_by_hand(window_dbm: list[float], wild: list[int]) -> None:
    rssi_dbm = torch.full((1, len(window_dbm), 6), -50.0)
    rssi_dbm[0, :, 2] = torch.tensor(window_dbm, dtype=torch.float32)
    found = wild_samples(rssi_dbm)
    assert (found is None) is (wild == [])
    if found is not None:
        assert found[0, :, 2].nonzero()[:, 0].tolist() == wild
        assert found.sum() == len(wild)


def test_wild_samples_are_those_of_a_loop() -> None:
    """Against the definition, sample by sample, in windows with gaps and anything in them."""
    generator = np.random.default_rng(2)
    rssi_dbm = generator.normal(-60, 12, (40, 20, 6))
    rssi_dbm[generator.random(rssi_dbm.shape) < 0.4] = np.nan
    found = wild_samples(torch.from_numpy(rssi_dbm))
    assert found is not None
    for chase, tracker in np.ndindex(40, 6):
        window = rssi_dbm[chase, :, tracker]
        heard = np.sort(window[np.isfinite(window)])
        is_told = len(heard) >= 3
        expected = window > heard[quartile_place(len(heard))] + WILD_DB if is_told else np.zeros(20, dtype=bool)
        assert found[chase, :, tracker].tolist() == expected.tolist()
    assert 5 < found.sum() < 200
