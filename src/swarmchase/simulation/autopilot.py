"""What simulated autopilots of all makes do alike: each flies a simulated vehicle, and speaks MAVLink to the tracker
agent beside it. What each does in its own way is in ``simulated_ardupilot`` and ``simulated_px4``.
"""

import math
import socket
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from enum import IntEnum
from typing import Any

from ..live.address import LOOPBACK
from ..live.link.dialect import mavlink
from ..live.link.messages import Metres
from ..live.ticker import next_moment_ns
from ..live.tracker.vehicles import GlobalFrame, SimulatedVehicle
from .vehicles_gone_wrong import FailingVehicle

HEARTBEAT_HZ = 1.0
MOST_DATAGRAMS = 100
POSITION_ONLY, POSITION_AND_VELOCITY = 3576, 3520
"""POSITION_TARGET_TYPEMASK, as both makes take it: all but the position, or all but position and velocity, is to be
ignored."""
ORIGIN = GlobalFrame(45.0, 10.0, 100.0)
"""Where the origin of the shared frame is on the earth; each one's own frame begins there too."""
ABOVE_GROUND_M = 100.0
"""So high one begins that is in the air."""
LANDED_M, TAKEN_OFF_M = 0.05, 0.2
"""So near to the ground, and to where its take-off ends."""
SIMULATED = mavlink.MAV_MODE_FLAG_HIL_ENABLED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
FULL_PERCENT, EMPTIES_PER_S = 97.0, 0.05
"""Of its battery: at the beginning, and in flight."""
SATELLITES = 14
TURNS_MPS = 0.5
"""Slower than this it keeps its heading."""
LOCAL, GLOBAL, LANDED = (
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
)
STATUS, GPS, HUD = (
    mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
    mavlink.MAVLINK_MSG_ID_VFR_HUD,
)


class Phase(IntEnum):
    """Of a flight, as MAVLink numbers them (MAV_LANDED_STATE)."""

    GROUND = mavlink.MAV_LANDED_STATE_ON_GROUND
    AIR = mavlink.MAV_LANDED_STATE_IN_AIR
    TAKE_OFF = mavlink.MAV_LANDED_STATE_TAKEOFF
    LANDING = mavlink.MAV_LANDED_STATE_LANDING


