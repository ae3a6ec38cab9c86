"""A target that flies: followed, lost, looked for and found again, by pencil."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from swarmchase.controllers.belief import GAUSSIAN_REACH, Belief
from swarmchase.live.service.following import Following
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.live.service.search import CLIMB_M, FARTHEST_RAD, PITCH_M, Loss, Spiral
from swarmchase.scenario import load_scenario

SCENARIO = load_scenario("flight")
STEP_M = SCENARIO.tracker_speed_mps * SCENARIO.decision_s


def spread(radius_m: float) -> Belief:
    """A belief whose region reaches this far."""
    variance_m2 = radius_m**2 / GAUSSIAN_REACH
    eye = torch.eye(3, dtype=torch.float64)[None]
    return Belief(torch.zeros(1, 3, dtype=torch.float64), variance_m2 * eye, torch.tensor([GAUSSIAN_REACH]))


def taken(*windows: tuple[float, bool, float]) -> list[str]:
    loss, reasons = Loss(), []
    for ended_s, is_heard, radius_m in windows:
        loss.take(ended_s, is_heard, spread(radius_m))
        reasons.append(loss.reason)
    return reasons


@pytest.mark.parametrize(
    ("windows", "is_lost"),
    [
        # At the start the belief is wide: nothing is lost that was not found.
        ([(0.5, True, 250), (1.0, True, 150), (1.5, True, 61)], [False] * 3),
        # Once it was narrow it may not spread.
        ([(0.5, True, 20), (1.0, True, 60), (1.5, True, 61), (2.0, True, 30), (2.5, True, 19)], [0, 0, 1, 1, 0]),
        # Silence for 5 s, counted from the last window in which anything was heard.
        ([(1.0, True, 10), (5.5, False, 20), (6.0, False, 20), (6.5, True, 30), (7.0, True, 15)], [0, 0, 1, 1, 0]),
        # Silent from the start.
        ([(0.5, False, 250), (5.0, False, 250), (5.5, False, 250)], [0, 0, 1]),
        # Narrow, but nothing is heard yet.
        ([(0.5, True, 9), (5.5, False, 9), (6.0, False, 9), (6.5, True, 9)], [0, 1, 1, 0]),
    ],
)
def test_a_target_is_lost_by_silence_or_by_a_belief_that_spreads(
    windows: list[tuple[float, bool, float]], is_lost: list[bool]
) -> None:
    assert [bool(reason) for reason in taken(*windows)] == [bool(one) for one in is_lost]


def test_why_it_is_lost_and_that_a_pause_begins_silence_anew() -> None:
    assert taken((0.5, True, 10), (1.0, True, 75.4))[-1] == "it may be 75 m from where it is believed to be"
    assert taken((0.5, True, 10), (5.5, False, 10))[-1] == "nothing has been heard of it for 5 s"
    loss = Loss()
    loss.take(0.5, True, None)
    loss.forget()
    loss.take(30.0, False, None)
    assert loss.reason == ""
    loss.take(35.0, False, None)
    assert loss.reason != ""


def fence(level_m: float, low_m: float, high_m: float) -> SafetyLimits:
    return SafetyLimits(-level_m, level_m, -level_m, level_m, low_m, high_m, SCENARIO.tracker_speed_mps)


def flown_m(spiral: Spiral, start_m: np.ndarray, decisions: int) -> np.ndarray:
    place_m, way = start_m, []
    for _ in range(decisions):
        place_m = place_m + spiral.displacement_m(place_m)
        way.append(place_m)
    return np.array(way)


def test_the_search_widens_climbs_and_passes_near_every_place() -> None:
    middle_m = np.array([40.0, -30.0, 0.0])
    limits = fence(900.0, -50.0, 900.0)
    way_m = flown_m(Spiral(SCENARIO, limits, middle_m), middle_m, 360)
    steps_m = np.linalg.norm(np.diff(way_m, axis=0), axis=1)
    np.testing.assert_allclose(steps_m, STEP_M)
    out_m = np.linalg.norm(way_m[:, :2] - middle_m[:2], axis=1)
    assert np.linalg.norm(way_m[60:, 2] - CLIMB_M, ord=np.inf) < 1.0
    # After three minutes, 1.8 km: r^2 = pitch * way / pi.
    assert out_m[-1] == pytest.approx(math.sqrt(PITCH_M * 360 * STEP_M / math.pi), rel=0.1)
    # No place inside is further than half a pitch from the way.
    random = np.random.default_rng(0)
    inside_m = middle_m[:2] + random.uniform(-1, 1, (200, 2)) * 0.6 * out_m[-1]
    nearest_m = np.linalg.norm(inside_m[:, None] - way_m[None, :, :2], axis=2).min(axis=1)
    assert nearest_m.max() < PITCH_M / 2 + STEP_M


def test_the_search_stays_inside_the_fence_and_does_not_hang_in_a_tiny_one() -> None:
    limits = fence(60.0, -40.0, 15.0)
    way_m = flown_m(Spiral(SCENARIO, limits, np.zeros(3)), np.zeros(3), 400)
    # The widest spacing from the fence, and what a step may cut.
    assert np.abs(way_m[:, :2]).max() <= 55.0 + 1e-6
    assert way_m[:, 2].max() <= 10.0 + 1e-6
    tiny = fence(6.0, -6.0, 6.0)
    assert np.isfinite(flown_m(Spiral(SCENARIO, tiny, np.zeros(3)), np.zeros(3), 5)).all()


def test_a_search_that_has_come_too_far_begins_anew() -> None:
    limits = fence(2000.0, -50.0, 2000.0)
    way_m = flown_m(Spiral(SCENARIO, limits, np.zeros(3)), np.zeros(3), 2600)
    out_m = np.linalg.norm(way_m[:, :2], axis=1)
    farthest_m = FARTHEST_RAD / (2 * math.pi) * PITCH_M
    assert farthest_m - PITCH_M < out_m.max() < farthest_m + STEP_M
    assert out_m[out_m.argmax() :].min() < 2 * PITCH_M


@pytest.mark.parametrize(
    ("target_m", "target_mps", "wanted_mps"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),  # there: it hovers
        ((2.0, 0.0, 0.0), (0.0, 0.0, 0.0), (2.0, 0.0, 0.0)),  # near: in a second
        ((0.0, 24.0, 0.0), (0.0, 0.0, 0.0), (0.0, 10.0, 0.0)),  # sqrt(2 * 3 * 24) = 12, but 10 at most
        ((0.0, 13.5, 0.0), (0.0, 0.0, 0.0), (0.0, 9.0, 0.0)),  # sqrt(2 * 3 * 13.5)
        ((-1.25, 0.0, 0.0), (5.0, 0.0, 0.0), (5.0, 0.0, 0.0)),  # half way through the interval it is there
        ((0.0, 0.0, -6.0), (0.0, 0.0, 0.0), (0.0, 0.0, -6.0)),
    ],
)
def test_following_brakes_so_that_it_comes_to_rest_with_the_target(
    target_m: tuple[float, ...], target_mps: tuple[float, ...], wanted_mps: tuple[float, ...]
) -> None:
    following = Following(SCENARIO)
    way_m = following.displacement_m(np.array(target_m), np.array(target_mps), np.zeros(3))
    np.testing.assert_allclose(way_m / SCENARIO.decision_s, wanted_mps, atol=1e-9)


def test_how_long_it_was_followed_is_counted_by_decisions() -> None:
    following = Following(replace(SCENARIO, decision_s=0.25))
    assert following.told is None
    for distance_m in (0.0, 9.99, 10.0, 10.01):
        following.count(distance_m)
    assert following.told is not None
    assert (following.told.seconds, following.told.share, following.told.within_m) == (1.0, 0.75, 10.0)
