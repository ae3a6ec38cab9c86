"""A vehicle with a MAVLink autopilot, in the mode in which set-points move it: ``known_firmware`` says which makes.

The operator arms it and takes it off; this only moves it, in that mode, and in the air. On the ground it is sent
nothing. In the air it depends on the firmware. What keeps to its last set-point is sent one when there is an order: a
ground station beside it can take it off, and fly it, before a controller has spoken and when none speaks any more. What
must not be without set-points is sent them all the time, its own position where nobody has an order for it, so that a
pilot can choose the mode.

Positions are dated by their arrival: the clocks of autopilots run as they please, those of simulated ones above all.
"""

import math
from collections import Counter
from typing import Any

from ...link.messages import FARTHEST_M, Health, Metres, Severity, TrackerMode, VehicleState
from .firmware import Firmware
from .frames import CoordinateFrame, LocalFrame
from .health import MESSAGES, HealthReport
from .heartbeat import AutopilotHeartbeat, heartbeat_of
from .known_firmware import UNKNOWN
from .landed_state import LandedState
from .mavlink_line import MavlinkLine
from .mode_keeper import ModeKeeper
from .obedience import Obedience
from .protocol import Said
from .set_points import SetPointPace
from .status_texts import StatusTexts
from .telemetry import Wanted, Wish
from .transports import Transport
from .way_point import WayPoint

HEARTBEAT_PERIOD_S = 1.0
REQUEST_PERIOD_S = 1.0
SILENCE_S = 3.0
"""Without a heartbeat, which comes once a second: whether the mode is still ours is not known."""
POSITION_IS_OLD_S = 1.0
"""Without a new one: where the vehicle is is not known."""
ORDER_REPEATED_S = 5.0
"""So long after an order an autopilot that keeps to its last set-point is reminded of it; then others may tell it
something else."""
STREAMED_FIRST_S = 1.2
"""What must not be without set-points takes the mode only when they have come for more than a second."""
POSITIONS_HZ, LANDED_STATES_HZ = 10.0, 5.0

AUTOPILOT_COMPONENT = 1
CUSTOM_MODE_ENABLED = 1  # MAV_MODE_FLAG
DO_SET_MODE, SET_MESSAGE_INTERVAL = 176, 511  # MAV_CMD
UNSUPPORTED = 3  # MAV_RESULT
REFUSALS = {1: "not now", 2: "denied", 4: "failed"}
POSITION_STREAM = 6  # MAV_DATA_STREAM
POSITION_MESSAGES = {"LOCAL_POSITION_NED": 32, "GLOBAL_POSITION_INT": 33}
EXTENDED_SYS_STATE = 245


