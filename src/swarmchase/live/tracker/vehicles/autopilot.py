"""A vehicle with a MAVLink autopilot, in the mode in which set-points move it: ``known_firmware`` says which makes.

The operator arms it and takes it off; this only moves it, and only in that mode. The mode is asked for when the first
set-point comes, and counts once a heartbeat shows it. Whatever else a heartbeat shows afterwards was done by a pilot or
a failsafe, and the vehicle is left alone until a heartbeat shows the mode again.

Set-points are streamed all the time, holding included. Where a pilot can give the vehicle back only while set-points
come, and only there, its own position is sent while the pilot has it.
"""

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

from ....errors import InputError
from ...link.messages import FARTHEST_M, Metres, TrackerMode, VehicleState
from .firmware import Firmware, GuidedMode
from .frames import CoordinateFrame, LocalFrame
from .known_firmware import UNKNOWN, firmware_of
from .protocol import Said
from .transports import Transport

SET_POINT_PERIOD_S = 0.1
"""PX4 wants more than 2 a second before and in OFFBOARD mode (PX4 guide, "Offboard Mode")."""
HEARTBEAT_PERIOD_S = 1.0
REQUEST_PERIOD_S = 1.0
MOST_MODE_REQUESTS = 10
"""Without success: then it is taken as refused, until a pilot sets the mode."""
SILENCE_S = 3.0
"""Without a heartbeat, which comes once a second: whether the mode is still ours is not known."""
POSITION_IS_OLD_S = 1.0
"""Without a new one, which comes ten times a second: where the vehicle is is not known."""

OWN_COMPONENT = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
AUTOPILOT_COMPONENT = 1
CUSTOM_MODE_ENABLED, ARMED = 1, 128  # MAV_MODE_FLAG
CRITICAL = 5  # MAV_STATE: from here on, a failsafe is at work
DO_SET_MODE, SET_MESSAGE_INTERVAL = 176, 511  # MAV_CMD
ACCEPTED, UNSUPPORTED, IN_PROGRESS = 0, 3, 5  # MAV_RESULT
POSITION_ONLY = 0b1101_1111_1000
"""POSITION_TARGET_TYPEMASK: velocity, acceleration, yaw and yaw rate are to be ignored."""


@dataclass(frozen=True)
class _Heartbeat:
    """The last one of the autopilot."""

    time_ns: int
    custom_mode: int
    wanted_mode: GuidedMode
    firmware: Firmware
    armed: bool
    failsafe: bool


