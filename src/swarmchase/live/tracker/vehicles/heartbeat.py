"""What an autopilot's heartbeat says."""

from dataclasses import dataclass
from typing import Any

from .firmware import Firmware
from .known_firmware import firmware_of

SIMULATED, ARMED = 32, 128  # MAV_MODE_FLAG: hardware in the loop, safety armed
CRITICAL = 5  # MAV_STATE: from here on, a failsafe is at work
NEVER_FLY = {10, 11}  # MAV_TYPE: ground rover, boat


@dataclass(frozen=True)
class AutopilotHeartbeat:
    """One of them."""

    time_ns: int
    """When it came."""
    firmware: Firmware
    vehicle_type: int
    """MAV_TYPE."""
    custom_mode: int
    system_status: int
    """MAV_STATE."""
    is_armed: bool
    is_simulated: bool

    @property
    def is_guided(self) -> bool:
        """Whether set-points would move it."""
        return self.custom_mode == self.firmware.guided_mode(self.vehicle_type).custom_mode

    @property
    def is_critical(self) -> bool:
        """Whether a failsafe is at work, or has been: ArduPilot says so until it is started anew."""
        return self.system_status >= CRITICAL

    @property
    def never_flies(self) -> bool:
        """Whether the ground, or the water, is where it moves."""
        return self.vehicle_type in NEVER_FLY


def heartbeat_of(message: Any, now_ns: int) -> AutopilotHeartbeat | None:
    """Of a HEARTBEAT that has come now; None where the make is not known."""
    firmware = firmware_of(message.autopilot)
    if firmware is None:
        return None
    return AutopilotHeartbeat(
        time_ns=now_ns,
        firmware=firmware,
        vehicle_type=message.type,
        custom_mode=message.custom_mode,
        system_status=message.system_status,
        is_armed=bool(message.base_mode & ARMED),
        is_simulated=bool(message.base_mode & SIMULATED),
    )
