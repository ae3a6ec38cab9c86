"""Between the frame that all trackers share (metres, x east, y north, z up) and the one that an autopilot speaks in.

Every autopilot has a local origin of its own. Outdoors the shared frame hangs on one point of the earth, and set-points
are global; indoors each autopilot's place of start in the shared frame is measured.
"""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from ...earth import EarthOrigin
from ...link.messages import Metres

GLOBAL_INT = 5  # MAV_FRAME
POSITION_AND_VELOCITY, POSITION_ONLY = 0b1101_1100_0000, 0b1101_1111_1000
"""POSITION_TARGET_TYPEMASK: acceleration, yaw and yaw rate are to be ignored, and the velocity where there is none."""


@runtime_checkable
class CoordinateFrame(Protocol):
    """What the set-points and positions of one autopilot are in."""

    position_message: str
    """The MAVLink message that says where it is."""

    def position_m(self, message: Any) -> Metres:
        """Its position in the shared frame."""

    def velocity_mps(self, message: Any) -> Metres:
        """Its velocity in the shared frame."""

    def set_point(
        self, mavlink: Any, now_ms: int, target: tuple[int, int], position_m: Metres, velocity_mps: Metres | None = None
    ) -> Any:
        """The MAVLink message that tells it to be there, and if it is given as fast as that.

        Args:
            target: Its system and component.
        """


@dataclass(frozen=True)
class LocalFrame:
    """LOCAL_POSITION_NED of an autopilot whose own origin lies at ``offset_m`` of the shared frame."""

    offset_m: Metres = (0.0, 0.0, 0.0)
    position_message = "LOCAL_POSITION_NED"

    def position_m(self, message: Any) -> Metres:
        """North, east, down turned into east, north, up."""
        east_m, north_m, up_m = self.offset_m
        return (east_m + message.y, north_m + message.x, up_m - message.z)

    def velocity_mps(self, message: Any) -> Metres:
        """Likewise."""
        return (message.vy, message.vx, -message.vz)

    def set_point(
        self, mavlink: Any, now_ms: int, target: tuple[int, int], position_m: Metres, velocity_mps: Metres | None = None
    ) -> Any:
        """SET_POSITION_TARGET_LOCAL_NED in MAV_FRAME_LOCAL_NED (1)."""
        east_m, north_m, up_m = (value - offset for value, offset in zip(position_m, self.offset_m, strict=True))
        type_mask, rest = _mask_and_rest(velocity_mps)
        return mavlink.set_position_target_local_ned_encode(
            now_ms, *target, 1, type_mask, north_m, east_m, -up_m, *rest
        )


@dataclass(frozen=True)
class GlobalFrame(EarthOrigin):
    """GLOBAL_POSITION_INT, with the origin of the shared frame at a point of the earth.

    Positions are rounded to 1e-7 degree: 1.1 cm.

    Raises:
        InputError: a point that is not on the earth, or at a pole.
    """

    position_message = "GLOBAL_POSITION_INT"

    def position_m(self, message: Any) -> Metres:
        """Degrees times 1e7 and millimetres above sea level turned into metres from the origin."""
        return self.metres((message.lat / 1e7, message.lon / 1e7, message.alt / 1e3))

    def velocity_mps(self, message: Any) -> Metres:
        """Centimetres a second north, east, down."""
        return (message.vy / 100, message.vx / 100, -message.vz / 100)

    def set_point(
        self, mavlink: Any, now_ms: int, target: tuple[int, int], position_m: Metres, velocity_mps: Metres | None = None
    ) -> Any:
        """SET_POSITION_TARGET_GLOBAL_INT in MAV_FRAME_GLOBAL_INT (5): altitude above sea level. PX4 refuses 0."""
        latitude_deg, longitude_deg, altitude_m = self.global_position(position_m)
        type_mask, rest = _mask_and_rest(velocity_mps)
        return mavlink.set_position_target_global_int_encode(
            now_ms,
            *target,
            GLOBAL_INT,
            type_mask,
            round(latitude_deg * 1e7),
            round(longitude_deg * 1e7),
            altitude_m,
            *rest,
        )


def _mask_and_rest(velocity_mps: Metres | None) -> tuple[int, tuple[float, ...]]:
    """The type mask of a set-point, and its fields after the position: velocity north, east, down, then zeros."""
    if velocity_mps is None:
        return POSITION_ONLY, (0.0,) * 8
    east_mps, north_mps, up_mps = velocity_mps
    return POSITION_AND_VELOCITY, (north_mps, east_mps, -up_mps, *(0.0,) * 5)
