"""What carries a receiver: simulated, or an autopilot, here a fake one that speaks MAVLink over UDP on loopback."""

import math
import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmchase.errors import InputError
from swarmchase.live.link.messages import Metres, TrackerMode
from swarmchase.live.tracker.vehicles import (
    AutopilotVehicle,
    GlobalFrame,
    LocalFrame,
    SerialTransport,
    SimulatedVehicle,
    UdpTransport,
    Vehicle,
    VehicleLimits,
)
from swarmchase.live.tracker.vehicles.frames import CoordinateFrame
from swarmchase.live.tracker.vehicles.mode_keeper import MOST_REQUESTS

HOLDING, FOLLOWING, MANUAL = TrackerMode.HOLDING, TrackerMode.FOLLOWING, TrackerMode.MANUAL
SECOND_NS = 1_000_000_000

# The simulated vehicle


def fly(vehicle: SimulatedVehicle, start_s: float, end_s: float, step_s: float = 0.05) -> list[tuple[Metres, Metres]]:
    """(position, velocity) after each update."""
    path = []
    for step in range(1, round((end_s - start_s) / step_s) + 1):
        vehicle.update(round((start_s + step * step_s) * 1e9))
        path.append((vehicle.position_m, vehicle.velocity_mps))
    return path


def test_it_arrives_exactly_and_stays() -> None:
    vehicle = SimulatedVehicle((1.0, 2.0, 3.0), VehicleLimits(speed_mps=2.0, acceleration_mps2=1.0))
    vehicle.update(0)
    assert (vehicle.position_m, vehicle.velocity_mps, vehicle.mode) == ((1, 2, 3), (0, 0, 0), HOLDING)
    vehicle.go_to((11.0, 2.0, 3.0))
    assert vehicle.mode == FOLLOWING
    # 10 m at 2 m/s, and 1 m/s^2 at either end: 7 s, a little more with the reserve in braking.
    path = fly(vehicle, 0, 6.9)
    assert path[-1][0] != (11, 2, 3)
    assert path[60][1] == pytest.approx((2, 0, 0))
    fly(vehicle, 6.9, 9)
    assert (vehicle.position_m, vehicle.velocity_mps, vehicle.mode) == ((11, 2, 3), (0, 0, 0), FOLLOWING)
    fly(vehicle, 9, 12)
    assert vehicle.position_m == (11, 2, 3)


def test_hold_stops_it_on_the_way() -> None:
    """From 2 m/s with 1 m/s^2: two seconds and two metres."""
    vehicle = SimulatedVehicle((0.0, 0.0, 0.0), VehicleLimits(speed_mps=2.0, acceleration_mps2=1.0))
    vehicle.update(0)
    vehicle.go_to((0.0, 100.0, 0.0))
    fly(vehicle, 0, 5)
    north_m = vehicle.position_m[1]
    vehicle.hold()
    assert vehicle.mode == HOLDING
    fly(vehicle, 5, 7.1)
    assert vehicle.velocity_mps == (0, 0, 0)
    assert vehicle.position_m[1] - north_m == pytest.approx(2, abs=0.05)
    stopped_m = vehicle.position_m
    fly(vehicle, 7.1, 20)
    assert vehicle.position_m == stopped_m


def test_a_pilot_takes_it_over() -> None:
    vehicle = SimulatedVehicle((0.0, 0.0, 0.0))
    vehicle.update(0)
    vehicle.go_to((10.0, 0.0, 0.0))
    fly(vehicle, 0, 1)
    vehicle.take_over()
    vehicle.go_to((-10.0, 0.0, 0.0))
    assert vehicle.mode == MANUAL
    fly(vehicle, 1, 5)
    stopped_m = vehicle.position_m
    assert 0 < stopped_m[0] < 10
    vehicle.give_back()
    assert vehicle.mode == HOLDING
    fly(vehicle, 5, 6)
    assert vehicle.position_m == stopped_m
    vehicle.go_to((-10.0, 0.0, 0.0))
    fly(vehicle, 6, 20)
    assert vehicle.position_m == (-10, 0, 0)


