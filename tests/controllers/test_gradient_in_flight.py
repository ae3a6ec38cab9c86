"""``gradient`` in flight: by hand, and in flights."""

import dataclasses
import math

import pytest
import torch

from swarmchase.controllers.condition import Condition
from swarmchase.controllers.gradient import GradientController
from swarmchase.evaluation.chases import run_chases
from swarmchase.formation import tracker_position_m
from swarmchase.observation import Observation
from swarmchase.scenario import load_scenario

FLIGHT = load_scenario("flight")
SLOPE_DB = 26 / math.log(10)


def with_difference(difference_db):
    """Trackers 5 m beside the origin, of which the one at +x hears so much more than the one at -x."""
    position_m = tracker_position_m(torch.zeros(1, 3).double(), torch.full((1,), 5.0).double())
    levels_dbm = torch.tensor([difference_db - 60.0, -60, -60, -60, -60, -60])
    return Observation(levels_dbm.expand(1, 10, 6), position_m[:, None].expand(1, 10, 6, 3))


@pytest.mark.parametrize(("distance_m", "kept"), [(100, math.exp(-5 / 25)), (10, math.exp(-5 / 2.5)), (1e6, 0.95)])
def test_it_forgets_by_the_way_flown(distance_m, kept):
    """5 m in half a second, of a quarter of the distance that the gradient tells."""
    controller = GradientController(FLIGHT)
    action, memory = controller.decide(with_difference(10 * SLOPE_DB / distance_m), controller.begin(1, 0))
    assert action.displacement_m[0].tolist() == pytest.approx([5, 0, 0], abs=1e-3)
    assert action.spacing_m.tolist() == [5]
    _, memory = controller.decide(with_difference(0.0), memory)
    assert memory.weight[0].tolist() == pytest.approx([1 + kept] * 3, rel=1e-3)


def test_in_silence_it_flies_on():
    controller = GradientController(FLIGHT)
    before, memory = controller.decide(with_difference(1.0), controller.begin(1, 0))
    after, memory = controller.decide(with_difference(math.nan), memory)
    assert memory.condition.tolist() == [Condition.TRACKING]
    silent = dataclasses.replace(with_difference(1.0), rssi_dbm=torch.full((1, 10, 6), math.nan))
    after, memory = controller.decide(silent, memory)
    assert memory.condition.tolist() == [Condition.DEAF]
    assert after.displacement_m[0, 0] == pytest.approx(before.displacement_m[0, 0].item())


@pytest.mark.parametrize(("behaviour", "speed_mps"), [("hover", 0.0), ("waypoints", 5.0)])
def test_it_reaches_a_target(behaviour, speed_mps):
    """Of 300 it reached all; with the memory of those that stop to listen it reached a quarter and half of them."""
    scenario = dataclasses.replace(FLIGHT, behaviour=behaviour, target_speed_mps=speed_mps)
    assert all(result.reached for result in run_chases(scenario, GradientController(scenario), 1, range(16)))
