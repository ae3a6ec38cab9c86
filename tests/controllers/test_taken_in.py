"""Whatever a program outside hands to any controller: garbage among the levels, positions that are no numbers."""

import dataclasses
import functools
import math

import numpy as np
import pytest
import torch

from swarmchase import Observation, Scenario, load_controller, load_scenario, paper_scenario
from swarmchase.batch.streams import chase_keys
from swarmchase.controllers import controller_names
from swarmchase.errors import InputError
from swarmchase.world.environment import Environment

SCENARIOS = {"pursuit": dataclasses.replace(load_scenario("flight"), sampling_hz=100.0)}
"""Of those that do not chase in the paper's; windows are of fifty samples here too."""
GARBAGE_DBM = {
    (0, 3, 1): 0.0,
    (0, 7, 5): 17.0,
    (1, 0, 0): 127.0,
    (1, 49, 2): -128.0,
    (2, 20, 4): 31.0,
    (2, 21, 4): 121.0,
}
"""By chase, sample and tracker."""


@functools.cache
def heard(name: str) -> tuple[Scenario, Observation]:
    """The scenario in which this controller chases, and what three chases hear first."""
    scenario = SCENARIOS.get(name, paper_scenario())
    return scenario, Environment(scenario).reset(chase_keys(4, 3)).observation()


def with_levels(observation: Observation, replaced_dbm: dict[tuple[int, int, int], float]) -> Observation:
    rssi_dbm = observation.rssi_dbm.clone()
    for place, level_dbm in replaced_dbm.items():
        rssi_dbm[place] = level_dbm
    return dataclasses.replace(observation, rssi_dbm=rssi_dbm)


@pytest.mark.parametrize("name", controller_names())
def test_garbage_is_the_same_to_it_as_a_missing_sample(name: str) -> None:
    scenario, observation = heard(name)
    controller = load_controller(name, scenario)
    found, expected = (
        controller.decide(with_levels(observation, levels_dbm), controller.begin(3, 9))[0]
        for levels_dbm in (GARBAGE_DBM, dict.fromkeys(GARBAGE_DBM, math.nan))
    )
    np.testing.assert_array_equal(found.displacement_m, expected.displacement_m)
    np.testing.assert_array_equal(found.spacing_m, expected.spacing_m)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("name", controller_names())
def test_a_position_that_is_no_number_is_refused_and_spoils_nothing(name: str, bad: float) -> None:
    """The one that does not listen takes no notice; every other goes on with the next window as if it had not been."""
    scenario, good = heard(name)
    controller = load_controller(name, scenario)
    memory = controller.begin(3, 9)
    position_m = good.tracker_position_m.clone()
    position_m[1, :, 2, 0] = bad
    observation = dataclasses.replace(good, tracker_position_m=position_m)
    if name == "random":
        assert controller.decide(observation, memory)[0].displacement_m.isfinite().all()
        return
    with pytest.raises(InputError, match="tracker_position_m must be finite"):
        controller.decide(observation, memory)
    after, fresh = (controller.decide(good, one)[0] for one in (memory, controller.begin(3, 9)))
    assert torch.equal(after.displacement_m, fresh.displacement_m)
