"""What autopilots of different makes do in their own ways."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class GuidedMode:
    """The flight mode in which set-points move the vehicle, in the two forms that MAVLink has for it."""

    custom_mode: int
    """In HEARTBEAT and SET_MODE."""
    command_mode: int
    """In MAV_CMD_DO_SET_MODE, as the second parameter."""


@dataclass(frozen=True, kw_only=True)
class Rhythm:
    """When set-points are sent, never more often than ``set_points.SOONEST_S`` apart."""

    least_change_m: float
    """One that is so far from the last one sent is sent at once."""
    settled_s: float
    """One that is nearer, and another one, is sent so long after the last."""
    repeat_s: float
    """The same one is sent again after so long: it may have got lost."""


@dataclass(frozen=True, kw_only=True)
class Firmware:
    """One make of autopilot."""

    name: str
    mav_autopilot: int
    """By which its heartbeats are known: MAV_AUTOPILOT."""
    mode_name: str
    """Of the flight mode in which set-points move it."""
    guided_mode: Callable[[int], GuidedMode]
    """The same, for vehicles of a MAV_TYPE."""
    rhythm: Rhythm
    takes_velocities: Callable[[int], bool]
    """Whether vehicles of a MAV_TYPE take a position with a velocity."""
    needs_set_points: bool
    """Whether it leaves the mode when set-points end, and lets a pilot choose it only while they come."""
    airborne_of_status: Mapping[int, bool]
    """What ``system_status`` of its heartbeats says of being in the air, where it says that: MAV_STATE."""
