"""ArduPilot: set-points move it in GUIDED mode, whose number differs between its copters and its planes and rovers.

If set-points cease it flies to the last one and stays there.
"""

from .firmware import Firmware, GuidedMode

GUIDED_OF_COPTERS, GUIDED_OF_PLANES_AND_ROVERS = GuidedMode(4, 4), GuidedMode(15, 15)
PLANES_AND_ROVERS = {1, 10, 11}  # MAV_TYPE: fixed wing, ground rover, boat


def _guided_mode(vehicle_type: int) -> GuidedMode:
    return GUIDED_OF_PLANES_AND_ROVERS if vehicle_type in PLANES_AND_ROVERS else GUIDED_OF_COPTERS


ARDUPILOT = Firmware(name="ArduPilot", mav_autopilot=3, guided_mode=_guided_mode, wants_set_points_from_manual=False)
