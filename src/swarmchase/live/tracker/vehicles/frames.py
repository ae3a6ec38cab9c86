"""Between the frame that all trackers share (metres, x east, y north, z up) and the one that an autopilot speaks in.

Every autopilot has a local origin of its own. Outdoors the shared frame hangs on one point of the earth, and set-points
are global; indoors each autopilot's place of start in the shared frame is measured.
"""

import math
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from ....errors import InputError
from ...link.messages import Metres

EQUATORIAL_RADIUS_M, ECCENTRICITY_SQUARED = 6_378_137.0, 6.69437999014e-3
"""WGS 84."""
GLOBAL_INT = 5  # MAV_FRAME


@runtime_checkable
class CoordinateFrame(Protocol):
    """What the set-points and positions of one autopilot are in."""

    position_message: str
    """The MAVLink message that says where it is."""

    def position_m(self, message: Any) -> Metres:
        """Its position in the shared frame."""

    def velocity_mps(self, message: Any) -> Metres:
        """Its velocity in the shared frame."""

    def set_point(self, mavlink: Any, now_ms: int, target: tuple[int, int], type_mask: int, position_m: Metres) -> Any:
        """The MAVLink message that tells it to be there. ``target``: its system and component."""


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

    def set_point(self, mavlink: Any, now_ms: int, target: tuple[int, int], type_mask: int, position_m: Metres) -> Any:
        """SET_POSITION_TARGET_LOCAL_NED in MAV_FRAME_LOCAL_NED (1)."""
        east_m, north_m, up_m = (value - offset for value, offset in zip(position_m, self.offset_m, strict=True))
        nothing = (0.0,) * 8
        return mavlink.set_position_target_local_ned_encode(
            now_ms, *target, 1, type_mask, north_m, east_m, -up_m, *nothing
        )


@dataclass(frozen=True)
class GlobalFrame:
    """GLOBAL_POSITION_INT, with the origin of the shared frame at a point of the earth, ``altitude_m`` above sea level.

    The earth is taken as flat around it, with WGS 84's two radii of curvature there: within 1 km of the origin and
    below 60 degrees of latitude, distances are right to 3 in 10,000. Positions are rounded to 1e-7 degree: 1.1 cm.

    Raises:
        InputError: a point that is not on the earth, or at a pole.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    position_message = "GLOBAL_POSITION_INT"

    def __post_init__(self) -> None:
        for name, value, bound in (
            ("latitude_deg", self.latitude_deg, 85.0),
            ("longitude_deg", self.longitude_deg, 180.0),
            ("altitude_m", self.altitude_m, 10_000.0),
        ):
            if not abs(value) <= bound:
                raise InputError(f"{name} = {value} is refused: allowed is -{bound:g} to {bound:g}")

    def position_m(self, message: Any) -> Metres:
        """Degrees times 1e7 and millimetres above sea level turned into metres from the origin."""
        east_m, north_m = self._metres_per_degree()
        # Across the date line the difference is that of the short way.
        degrees_east = (message.lon / 1e7 - self.longitude_deg + 180) % 360 - 180
        return (
            degrees_east * east_m,
            (message.lat / 1e7 - self.latitude_deg) * north_m,
            message.alt / 1e3 - self.altitude_m,
        )

    def velocity_mps(self, message: Any) -> Metres:
        """Centimetres a second north, east, down."""
        return (message.vy / 100, message.vx / 100, -message.vz / 100)

    def set_point(self, mavlink: Any, now_ms: int, target: tuple[int, int], type_mask: int, position_m: Metres) -> Any:
        """SET_POSITION_TARGET_GLOBAL_INT in MAV_FRAME_GLOBAL_INT (5): altitude above sea level. PX4 refuses 0."""
        east_m, north_m = self._metres_per_degree()
        latitude_deg = self.latitude_deg + position_m[1] / north_m
        longitude_deg = (self.longitude_deg + position_m[0] / east_m + 180) % 360 - 180
        nothing = (0.0,) * 8
        return mavlink.set_position_target_global_int_encode(
            now_ms,
            *target,
            GLOBAL_INT,
            type_mask,
            round(latitude_deg * 1e7),
            round(longitude_deg * 1e7),
            self.altitude_m + position_m[2],
            *nothing,
        )

    def _metres_per_degree(self) -> tuple[float, float]:
        """(East, north), from the radii of curvature in the prime vertical and in the meridian."""
        latitude = math.radians(self.latitude_deg)
        flattened = 1 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
        vertical_m = EQUATORIAL_RADIUS_M / math.sqrt(flattened) + self.altitude_m
        meridian_m = EQUATORIAL_RADIUS_M * (1 - ECCENTRICITY_SQUARED) / flattened**1.5 + self.altitude_m
        return math.radians(vertical_m * math.cos(latitude)), math.radians(meridian_m)
