"""What autopilots of different makes do in their own ways."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class GuidedMode:
    """The flight mode in which set-points move the vehicle, in the two forms that MAVLink has for it."""

    custom_mode: int
    """In HEARTBEAT and SET_MODE."""
    command_mode: int
    """In MAV_CMD_DO_SET_MODE, as the second parameter."""


@dataclass(frozen=True, kw_only=True)
class Firmware:
    """One make of autopilot."""

    name: str
    mav_autopilot: int
    """By which its heartbeats are known: MAV_AUTOPILOT."""
    guided_mode: Callable[[int], GuidedMode]
    """Of vehicles of a MAV_TYPE."""
    wants_set_points_from_manual: bool
    """Whether a pilot can give the vehicle back only while set-points come."""