class AutopilotVehicle:
    """One autopilot, reached through ``transport``.

    Raises:
        InputError: pymavlink is not installed.
    """

    def __init__(self, transport: Transport, frame: CoordinateFrame | None = None, system: int = 1) -> None:
        try:
            from pymavlink.dialects.v20 import common
        except ModuleNotFoundError as error:
            raise InputError("pymavlink is missing: pip install 'swarmchase[live]'") from error
        self.rejected: Counter[str] = Counter()
        self._transport = transport
        self._frame: CoordinateFrame = frame or LocalFrame()
        self._target = (system, AUTOPILOT_COMPONENT)
        self._mavlink: Any = common.MAVLink(None, srcSystem=system, srcComponent=OWN_COMPONENT)
        self._mavlink.robust_parsing = True
        self._heartbeat: _Heartbeat | None = None
        self._last_position_m: Metres | None = None
        self._position_ns = 0
        self._velocity_mps: Metres = (0.0, 0.0, 0.0)
        self._destination_m: Metres | None = None
        self._following = False
        self._confirmed = False
        self._taken_over = False
        self._mode_before_request: int | None = None
        self._mode_requests = 0
        self._command_is_unsupported = False
        self._now_ns = 0
        self._due_ns: dict[str, int] = {}

    @property
    def position_m(self) -> Metres | None:
        """Where the autopilot said it was, a moment ago."""
        return None if self._now_ns - self._position_ns > POSITION_IS_OLD_S * 1e9 else self._last_position_m

    @property
    def velocity_mps(self) -> Metres:
        """How fast it last said it was."""
        return self._velocity_mps

    @property
    def mode(self) -> TrackerMode:
        """MANUAL, too, while it is silent, disarmed or in a failsafe."""
        beat = self._heartbeat
        if beat is None or self._now_ns - beat.time_ns > SILENCE_S * 1e9:
            return TrackerMode.MANUAL
        if not beat.armed or beat.failsafe or self._taken_over:
            return TrackerMode.MANUAL
        return TrackerMode.FOLLOWING if self._following and self._confirmed else TrackerMode.HOLDING

    @property
    def position_age_s(self) -> float:
        """Since it arrived."""
        return (self._now_ns - self._position_ns) / 1e9

    @property
    def state(self) -> VehicleState:
        """As its last heartbeat says."""
        beat = self._heartbeat
        return VehicleState(is_armed=beat is not None and beat.armed, is_airborne=None, is_simulated=False)

    def said(self) -> list[Said]:
        """Nothing yet."""
        return []

    def go_to(self, position_m: Metres) -> None:
        """Stream this set-point, and ask for the mode if need be."""
        if self.mode != TrackerMode.MANUAL:
            self._destination_m, self._following = position_m, True

    def hold(self) -> None:
        """Stream where it is now as the set-point."""
        if self._following:
            self._destination_m, self._following = self._last_position_m, False

    def update(self, now_ns: int) -> None:
        """Take up what the autopilot has said; send what is due."""
        self._now_ns = now_ns
        for message in self._received():
            self._take_up(message)
        if self._is_due("heartbeat", HEARTBEAT_PERIOD_S):
            # MAV_TYPE_ONBOARD_CONTROLLER, MAV_AUTOPILOT_INVALID, MAV_STATE_ACTIVE
            self._send(self._mavlink.heartbeat_encode(18, 8, 0, 0, 4))
        beat = self._heartbeat
        if self.position_m is None and beat is not None and self._is_due("position", REQUEST_PERIOD_S):
            self._ask_for_positions()
        if self.mode == TrackerMode.MANUAL:
            self._destination_m, self._following = None, False
            if beat is not None and beat.firmware.wants_set_points_from_manual:
                self._stream(self.position_m)
            return
        if self._confirmed and self._destination_m is None:
            self._destination_m = self.position_m
        self._stream(self._destination_m)
        if self._following and not self._confirmed and self._is_due("mode", REQUEST_PERIOD_S):
            self._ask_for_mode()

    def close(self) -> None:
        """Close the transport; the autopilot does then what it does without a companion."""
        self._transport.close()

    def _received(self) -> list[Any]:
        messages: list[Any] = []
        for data in self._transport.read():
            found = self._mavlink.parse_buffer(data)
            messages += found or []
            # pymavlink keeps what it has parsed as long as something incomplete follows.
            del self._mavlink.buf[: self._mavlink.buf_index]
            self._mavlink.buf_index = 0
        return messages

    def _take_up(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "BAD_DATA":
            self.rejected["no MAVLink"] += 1
        elif (message.get_srcSystem(), message.get_srcComponent()) != self._target:
            self.rejected["not from the autopilot"] += 1
        elif kind == "HEARTBEAT":
            self._take_up_heartbeat(message)
        elif kind == self._frame.position_message:
            self._take_up_position(message)
        elif kind == "COMMAND_ACK" and message.command == DO_SET_MODE and message.result == UNSUPPORTED:
            self._command_is_unsupported = True
            self._due_ns.pop("mode", None)

    def _take_up_position(self, message: Any) -> None:
        position_m, velocity_mps = self._frame.position_m(message), self._frame.velocity_mps(message)
        # Also what it says before it knows where it is: 0 degrees north, 0 degrees east.
        if not all(abs(value) <= FARTHEST_M for value in position_m) or not all(map(math.isfinite, velocity_mps)):
            self.rejected["impossible position"] += 1
            return
        self._last_position_m, self._velocity_mps, self._position_ns = position_m, velocity_mps, self._now_ns

    def _take_up_heartbeat(self, message: Any) -> None:
        firmware = firmware_of(message.autopilot)
        if firmware is None:
            self.rejected[UNKNOWN] += 1
            return
        beat = _Heartbeat(
            time_ns=self._now_ns,
            custom_mode=message.custom_mode,
            wanted_mode=firmware.guided_mode(message.type),
            firmware=firmware,
            armed=bool(message.base_mode & ARMED),
            failsafe=message.system_status >= CRITICAL,
        )
        self._heartbeat = beat
        if beat.custom_mode == beat.wanted_mode.custom_mode:
            self._confirmed, self._taken_over, self._mode_requests = True, False, 0
        elif self._confirmed or self._mode_before_request not in {None, beat.custom_mode}:
            self._confirmed, self._taken_over, self._mode_before_request = False, True, None
            self._destination_m, self._following = None, False

    def _stream(self, position_m: Metres | None) -> None:
        if position_m is not None and self._is_due("set-point", SET_POINT_PERIOD_S):
            now_ms = self._now_ns // 1_000_000 % 2**32
            self._send(self._frame.set_point(self._mavlink, now_ms, self._target, POSITION_ONLY, position_m))

    def _ask_for_mode(self) -> None:
        beat = self._heartbeat
        if beat is None:
            return
        if self._mode_requests >= MOST_MODE_REQUESTS:
            self._taken_over, self._mode_before_request, self._mode_requests = True, None, 0
            self.rejected["mode refused"] += 1
            return
        self._mode_before_request = beat.custom_mode
        # Some firmware does not know the command, some does not answer it, and some no longer knows the message.
        if self._command_is_unsupported or self._mode_requests % 2:
            self._send(
                self._mavlink.set_mode_encode(self._target[0], CUSTOM_MODE_ENABLED, beat.wanted_mode.custom_mode)
            )
        else:
            self._command(DO_SET_MODE, CUSTOM_MODE_ENABLED, beat.wanted_mode.command_mode)
        self._mode_requests += 1

    def _ask_for_positions(self) -> None:
        message_id = {"LOCAL_POSITION_NED": 32, "GLOBAL_POSITION_INT": 33}[self._frame.position_message]
        self._command(SET_MESSAGE_INTERVAL, message_id, round(SET_POINT_PERIOD_S * 1e6))

    def _command(self, command: int, first: int, second: int) -> None:
        self._send(self._mavlink.command_long_encode(*self._target, command, 0, first, second, 0, 0, 0, 0, 0))

    def _send(self, message: Any) -> None:
        self._transport.write(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256

    def _is_due(self, what: str, period_s: float) -> bool:
        if self._now_ns < self._due_ns.get(what, 0):
            return False
        self._due_ns[what] = self._now_ns + round(period_s * 1e9)
        return True
