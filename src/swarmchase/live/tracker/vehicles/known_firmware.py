"""The makes of autopilots that can be flown. A new one is a module with its ``Firmware``, and its name here."""

from .ardupilot import ARDUPILOT
from .firmware import Firmware
from .px4 import PX4

KNOWN_FIRMWARE = (ARDUPILOT, PX4)
UNKNOWN = f"neither {' nor '.join(one.name for one in KNOWN_FIRMWARE)}"
"""What an autopilot of another make is."""


def firmware_of(mav_autopilot: int) -> Firmware | None:
    """The one whose heartbeats say so; None where it is not known."""
    return next((one for one in KNOWN_FIRMWARE if one.mav_autopilot == mav_autopilot), None)
