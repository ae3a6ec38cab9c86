"""The message map: what each message is in MAVLink 2. docs/link.md says the same for strangers, and a test compares.

Here positions are (east, north, up); MAVLink's local frame is (north, east, down), from the same origin.
Numbers travel as float32, times as milliseconds or microseconds: what arrives is rounded to that, times downwards.
"""

import math
from typing import Any

from ...errors import InputError
from .dialect import mavlink
from .messages import (
    SPAN_MS,
    FeedForward,
    Health,
    Heartbeat,
    Message,
    Metres,
    Notice,
    PositionReport,
    Report,
    RssiWindow,
    SetPoint,
    Severity,
    TrackerMode,
    VehicleState,
)
from .rejection import Reason, RejectedError

CONTROLLER_SYSTEM = 255
CONTROLLER_COMPONENT = mavlink.MAV_COMP_ID_MISSIONPLANNER
TRACKER_COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER

RSSI_NAME, RSSI_LAYOUT = b"rssi_dbm", 1
"""``name`` and ``array_id`` of the RSSI windows; a new layout gets a new number."""
RSSI_OBEYED, RSSI_FIRST_SAMPLE = 2, 8
"""In ``data``: 0 is the sampling rate, 1 the number of samples, 2 to 4 say what was obeyed, 5 to 7 are kept for later,
then come the samples."""
RSSI_FLOATS = 58

POSITION_AND_VELOCITY = (
    mavlink.POSITION_TARGET_TYPEMASK_AX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_AY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_AZ_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
)
POSITION_ONLY = (
    POSITION_AND_VELOCITY
    | mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VZ_IGNORE
)
MODE_FLAGS = {
    TrackerMode.HOLDING: mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED,
    TrackerMode.FOLLOWING: mavlink.MAV_MODE_FLAG_GUIDED_ENABLED,
    TrackerMode.MANUAL: mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED,
}
_MODE_OF_FLAGS = {flag: mode for mode, flag in MODE_FLAGS.items()}
_ANY_MODE_FLAG = sum(MODE_FLAGS.values())
ARMED_FLAG, SIMULATED_FLAG = mavlink.MAV_MODE_FLAG_SAFETY_ARMED, mavlink.MAV_MODE_FLAG_HIL_ENABLED
AIRBORNE_STATES: dict[bool | None, int] = {
    None: mavlink.MAV_STATE_UNINIT,
    False: mavlink.MAV_STATE_STANDBY,
    True: mavlink.MAV_STATE_ACTIVE,
}
"""``system_status`` says whether the vehicle is in the air."""
_AIRBORNE_OF_STATE = {state: airborne for airborne, state in AIRBORNE_STATES.items()}

UNKNOWN_BYTE, UNKNOWN_HEADING = 255, 65_535
"""Of the health: what is not known."""
_HEALTH_UNUSED = (
    "base_mode",
    "custom_mode",
    "landed_state",
    "roll",
    "pitch",
    "throttle",
    "heading_sp",
    "latitude",
    "longitude",
    "altitude_amsl",
    "altitude_sp",
    "airspeed",
    "airspeed_sp",
    "groundspeed",
    "climb_rate",
    "temperature",
    "temperature_air",
    "failsafe",
    "wp_num",
    "wp_distance",
)
"""Fields of its message that are sent as 0 and not read."""

_MOST_SPANS = 65_536
"""More than any time of messages.py has."""
_HALF = 65_536
"""A float32 holds whole numbers of up to 24 bits exactly: 32 bits go in two halves."""


def system_of(tracker: int) -> int:
    """The MAVLink system id of a tracker."""
    return tracker + 1


def to_mavlink(message: Message) -> Any:
    """The pymavlink message, ready to be packed."""
    match message:
        case RssiWindow():
            return _rssi_to_mavlink(message)
        case PositionReport():
            return mavlink.MAVLink_local_position_ned_message(
                _time_boot_ms(message.time_ns), *_swap_axes(message.position_m), *_swap_axes(message.velocity_mps)
            )
        case Heartbeat():
            return _heartbeat_to_mavlink(message)
        case Notice():
            text = message.text.encode("ascii")
            return mavlink.MAVLink_statustext_message(message.severity, text, message.number, message.piece)
        case Health():
            return _health_to_mavlink(message)
        case SetPoint():
            return _set_point_to_mavlink(message)


