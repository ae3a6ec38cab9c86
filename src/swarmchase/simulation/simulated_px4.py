"""A simulated multicopter with PX4, with the habits that were seen of real ones in SITL."""

from typing import Any

from ..live.link.dialect import mavlink
from ..live.link.messages import Metres
from ..live.tracker.vehicles import SimulatedVehicle
from .autopilot import GLOBAL, LANDED, LOCAL, Phase, SimulatedAutopilot
from .vehicles_gone_wrong import FailingVehicle

POSITION, OFFBOARD = 3 << 16, 6 << 16
TAKE_OFF, HOLD, RETURN, LAND = (4 << 16 | sub_mode << 24 for sub_mode in (2, 3, 5, 6))
FRAMES = {
    mavlink.MAV_FRAME_LOCAL_NED,
    mavlink.MAV_FRAME_GLOBAL_INT,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
    mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT,
}
"""Of set-points that it takes; any other, MAV_FRAME_GLOBAL among them, it drops."""
LOST_S = 1.0
"""COM_OF_LOSS_T: so long after the last set-point it leaves OFFBOARD."""
STREAM_S = 1.0
"""So long they must have come before it takes the mode."""
LIFTED_OFF_M = 0.5


class SimulatedPx4(SimulatedAutopilot):
    """OFFBOARD is refused while no set-points come, and left for a landing when they end. Armed in it on the ground,
    it takes off to the set-points that come.
    """

    mav_autopilot = mavlink.MAV_AUTOPILOT_PX4

    def __init__(self, vehicle: SimulatedVehicle | FailingVehicle, port: int, is_in_the_air: bool = True) -> None:
        super().__init__(vehicle, port, POSITION, is_in_the_air, {LOCAL: 1.0, GLOBAL: 5.0, LANDED: 1.0})
        self._set_point_m: Metres | None = None
        self._set_point_mps: Metres | None = None
        self._first_ns = self._last_set_point_ns = -round(LOST_S * 1e9)
        """Of the set-points that came without a gap."""

    def take_off(self, above_ground_m: float) -> None:
        """In the mode of that name; then it holds."""
        if self.is_armed and self.phase is Phase.GROUND:
            self.mode = TAKE_OFF
            self._climb(above_ground_m)

    def _system_status(self) -> int:
        return int(mavlink.MAV_STATE_ACTIVE if self.is_armed else mavlink.MAV_STATE_STANDBY)

    def _mode_of_command(self, message: Any) -> int:
        return int(message.param2) << 16 | int(message.param3) << 24

    def _refusal(self, mode: int) -> str | None:
        if mode != OFFBOARD or (self._set_points_come() and self._now_ns - self._first_ns >= STREAM_S * 1e9):
            return None
        return "Switching to Offboard is currently not available"

    def _refused_result(self) -> int:
        return int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)

    def _change_mode(self, mode: int) -> None:
        self.mode = mode
        if self.phase is Phase.GROUND:
            return
        self.phase = Phase.AIR
        if mode == LAND:
            self._land()
        elif mode == RETURN:
            self._vehicle.go_to((*self._home_m[:2], self._vehicle.position_m[2]))
        else:
            self._vehicle.hold()

    def _take_stream(self, message: Any) -> None:
        """It does not know it."""

    def _take_set_point(self, frame: int, position_m: Metres, velocity_mps: Metres | None) -> None:
        if frame not in FRAMES:
            return
        if not self._set_points_come():
            self._first_ns = self._now_ns
        self._set_point_m, self._set_point_mps = position_m, velocity_mps
        self._last_set_point_ns = self._now_ns

    def _set_points_come(self) -> bool:
        return self._now_ns - self._last_set_point_ns < LOST_S * 1e9

    def _fly(self) -> None:
        if self.mode == TAKE_OFF and self.phase is Phase.AIR:
            self.mode = HOLD
        if self.mode != OFFBOARD:
            return
        if not self._set_points_come():
            self._tell("No offboard signal: landing", mavlink.MAV_SEVERITY_CRITICAL)
            self._change_mode(LAND)
        elif self.is_armed and self._set_point_m is not None:
            if self._set_point_mps is None:
                self._vehicle.go_to(self._set_point_m)
            else:
                self._vehicle.track(self._set_point_m, self._set_point_mps)
            if self.phase is Phase.GROUND and self._above_ground_m() > LIFTED_OFF_M:
                self.phase = Phase.AIR