class AutopilotVehicle:
    """One autopilot, reached through ``transport``.

    Raises:
        InputError: pymavlink is not installed.
    """

    def __init__(self, transport: Transport, frame: CoordinateFrame | None = None, system: int = 1) -> None:
        self.rejected: Counter[str] = Counter()
        self._line = MavlinkLine(transport, system)
        self._frame: CoordinateFrame = frame or LocalFrame()
        self._target = (system, AUTOPILOT_COMPONENT)
        self._heartbeat: AutopilotHeartbeat | None = None
        self._landed, self._keeper, self._pace = LandedState(), ModeKeeper(), SetPointPace()
        self._texts, self._obedience = StatusTexts(), Obedience()
        message_id = POSITION_MESSAGES[self._frame.position_message]
        self._positions = Wish(Wanted(message_id, POSITIONS_HZ, POSITION_STREAM))
        self._landed_states = Wish(Wanted(EXTENDED_SYS_STATE, LANDED_STATES_HZ))
        self._health, self._healths = HealthReport(), {wanted.message_id: Wish(wanted) for wanted in MESSAGES}
        self._last_position_m: Metres | None = None
        self._position_ns = 0
        self._velocity_mps: Metres = (0.0, 0.0, 0.0)
        self._destination_m: Metres | None = None
        self._way_point: WayPoint | None = None
        """While it is led along a way."""
        self._braking_mps2 = 0.0
        """So hard it then brakes before its destination."""
        self._following = False
        self._ordered_ns = 0
        self._streaming_since_ns: int | None = None
        """None while there is no set-point for it."""
        self._unsupported: set[int] = set()
        """Commands that it does not know."""
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
        """MANUAL, too, while it is silent, disarmed, not in the air or in a failsafe."""
        if not self._may_fly or self._keeper.is_in_other_hands:
            return TrackerMode.MANUAL
        return TrackerMode.FOLLOWING if self._following and self._keeper.is_confirmed else TrackerMode.HOLDING

    @property
    def position_age_s(self) -> float:
        """Since it arrived."""
        return (self._now_ns - self._position_ns) / 1e9

    @property
    def state(self) -> VehicleState:
        """As it has said of late."""
        beat = self._beat_of_late
        if beat is None:
            return VehicleState(is_armed=False, is_airborne=None, is_simulated=False)
        return VehicleState(beat.is_armed, self._landed.is_airborne, beat.is_simulated)

    def health(self, tracker: int) -> Health | None:
        """As it has said of late."""
        return self._health.health(tracker, self._now_ns)

    def said(self) -> list[Said]:
        """Warnings and worse of the autopilot, and what it refuses."""
        return self._texts.taken()

    def go_to(self, position_m: Metres) -> None:
        """Send this set-point, and ask for the mode if need be."""
        if self.mode != TrackerMode.MANUAL:
            self._destination_m, self._following, self._ordered_ns = position_m, True, self._now_ns
            self._way_point = None

    def lead(self, rest_m: Metres, braking_mps2: float) -> None:
        """Send places on the way there with their velocities, where its firmware takes them."""
        way_point = self._way_point
        self.go_to(rest_m)
        beat = self._heartbeat
        if not self._following or beat is None or not beat.firmware.takes_velocities(beat.vehicle_type):
            return
        if self.position_m is not None and (way_point is None or way_point.is_astray(self.position_m)):
            way_point = WayPoint(self.position_m, self._velocity_mps, self._now_ns)
        self._way_point, self._braking_mps2 = way_point, braking_mps2

    def hold(self) -> None:
        """Send at once where it is now, or comes to rest on its way: there may be no later."""
        if self._following:
            way_point, self._way_point = self._way_point, None
            stops_m = self._last_position_m if way_point is None else way_point.rest_m(self._braking_mps2)
            self._destination_m, self._following, self._ordered_ns = stops_m, False, self._now_ns
            self._pace.forget()

    def update(self, now_ns: int) -> None:
        """Take up what the autopilot has said; send what is due."""
        self._now_ns = now_ns
        for message in self._line.received():
            self._take_up(message)
        if self._is_due("heartbeat", HEARTBEAT_PERIOD_S):
            # MAV_TYPE_ONBOARD_CONTROLLER, MAV_AUTOPILOT_INVALID, MAV_STATE_ACTIVE
            self._line.send(self._line.messages.heartbeat_encode(18, 8, 0, 0, 4))
        if self._heartbeat is None:
            return
        for wish in self._wishes:
            if wish.is_due(now_ns):
                self._ask_for(wish.wanted)
        if self.mode == TrackerMode.MANUAL:
            self._forget_orders()
        self._send_set_point(self._heartbeat.firmware)
        if self._following and not self._keeper.is_confirmed:
            self._ordered_ns = now_ns  # it can be obeyed only in the mode
            if self._takes_the_mode(self._heartbeat.firmware) and self._is_due("mode", REQUEST_PERIOD_S):
                self._ask_for_mode(self._heartbeat)
        self._look_whether_it_obeys()

    def close(self) -> None:
        """Close the transport; the autopilot does then what it does without a companion."""
        self._line.close()

    @property
    def _wishes(self) -> tuple[Wish, ...]:
        return (self._positions, self._landed_states, *self._healths.values())

    @property
    def _beat_of_late(self) -> AutopilotHeartbeat | None:
        """None while it is silent."""
        beat = self._heartbeat
        return None if beat is None or self._now_ns - beat.time_ns > SILENCE_S * 1e9 else beat

    @property
    def _may_fly(self) -> bool:
        """Whether it is heard, armed and in the air."""
        beat = self._beat_of_late
        return beat is not None and beat.is_armed and self._landed.is_airborne is True

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
        elif kind == "EXTENDED_SYS_STATE":
            self._landed_states.heard(self._now_ns)
            self._landed.take_up_landed_state(message.landed_state)
        elif message.get_msgId() in self._healths:
            self._healths[message.get_msgId()].heard(self._now_ns)
            self._health.take_up(message, self._now_ns)
        elif kind == "STATUSTEXT":
            self._texts.take_up(message)
        elif kind == "COMMAND_ACK" and self._line.is_for_us(message):
            self._take_up_answer(message.command, message.result)

    def _take_up_position(self, message: Any) -> None:
        position_m, velocity_mps = self._frame.position_m(message), self._frame.velocity_mps(message)
        self._positions.heard(self._now_ns)
        # Also what it says before it knows where it is: 0 degrees north, 0 degrees east.
        if not all(abs(value) <= FARTHEST_M for value in position_m) or not all(map(math.isfinite, velocity_mps)):
            self.rejected["impossible position"] += 1
            return
        self._last_position_m, self._velocity_mps, self._position_ns = position_m, velocity_mps, self._now_ns
        self._landed.take_up_climb(velocity_mps[2], self._now_ns)

    def _take_up_heartbeat(self, message: Any) -> None:
        beat = heartbeat_of(message, self._now_ns)
        if beat is None:
            self.rejected[UNKNOWN] += 1
            return
        self._heartbeat = beat
        self._landed.take_up_heartbeat(beat)
        self._keeper.take_up(beat)
        if self._keeper.is_in_other_hands:
            self._forget_orders()

    def _forget_orders(self) -> None:
        if self._destination_m is not None:
            self._pace.forget()
        self._destination_m, self._following, self._way_point = None, False, None

    def _take_up_answer(self, command: int, result: int) -> None:
        beat = self._heartbeat
        if result == UNSUPPORTED and command not in self._unsupported:
            self._unsupported.add(command)
            self._due_ns.pop("mode", None)
            for wish in self._wishes:
                wish.ask_again(self._now_ns)
        elif command == DO_SET_MODE and result in REFUSALS and beat is not None and self._keeper.refused():
            self._texts.say(Severity.ERROR, f"{beat.firmware.mode_name} is refused: {REFUSALS[result]}")

    def _send_set_point(self, firmware: Firmware) -> None:
        position_m = self._set_point_m(firmware)
        if position_m is None:
            self._streaming_since_ns = None
            return
        if self._streaming_since_ns is None:
            self._streaming_since_ns = self._now_ns
        velocity_mps = None
        if self._way_point is not None and position_m == self._destination_m:
            self._way_point.fly(position_m, self._braking_mps2, self._now_ns)
            position_m, velocity_mps = self._way_point.position_m, self._way_point.velocity_mps
        if self._pace.is_due(position_m, velocity_mps, firmware.rhythm, self._now_ns):
            now_ms = self._now_ns // 1_000_000 % 2**32
            told = (self._line.messages, now_ms, self._target, position_m, velocity_mps)
            self._line.send(self._frame.set_point(*told))

    def _set_point_m(self, firmware: Firmware) -> Metres | None:
        """What it is to be sent while it flies, in whosever hands it is."""
        if not self._may_fly:
            return None
        if not firmware.needs_set_points:
            return self._destination_m if self._keeper.is_confirmed and self._order_is_fresh else None
        if self._keeper.is_confirmed and not self._keeper.is_in_other_hands and self._destination_m is None:
            self._destination_m = self.position_m
        return self._destination_m or self.position_m

    @property
    def _order_is_fresh(self) -> bool:
        return self._now_ns - self._ordered_ns <= ORDER_REPEATED_S * 1e9

    def _takes_the_mode(self, firmware: Firmware) -> bool:
        since_ns = self._streaming_since_ns
        has_streamed = since_ns is not None and self._now_ns - since_ns >= STREAMED_FIRST_S * 1e9
        return has_streamed or not firmware.needs_set_points

    def _look_whether_it_obeys(self) -> None:
        is_led = self.mode == TrackerMode.FOLLOWING and self._order_is_fresh
        destination_m = self._destination_m if is_led else None
        complaint = self._obedience.complaint(destination_m, self.position_m, self._velocity_mps, self._now_ns)
        if complaint is not None:
            self._texts.say(Severity.WARNING, complaint)

    def _ask_for_mode(self, beat: AutopilotHeartbeat) -> None:
        firmware, is_odd = beat.firmware, self._keeper.requests % 2
        if not self._keeper.ask():
            self.rejected["mode refused"] += 1
            self._texts.say(Severity.ERROR, f"{firmware.mode_name} is refused: left alone until a pilot chooses it")
            return
        mode = firmware.guided_mode(beat.vehicle_type)
        # Some firmware does not know the command, some does not answer it, and some no longer knows the message.
        if DO_SET_MODE in self._unsupported or is_odd:
            self._line.send(self._line.messages.set_mode_encode(self._target[0], CUSTOM_MODE_ENABLED, mode.custom_mode))
        else:
            self._command(DO_SET_MODE, CUSTOM_MODE_ENABLED, mode.command_mode)

    def _ask_for(self, wanted: Wanted) -> None:
        rate_hz = round(wanted.rate_hz)
        if SET_MESSAGE_INTERVAL not in self._unsupported:
            self._command(SET_MESSAGE_INTERVAL, wanted.message_id, round(1e6 / wanted.rate_hz))
        elif wanted.data_stream is not None:
            self._line.send(
                self._line.messages.request_data_stream_encode(*self._target, wanted.data_stream, rate_hz, 1)
            )

    def _command(self, command: int, first: int, second: int) -> None:
        self._line.send(
            self._line.messages.command_long_encode(*self._target, command, 0, first, second, 0, 0, 0, 0, 0)
        )

    def _is_due(self, what: str, period_s: float) -> bool:
        if self._now_ns < self._due_ns.get(what, 0):
            return False
        self._due_ns[what] = self._now_ns + round(period_s * 1e9)
        return True