def test_the_habits_of_real_ones() -> None:
    """It lags, wind moves it, and it is half a metre from where it takes itself to be; a seed is a flight."""
    limits = VehicleLimits(lag_s=0.3, gusts_mps2=1.0, position_error_m=0.5)
    one, same, other = (SimulatedVehicle((0.0, 0.0, 0.0), limits, Random(seed)) for seed in (1, 1, 2))
    ideal = SimulatedVehicle((0.0, 0.0, 0.0))
    for vehicle in (one, same, other, ideal):
        vehicle.update(0)
        vehicle.go_to((10.0, 0.0, 0.0))
    began_m = one.position_m
    for flown_s in range(6):
        for vehicle in (one, same, other, ideal):
            fly(vehicle, flown_s, flown_s + 1)
        assert math.dist(one.position_m, one.true_position_m) == pytest.approx(0.5)
        if flown_s < 2:
            assert one.true_position_m[0] < ideal.true_position_m[0]
    assert one.position_m == same.position_m != other.position_m
    # It holds its place against the wind by what it takes for its place.
    assert 0 < math.dist(one.position_m, (10, 0, 0)) < 0.5
    assert math.dist(one.true_position_m, (10, 0, 0)) > 0
    assert math.dist(began_m, (0, 0, 0)) == pytest.approx(0.5)
    one.hold()
    fly(one, 6, 7)
    held_m = one.position_m
    fly(one, 7, 30)
    assert math.dist(one.position_m, held_m) < 0.6


def test_after_a_pause_it_has_stood_still() -> None:
    vehicle = SimulatedVehicle((0.0, 0.0, 0.0), VehicleLimits(speed_mps=2.0))
    vehicle.update(0)
    vehicle.go_to((100.0, 0.0, 0.0))
    vehicle.update(3600 * SECOND_NS)
    assert 0 < vehicle.position_m[0] < 2


COORDINATE = st.floats(-50, 50)


@settings(deadline=None, max_examples=15)
@given(
    st.lists(st.tuples(st.tuples(COORDINATE, COORDINATE, COORDINATE), st.integers(1, 60)), min_size=1, max_size=5),
    st.floats(1, 20),
    st.floats(1, 20),
    st.floats(0.01, 0.3),
)
def test_it_never_exceeds_its_limits(
    orders: list[tuple[Metres, int]], speed_mps: float, acceleration_mps2: float, step_s: float
) -> None:
    vehicle = SimulatedVehicle((0.0, 0.0, 0.0), VehicleLimits(speed_mps, acceleration_mps2))
    vehicle.update(0)
    now_s, velocity_mps = 0.0, vehicle.velocity_mps
    for target_m, steps in orders:
        vehicle.go_to(target_m)
        for _, changed_mps in fly(vehicle, now_s, now_s + steps * step_s, step_s):
            assert math.hypot(*changed_mps) <= speed_mps * (1 + 1e-9)
            # The last thousandth of a metre is a jump from less than .05 m/s.
            assert math.dist(velocity_mps, changed_mps) <= acceleration_mps2 * step_s + 0.05
            velocity_mps = changed_mps
        now_s += steps * step_s
    distance_m = math.dist(vehicle.position_m, orders[-1][0])
    longest_s = (
        distance_m / speed_mps + 5 * speed_mps / acceleration_mps2 + 5 * math.sqrt(distance_m / acceleration_mps2)
    )
    fly(vehicle, now_s, now_s + longest_s + 5, 0.1)
    assert vehicle.position_m == orders[-1][0]


@pytest.mark.parametrize("limit", [0.0, -1.0, math.nan, math.inf])
def test_refused_limits(limit: float) -> None:
    with pytest.raises(InputError, match="speed_mps"):
        VehicleLimits(speed_mps=limit)
    with pytest.raises(InputError, match="acceleration_mps2"):
        VehicleLimits(acceleration_mps2=limit)


# The autopilot

ARDUPILOT, PX4 = 3, 12
COPTER, PLANE, ROVER = 2, 1, 10
STABILIZE, AUTO, GUIDED, LOITER, RTL, PLANE_GUIDED = 0, 3, 4, 5, 6, 15
PX4_POSITION, PX4_RETURN, PX4_OFFBOARD = 3 << 16, 4 << 16 | 5 << 24, 6 << 16
ACTIVE, CRITICAL = 4, 5
IN_AIR = 2
MAV_RESULT = {"accepted": 0, "denied": 2, "unsupported": 3}


