"""Where a swarm in flight is sent, by pencil."""

import math

import numpy as np
import pytest
import torch

from swarmchase.controllers.belief import GAUSSIAN_REACH, Belief
from swarmchase.live.service.chase_state import ChaseState
from swarmchase.live.service.course import END_GAME_M, FlightCourse
from swarmchase.live.service.pace import Window
from swarmchase.live.service.settings import ServiceSettings
from swarmchase.scenario import NUM_TRACKERS, load_scenario
from swarmchase.simulation.site import site_limits

Xyz = tuple[float, float, float]
SCENARIO = load_scenario("flight")
TOLD_M = (0.0, 0.0, -5.0)
WINDOW = Window(np.full((1, NUM_TRACKERS), -60.0), np.zeros((1, NUM_TRACKERS, 3)), np.zeros(3), np.zeros(1))


def believed(mean_m: Xyz, velocity_mps: Xyz, radius_m: float) -> Belief:
    """A belief whose region reaches this far."""
    covariance_m2 = torch.eye(3, dtype=torch.float64)[None] * radius_m**2 / GAUSSIAN_REACH
    mean, velocity = (torch.tensor([one], dtype=torch.float64) for one in (mean_m, velocity_mps))
    return Belief(mean, covariance_m2, torch.tensor([GAUSSIAN_REACH]), velocity)


@pytest.mark.parametrize(
    ("mean_m", "velocity_mps", "since_s", "center_m", "radius_m", "way_m"),
    [
        # Nobody knows well where it is: as the controller says.
        ((30, 0, 0), (0, 0, 0), 0.0, (0, 0, 0), END_GAME_M + 0.1, TOLD_M),
        # It stands: at full speed towards it while the swarm can brake before it, sqrt(2 3 m/s2 30 m) > 10 m/s.
        ((30, 0, 0), (0, 0, 0), 0.3, (0, 0, 0), END_GAME_M - 0.1, (5, 0, 0)),
        # Near it as fast as brings it there in a second: 1 m/s for 0.5 s.
        ((0, 0, 1), (0, 0, 0), 0.3, (0, 0, 0), 3.0, (0, 0, 0.5)),
        # It flies by: as fast as it, and to where it will be half way through the interval, which is the centre.
        ((0, -2, 0), (0, 4, 0), 0.25, (0, 0, 0), 3.0, (0, 2, 0)),
        # It flees: at full speed to where it will be then, (3, 2 + 4 (0.25 + 0.25)), seen from where the swarm is now.
        ((3, 2, 0), (0, 4, 0), 0.25, (0, 0, 0), 3.0, (3, 4, 0)),
        ((4, 3, 0), (0, 4, 0), 0.25, (1, 1, 0), 3.0, (3, 4, 0)),
        # Hardly, or by more than 45 degrees aside: as fast as it, and 1 m/s nearer.
        ((0, 0.625, 0), (0, 0.75, 0), 0.25, (0, 0, 0), 3.0, (0, 0.875, 0)),
        ((4, 2, 0), (0, 2, 0), 0.0, (0, 0, 0), 3.0, (2, 2.25, 0)),
    ],
)
def test_a_swarm_that_knows_where_its_target_is_flies_to_where_that_will_be(
    mean_m: Xyz, velocity_mps: Xyz, since_s: float, center_m: Xyz, radius_m: float, way_m: Xyz
) -> None:
    course = FlightCourse(SCENARIO, ServiceSettings(), site_limits(SCENARIO))
    belief = believed(mean_m, velocity_mps, radius_m)
    flown_m, spacing_m = course.flown(
        np.array(TOLD_M), 4.0, WINDOW, np.zeros(3), np.array(center_m, dtype=np.float64), since_s, belief
    )
    assert flown_m == pytest.approx(np.array(way_m), abs=1e-9)
    assert spacing_m == 4.0


def test_a_target_that_is_right_there_is_flown_at_by_a_number() -> None:
    course = FlightCourse(SCENARIO, ServiceSettings(), site_limits(SCENARIO))
    for velocity_mps in ((0.0, 0.0, 0.0), (0.0, 5.0, 0.0)):
        belief = believed((0, 0, 0), velocity_mps, 1.0)
        flown_m, _ = course.flown(np.zeros(3), 4.0, WINDOW, np.zeros(3), np.zeros(3), 0.0, belief)
        assert all(map(math.isfinite, flown_m))


def test_a_target_that_two_may_be_heard_of_is_flown_around_while_that_is_so() -> None:
    """In the shared frame, whose origin is elsewhere: 4 m straight out, then on as ever once it is one alone."""
    course = FlightCourse(SCENARIO, ServiceSettings(), site_limits(SCENARIO))
    course._second.is_heard = True
    belief, center_m, origin_m = (
        believed((0, 0, 0), (0, 0, 0), 3.0),
        np.array([0.0, 1.0, 0.0]),
        np.array([9.0, 9.0, 50.0]),
    )

    def flown_m() -> list[float]:
        way_m, spacing_m = course.flown(np.array(TOLD_M), 4.0, WINDOW, origin_m, center_m, 0.0, belief)
        assert spacing_m == 4.0
        return [round(value, 6) for value in way_m.tolist()]

    assert not course.looks_again
    assert flown_m() == [0.0, -0.5, 0.0]
    course._next(is_caught=True)
    assert course.looks_again
    assert course.state is ChaseState.PURSUING
    assert flown_m() == [0.0, 4.0, 0.0]
    course._second.is_heard = False
    assert not course.looks_again
    assert flown_m() == [0.0, -0.5, 0.0]
    course._next(is_caught=True)
    assert course.state is ChaseState.REACHED