class ReportDecoder:
    """What trackers say, from checked packets.

    Milliseconds since boot come without their upper bits: the full time is the one nearest to the last full time of
    the same tracker, which its RSSI windows carry. Before the first, they are read as they stand.
    """

    IDS = frozenset(
        (
            mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
            mavlink.MAVLINK_MSG_ID_HEARTBEAT,
            mavlink.MAVLINK_MSG_ID_STATUSTEXT,
            mavlink.MAVLINK_MSG_ID_HIGH_LATENCY,
        )
    )

    def __init__(self) -> None:
        self._latest_ms: dict[int, int] = {}

    def decode(self, tracker: int, fields: Any) -> Report:
        """A tracker's message.

        Raises:
            RejectedError: wrong layout or refused value.
        """
        try:
            report = self._report(tracker, fields)
        except InputError as error:
            raise RejectedError(Reason.REFUSED_VALUE) from error
        if not isinstance(report, Notice | Health):
            self._latest_ms[tracker] = report.time_ns // 10**6
        return report

    def _report(self, tracker: int, fields: Any) -> Report:
        match fields.get_msgId():
            case mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY:
                return _rssi_from_mavlink(tracker, fields)
            case mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED:
                position_m = _swap_axes((fields.x, fields.y, fields.z))
                velocity_mps = _swap_axes((fields.vx, fields.vy, fields.vz))
                return PositionReport(tracker, self._time_ns(tracker, fields.time_boot_ms), position_m, velocity_mps)
            case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                return self._heartbeat(tracker, fields)
            case mavlink.MAVLINK_MSG_ID_STATUSTEXT:
                return _notice_from_mavlink(tracker, fields)
            case mavlink.MAVLINK_MSG_ID_HIGH_LATENCY:
                return _health_from_mavlink(tracker, fields)
            case _:
                raise RejectedError(Reason.UNKNOWN_MESSAGE)

    def _heartbeat(self, tracker: int, fields: Any) -> Heartbeat:
        mode = _MODE_OF_FLAGS.get(fields.base_mode & _ANY_MODE_FLAG)
        if mode is None or fields.system_status not in _AIRBORNE_OF_STATE:
            raise RejectedError(Reason.REFUSED_VALUE)
        vehicle = VehicleState(
            is_armed=bool(fields.base_mode & ARMED_FLAG),
            is_airborne=_AIRBORNE_OF_STATE[fields.system_status],
            is_simulated=bool(fields.base_mode & SIMULATED_FLAG),
        )
        return Heartbeat(tracker, self._time_ns(tracker, fields.custom_mode), mode, vehicle)

    def _time_ns(self, tracker: int, time_boot_ms: int) -> int:
        latest_ms = self._latest_ms.get(tracker, 0)
        nearest_ms = latest_ms + (time_boot_ms - latest_ms + SPAN_MS // 2) % SPAN_MS - SPAN_MS // 2
        return (nearest_ms if nearest_ms >= 0 else nearest_ms + SPAN_MS) * 10**6


class SetPointDecoder:
    """What the controller says, from checked packets."""

    IDS = frozenset({mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED})

    def decode(self, tracker: int, fields: Any) -> SetPoint:
        """The controller's message to this tracker.

        Raises:
            RejectedError: wrong layout (one for another tracker included) or refused value.
        """
        if (
            fields.target_system != system_of(tracker)
            or fields.target_component != TRACKER_COMPONENT
            or fields.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED
            or fields.type_mask not in {POSITION_ONLY, POSITION_AND_VELOCITY}
        ):
            raise RejectedError(Reason.WRONG_LAYOUT)
        time_ms = _whole(fields.afz, _MOST_SPANS) * SPAN_MS + fields.time_boot_ms
        epoch = _whole(fields.afx, _HALF) * _HALF + _whole(fields.afy, _HALF)
        try:
            position_m, feed_forward = _swap_axes((fields.x, fields.y, fields.z)), _feed_forward(fields)
            return SetPoint(tracker, time_ms * 10**6, epoch, position_m, feed_forward)
        except InputError as error:
            raise RejectedError(Reason.REFUSED_VALUE) from error


def _heartbeat_to_mavlink(heartbeat: Heartbeat) -> Any:
    vehicle = heartbeat.vehicle
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        mavlink.MAV_AUTOPILOT_INVALID,
        mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        | MODE_FLAGS[heartbeat.mode]
        | (ARMED_FLAG if vehicle.is_armed else 0)
        | (SIMULATED_FLAG if vehicle.is_simulated else 0),
        _time_boot_ms(heartbeat.time_ns),
        AIRBORNE_STATES[vehicle.is_airborne],
        3,
    )


def _notice_from_mavlink(tracker: int, fields: Any) -> Notice:
    try:
        severity = Severity(fields.severity)
    except ValueError as error:
        raise RejectedError(Reason.REFUSED_VALUE) from error
    return Notice(tracker, fields.id, severity, fields.text, fields.chunk_seq)


