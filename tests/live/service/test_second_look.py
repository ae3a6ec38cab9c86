"""Around a target that two may be heard of, by pencil and flown."""

import math

import numpy as np
import pytest

from swarmchase.live.service.safety import SafetyLimits
from swarmchase.live.service.second_look import LOOK_S, RADIUS_M, SecondLook
from swarmchase.scenario import load_scenario

SCENARIO = load_scenario("flight")
STEP_M = SCENARIO.tracker_speed_mps * SCENARIO.decision_s
SPACING_M = 4.0
WIDE = SafetyLimits(-900.0, 900.0, -900.0, 900.0, 5.0, 120.0, SCENARIO.tracker_speed_mps)


def flown_m(
    target_mps: tuple[float, float, float],
    limits: SafetyLimits = WIDE,
    start_m: tuple[float, float, float] = (0, 0, 50),
) -> np.ndarray:
    """The whole look, seen from the target [decision, 3], which is at (0, 0, 50) at first, and the swarm here."""
    look, target_m, center_m, way = (
        SecondLook(SCENARIO, limits),
        np.array([0.0, 0.0, 50.0]),
        np.array(start_m, dtype=np.float64),
        [],
    )
    velocity_mps = np.array(target_mps)
    look.begin()
    while look.is_on:
        center_m = center_m + look.displacement_m(target_m, velocity_mps, center_m, SPACING_M)
        target_m = target_m + velocity_mps * SCENARIO.decision_s
        way.append(center_m - target_m)
    look.begin()
    assert not look.is_on
    return np.array(way)


@pytest.mark.parametrize("target_mps", [(0.0, 0.0, 0.0), (1.4, 1.4, 0.0)])
def test_it_is_a_circle_around_a_target_that_stands_or_flies_at_four_fifths_of_the_speed_for_half_a_minute(
    target_mps: tuple[float, float, float],
) -> None:
    way_m = flown_m(target_mps)
    assert len(way_m) == LOOK_S / SCENARIO.decision_s == 60
    np.testing.assert_allclose(way_m[0], [0.8 * STEP_M, 0.0, 0.0])  # from the middle straight out
    out_m = np.linalg.norm(way_m[10:], axis=1)
    assert RADIUS_M - 1.0 < out_m.min() <= out_m.max() < RADIUS_M + 1.0
    np.testing.assert_allclose(np.linalg.norm(np.diff(way_m, axis=0), axis=1), 0.8 * STEP_M)
    # 50 intervals of 4 m on a circle 251 m round.
    turned_rad = np.unwrap(np.arctan2(way_m[10:, 1], way_m[10:, 0]))
    assert turned_rad[-1] - turned_rad[0] == pytest.approx(49 * 0.8 * STEP_M / RADIUS_M, rel=0.05)


def test_with_a_target_that_is_as_fast_as_the_rest_no_step_is_longer_than_the_swarm_is_fast() -> None:
    way_m = flown_m((5.0, 0.0, 0.0)) + np.arange(1, 61)[:, None] * np.array([2.5, 0.0, 0.0])
    steps_m = np.linalg.norm(np.diff(way_m, axis=0), axis=1)
    assert steps_m.max() == pytest.approx(STEP_M)


def test_beside_a_fence_it_goes_on_all_the_same_and_the_formation_keeps_inside() -> None:
    limits = SafetyLimits(-900.0, 12.0, -25.0, 900.0, 5.0, 120.0, SCENARIO.tracker_speed_mps)
    way_m = flown_m((0.0, 0.0, 0.0), limits)
    assert way_m[:, 0].max() <= 12.0 - SPACING_M + 1e-9
    assert way_m[:, 1].min() >= -25.0 + SPACING_M - 1e-9
    steps_m = np.linalg.norm(np.diff(way_m, axis=0), axis=1)
    np.testing.assert_allclose(steps_m, 0.8 * STEP_M)
    # Three quarters of a turn and more in half a minute, as in the open.
    turned_rad = np.unwrap(np.arctan2(way_m[:, 1], way_m[:, 0]))
    assert turned_rad.max() - turned_rad.min() > 1.5 * math.pi


def test_where_there_is_no_room_its_steps_are_numbers() -> None:
    limits = SafetyLimits(-4.0, 4.0, -4.0, 4.0, 45.0, 55.0, SCENARIO.tracker_speed_mps)
    assert np.isfinite(flown_m((0.0, 0.0, 0.0), limits)).all()
