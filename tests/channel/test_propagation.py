"""The ground's reflection against the two rays added by hand; path loss itself is in test_fading.py."""

import cmath
import math
from typing import Any

import pytest
import torch

from swarmchase.channel.fading import DEEPEST_FADE_DB
from swarmchase.channel.propagation import ground_reflection_db
from swarmchase.scenario import SPEED_OF_LIGHT_MPS, paper_scenario


def reflected_db(target_m: list[float], tracker_m: list[float], **changes: Any) -> float:
    scenario = paper_scenario(**{"ground_reflection": 1.0, "start_altitude_m": 50.0, **changes})
    places = (torch.tensor([place_m], dtype=torch.float64) for place_m in (target_m, tracker_m))
    return float(ground_reflection_db(scenario, *places))


@pytest.mark.parametrize("reflection", [0.2, 0.5, 0.9])
@pytest.mark.parametrize("carrier_hz", [433e6, 3e9])
@pytest.mark.parametrize(
    ("target_m", "tracker_m"),
    [([100.0, 0, 0], [0.0, 0, 0]), ([30.0, 40, 20], [0.0, 0, -45]), ([5.0, 0, 3], [0.0, 3, 0])],
)
def test_two_rays_by_hand(reflection: float, carrier_hz: float, target_m: list[float], tracker_m: list[float]) -> None:
    """The reflected ray comes from the target's image under ground, weaker by its longer way and turned in phase."""
    direct_m = math.dist(target_m, tracker_m)
    image_m = [*target_m[:2], -100.0 - target_m[2]]
    way_m = math.dist(image_m, tracker_m)
    wave = 2j * math.pi * carrier_hz / SPEED_OF_LIGHT_MPS
    field = cmath.exp(-wave * direct_m) / direct_m - reflection * cmath.exp(-wave * way_m) / way_m
    expected = 20 * math.log10(abs(field) * direct_m)
    found = reflected_db(target_m, tracker_m, ground_reflection=reflection, carrier_hz=carrier_hz)
    assert found == pytest.approx(expected, abs=1e-6)


def test_far_away_and_low_it_falls_by_forty_db_a_decade() -> None:
    """4 (sin(2 pi h h' / (lambda d)))^2 of the power of free space: 20 dB a decade beyond that of the direct ray."""
    near_db, far_db = (reflected_db([distance_m, 0, 0], [0.0, 0, 0], start_altitude_m=2.0) for distance_m in (2e4, 2e5))
    assert near_db - far_db == pytest.approx(20, abs=0.01)
    wavelength_m = SPEED_OF_LIGHT_MPS / 3e9
    assert near_db == pytest.approx(20 * math.log10(2 * math.sin(2 * math.pi * 4 / (wavelength_m * 2e4))), abs=0.01)


def test_its_power_averages_to_that_of_both_rays() -> None:
    """Over many places: 1 + g^2 (d / d')^2."""
    scenario = paper_scenario(ground_reflection=0.5)
    target_m = torch.zeros(100_000, 3, dtype=torch.float64)
    target_m[:, 0] = torch.linspace(99, 101, 100_000)
    target_m[:, 2] = torch.linspace(-1, 1, 100_000)[torch.randperm(100_000, generator=torch.Generator().manual_seed(1))]
    power = 10 ** (ground_reflection_db(scenario, target_m, torch.zeros(100_000, 3).double()) / 10)
    assert power.mean().item() == pytest.approx(1 + 0.25 * 100**2 / (100**2 + 100**2), rel=0.01)


def test_where_nothing_is_left_a_level_is_left() -> None:
    """On the ground both rays have the same way; what lies under it counts as on it."""
    for altitude_m in (0.0, -30.0):
        found = reflected_db([100.0, 0, 0], [0.0, 0, 0], start_altitude_m=altitude_m)
        assert found == pytest.approx(DEEPEST_FADE_DB)
    assert math.isfinite(reflected_db([0.0, 0, -50], [0.0, 0, -50]))
    assert reflected_db([3.0, 0, 0], [0.0, 0, 0], ground_reflection=0.0) == 0
