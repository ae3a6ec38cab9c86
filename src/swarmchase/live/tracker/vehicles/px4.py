"""PX4: set-points move it in OFFBOARD mode. They are its proof of life: a second after the last one it leaves the mode,
and lands where nobody has told it otherwise (COM_OBL_RC_ACT).

So they are streamed as long as it flies, holding included, and also while a pilot has it, who can choose the mode only
while they come; in other modes they move nothing. In OFFBOARD it takes off when it is armed and they come, so that on
the ground it is sent none; its heartbeats do not say whether it is there.
"""

from .firmware import Firmware, GuidedMode, Rhythm

MAIN_MODE_OFFBOARD = 6
FIXED_WING = 1  # MAV_TYPE
# A custom mode has the main mode in its third byte and the sub-mode in its fourth; the command takes the main mode.
OFFBOARD = GuidedMode(custom_mode=MAIN_MODE_OFFBOARD << 16, command_mode=MAIN_MODE_OFFBOARD)
RHYTHM = Rhythm(least_change_m=0.0, settled_s=0.1, repeat_s=0.1)
"""PX4 wants more than 2 a second before and in OFFBOARD mode (PX4 guide, "Offboard Mode")."""


def _guided_mode(_vehicle_type: int) -> GuidedMode:
    return OFFBOARD


PX4 = Firmware(
    name="PX4",
    mav_autopilot=12,
    mode_name="OFFBOARD",
    guided_mode=_guided_mode,
    rhythm=RHYTHM,
    takes_velocities=lambda vehicle_type: vehicle_type != FIXED_WING,
    needs_set_points=True,
    airborne_of_status={},
)
