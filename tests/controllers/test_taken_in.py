"""Whatever a program outside hands to any controller: garbage among the levels, positions that are no numbers."""

import math

import numpy as np
import pytest
import torch

from swarmchase import Observation, load_controller, paper_scenario
from swarmchase.batch.streams import chase_keys
from swarmchase.controllers import controller_names
from swarmchase.errors import InputError
from swarmchase.world.environment import Environment

SCENARIO = paper_scenario()
HEARD = Environment(SCENARIO).reset(chase_keys(4, 3)).observation()
GARBAGE_DBM = {
    (0, 3, 1): 0.0,
    (0, 7, 5): 17.0,
    (1, 0, 0): 127.0,
    (1, 49, 2): -128.0,
    (2, 20, 4): 31.0,
    (2, 21, 4): 121.0,
}
"""By chase, sample and tracker."""


def with_levels(replaced_dbm: dict[tuple[int, int, int], float]) -> Observation:
    rssi_dbm = HEARD.rssi_dbm.clone()
    for place, level_dbm in replaced_dbm.items():
        rssi_dbm[place] = level_dbm
    return Observation(rssi_dbm, HEARD.tracker_position_m)


@pytest.mark.parametrize("name", controller_names())
def test_garbage_is_the_same_to_it_as_a_missing_sample(name: str) -> None:
    controller = load_controller(name, SCENARIO)
    found, expected = (
        controller.decide(observation, controller.begin(3, 9))[0]
        for observation in (with_levels(GARBAGE_DBM), with_levels(dict.fromkeys(GARBAGE_DBM, math.nan)))
    )
    np.testing.assert_array_equal(found.displacement_m, expected.displacement_m)
    np.testing.assert_array_equal(found.spacing_m, expected.spacing_m)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("name", controller_names())
def test_a_position_that_is_no_number_is_refused_and_spoils_nothing(name: str, bad: float) -> None:
    """The one that does not listen takes no notice; every other goes on with the next window as if it had not been."""
    controller = load_controller(name, SCENARIO)
    memory = controller.begin(3, 9)
    position_m = HEARD.tracker_position_m.clone()
    position_m[1, :, 2, 0] = bad
    observation = Observation(HEARD.rssi_dbm, position_m)
    if name == "random":
        assert controller.decide(observation, memory)[0].displacement_m.isfinite().all()
        return
    with pytest.raises(InputError, match="tracker_position_m must be finite"):
        controller.decide(observation, memory)
    after, fresh = (controller.decide(HEARD, one)[0] for one in (memory, controller.begin(3, 9)))
    assert torch.equal(after.displacement_m, fresh.displacement_m)
