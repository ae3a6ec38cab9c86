"""A simulated ArduCopter, with the habits that were seen of real ones in SITL."""

import math
from dataclasses import dataclass
from typing import Any

from ..live.link.dialect import mavlink
from ..live.link.messages import Metres
from ..live.tracker.vehicles import SimulatedVehicle
from .autopilot import GLOBAL, GPS, HUD, LANDED, LOCAL, STATUS, Phase, SimulatedAutopilot
from .vehicles_gone_wrong import FailingVehicle

GUIDED, LOITER, RTL, LAND = 4, 5, 6, 9
"""Copter's modes."""
LOCAL_FRAMES, GLOBAL_FRAMES = {mavlink.MAV_FRAME_LOCAL_NED}, {mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT}
POSITION_HZ = 2.0
"""SRx_POSITION of a telemetry port that nobody has set."""
PLANS_S, CRAWL_AHEAD_M = 0.25, 0.03
"""So long after a destination one that plans anew has planned only so far: sent one ten times a second, it creeps."""
GUID_TIMEOUT_S = 3.0
"""So long without news a velocity counts."""
DISARM_DELAY_S = 10.0
"""Armed, and on the ground."""


@dataclass(frozen=True)
class ArduCopterRelease:
    """What differs from one to the next."""

    knows_message_intervals: bool = True
    """Otherwise REQUEST_DATA_STREAM alone."""
    plans_anew: bool = False
    """At each destination, also at the one that it has."""
    ends_take_off: bool = True
    """Otherwise it says that it takes off until it is told to fly somewhere."""


COPTER_3_5 = ArduCopterRelease(knows_message_intervals=False, plans_anew=True, ends_take_off=False)
COPTER_4_0 = ArduCopterRelease(plans_anew=True, ends_take_off=False)
COPTER_4_6 = ArduCopterRelease()


