"""ArduPilot: set-points move it in GUIDED mode, whose number differs between its copters and its planes and rovers.

It flies to the last one that it was sent and stays there, so nothing need be streamed, and nothing must be: a target
that comes during a take-off ends the take-off, one that comes after a ground station's "fly here" overrides that, and
copters up to 4.0 plan their way anew at each, so that one that comes ten times a second makes them crawl. One beyond a
fence of its own it drops without a word. Positions with a velocity its copters fly without planning a way to them, and
stop three seconds after the last (GUID_TIMEOUT).
"""

from .firmware import Firmware, GuidedMode, Rhythm

GUIDED_OF_COPTERS, GUIDED_OF_PLANES_AND_ROVERS = GuidedMode(4, 4), GuidedMode(15, 15)
PLANES_AND_ROVERS = {1, 10, 11}  # MAV_TYPE: fixed wing, ground rover, boat
STANDBY, ACTIVE = 3, 4  # MAV_STATE
RHYTHM = Rhythm(least_change_m=0.25, settled_s=0.3, repeat_s=2.0)


def _guided_mode(vehicle_type: int) -> GuidedMode:
    return GUIDED_OF_PLANES_AND_ROVERS if vehicle_type in PLANES_AND_ROVERS else GUIDED_OF_COPTERS


ARDUPILOT = Firmware(
    name="ArduPilot",
    mav_autopilot=3,
    mode_name="GUIDED",
    guided_mode=_guided_mode,
    rhythm=RHYTHM,
    takes_velocities=lambda vehicle_type: vehicle_type not in PLANES_AND_ROVERS,
    needs_set_points=False,
    airborne_of_status={STANDBY: False, ACTIVE: True},
)
