"""PX4: set-points move it in OFFBOARD mode, which it leaves by itself within a second when they cease.

It lets a pilot choose OFFBOARD, and so give the vehicle back, only while set-points come.
"""

from .firmware import Firmware, GuidedMode

MAIN_MODE_OFFBOARD = 6
# A custom mode has the main mode in its third byte and the sub-mode in its fourth; the command takes the main mode.
OFFBOARD = GuidedMode(custom_mode=MAIN_MODE_OFFBOARD << 16, command_mode=MAIN_MODE_OFFBOARD)


def _guided_mode(_vehicle_type: int) -> GuidedMode:
    return OFFBOARD


PX4 = Firmware(name="PX4", mav_autopilot=12, guided_mode=_guided_mode, wants_set_points_from_manual=True)