class FakeAutopilot:
    """In the air. Says once a second that it is there and how it is, and ten times where it is and that it flies;
    answers to mode requests as it is told to. ``swarmchase.simulation`` has autopilots with habits of their own."""

    def __init__(self, port: int, firmware: int = ARDUPILOT, kind: int = COPTER, system: int = 1) -> None:
        from pymavlink.dialects.v20 import common

        self.mavlink: Any = common.MAVLink(None, srcSystem=system, srcComponent=1)
        self.parser: Any = common.MAVLink(None)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.connect(("127.0.0.1", port))
        self.firmware, self.kind = firmware, kind
        self.mode = LOITER if firmware == ARDUPILOT else PX4_POSITION
        self.armed, self.status = True, ACTIVE
        self.command_answer = "accepted"
        """Or denied, unsupported, silent."""
        self.takes_set_mode = True
        self.north_east_down_m = (0.0, 0.0, -10.0)
        self.speaks, self.knows_where_it_is = True, True
        self.heard: list[Any] = []

    def say(self, message: Any) -> None:
        self.socket.send(message.pack(self.mavlink))

    def beat(self) -> None:
        armed = 128 if self.armed else 0
        self.say(self.mavlink.heartbeat_encode(self.kind, self.firmware, 1 | armed, self.mode, self.status))

    def say_how_it_is(self) -> None:
        self.say(self.mavlink.sys_status_encode(0, 0, 0, 0, 15_000, 900, 80, 0, 0, 0, 0, 0, 0))
        self.say(self.mavlink.gps_raw_int_encode(0, 3, 0, 0, 0, 0, 0, 0, 0, 12))
        self.say(self.mavlink.vfr_hud_encode(0, 0, 45, 0, 10, 0))

    def say_that_it_flies(self) -> None:
        self.say(self.mavlink.extended_sys_state_encode(0, IN_AIR))

    def say_position(self) -> None:
        self.say(self.mavlink.local_position_ned_encode(0, *self.north_east_down_m, 1.0, 2.0, -3.0))

    def hear(self) -> None:
        while True:
            try:
                datagram = self.socket.recv(65536)
            except BlockingIOError:
                return
            for message in self.parser.parse_buffer(datagram):
                self.heard.append(message)
                if message.get_type() == "SET_MODE" and self.takes_set_mode:
                    self.mode = message.custom_mode
                elif (
                    message.get_type() == "COMMAND_LONG" and message.command == 176 and self.command_answer != "silent"
                ):
                    if self.command_answer == "accepted":
                        self.mode = int(message.param2) << 16 if self.firmware == PX4 else int(message.param2)
                    self.say(self.mavlink.command_ack_encode(176, MAV_RESULT[self.command_answer]))

    def heard_of(self, kind: str) -> list[Any]:
        return [message for message in self.heard if message.get_type() == kind]

    def mode_requests(self) -> list[str]:
        """In the order of their coming."""
        return [
            message.get_type()
            for message in self.heard
            if message.get_type() == "SET_MODE" or (message.get_type() == "COMMAND_LONG" and message.command == 176)
        ]

    def set_points(self) -> list[tuple[float, float, float]]:
        """North, east, down."""
        return [(message.x, message.y, message.z) for message in self.heard_of("SET_POSITION_TARGET_LOCAL_NED")]


