"""Whole chases whose receivers report what real ones do, and whose trackers do not know where they are."""

import math
from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from swarmchase.controllers import load_controller
from swarmchase.levels import NoLevel
from swarmchase.live.link.messages import Metres
from swarmchase.live.service.chase_state import ChaseState
from swarmchase.live.tracker.agent import TrackerAgent
from swarmchase.live.tracker.sources import Sample
from swarmchase.live.tracker.vehicles import SimulatedVehicle
from swarmchase.scenario import paper_scenario
from swarmchase.simulation.fault_plan import fault_plan
from swarmchase.simulation.virtual_chase import VirtualChase

SCENARIO = paper_scenario(sampling_hz=50.0, start_distance_m=30.0)


def chase_with(faults: str, number: int = 3) -> VirtualChase:
    return VirtualChase(SCENARIO, load_controller("particle", SCENARIO), 5, number, fault_plan(faults))


def test_without_faults_nothing_is_dropped() -> None:
    """Neither at a tracker, but for the moments in which the site is silent, nor by the service, up to the target."""
    chase = chase_with("")
    assert chase.run().reached
    assert all(agent is not None and set(agent.dropped) == {str(NoLevel.NOTHING_HEARD)} for agent in chase.agents)
    assert all(tracker.dropped == {} for tracker in chase.service.snapshot().trackers)


def test_garbage_is_dropped_counted_by_reason_and_stops_nothing() -> None:
    """From all six: what any receiver knows for none goes at the tracker, what this transmitter cannot give, here."""
    chase = chase_with(",".join(f"garbage={tracker}@0" for tracker in range(6)))
    assert chase.run().reached
    for agent, tracker in zip(chase.agents, chase.service.snapshot().trackers, strict=True):
        assert agent is not None
        # Of seven numbers four are error values, one is 121; 17 comes as often, and goes here, counted once.
        count = agent.dropped[str(NoLevel.OUT_OF_RANGE)]
        assert count > 50
        assert 3 * count < agent.dropped[str(NoLevel.ERROR_VALUE)] < 5 * count
        assert tracker.dropped.keys() == {str(NoLevel.TOO_STRONG)}
        assert 0.6 * count < tracker.dropped[str(NoLevel.TOO_STRONG)] < 1.4 * count


def test_a_wild_level_that_its_transmitter_could_give_is_dropped_and_counted() -> None:
    """Tracker 1's receiver says -15 dBm for every thirtieth sample, at 30 m from the target."""
    chase = chase_with("")
    receiver = chase._receivers[1]
    put: Callable[[list[Sample]], None] = receiver.put
    receiver.put = lambda samples: put(  # type: ignore[method-assign]
        [(time_ns, -15.0 if time_ns // 20_000_000 % 30 == 0 else level_dbm) for time_ns, level_dbm in samples]
    )
    decided: list[np.ndarray] = []
    chase._recorder = lambda entry: decided.append(entry.rssi_dbm) if hasattr(entry, "rssi_dbm") else None
    for _ in range(400):
        chase.tick()
    assert len(decided) >= 2
    assert max(float(np.nanmax(rssi_dbm[:, 1])) for rssi_dbm in decided) < -20
    dropped = [tracker.dropped for tracker in chase.service.snapshot().trackers]
    assert dropped[0] == {}
    # One or two in each window of fifty.
    assert len(decided) <= dropped[1][str(NoLevel.WILD)] <= 2 * (len(decided) + 1)


class Adrift(SimulatedVehicle):
    """Its autopilot has lost its position."""

    bad_m = math.nan

    @property
    def position_m(self) -> Metres:
        return (self.bad_m, 0.0, 0.0)


def test_trackers_that_do_not_know_where_they_are_are_left_behind() -> None:
    """Their autopilots' positions become no numbers: that is not said, and to the others they are lost."""
    chase = chase_with("")
    while chase.service.snapshot().movements < 2:
        chase.tick()
    adrift: dict[int, TrackerAgent] = {}
    for tracker, bad_m in ((2, math.nan), (5, math.inf)):
        agent = chase.agents[tracker]
        assert agent is not None
        vehicle = Adrift(chase.site.vehicles[tracker].position_m)
        vehicle.bad_m = bad_m
        agent._vehicle, adrift[tracker] = vehicle, agent
    result = chase.run()
    assert result.state == ChaseState.REACHED.value
    for tracker, agent in adrift.items():
        assert agent.ignored["impossible position"] > 0
        assert chase.service.snapshot().trackers[tracker].is_lost