class SimulatedAutopilot(ABC):
    """Flies ``vehicle`` and speaks to the agent that listens at ``port`` of this machine.

    Args:
        mode: Its custom mode at the beginning.
        is_in_the_air: It begins armed, and ``ABOVE_GROUND_M`` high; otherwise it stands on the ground.
        rates_hz: How often it says ``LOCAL``, ``GLOBAL`` and ``LANDED`` until it is asked to say them more often.
    """

    mav_autopilot: int
    """MAV_AUTOPILOT of its make."""

    def __init__(
        self,
        vehicle: SimulatedVehicle | FailingVehicle,
        port: int,
        mode: int,
        is_in_the_air: bool,
        rates_hz: dict[int, float],
    ) -> None:
        self.has_companion = False
        """Whether an agent has ever spoken."""
        self.mode = mode
        self.is_armed = is_in_the_air
        self.phase = Phase.AIR if is_in_the_air else Phase.GROUND
        self.has_position = True
        """Whether it knows where it is."""
        self.heard: Counter[str] = Counter()
        """Messages by type."""
        self.last_mask: int | None = None
        """Of the newest set-point, as it came."""
        self._vehicle = vehicle
        self._home_m = vehicle.position_m
        self._ground_m = self._home_m[2] - (ABOVE_GROUND_M if is_in_the_air else 0.0)
        self._rates_hz = rates_hz | dict.fromkeys((STATUS, GPS, HUD), 0.0)
        self._now_ns = 0
        self._begun_ns: int | None = None
        self._heading_deg = 0
        self._mavlink: Any = mavlink.MAVLink(None, srcSystem=1, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._parser: Any = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._last_ns: dict[str, int] = {}
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect((LOOPBACK, port))

    def step(self, now_ns: int) -> None:
        """Hear, fly, and say what is due."""
        self._now_ns = now_ns
        self._begun_ns = now_ns if self._begun_ns is None else self._begun_ns
        for message in self._received():
            self._hear(message)
        self._fly()
        self._begin_or_end_the_flight()
        if self._is_due("heartbeat", HEARTBEAT_HZ):
            self._say_heartbeat()
        for message_id, say in self._telemetry.items():
            if self._is_due(str(message_id), self._rates_hz[message_id]):
                say()

    @property
    def _telemetry(self) -> dict[int, Callable[[], None]]:
        return {
            LOCAL: self._say_local,
            GLOBAL: self._say_global,
            LANDED: self._say_landed,
            STATUS: self._say_status,
            GPS: self._say_gps,
            HUD: self._say_hud,
        }

    def close(self) -> None:
        """Give the socket back."""
        self._socket.close()

    def arm(self) -> None:
        """By the person at the ground station, as what follows."""
        self.is_armed = True

    @abstractmethod
    def take_off(self, above_ground_m: float) -> None:
        """Climb so high."""

    def choose(self, mode: int) -> None:
        """Another flight mode; what it refuses it refuses with a text."""
        refusal = self._refusal(mode)
        if refusal is None:
            self._change_mode(mode)
        else:
            self._tell(refusal)

    @abstractmethod
    def _system_status(self) -> int:
        """MAV_STATE."""

    @abstractmethod
    def _mode_of_command(self, message: Any) -> int:
        """The custom mode that MAV_CMD_DO_SET_MODE means."""

    @abstractmethod
    def _refusal(self, mode: int) -> str | None:
        """In its words, why it does not take a mode now; None: it does."""

    @abstractmethod
    def _refused_result(self) -> int:
        """MAV_RESULT of that."""

    @abstractmethod
    def _change_mode(self, mode: int) -> None:
        """Fly as the mode has it."""

    @abstractmethod
    def _take_set_point(self, frame: int, position_m: Metres, velocity_mps: Metres | None) -> None:
        """One has come, in this MAV_FRAME; without a velocity it is a place to stay at."""

    def _take_interval(self, message: Any) -> int:
        """MAV_CMD_SET_MESSAGE_INTERVAL: MAV_RESULT."""
        self._rates_hz[int(message.param1)] = 1e6 / message.param2
        return int(mavlink.MAV_RESULT_ACCEPTED)

    @abstractmethod
    def _take_stream(self, message: Any) -> None:
        """REQUEST_DATA_STREAM has come."""

    @abstractmethod
    def _fly(self) -> None:
        """Do what time has come for."""

    def _end_take_off(self) -> None:
        """It has climbed as high as it was told to."""
        self.phase = Phase.AIR

    def _above_ground_m(self) -> float:
        return self._vehicle.position_m[2] - self._ground_m

    def _climb(self, above_ground_m: float) -> None:
        x_m, y_m, _ = self._vehicle.position_m
        self.phase, self._climbs_to_m = Phase.TAKE_OFF, above_ground_m
        self._vehicle.go_to((x_m, y_m, self._ground_m + above_ground_m))

    def _land(self) -> None:
        x_m, y_m, _ = self._vehicle.position_m
        self.phase = Phase.LANDING
        self._vehicle.go_to((x_m, y_m, self._ground_m))

    def _begin_or_end_the_flight(self) -> None:
        if self.phase is Phase.TAKE_OFF and self._above_ground_m() >= self._climbs_to_m - TAKEN_OFF_M:
            self._end_take_off()
        elif self.phase is Phase.LANDING and self._above_ground_m() <= LANDED_M:
            self.phase, self.is_armed = Phase.GROUND, False

    def _received(self) -> list[Any]:
        messages: list[Any] = []
        for _ in range(MOST_DATAGRAMS):
            try:
                datagram = self._socket.recv(65536)
            except OSError:  # nothing waits, or the agent has gone
                break
            messages += self._parser.parse_buffer(datagram) or []
        return messages

    def _hear(self, message: Any) -> None:
        self.has_companion = True
        kind = message.get_type()
        self.heard[kind] += 1
        if kind == "COMMAND_LONG":
            sender = (message.get_srcSystem(), message.get_srcComponent())
            self._say(self._mavlink.command_ack_encode(message.command, self._result(message), 0, 0, *sender))
        elif kind == "SET_MODE":
            self.choose(message.custom_mode)
        elif kind == "REQUEST_DATA_STREAM":
            self._take_stream(message)
        elif kind in {"SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"}:
            self._hear_set_point(message)

    def _hear_set_point(self, message: Any) -> None:
        """What it is to ignore it does not read; masks other than these it drops."""
        self.last_mask = message.type_mask
        if message.type_mask not in {POSITION_ONLY, POSITION_AND_VELOCITY}:
            return
        if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            position_m: Metres = (message.y, message.x, -message.z)
        else:
            place = (message.lat_int, message.lon_int, round(message.alt * 1e3))
            position_m = ORIGIN.position_m(self._mavlink.global_position_int_encode(0, *place, 0, 0, 0, 0, 0))
        is_tracked = message.type_mask == POSITION_AND_VELOCITY
        velocity_mps = (message.vy, message.vx, -message.vz) if is_tracked else None
        self._take_set_point(message.coordinate_frame, position_m, velocity_mps)

    def _result(self, message: Any) -> int:
        """MAV_RESULT of a command."""
        if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self._take_interval(message)
        if message.command != mavlink.MAV_CMD_DO_SET_MODE:
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        mode = self._mode_of_command(message)
        is_refused = self._refusal(mode) is not None
        self.choose(mode)
        return self._refused_result() if is_refused else int(mavlink.MAV_RESULT_ACCEPTED)

    def _say_heartbeat(self) -> None:
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.is_armed else 0
        about = (mavlink.MAV_TYPE_QUADROTOR, self.mav_autopilot, SIMULATED | armed, self.mode, self._system_status())
        self._say(self._mavlink.heartbeat_encode(*about))

    def _say_local(self) -> None:
        (x_m, y_m, z_m), (x_mps, y_mps, z_mps) = self._vehicle.position_m, self._vehicle.velocity_mps
        if self.has_position:
            north_east_down = (y_m, x_m, -z_m, y_mps, x_mps, -z_mps)
            self._say(self._mavlink.local_position_ned_encode(self._boot_ms(), *north_east_down))

    def _say_global(self) -> None:
        x_mps, y_mps, z_mps = self._vehicle.velocity_mps
        if self.has_position:
            place = ORIGIN.set_point(self._mavlink, 0, (1, 1), self._vehicle.position_m)
            velocity = (round(y_mps * 100), round(x_mps * 100), round(-z_mps * 100))
            above_mm = round(self._above_ground_m() * 1e3)
            where = (place.lat_int, place.lon_int, round(place.alt * 1e3), above_mm)
            self._say(self._mavlink.global_position_int_encode(self._boot_ms(), *where, *velocity, 0))

    def _say_landed(self) -> None:
        self._say(self._mavlink.extended_sys_state_encode(mavlink.MAV_VTOL_STATE_UNDEFINED, self.phase))

    def _say_status(self) -> None:
        assert self._begun_ns is not None
        percent = FULL_PERCENT - EMPTIES_PER_S * (self._now_ns - self._begun_ns) / 1e9
        self._say(self._mavlink.sys_status_encode(0, 0, 0, 0, 15_200, 1_800, max(0, round(percent)), 0, 0, 0, 0, 0, 0))

    def _say_gps(self) -> None:
        fix = mavlink.GPS_FIX_TYPE_3D_FIX if self.has_position else mavlink.GPS_FIX_TYPE_NO_FIX
        unknown = (65_535, 65_535, 65_535, 65_535)
        self._say(self._mavlink.gps_raw_int_encode(self._now_ns // 1000, fix, 0, 0, 0, *unknown, SATELLITES))

    def _say_hud(self) -> None:
        """It looks where it flies."""
        (x_mps, y_mps, z_mps), speed_mps = self._vehicle.velocity_mps, math.hypot(*self._vehicle.velocity_mps[:2])
        if speed_mps > TURNS_MPS:
            self._heading_deg = round(math.degrees(math.atan2(x_mps, y_mps))) % 360
        up_m = self._vehicle.position_m[2]
        self._say(self._mavlink.vfr_hud_encode(speed_mps, speed_mps, self._heading_deg, 40, up_m, z_mps))

    def _tell(self, text: str, severity: int = mavlink.MAV_SEVERITY_WARNING) -> None:
        self._say(self._mavlink.statustext_encode(severity, text.encode()))

    def _say(self, message: Any) -> None:
        try:
            self._socket.send(message.pack(self._mavlink))
        except OSError:  # nobody listens
            return

    def _boot_ms(self) -> int:
        return self._now_ns // 10**6 % 2**32

    def _is_due(self, what: str, rate_hz: float) -> bool:
        if rate_hz == 0:
            return False
        last_ns = self._last_ns.get(what)
        if last_ns is None:
            self._last_ns[what] = self._now_ns
            return True
        next_ns = next_moment_ns(last_ns, round(1e9 / rate_hz), self._now_ns)
        if next_ns > self._now_ns:
            return False
        self._last_ns[what] = next_ns
        return True