class Flight:
    """A vehicle, its autopilot, and time that passes in steps of .1 s."""

    def __init__(self, frame: CoordinateFrame | None = None, firmware: int = ARDUPILOT, kind: int = COPTER) -> None:
        pytest.importorskip("pymavlink")
        self.transport = UdpTransport(0)
        self.vehicle = AutopilotVehicle(self.transport, frame)
        self.autopilot = FakeAutopilot(self.transport.port, firmware, kind)
        self.step = 100

    def go_on(self, seconds: float) -> None:
        for _ in range(round(seconds * 10)):
            self.step += 1
            if self.autopilot.speaks:
                if self.step % 10 == 0:
                    self.autopilot.beat()
                    self.autopilot.say_how_it_is()
                self.autopilot.say_that_it_flies()
                if self.autopilot.knows_where_it_is:
                    self.autopilot.say_position()
            self.vehicle.update(self.step * SECOND_NS // 10)
            self.autopilot.hear()

    def follow(self, position_m: Metres = (5.0, 6.0, 7.0)) -> None:
        """Until it does."""
        self.go_on(2.1)
        self.vehicle.go_to(position_m)
        self.go_on(4)
        assert self.vehicle.mode == FOLLOWING
        self.autopilot.heard.clear()

    def close(self) -> None:
        self.vehicle.close()
        self.autopilot.socket.close()


@pytest.fixture
def flight() -> Iterator[Flight]:
    flight = Flight()
    yield flight
    flight.close()


@pytest.mark.parametrize(
    ("firmware", "kind", "answer", "takes_set_mode", "requests", "mode"),
    [
        (ARDUPILOT, COPTER, "accepted", False, ["COMMAND_LONG"], GUIDED),
        (ARDUPILOT, PLANE, "accepted", False, ["COMMAND_LONG"], PLANE_GUIDED),
        (ARDUPILOT, ROVER, "unsupported", True, ["COMMAND_LONG", "SET_MODE"], PLANE_GUIDED),
        (ARDUPILOT, COPTER, "unsupported", True, ["COMMAND_LONG", "SET_MODE"], GUIDED),
        (ARDUPILOT, COPTER, "silent", True, ["COMMAND_LONG", "SET_MODE"], GUIDED),
        (PX4, COPTER, "accepted", False, ["COMMAND_LONG"], PX4_OFFBOARD),
        (PX4, COPTER, "denied", True, ["COMMAND_LONG", "SET_MODE"], PX4_OFFBOARD),
    ],
)
def test_the_mode_is_asked_for_and_counts_when_a_heartbeat_shows_it(
    firmware: int, kind: int, answer: str, takes_set_mode: bool, requests: list[str], mode: int
) -> None:
    flight = Flight(firmware=firmware, kind=kind)
    flight.autopilot.command_answer, flight.autopilot.takes_set_mode = answer, takes_set_mode
    assert flight.vehicle.mode == MANUAL  # nothing is known
    flight.go_on(3.5)
    assert flight.vehicle.mode == HOLDING
    assert flight.autopilot.mode_requests() == []
    flight.vehicle.go_to((5.0, 6.0, 7.0))
    flight.go_on(0.2)
    # What is not known is not asked for again; what is not answered is, a second later.
    assert flight.autopilot.mode_requests() == (requests if answer == "unsupported" else requests[:1])
    assert flight.vehicle.mode == HOLDING  # no heartbeat yet
    flight.go_on(3)
    assert flight.vehicle.mode == FOLLOWING
    assert flight.autopilot.mode == mode
    assert flight.autopilot.mode_requests()[: len(requests)] == requests
    heard = len(flight.autopilot.mode_requests())
    flight.go_on(5)
    assert len(flight.autopilot.mode_requests()) == heard
    flight.close()


def test_set_points_are_in_the_autopilot_s_frame() -> None:
    flight = Flight(LocalFrame(offset_m=(1.0, 2.0, 3.0)))
    flight.follow((5.0, 6.0, 7.0))
    assert flight.vehicle.position_m == (1.0, 2.0, 13.0)
    assert flight.vehicle.velocity_mps == (2.0, 1.0, 3.0)
    flight.vehicle.go_to((5.0, 6.5, 7.0))
    flight.go_on(1)
    (sent,) = flight.autopilot.heard_of("SET_POSITION_TARGET_LOCAL_NED")
    assert (sent.x, sent.y, sent.z) == (4.5, 4, -4)
    assert (sent.coordinate_frame, sent.type_mask, sent.target_system, sent.target_component) == (1, 0xDF8, 1, 1)
    assert len(flight.autopilot.heard_of("HEARTBEAT")) == 1
    flight.close()


def test_ardupilot_is_sent_what_changes_and_reminded_for_a_while(flight: Flight) -> None:
    flight.follow((5.0, 6.0, 7.0))
    for tenth in range(20):  # 3 m/s: each .1 s another one
        flight.vehicle.go_to((5.0 + 0.3 * (tenth + 1), 6.0, 7.0))
        flight.go_on(0.1)
    assert len(flight.autopilot.set_points()) == 20
    flight.autopilot.heard.clear()
    for tenth in range(20):  # .5 m/s
        flight.vehicle.go_to((11.0 + 0.05 * (tenth + 1), 6.0, 7.0))
        flight.go_on(0.1)
    assert len(flight.autopilot.set_points()) == 6
    flight.go_on(1)
    assert flight.autopilot.set_points()[-1] == (6, 12, -7)  # also the last little change
    flight.autopilot.heard.clear()
    for _ in range(40):  # the controller says the same again and again
        flight.vehicle.go_to((12.0, 6.0, 7.0))
        flight.go_on(0.1)
    assert flight.autopilot.set_points() == [(6, 12, -7)] * 2
    flight.go_on(6)  # it falls silent
    flight.autopilot.heard.clear()
    flight.go_on(20)
    assert flight.autopilot.set_points() == []


def test_holding_is_said_at_once_and_for_a_while(flight: Flight) -> None:
    flight.follow()
    flight.autopilot.north_east_down_m = (3.0, 2.0, -9.0)
    flight.vehicle.go_to((4.0, 6.0, 7.0))
    flight.go_on(0.1)
    flight.autopilot.heard.clear()
    flight.vehicle.hold()
    flight.vehicle.update(flight.step * SECOND_NS // 10)  # no time has passed: the agent ends
    flight.autopilot.hear()
    assert flight.autopilot.set_points() == [(3, 2, -9)]
    flight.autopilot.north_east_down_m = (3.5, 2.0, -9.0)  # it drifts on
    flight.go_on(30)
    assert flight.vehicle.mode == HOLDING
    assert flight.autopilot.set_points() == [(3, 2, -9)] * 3
    assert flight.autopilot.mode == GUIDED


def test_px4_is_streamed_to_while_it_flies() -> None:
    flight = Flight(firmware=PX4)
    flight.go_on(2.1)
    flight.autopilot.heard.clear()
    flight.go_on(2)  # before anybody has spoken: so that it takes the mode at once
    assert flight.vehicle.mode == HOLDING
    assert flight.autopilot.set_points() == [(0, 0, -10)] * 20
    assert flight.autopilot.mode_requests() == []
    flight.vehicle.go_to((5.0, 6.0, 7.0))
    flight.go_on(2)
    flight.autopilot.heard.clear()
    flight.go_on(20)
    assert flight.autopilot.set_points() == [(6, 5, -7)] * 200
    flight.autopilot.north_east_down_m = (3.0, 2.0, -9.0)
    flight.go_on(0.1)
    flight.vehicle.hold()
    flight.autopilot.north_east_down_m = (3.5, 2.0, -9.0)  # it drifts on
    flight.autopilot.heard.clear()
    flight.go_on(20)
    assert flight.vehicle.mode == HOLDING
    assert flight.autopilot.set_points() == [(3, 2, -9)] * 200
    flight.close()


@pytest.mark.parametrize("mode", [STABILIZE, LOITER, RTL, AUTO])
def test_what_a_pilot_or_a_failsafe_takes_is_left_alone_until_it_is_given_back(flight: Flight, mode: int) -> None:
    flight.follow()
    flight.autopilot.mode = mode
    flight.go_on(1)
    assert flight.vehicle.mode == MANUAL
    flight.autopilot.heard.clear()
    flight.vehicle.go_to((50.0, 0.0, 10.0))
    flight.vehicle.hold()
    flight.go_on(20)
    assert flight.vehicle.mode == MANUAL
    assert flight.autopilot.mode == mode
    assert {message.get_type() for message in flight.autopilot.heard} == {"HEARTBEAT"}
    # Given back, it stays where it is, and neither order from before moves it.
    flight.autopilot.north_east_down_m = (7.0, 8.0, -9.0)
    flight.autopilot.mode = GUIDED
    flight.go_on(3)
    assert flight.vehicle.mode == HOLDING
    assert flight.autopilot.set_points() == []
    flight.vehicle.go_to((1.0, 2.0, 3.0))
    flight.go_on(0.1)
    assert flight.vehicle.mode == FOLLOWING
    assert flight.autopilot.set_points()[-1] == (2, 1, -3)


def test_px4_gets_its_own_position_so_that_a_pilot_can_give_it_back() -> None:
    flight = Flight(firmware=PX4)
    flight.follow()
    flight.autopilot.mode = PX4_RETURN
    flight.go_on(1)
    flight.autopilot.heard.clear()
    flight.autopilot.north_east_down_m = (9.0, 9.0, -9.0)
    flight.vehicle.go_to((50.0, 0.0, 10.0))
    flight.go_on(3)
    assert flight.vehicle.mode == MANUAL
    assert flight.autopilot.set_points() == [(9, 9, -9)] * 30
    assert flight.autopilot.mode_requests() == []
    flight.autopilot.mode = PX4_OFFBOARD
    flight.go_on(2)
    assert flight.vehicle.mode == HOLDING
    assert set(flight.autopilot.set_points()) == {(9, 9, -9)}
    flight.close()


@pytest.mark.parametrize(
    ("change", "after_s"),
    [({"armed": False}, 1.0), ({"status": CRITICAL}, 1.0), ({"speaks": False}, 4.0)],
    ids=["disarmed", "failsafe", "silent"],
)
def test_what_cannot_be_commanded_is_not(flight: Flight, change: dict[str, Any], after_s: float) -> None:
    flight.follow()
    before = {name: getattr(flight.autopilot, name) for name in change}
    for name, value in change.items():
        setattr(flight.autopilot, name, value)
    flight.go_on(after_s)
    assert flight.vehicle.mode == MANUAL
    flight.autopilot.heard.clear()
    flight.vehicle.go_to((1.0, 2.0, 3.0))
    flight.go_on(2)
    assert flight.autopilot.set_points() == []
    for name, value in before.items():
        setattr(flight.autopilot, name, value)
    flight.go_on(1)
    assert flight.vehicle.mode == HOLDING


def test_a_refused_mode_is_not_asked_for_for_ever(flight: Flight) -> None:
    flight.autopilot.command_answer, flight.autopilot.takes_set_mode = "denied", False
    flight.go_on(1.1)
    flight.vehicle.go_to((1.0, 2.0, 3.0))
    flight.go_on(30)
    assert flight.vehicle.mode == MANUAL
    assert len(flight.autopilot.mode_requests()) == MOST_REQUESTS
    assert flight.vehicle.rejected["mode refused"] == 1
    flight.autopilot.mode = GUIDED  # by the pilot
    flight.go_on(1)
    assert flight.vehicle.mode == HOLDING


def test_a_pilot_who_changes_the_mode_meanwhile_is_not_overruled(flight: Flight) -> None:
    flight.autopilot.command_answer, flight.autopilot.takes_set_mode = "denied", False
    flight.go_on(1.1)
    flight.vehicle.go_to((1.0, 2.0, 3.0))
    flight.go_on(1)
    flight.autopilot.mode = STABILIZE
    flight.go_on(1)
    assert flight.vehicle.mode == MANUAL
    requests = len(flight.autopilot.mode_requests())
    flight.go_on(5)
    assert len(flight.autopilot.mode_requests()) == requests


def test_others_on_the_same_line_are_not_the_autopilot(flight: Flight) -> None:
    flight.follow()
    station, gimbal = FakeAutopilot(flight.transport.port, system=255), FakeAutopilot(flight.transport.port)
    gimbal.mavlink.srcComponent = 154
    for other in (station, gimbal):
        other.mode, other.north_east_down_m = RTL, (99.0, 99.0, 99.0)
        other.beat()
        other.say_position()
    flight.go_on(0.1)
    assert flight.vehicle.mode == FOLLOWING
    assert flight.vehicle.position_m == (0, 0, 10)
    assert flight.vehicle.rejected["not from the autopilot"] == 4
    stranger = FakeAutopilot(flight.transport.port, firmware=8)  # not an autopilot at all, by its own word
    stranger.beat()
    flight.go_on(0.1)
    assert flight.vehicle.mode == FOLLOWING
    for other in (station, gimbal, stranger):
        other.socket.close()


def test_what_a_ground_station_is_answered_is_not_for_us(flight: Flight) -> None:
    flight.autopilot.knows_where_it_is = False
    flight.autopilot.command_answer, flight.autopilot.takes_set_mode = "silent", False
    flight.go_on(1.1)
    flight.vehicle.go_to((1.0, 2.0, 3.0))
    flight.go_on(0.1)
    assert flight.autopilot.mode_requests() == ["COMMAND_LONG"]
    for command, answer in ((176, "denied"), (511, "unsupported")):
        for system, component in ((255, 190), (1, 190)):
            answered = (command, MAV_RESULT[answer], 0, 0, system, component)
            flight.autopilot.say(flight.autopilot.mavlink.command_ack_encode(*answered))
    flight.go_on(4)
    assert flight.vehicle.said() == []
    assert flight.autopilot.heard_of("REQUEST_DATA_STREAM") == []
    flight.autopilot.say(flight.autopilot.mavlink.command_ack_encode(511, MAV_RESULT["unsupported"], 0, 0, 1, 191))
    flight.go_on(0.1)
    assert len(flight.autopilot.heard_of("REQUEST_DATA_STREAM")) == 1


def test_a_position_is_asked_for_and_grows_old(flight: Flight) -> None:
    flight.autopilot.knows_where_it_is = False
    flight.go_on(2)
    assert flight.vehicle.position_m is None
    requests = [message for message in flight.autopilot.heard_of("COMMAND_LONG") if message.command == 511]
    assert (requests[0].param1, requests[0].param2) == (32, 100_000)
    flight.autopilot.knows_where_it_is = True
    flight.go_on(0.1)
    assert flight.vehicle.position_m == (0, 0, 10)
    flight.autopilot.knows_where_it_is = False
    flight.go_on(1)
    assert flight.vehicle.position_m == (0, 0, 10)
    flight.go_on(0.1)
    assert flight.vehicle.position_m is None
    for impossible_m in (math.nan, math.inf, 200_000.0):
        flight.autopilot.north_east_down_m = (0.0, impossible_m, 0.0)
        flight.autopilot.say_position()
    flight.go_on(0.1)
    assert flight.vehicle.position_m is None
    assert flight.vehicle.rejected["impossible position"] == 3


def test_without_a_position_it_is_not_held_anywhere(flight: Flight) -> None:
    flight.autopilot.knows_where_it_is = False
    flight.autopilot.mode = GUIDED
    flight.go_on(5)
    assert flight.vehicle.mode == HOLDING
    assert flight.autopilot.set_points() == []


@settings(deadline=None)
@given(st.lists(st.binary(max_size=60) | st.binary(max_size=40).map(lambda rest: b"\xfd" + rest), max_size=10))
def test_garbage_is_survived(datagrams: list[bytes]) -> None:
    flight = Flight()
    for datagram in datagrams:
        flight.autopilot.socket.send(datagram)
    flight.go_on(0.1)
    # A header may have promised more than came: what fills it up is lost with it, and no more.
    flight.go_on(4)
    assert flight.vehicle.mode == HOLDING
    flight.close()


def test_a_stream_that_is_never_cut_between_messages_fills_no_memory(flight: Flight) -> None:
    heartbeat = flight.autopilot.mavlink.heartbeat_encode(COPTER, ARDUPILOT, 129, GUIDED, ACTIVE)
    message = heartbeat.pack(flight.autopilot.mavlink)
    flight.autopilot.speaks = False
    flight.autopilot.socket.send(message[:5])
    for _ in range(200):
        flight.autopilot.socket.send(message[5:] + message[:5])
        flight.go_on(0.1)
    assert flight.vehicle.mode == HOLDING
    assert flight.vehicle.rejected == {}
    assert len(flight.vehicle._line.messages.buf) < 100


@settings(deadline=None)
@given(st.integers(0, 300), st.binary(min_size=1, max_size=9))
def test_a_damaged_message_changes_nothing(position: int, damage: bytes) -> None:
    flight = Flight()
    flight.go_on(1.1)
    packed = bytearray(
        flight.autopilot.mavlink.local_position_ned_encode(0, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0).pack(
            flight.autopilot.mavlink
        )
    )
    position %= len(packed) - 1
    changed = packed[:position] + damage + packed[position + len(damage) :]
    flight.autopilot.knows_where_it_is = False
    flight.autopilot.socket.send(bytes(changed))
    flight.go_on(0.1)
    assert flight.vehicle.position_m == ((2, 1, -3) if changed[: len(packed)] == packed else (0, 0, 10))
    flight.close()


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20", None)
    with UdpSocket() as transport, pytest.raises(InputError, match=r"pip install 'swarmchase\[live\]'"):
        AutopilotVehicle(transport)


class UdpSocket:
    """A transport that is closed at the end of a block."""

    def __enter__(self) -> UdpTransport:
        self.transport = UdpTransport(0)
        return self.transport

    def __exit__(self, *_: object) -> None:
        self.transport.close()


# Transports


def test_a_port_in_use_or_beyond() -> None:
    with UdpSocket() as transport:
        with pytest.raises(InputError, match="cannot listen"):
            UdpTransport(transport.port)
        with pytest.raises(InputError, match="cannot listen"):
            UdpTransport(70_000)
        transport.write(b"to nobody yet")
        assert transport.read() == []


def test_an_autopilot_that_has_gone_is_survived() -> None:
    with UdpSocket() as transport:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
            peer.sendto(b"hello", ("127.0.0.1", transport.port))
            assert transport.read() == [b"hello"]
        for _ in range(3):
            transport.write(b"anybody?")
            assert transport.read() == []


def test_a_serial_line() -> None:
    other_end, port = os.openpty()
    transport = SerialTransport(Path(os.ttyname(port)))
    os.close(port)
    assert transport.read() == []
    os.write(other_end, b"\xfd\x00\r\n\x03")
    found = b""
    for _ in range(10_000):
        found += b"".join(transport.read())
        if len(found) == 5:
            break
    assert found == b"\xfd\x00\r\n\x03"
    transport.write(b"\n\xfd")
    assert os.read(other_end, 10) == b"\n\xfd"
    os.close(other_end)  # unplugged
    transport.read()
    transport.write(b"x")
    transport.close()


# Frames


def earth_centred_m(latitude_deg: float, longitude_deg: float, altitude_m: float) -> tuple[float, float, float]:
    """WGS 84, from its semi-axes: an independent way to the same distances."""
    a, b = 6_378_137.0, 6_356_752.314245
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    normal = a * a / math.hypot(a * math.cos(latitude), b * math.sin(latitude))
    return (
        (normal + altitude_m) * math.cos(latitude) * math.cos(longitude),
        (normal + altitude_m) * math.cos(latitude) * math.sin(longitude),
        (normal * (b / a) ** 2 + altitude_m) * math.sin(latitude),
    )


@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg"), [(0.0, 0.0), (45.4754, -122.8413), (-35.36, 149.17), (60.0, 179.9999)]
)
def test_global_set_points_are_where_they_should_be(latitude_deg: float, longitude_deg: float) -> None:
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    mavlink = common.MAVLink(None)
    frame = GlobalFrame(latitude_deg, longitude_deg, 150.0)
    places_m = [(0.0, 0.0, 0.0), (300.0, 0.0, 0.0), (0.0, -400.0, 20.0), (-500.0, 600.0, 50.0), (0.5, 0.5, 1.0)]
    on_earth_m = []
    for place_m in places_m:
        sent = frame.set_point(mavlink, 7, (1, 1), place_m)
        assert (sent.coordinate_frame, sent.type_mask, sent.time_boot_ms) == (5, 0xDF8, 7)
        assert abs(sent.lon_int) <= 1_800_000_000
        on_earth_m.append(earth_centred_m(sent.lat_int / 1e7, sent.lon_int / 1e7, sent.alt))
        reported = mavlink.global_position_int_encode(
            0, sent.lat_int, sent.lon_int, round(sent.alt * 1e3), 0, 100, 200, -300, 0
        )
        assert frame.position_m(reported) == pytest.approx(place_m, abs=0.012)
        assert frame.velocity_mps(reported) == (2, 1, 3)
    for one, one_on_earth in zip(places_m, on_earth_m, strict=True):
        for other, other_on_earth in zip(places_m, on_earth_m, strict=True):
            distance_m = math.dist(one, other)
            assert math.dist(one_on_earth, other_on_earth) == pytest.approx(distance_m, rel=3e-4, abs=0.02)


@settings(deadline=None)
@given(st.tuples(COORDINATE, COORDINATE, COORDINATE), st.tuples(COORDINATE, COORDINATE, COORDINATE))
def test_local_set_points_come_back(offset_m: Metres, place_m: Metres) -> None:
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    mavlink = common.MAVLink(None)
    frame = LocalFrame(offset_m)
    sent = frame.set_point(mavlink, 7, (1, 1), place_m)
    assert frame.position_m(sent) == pytest.approx(place_m, abs=1e-9)


@pytest.mark.parametrize("frame", [LocalFrame((1.0, 2.0, 3.0)), GlobalFrame(45.0, 10.0, 100.0)])
def test_set_points_with_a_velocity_say_so_and_it_comes_back(frame: CoordinateFrame) -> None:
    """Acceleration, yaw and yaw rate alone are to be ignored."""
    mavlink = pytest.importorskip("pymavlink.dialects.v20.common").MAVLink(None)
    sent = frame.set_point(mavlink, 7, (1, 1), (4.0, 5.0, 6.0), (0.5, -2.0, 1.0))
    assert sent.type_mask == 0xDC0
    assert (sent.vx, sent.vy, sent.vz) == (-2.0, 0.5, -1.0)
    at_rest = frame.set_point(mavlink, 7, (1, 1), (4.0, 5.0, 6.0))
    assert (at_rest.type_mask, at_rest.vx, at_rest.vy, at_rest.vz) == (0xDF8, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("point", [(91.0, 0.0, 0.0), (90.0, 0.0, 0.0), (0.0, 181.0, 0.0), (0.0, 0.0, math.nan)])
def test_refused_origins(point: tuple[float, float, float]) -> None:
    with pytest.raises(InputError, match="is refused"):
        GlobalFrame(*point)


def test_a_global_flight() -> None:
    flight = Flight(GlobalFrame(45.0, 10.0, 100.0))
    flight.autopilot.say_position = lambda: flight.autopilot.say(
        flight.autopilot.mavlink.global_position_int_encode(0, 450_000_000, 100_000_000, 112_000, 0, 0, 0, 0, 0)
    )
    flight.follow((0.0, 0.0, 15.0))
    assert flight.vehicle.position_m == (0, 0, 12)
    flight.vehicle.go_to((0.0, 0.0, 16.0))
    flight.go_on(0.1)
    (sent,) = flight.autopilot.heard_of("SET_POSITION_TARGET_GLOBAL_INT")
    assert (sent.lat_int, sent.lon_int, sent.alt) == (450_000_000, 100_000_000, 116)
    flight.close()


def test_every_vehicle_is_a_vehicle() -> None:
    pytest.importorskip("pymavlink")
    with UdpSocket() as transport:
        vehicles = [SimulatedVehicle((0.0, 0.0, 0.0)), AutopilotVehicle(transport)]
        assert all(isinstance(vehicle, Vehicle) for vehicle in vehicles)
        assert [vehicle.position_m for vehicle in vehicles] == [(0, 0, 0), None]