class SimulatedArduPilot(SimulatedAutopilot):
    """Keeps to the last destination that came in GUIDED, whoever has sent it, and for ever. One that comes during a
    take-off ends it, one beyond ``fence_m`` (to any side of the origin) is dropped without a word. After a failsafe of
    its battery it stays critical.
    """

    mav_autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA

    def __init__(
        self,
        vehicle: SimulatedVehicle | FailingVehicle,
        port: int,
        release: ArduCopterRelease = COPTER_4_6,
        is_in_the_air: bool = True,
        fence_m: float = math.inf,
        position_hz: float = POSITION_HZ,
    ) -> None:
        super().__init__(vehicle, port, LOITER, is_in_the_air, {LOCAL: position_hz, GLOBAL: position_hz, LANDED: 0.0})
        self._release, self._fence_m = release, fence_m
        self._is_critical = False
        self._destination_m: Metres | None = None
        self._destination_mps: Metres | None = None
        self._destination_ns = self._landed_ns = 0

    def take_off(self, above_ground_m: float) -> None:
        """MAV_CMD_NAV_TAKEOFF, in GUIDED."""
        if self.mode == GUIDED and self.is_armed and self.phase is Phase.GROUND:
            self._destination_m = None
            self._climb(above_ground_m)

    def fly_here(self, position_m: Metres) -> None:
        """A ground station's destination, in GUIDED."""
        self._take_destination(position_m)

    def fail_battery(self) -> None:
        """It returns, and says that it is critical until it is started anew."""
        self._is_critical = True
        self._tell("Battery 1 low voltage", mavlink.MAV_SEVERITY_WARNING)
        self.choose(RTL)

    def _system_status(self) -> int:
        if self._is_critical:
            return int(mavlink.MAV_STATE_CRITICAL)
        return int(mavlink.MAV_STATE_STANDBY if self.phase is Phase.GROUND else mavlink.MAV_STATE_ACTIVE)

    def _mode_of_command(self, message: Any) -> int:
        return int(message.param2)

    def _refusal(self, mode: int) -> str | None:
        is_refused = mode == GUIDED and not self.has_position
        return "Mode change to GUIDED failed: requires position" if is_refused else None

    def _refused_result(self) -> int:
        return int(mavlink.MAV_RESULT_FAILED)

    def _change_mode(self, mode: int) -> None:
        self.mode, self._destination_m = mode, None
        if self.phase is Phase.GROUND:
            return
        if mode == LAND:
            self._land()
        elif mode == RTL:
            self._vehicle.go_to((*self._home_m[:2], self._vehicle.position_m[2]))
        else:
            self._vehicle.hold()

    def _take_interval(self, message: Any) -> int:
        if not self._release.knows_message_intervals:
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        return super()._take_interval(message)

    def _take_stream(self, message: Any) -> None:
        if message.req_stream_id == mavlink.MAV_DATA_STREAM_POSITION:
            self._rates_hz[LOCAL] = self._rates_hz[GLOBAL] = float(message.req_message_rate)
        elif message.req_stream_id == mavlink.MAV_DATA_STREAM_EXTENDED_STATUS:
            self._rates_hz[STATUS] = self._rates_hz[GPS] = float(message.req_message_rate)
        elif message.req_stream_id == mavlink.MAV_DATA_STREAM_EXTRA2:
            self._rates_hz[HUD] = float(message.req_message_rate)

    def _take_set_point(self, frame: int, position_m: Metres, velocity_mps: Metres | None) -> None:
        if frame in LOCAL_FRAMES | GLOBAL_FRAMES:
            self._take_destination(position_m, velocity_mps)

    def _take_destination(self, position_m: Metres, velocity_mps: Metres | None = None) -> None:
        if self.mode != GUIDED or not self.is_armed or max(map(abs, position_m)) > self._fence_m:
            return
        if self.phase is Phase.TAKE_OFF:
            # It has not left the ground yet, or has, and flies on from there.
            self.phase = Phase.AIR if self._above_ground_m() > 1.0 else Phase.GROUND
            self._vehicle.hold()
        if self.phase is Phase.AIR:
            self._destination_m, self._destination_ns = position_m, self._now_ns
            self._destination_mps = velocity_mps

    def _fly(self) -> None:
        if self._destination_m is not None and self._destination_mps is not None:
            self._track(self._destination_m, self._destination_mps)
        elif self._destination_m is not None:
            self._vehicle.go_to(self._planned_m(self._destination_m))
        if not (self.is_armed and self.phase is Phase.GROUND):
            self._landed_ns = self._now_ns
        elif self._now_ns - self._landed_ns > DISARM_DELAY_S * 1e9:
            self.is_armed = False

    def _track(self, position_m: Metres, velocity_mps: Metres) -> None:
        """A place with a velocity moves on by itself, without being planned for, until news of it end."""
        since_s = (self._now_ns - self._destination_ns) / 1e9
        x_m, y_m, z_m = (
            there + speed * min(since_s, GUID_TIMEOUT_S) for there, speed in zip(position_m, velocity_mps, strict=True)
        )
        if since_s < GUID_TIMEOUT_S:
            self._vehicle.track((x_m, y_m, z_m), velocity_mps)
        else:
            self._vehicle.go_to((x_m, y_m, z_m))

    def _end_take_off(self) -> None:
        if self._release.ends_take_off:
            super()._end_take_off()

    def _planned_m(self, destination_m: Metres) -> Metres:
        """How far it has planned its way."""
        at_m = self._vehicle.position_m
        distance_m = math.dist(destination_m, at_m)
        has_planned = not self._release.plans_anew or self._now_ns - self._destination_ns >= PLANS_S * 1e9
        if has_planned or distance_m <= CRAWL_AHEAD_M:
            return destination_m
        x_m, y_m, z_m = (
            here + CRAWL_AHEAD_M / distance_m * (there - here) for here, there in zip(at_m, destination_m, strict=True)
        )
        return (x_m, y_m, z_m)
