"""``pursuit``: what it refuses, what it says of its belief, gaps, batches, and that it catches who flees fast."""

import dataclasses
import math

import pytest
import torch

from swarmchase.batch.selection import select_chases
from swarmchase.batch.streams import chase_keys
from swarmchase.controllers import load_controller, require_controller
from swarmchase.controllers.belief import GAUSSIAN_REACH
from swarmchase.controllers.condition import Condition
from swarmchase.controllers.pursuit import PursuitController
from swarmchase.errors import InputError
from swarmchase.evaluation.chases import run_chases
from swarmchase.networks.pursuit import PursuitReading
from swarmchase.observation import Observation
from swarmchase.scenario import Scenario, load_scenario, paper_scenario
from swarmchase.world.environment import Environment

FLEEING = dataclasses.replace(
    load_scenario("flight"), behaviour="flee", target_speed_mps=8.0, sampling_hz=100.0, max_movements=599
)


def pursuit(scenario: Scenario = FLEEING) -> PursuitController:
    controller = load_controller("pursuit", scenario)
    assert isinstance(controller, PursuitController)
    return controller


def first_heard(number: int) -> Observation:
    return Environment(FLEEING).reset(chase_keys(3, number)).observation()


def test_it_is_not_for_trackers_that_stop_to_listen() -> None:
    for made in (load_controller, require_controller):
        with pytest.raises(InputError, match="pursuit flies where trackers listen in flight"):
            made("pursuit", paper_scenario())


@pytest.mark.parametrize(
    ("way_m", "correction", "command"),
    [
        ((0.0, 30.0, 40.0), (0.0, 0.0, 0.0), (0.0, 0.6, 0.8)),
        ((10.0, 0.0, 0.0), (0.0, 1.0, 0.0), (math.sqrt(0.5), math.sqrt(0.5), 0.0)),
        ((10.0, 0.0, 0.0), (-0.5, 0.0, 0.0), (0.5, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.2), (0.0, 0.0, 0.2)),
    ],
)
def test_a_command_is_straight_to_the_target_and_corrected(
    way_m: tuple[float, ...], correction: tuple[float, ...], command: tuple[float, ...]
) -> None:
    nothing = torch.zeros(1)
    reading = PursuitReading(torch.tensor([way_m]), torch.zeros(1, 3), nothing, torch.tensor([correction]), nothing)
    assert reading.command[0].tolist() == pytest.approx(command)


def test_a_chase_is_the_same_alone_and_in_a_batch() -> None:
    heard, controller = first_heard(20), pursuit()
    together, _ = controller.decide(heard, controller.begin(20, seed=3))
    for row in (0, 7, 19):
        one = select_chases(heard, [row])
        alone, _ = controller.decide(one, controller.begin(1, seed=3, first_chase=row))
        assert torch.equal(alone.displacement_m[0], together.displacement_m[row])


def test_it_says_where_it_believes_the_target_to_be() -> None:
    heard, controller = first_heard(4), pursuit()
    memory = controller.begin(4, seed=3)
    assert (controller.belief(memory).radius_m > 300).all()
    _, memory = controller.decide(heard, memory)
    belief = controller.belief(memory)
    assert torch.equal(belief.mean_m, memory.target_m)
    assert belief.radius_m.tolist() == pytest.approx((memory.spread_m * GAUSSIAN_REACH**0.5).tolist())
    explanation = controller.explain(heard, memory)
    assert explanation.target_m is not None
    assert torch.equal(explanation.target_m[0], memory.target_m[0])


@pytest.mark.parametrize("gap", ["nothing", "one tracker", "half of the samples"])
def test_gaps_leave_it_finite(gap: str) -> None:
    heard, controller = first_heard(2), pursuit()
    rssi_dbm = heard.rssi_dbm.clone()
    if gap == "nothing":
        rssi_dbm[0] = math.nan
    elif gap == "one tracker":
        rssi_dbm[0, :, 2] = math.nan
    else:
        rssi_dbm[0, ::2] = math.nan
    action, memory = controller.decide(dataclasses.replace(heard, rssi_dbm=rssi_dbm), controller.begin(2, seed=3))
    assert action.displacement_m.isfinite().all()
    assert (action.displacement_m.norm(dim=1) <= 5.0 + 1e-9).all()
    expected = Condition.DEAF if gap == "nothing" else Condition.TRACKING
    assert memory.condition.tolist() == [expected, Condition.TRACKING]


def test_it_catches_targets_that_flee_nearly_as_fast_as_the_swarm_flies() -> None:
    """16 flights at F = 100 Hz; docs/results.md has 300."""
    rows = list(run_chases(FLEEING, pursuit(), 1, range(16)))
    assert sum(row.reached for row in rows) >= 15