def _rssi_to_mavlink(window: RssiWindow) -> Any:
    data = [0.0] * RSSI_FLOATS
    data[0], data[1] = window.sampling_hz, float(len(window.rssi_dbm))
    if window.obeyed_ms is not None:
        halves = divmod(window.obeyed_ms, _HALF)
        data[RSSI_OBEYED : RSSI_OBEYED + 3] = 1.0, *map(float, halves)
    data[RSSI_FIRST_SAMPLE : RSSI_FIRST_SAMPLE + len(window.rssi_dbm)] = window.rssi_dbm
    return mavlink.MAVLink_debug_float_array_message(window.time_ns // 1000, RSSI_NAME, RSSI_LAYOUT, data)


def _rssi_from_mavlink(tracker: int, fields: Any) -> RssiWindow:
    if fields.name != RSSI_NAME.decode() or fields.array_id != RSSI_LAYOUT:
        raise RejectedError(Reason.WRONG_LAYOUT)
    num_samples = _whole(fields.data[1], RSSI_FLOATS - RSSI_FIRST_SAMPLE + 1)
    samples_dbm = tuple(fields.data[RSSI_FIRST_SAMPLE : RSSI_FIRST_SAMPLE + num_samples])
    says, upper, lower = (_whole(number, _HALF) for number in fields.data[RSSI_OBEYED : RSSI_OBEYED + 3])
    obeyed_ms = upper * _HALF + lower if says else None
    return RssiWindow(tracker, fields.time_usec * 1000, fields.data[0], samples_dbm, obeyed_ms)


def _health_to_mavlink(health: Health) -> Any:
    heading_deg = health.heading_deg
    return mavlink.MAVLink_high_latency_message(
        heading=UNKNOWN_HEADING if heading_deg is None else round(100 * heading_deg) % 36_000,
        gps_nsat=_byte(health.satellites),
        gps_fix_type=_byte(health.gps_fix),
        battery_remaining=_byte(health.battery_percent),
        **dict.fromkeys(_HEALTH_UNUSED, 0),
    )


def _health_from_mavlink(tracker: int, fields: Any) -> Health:
    return Health(
        tracker,
        battery_percent=_known(fields.battery_remaining),
        gps_fix=_known(fields.gps_fix_type),
        satellites=_known(fields.gps_nsat),
        heading_deg=None if fields.heading == UNKNOWN_HEADING else fields.heading / 100,
    )


def _known(byte: int) -> int | None:
    return None if byte == UNKNOWN_BYTE else byte


def _byte(number: int | None) -> int:
    return UNKNOWN_BYTE if number is None else number


def _set_point_to_mavlink(point: SetPoint) -> Any:
    """The type mask tells every reader to ignore acceleration and yaw; their places hold what MAVLink has no place for.
    So epoch, position and how it goes on are in one packet, under one signature."""
    onward = point.feed_forward
    north_mps, east_mps, down_mps = (0.0, 0.0, 0.0) if onward is None else _swap_axes(onward.velocity_mps)
    return mavlink.MAVLink_set_position_target_local_ned_message(
        _time_boot_ms(point.time_ns),
        system_of(point.tracker),
        TRACKER_COMPONENT,
        mavlink.MAV_FRAME_LOCAL_NED,
        POSITION_ONLY if onward is None else POSITION_AND_VELOCITY,
        *_swap_axes(point.position_m),
        vx=north_mps,
        vy=east_mps,
        vz=down_mps,
        afx=float(point.epoch // _HALF),
        afy=float(point.epoch % _HALF),
        afz=float(point.time_ns // 10**6 // SPAN_MS),
        yaw=0.0 if onward is None else onward.valid_s,
        yaw_rate=0.0 if onward is None else onward.braking_mps2,
    )


def _feed_forward(fields: Any) -> FeedForward | None:
    if fields.type_mask == POSITION_ONLY:
        return None
    return FeedForward(_swap_axes((fields.vx, fields.vy, fields.vz)), fields.yaw, fields.yaw_rate)


def _swap_axes(vector: Metres) -> Metres:
    """(east, north, up) to (north, east, down), and back: it is its own inverse."""
    return vector[1], vector[0], -vector[2]


def _time_boot_ms(time_ns: int) -> int:
    return time_ns // 10**6 % SPAN_MS


def _whole(number: float, bound: int) -> int:
    """A whole number from 0 to below ``bound``."""
    if not (math.isfinite(number) and number.is_integer() and 0 <= number < bound):
        raise RejectedError(Reason.REFUSED_VALUE)
    return int(number)
