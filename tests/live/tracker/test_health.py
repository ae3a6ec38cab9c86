"""Battery, satellites and heading: from what autopilots say to what the controller knows."""

from contextlib import closing

import pytest

pytest.importorskip("pymavlink")

from swarmchase.live.link.messages import Health
from swarmchase.live.service.tracker_record import HEALTH_S, TrackerRecord
from swarmchase.live.tracker.vehicles import AutopilotVehicle, SimulatedVehicle, UdpTransport
from swarmchase.scenario import paper_scenario
from swarmchase.simulation.autopilot import SimulatedAutopilot
from swarmchase.simulation.simulated_ardupilot import COPTER_3_5, SimulatedArduPilot
from swarmchase.simulation.simulated_px4 import SimulatedPx4

STEP_NS = 50_000_000
START_NS = 10**12
MAKES = {
    "ArduPilot": SimulatedArduPilot,
    "ArduPilot 3.5": lambda flown, port: SimulatedArduPilot(flown, port, COPTER_3_5),
    "PX4": SimulatedPx4,
}


def steps(now_ns: int, seconds: float) -> range:
    return range(now_ns + STEP_NS, now_ns + round(seconds * 1e9) + 1, STEP_NS)


@pytest.mark.parametrize("make", MAKES)
def test_an_autopilot_is_asked_for_it_and_what_is_old_is_not_known(make: str) -> None:
    """It flies east at first; then it falls silent."""
    flown, transport = SimulatedVehicle((0.0, 0.0, 0.0)), UdpTransport(0)
    vehicle = AutopilotVehicle(transport)
    autopilot: SimulatedAutopilot = MAKES[make](flown, transport.port)
    with closing(vehicle), closing(autopilot):
        assert vehicle.health(3) is None
        flown.go_to((100.0, 0.0, 0.0))
        for now_ns in steps(START_NS, 9):
            flown.update(now_ns)
            autopilot.step(now_ns)
            vehicle.update(now_ns)
        assert vehicle.health(3) == Health(3, battery_percent=97, gps_fix=3, satellites=14, heading_deg=90.0)
        for now_ns in steps(START_NS + 9 * 10**9, 11):
            vehicle.update(now_ns)
        assert vehicle.health(3) is None


def test_the_controller_forgets_what_is_old() -> None:
    record = TrackerRecord(paper_scenario())
    health = Health(0, battery_percent=50)
    record.hear(health, START_NS)
    assert record.health(START_NS + round(HEALTH_S * 1e9)) == health
    assert record.health(START_NS + round(HEALTH_S * 1e9) + 1) is None
