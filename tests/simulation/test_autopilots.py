"""The agent's vehicle beside simulated autopilots with the habits of real ones, over real sockets; time is made."""

import math
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from random import Random

import pytest

from swarmchase.controllers import load_controller
from swarmchase.formation import TRACKER_DIRECTION
from swarmchase.live.link.messages import Metres, Severity, TrackerMode
from swarmchase.live.service.chase_state import Snapshot
from swarmchase.live.service.pursuit import BRAKING_SHARE
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.live.service.separation import MARGIN_M
from swarmchase.live.tracker.vehicles import (
    AutopilotVehicle,
    LocalFrame,
    SimulatedVehicle,
    UdpTransport,
)
from swarmchase.live.tracker.vehicles.ardupilot import ARDUPILOT
from swarmchase.live.tracker.vehicles.frames import POSITION_AND_VELOCITY, CoordinateFrame
from swarmchase.live.tracker.vehicles.px4 import PX4
from swarmchase.live.tracker.vehicles.simulated import VehicleLimits
from swarmchase.scenario import Scenario, load_scenario, paper_scenario
from swarmchase.simulation.autopilot import ORIGIN, Phase, SimulatedAutopilot
from swarmchase.simulation.fault_plan import fault_plan
from swarmchase.simulation.simulated_ardupilot import (
    COPTER_3_5,
    COPTER_4_0,
    COPTER_4_6,
    GUIDED,
    LOITER,
    RTL,
    ArduCopterRelease,
    SimulatedArduPilot,
)
from swarmchase.simulation.simulated_ardupilot import LAND as COPTER_LAND
from swarmchase.simulation.simulated_px4 import LAND, OFFBOARD, POSITION, SimulatedPx4
from swarmchase.simulation.virtual_chase import START_NS, VirtualChase

pytest.importorskip("pymavlink")

HOLDING, FOLLOWING, MANUAL = TrackerMode.HOLDING, TrackerMode.FOLLOWING, TrackerMode.MANUAL
STEP_S = 0.05
LOCAL_POINT, GLOBAL_POINT = "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"
Makes = Callable[[SimulatedVehicle, int], SimulatedAutopilot]
RELEASES = pytest.mark.parametrize("release", [COPTER_3_5, COPTER_4_0, COPTER_4_6], ids=["3.5", "4.0", "4.6"])
FRAMES = pytest.mark.parametrize("frame", [LocalFrame(), ORIGIN], ids=["local", "global"])


class Flight:
    """One autopilot, the agent's vehicle beside it, and a controller that may be speaking."""

    def __init__(self, makes: Makes, frame: CoordinateFrame | None = None, limits: VehicleLimits | None = None) -> None:
        self.flown = SimulatedVehicle((0.0, 0.0, 0.0), limits)
        self.transport = UdpTransport(0)
        self.vehicle = AutopilotVehicle(self.transport, frame)
        self.autopilot = makes(self.flown, self.transport.port)
        self.now_ns = START_NS
        self.ordered_m: Metres | None = None
        """What the controller says in each step."""
        self.told: list[tuple[Severity, str]] = []
        self.flown.update(self.now_ns)

    def go_on(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.now_ns += round(STEP_S * 1e9)
            self.flown.update(self.now_ns)
            self.autopilot.step(self.now_ns)
            if self.ordered_m is not None:
                self.vehicle.go_to(self.ordered_m)
            self.vehicle.update(self.now_ns)
            self.told += self.vehicle.said()

    def off_m(self, position_m: Metres) -> float:
        return math.dist(self.flown.position_m, position_m)

    def set_points(self) -> int:
        return self.autopilot.heard[LOCAL_POINT] + self.autopilot.heard[GLOBAL_POINT]


@contextmanager
def flight_of(makes: Makes, frame: CoordinateFrame | None = None) -> Iterator[Flight]:
    flight = Flight(makes, frame)
    with closing(flight.vehicle), closing(flight.autopilot):
        yield flight


def copter(release: ArduCopterRelease = COPTER_4_6, is_in_the_air: bool = True, fence_m: float = math.inf) -> Makes:
    return lambda vehicle, port: SimulatedArduPilot(vehicle, port, release, is_in_the_air, fence_m)


def px4(is_in_the_air: bool = True) -> Makes:
    return lambda vehicle, port: SimulatedPx4(vehicle, port, is_in_the_air)


@RELEASES
@FRAMES
def test_ardupilot_flies_where_it_is_told(release: ArduCopterRelease, frame: CoordinateFrame) -> None:
    """Also up to 4.0, which creeps as long as it is told to again and again."""
    with flight_of(copter(release), frame) as flight:
        flight.go_on(1.5)
        assert flight.vehicle.mode is HOLDING
        flight.ordered_m = (9.0, -6.0, 3.0)
        flight.go_on(8)
        assert flight.vehicle.mode is FOLLOWING
        assert flight.off_m(flight.ordered_m) < 0.05
        assert flight.told == []


def test_a_destination_that_runs_ahead_is_followed_up_to_4_0_slowly() -> None:
    with flight_of(copter(COPTER_4_0)) as flight:
        flight.go_on(1.5)
        for step in range(100):
            flight.ordered_m = (0.15 * step, 0.0, 0.0)  # 3 m/s
            flight.go_on(STEP_S)
        assert flight.off_m(flight.ordered_m) > 5
        flight.go_on(5)
        assert flight.off_m(flight.ordered_m) < 0.05


@FRAMES
def test_px4_flies_where_it_is_told(frame: CoordinateFrame) -> None:
    with flight_of(px4(), frame) as flight:
        flight.go_on(4)
        assert flight.vehicle.mode is HOLDING
        assert flight.autopilot.mode == POSITION
        flight.ordered_m = (9.0, -6.0, 3.0)
        flight.go_on(1)
        assert flight.autopilot.mode == OFFBOARD  # it is not refused even once
        flight.go_on(7)
        assert flight.off_m(flight.ordered_m) < 0.05
        flight.ordered_m = None
        flight.vehicle.hold()
        flight.go_on(20)  # holding lasts
        assert (flight.vehicle.mode, flight.autopilot.mode) == (HOLDING, OFFBOARD)
        assert flight.off_m((9.0, -6.0, 3.0)) < 0.1
        assert flight.told == []


def test_px4_is_asked_for_the_mode_when_it_takes_it() -> None:
    """A controller speaks from the beginning; nothing red during a normal start."""
    with flight_of(px4()) as flight:
        flight.ordered_m = (9.0, -6.0, 3.0)
        flight.go_on(12)
        assert flight.off_m(flight.ordered_m) < 0.05
        assert flight.told == []


def test_px4_lands_when_set_points_end() -> None:
    """The agent has died."""
    with flight_of(px4(is_in_the_air=False)) as flight:
        flight.autopilot.arm()
        flight.autopilot.take_off(5.0)
        flight.go_on(6)
        flight.ordered_m = (4.0, 0.0, 5.0)
        flight.go_on(5)
        assert flight.off_m(flight.ordered_m) < 0.05
        for _ in range(round(15 / STEP_S)):
            flight.now_ns += round(STEP_S * 1e9)
            flight.flown.update(flight.now_ns)
            flight.autopilot.step(flight.now_ns)
        assert (flight.autopilot.mode, flight.autopilot.is_armed) == (LAND, False)
        assert flight.off_m((4.0, 0.0, 0.0)) < 0.05


def test_arming_does_not_launch_px4() -> None:
    """A controller speaks; the mode is chosen at the ground station, as soon as it can be, and the vehicle armed."""
    with flight_of(px4(is_in_the_air=False)) as flight:
        flight.ordered_m = (0.0, 0.0, 10.0)
        flight.go_on(3)
        flight.autopilot.choose(OFFBOARD)
        flight.autopilot.arm()
        flight.go_on(3)
        flight.autopilot.choose(OFFBOARD)
        flight.go_on(20)
        assert flight.off_m((0.0, 0.0, 0.0)) == 0
        assert flight.set_points() == 0
        assert flight.vehicle.mode is MANUAL
        assert (flight.vehicle.state.is_armed, flight.vehicle.state.is_airborne) == (True, False)
        flight.autopilot.take_off(5.0)
        flight.go_on(10)  # once it is up it is led
        assert flight.vehicle.mode is FOLLOWING
        assert flight.off_m((0.0, 0.0, 10.0)) < 0.05


@RELEASES
def test_ardupilot_takes_off_beside_a_running_agent(release: ArduCopterRelease) -> None:
    with flight_of(copter(release, is_in_the_air=False)) as flight:
        flight.go_on(3)
        assert flight.vehicle.state.is_airborne is False
        flight.autopilot.choose(GUIDED)
        flight.autopilot.arm()
        flight.go_on(2)
        flight.autopilot.take_off(10.0)
        flight.go_on(10)
        assert flight.off_m((0.0, 0.0, 10.0)) < 0.3
        assert flight.autopilot.is_armed
        assert flight.vehicle.mode is HOLDING
        assert flight.vehicle.state.is_airborne is True
        assert flight.set_points() == 0


@pytest.mark.parametrize("release", [COPTER_4_0, COPTER_4_6], ids=["4.0", "4.6"])
def test_a_controller_does_not_end_the_take_off(release: ArduCopterRelease) -> None:
    """It speaks all the time; the landed state is what says that it is not time yet."""
    with flight_of(copter(release, is_in_the_air=False)) as flight:
        flight.ordered_m = (6.0, 0.0, 12.0)
        flight.autopilot.choose(GUIDED)
        flight.go_on(3)
        flight.autopilot.arm()
        flight.go_on(2)
        flight.autopilot.take_off(10.0)
        flight.go_on(1)
        assert flight.autopilot.phase is Phase.TAKE_OFF
        assert flight.vehicle.mode is MANUAL
        flight.go_on(12)
        assert flight.off_m(flight.ordered_m) < 0.05


@pytest.mark.parametrize(
    ("makes", "modes"),
    [
        (copter(COPTER_4_0, is_in_the_air=False), [GUIDED, GUIDED, LOITER, COPTER_LAND]),
        (copter(COPTER_4_6, is_in_the_air=False), [GUIDED, GUIDED, LOITER, COPTER_LAND]),
        (px4(is_in_the_air=False), [OFFBOARD, OFFBOARD, POSITION, LAND]),
    ],
    ids=["ArduCopter 4.0", "ArduCopter 4.6", "PX4"],
)
def test_whatever_people_do_nothing_is_sent_on_the_ground(makes: Makes, modes: list[int]) -> None:
    """Nor in a climb. What it says of that may be half a second old."""
    flights, sent = 0, 0
    for seed in range(8):
        random = Random(seed)
        with flight_of(makes) as flight:
            began_ns, phase = flight.now_ns, flight.autopilot.phase
            for _ in range(20):
                do_something(flight, modes, random)
                for _ in range(random.randint(4, 60)):
                    before = flight.set_points()
                    flight.go_on(STEP_S)
                    if flight.autopilot.phase is not phase:
                        began_ns, phase = flight.now_ns, flight.autopilot.phase
                        flights += phase is Phase.TAKE_OFF
                    is_climbing = phase is Phase.TAKE_OFF and flight.flown.velocity_mps[2] > 0.3
                    if (phase is Phase.GROUND or is_climbing) and flight.now_ns - began_ns > 0.5e9:
                        assert flight.set_points() == before, (seed, phase)
                    sent += flight.set_points() - before
    assert flights >= 8
    assert sent >= 20


def do_something(flight: Flight, modes: list[int], random: Random) -> None:
    """As pilots, people at ground stations and controllers do."""
    what = random.randrange(5)
    if what == 0:
        flight.autopilot.choose(random.choice(modes))
    elif what == 1:
        flight.ordered_m = (random.uniform(-9, 9), 0.0, random.uniform(3, 9))
    elif what == 2:
        flight.ordered_m = None
        flight.vehicle.hold()
    else:
        flight.autopilot.arm()
        flight.autopilot.take_off(random.uniform(2, 8))


def test_a_ground_station_s_fly_here_lasts() -> None:
    """Before a controller has been heard, and when none is heard any more."""
    with flight_of(copter()) as flight:
        assert isinstance(flight.autopilot, SimulatedArduPilot)
        flight.autopilot.choose(GUIDED)
        flight.go_on(3)
        flight.autopilot.fly_here((5.0, 0.0, 0.0))
        flight.go_on(10)
        assert flight.off_m((5.0, 0.0, 0.0)) < 0.05
        flight.ordered_m = (0.0, 5.0, 0.0)
        flight.go_on(6)
        assert flight.off_m((0.0, 5.0, 0.0)) < 0.05
        flight.ordered_m = None
        flight.vehicle.hold()
        flight.go_on(6)
        flight.autopilot.fly_here((-5.0, 0.0, 0.0))
        flight.go_on(20)
        assert flight.off_m((-5.0, 0.0, 0.0)) < 0.05
        # It has returned as far as the agent leads it, and nothing is said any more.
        flight.vehicle.go_to((0.0, 0.0, 0.0))
        flight.go_on(10)
        assert flight.off_m((0.0, 0.0, 0.0)) < 0.05
        flight.autopilot.fly_here((5.0, 0.0, 0.0))
        flight.go_on(20)
        assert flight.off_m((5.0, 0.0, 0.0)) < 0.05
        assert flight.told == []


@RELEASES
@FRAMES
def test_positions_come_often_enough(release: ArduCopterRelease, frame: CoordinateFrame) -> None:
    """Twice a second until they are asked for, which 3.5 understands in its own way alone."""
    with flight_of(copter(release), frame) as flight:
        flight.go_on(3)
        oldest_s = 0.0
        for _ in range(40):
            flight.go_on(STEP_S)
            oldest_s = max(oldest_s, flight.vehicle.position_age_s)
        assert oldest_s <= 0.1
        asked = sum(flight.autopilot.heard.values())
        flight.go_on(20)
        assert sum(flight.autopilot.heard.values()) - asked == 20  # heartbeats: it asks no more
        # Somebody else on the line has it say less.
        flight.autopilot._rates_hz.update(dict.fromkeys(flight.autopilot._rates_hz, 1.0))
        flight.go_on(5)
        assert flight.vehicle.position_age_s <= 0.1


def test_a_destination_that_is_dropped_is_told_once() -> None:
    with flight_of(copter(fence_m=10.0)) as flight:
        flight.ordered_m = (8.0, 0.0, 0.0)
        flight.go_on(10)
        assert flight.told == []
        flight.ordered_m = (30.0, 0.0, 0.0)
        flight.go_on(30)
        assert flight.off_m((8.0, 0.0, 0.0)) < 0.05
        ((severity, text),) = flight.told
        assert severity is Severity.WARNING
        assert text == "stands 22.0 m from where it is told to be: is there a fence of its own?"


def test_a_refused_mode_is_shown_with_the_autopilot_s_words() -> None:
    with flight_of(copter(COPTER_4_6)) as flight:
        flight.go_on(3)
        flight.autopilot.has_position = False
        flight.ordered_m = (5.0, 0.0, 0.0)
        flight.go_on(1)
        assert flight.told[0] == (Severity.WARNING, "Mode change to GUIDED failed: requires position")
        assert flight.told[1] == (Severity.ERROR, "GUIDED is refused: failed")
        flight.go_on(30)
        own = [text for _, text in flight.told if text.startswith("GUIDED")]
        assert own == ["GUIDED is refused: failed", "GUIDED is refused: left alone until a pilot chooses it"]
        assert (flight.vehicle.mode, flight.autopilot.mode) == (MANUAL, LOITER)


def test_after_a_failsafe_a_pilot_gives_it_back_though_its_status_stays() -> None:
    with flight_of(copter()) as flight:
        assert isinstance(flight.autopilot, SimulatedArduPilot)
        flight.ordered_m = (20.0, 0.0, 0.0)
        flight.go_on(8)
        assert flight.vehicle.mode is FOLLOWING
        flight.autopilot.fail_battery()
        flight.go_on(10)
        assert (flight.vehicle.mode, flight.autopilot.mode) == (MANUAL, RTL)
        assert flight.off_m((0.0, 0.0, 0.0)) < 0.05
        assert flight.told == [(Severity.WARNING, "Battery 1 low voltage")]
        flight.autopilot.choose(LOITER)
        flight.go_on(5)
        assert flight.vehicle.mode is MANUAL
        flight.autopilot.choose(GUIDED)
        flight.go_on(8)
        assert flight.vehicle.mode is FOLLOWING
        assert flight.off_m((20.0, 0.0, 0.0)) < 0.05


def test_six_of_different_makes_chase_the_target() -> None:
    """The real service, link and agents. The preflight passes without a word from the operator; the battery of one
    fails on the way, and the others reach the target without it.
    """
    scenario = paper_scenario(sampling_hz=10, start_distance_m=15.0)
    makes = [copter(COPTER_4_6), copter(COPTER_4_0), copter(COPTER_3_5), px4(), px4(), copter(COPTER_4_6)]
    snapshots: list[Snapshot] = []
    chase = VirtualChase(scenario, load_controller("oracle", scenario), 1, 0, watch=snapshots.append)
    autopilots: list[SimulatedAutopilot] = []
    for tracker, agent in enumerate(chase.agents):
        transport = UdpTransport(0)
        autopilots.append(makes[tracker](chase.site.vehicles[tracker], transport.port))
        assert agent is not None
        agent._vehicle = AutopilotVehicle(transport, ORIGIN)
    failing = autopilots[5]
    assert isinstance(failing, SimulatedArduPilot)

    def step_autopilots() -> None:
        for one in autopilots:
            one.step(chase.clock.now_ns())
        if failing.mode == GUIDED and snapshots and snapshots[-1].movements == 2:
            failing.fail_battery()

    try:
        result = chase.run(step_autopilots)
    finally:
        for agent, autopilot in zip(chase.agents, autopilots, strict=True):
            assert agent is not None
            agent._vehicle.close()
            autopilot.close()
    assert result.reached
    assert [one.mode for one in autopilots] == [GUIDED, GUIDED, GUIDED, OFFBOARD, OFFBOARD, RTL]
    trackers = snapshots[-1].trackers
    assert trackers[5].mode is MANUAL
    assert [[notice.text for notice in tracker.notices] for tracker in trackers] == [
        *[[]] * 5,
        ["Battery 1 low voltage"],
    ]


# Led along a way


class LedFlight(Flight):
    """A formation's place that flies east at 8 m/s after speeding up, then north; the controller speaks of it in each
    step, as the service does (``pursuit``): where it comes to rest if it brakes now.
    """

    def __init__(self, makes: Makes, frame: CoordinateFrame | None = None, limits: VehicleLimits | None = None) -> None:
        super().__init__(makes, frame, limits)
        self.acceleration_mps2 = self.flown._limits.acceleration_mps2
        self.place_m, self.velocity_mps = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        self.off: list[float] = []

    def lead(self, wanted_mps: Metres, seconds: float) -> None:
        self.off.clear()
        for _ in range(round(seconds / STEP_S)):
            change = [wanted - now for wanted, now in zip(wanted_mps, self.velocity_mps, strict=True)]
            share = min(1.0, self.acceleration_mps2 * STEP_S / max(math.hypot(*change), 1e-9))
            before = self.velocity_mps
            self.velocity_mps = [now + share * part for now, part in zip(before, change, strict=True)]
            self.place_m = [
                here + (one + other) / 2 * STEP_S
                for here, one, other in zip(self.place_m, before, self.velocity_mps, strict=True)
            ]
            braking_mps2 = BRAKING_SHARE * self.acceleration_mps2
            ahead_s = math.hypot(*self.velocity_mps) / (2 * braking_mps2)
            rest_m = tuple(here + ahead_s * one for here, one in zip(self.place_m, self.velocity_mps, strict=True))
            self.vehicle.lead(rest_m, braking_mps2)  # type: ignore[arg-type]
            self.go_on(STEP_S)
            self.off.append(math.dist(self.flown.true_position_m, self.place_m))

    def sent_with_velocity(self) -> bool:
        return self.autopilot.last_mask == POSITION_AND_VELOCITY


@contextmanager
def led_flight_of(
    makes: Makes, frame: CoordinateFrame | None = None, limits: VehicleLimits | None = None
) -> Iterator[LedFlight]:
    flight = LedFlight(makes, frame, limits)
    with closing(flight.vehicle), closing(flight.autopilot):
        yield flight


IDEAL = VehicleLimits(12.0, 5.0)
HABITS = [
    pytest.param(IDEAL, 2.5, 0.8, id="ideal"),
    pytest.param(VehicleLimits(12.0, 5.0, 0.3, 0.5, 0.5), 4.5, 1.5, id="lag, wind and noise"),
    pytest.param(VehicleLimits(12.0, 2.0, 0.3, 0.3, 0.5), 4.5, 1.5, id="2 m/s2"),
]
"""Of vehicles, how far off they may get in turns, in which the formation turns as hard as they can, and afterwards."""


@pytest.mark.parametrize(("limits", "most_off_m", "then_off_m"), HABITS)
@pytest.mark.parametrize("make", ["3.5", "4.0", "4.6", "px4"])
@FRAMES
def test_whoever_is_led_along_a_way_flies_it_as_fast_as_it_is_led(
    make: str, frame: CoordinateFrame, limits: VehicleLimits, most_off_m: float, then_off_m: float
) -> None:
    """Copters up to 4.0 too, which creep where places come ten times a second; speeding up and round a corner."""
    releases = {"3.5": COPTER_3_5, "4.0": COPTER_4_0, "4.6": COPTER_4_6}
    with led_flight_of(px4() if make == "px4" else copter(releases[make]), frame, limits) as flight:
        flight.go_on(4)
        flight.lead((0.0, 0.0, 0.0), 2.0)  # PX4 takes the mode
        flight.lead((8.0, 0.0, 0.0), 9.0)
        assert flight.vehicle.mode is FOLLOWING
        assert flight.sent_with_velocity()
        assert max(flight.off) < most_off_m
        assert max(flight.off[-20:]) < then_off_m
        flight.lead((0.0, 8.0, 0.0), 9.0)
        assert max(flight.off) < most_off_m
        assert max(flight.off[-20:]) < then_off_m
        assert math.hypot(*flight.flown.velocity_mps) > 7.0
        # The controller falls silent: the agent holds, and the vehicle comes to rest ahead of where it is.
        at_m = flight.flown.true_position_m
        flight.vehicle.hold()
        flight.go_on(9.0)
        assert not flight.sent_with_velocity()
        flown_m = flight.flown.true_position_m[1] - at_m[1]
        stopping_m = 64 / 2 / limits.acceleration_mps2
        assert stopping_m - 2 < flown_m < 1.25 * stopping_m + 3
        assert math.hypot(*flight.flown.velocity_mps) < 0.6
        assert flight.told == []


@pytest.mark.parametrize("make", ["4.6", "px4"])
def test_an_agent_that_dies_in_full_flight_has_its_vehicle_stop(make: str) -> None:
    """ArduCopter after GUID_TIMEOUT, PX4 after COM_OF_LOSS_T."""
    with led_flight_of(px4() if make == "px4" else copter(), limits=IDEAL) as flight:
        flight.go_on(4)
        flight.lead((0.0, 0.0, 0.0), 2.0)
        flight.lead((8.0, 0.0, 0.0), 4.0)
        at_m = flight.flown.true_position_m
        for _ in range(round(8.0 / STEP_S)):
            flight.now_ns += round(STEP_S * 1e9)
            flight.flown.update(flight.now_ns)
            flight.autopilot.step(flight.now_ns)
        flown_m = flight.flown.true_position_m[0] - at_m[0]
        assert (5.0 < flown_m < 22.0) if make == "px4" else (20.0 < flown_m < 35.0)
        assert math.hypot(*flight.flown.velocity_mps[:2]) < 1.0


def test_six_copters_of_all_makes_catch_a_target_that_flies_over_a_link_with_bursts() -> None:
    """With lag, wind, receivers of positions that are .3 m off, and 2 m/s2 to 5 in what they can."""
    scenario = Scenario.from_dict(
        load_scenario("flight").to_dict()
        | {"behaviour": "waypoints", "start_distance_m": 30.0, "farthest_start_m": 40.0, "tracker_speed_mps": 8.0}
        | {"tracker_acceleration_mps2": 2.5, "target_speed_mps": 2.0}
    )
    makes = [copter(COPTER_4_6), copter(COPTER_4_0), copter(COPTER_3_5), px4(), px4(), copter(COPTER_4_6)]
    places_m = (scenario.initial_spacing_m * TRACKER_DIRECTION).tolist()
    accelerations_mps2 = (2.5, 3.0, 3.5, 4.0, 4.5, 5.0)
    vehicles = [
        SimulatedVehicle((x_m, y_m, z_m), VehicleLimits(9.6, acceleration_mps2, 0.2, 0.3, 0.3), Random(tracker))
        for tracker, ((x_m, y_m, z_m), acceleration_mps2) in enumerate(zip(places_m, accelerations_mps2, strict=True))
    ]
    plan, controller = fault_plan("burst=0.15"), load_controller("particle", scenario)
    chase = VirtualChase(scenario, controller, 1, 0, plan, vehicles=vehicles)
    autopilots: list[SimulatedAutopilot] = []
    for agent, make, vehicle in zip(chase.agents, makes, vehicles, strict=True):
        transport = UdpTransport(0)
        autopilots.append(make(vehicle, transport.port))
        assert agent is not None
        agent._vehicle = AutopilotVehicle(transport, ORIGIN)
    with_velocity: set[int] = set()

    def step_autopilots() -> None:
        for number, one in enumerate(autopilots):
            one.step(chase.clock.now_ns())
            if one.last_mask == POSITION_AND_VELOCITY:
                with_velocity.add(number)

    try:
        result = chase.run(step_autopilots)
    finally:
        for agent, autopilot in zip(chase.agents, autopilots, strict=True):
            assert agent is not None
            agent._vehicle.close()
            autopilot.close()
    assert (result.state, result.said_distance_m < scenario.success_radius_m + 1.0) == ("reached", True), result.reason
    assert with_velocity == set(range(6))
    assert result.least_separation_m >= SafetyLimits().minimum_separation_m - MARGIN_M


def test_planes_and_rovers_are_sent_places_alone() -> None:
    assert not ARDUPILOT.takes_velocities(1)
    assert not ARDUPILOT.takes_velocities(10)
    assert ARDUPILOT.takes_velocities(2)
    assert not PX4.takes_velocities(1)
    assert PX4.takes_velocities(2)
