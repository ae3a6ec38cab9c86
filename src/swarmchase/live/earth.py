"""Where the shared frame lies on the earth: between its metres and latitude, longitude and altitude."""

import math
from dataclasses import dataclass

from ..errors import InputError
from .link.messages import Metres

EQUATORIAL_RADIUS_M, ECCENTRICITY_SQUARED = 6_378_137.0, 6.69437999014e-3
"""WGS 84."""

GlobalPosition = tuple[float, float, float]
"""Latitude and longitude in degrees, altitude in metres above sea level."""


@dataclass(frozen=True)
class EarthOrigin:
    """The point of the earth at which x, y, z are 0, ``altitude_m`` above sea level.

    The earth is taken as flat around it, with WGS 84's two radii of curvature there: within 1 km of the origin and
    below 60 degrees of latitude, distances are right to 3 in 10,000.

    Raises:
        InputError: a point that is not on the earth, or at a pole.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float

    def __post_init__(self) -> None:
        for name, value, bound in (
            ("latitude_deg", self.latitude_deg, 85.0),
            ("longitude_deg", self.longitude_deg, 180.0),
            ("altitude_m", self.altitude_m, 10_000.0),
        ):
            if not abs(value) <= bound:
                raise InputError(f"{name} = {value} is refused: allowed is -{bound:g} to {bound:g}")

    def metres(self, position: GlobalPosition) -> Metres:
        """Of the shared frame: x east, y north, z up."""
        latitude_deg, longitude_deg, altitude_m = position
        east_m, north_m = self._metres_per_degree()
        # Across the date line the difference is that of the short way.
        degrees_east = (longitude_deg - self.longitude_deg + 180) % 360 - 180
        return degrees_east * east_m, (latitude_deg - self.latitude_deg) * north_m, altitude_m - self.altitude_m

    def global_position(self, position_m: Metres) -> GlobalPosition:
        """Of a place in the shared frame."""
        east_m, north_m = self._metres_per_degree()
        return (
            self.latitude_deg + position_m[1] / north_m,
            (self.longitude_deg + position_m[0] / east_m + 180) % 360 - 180,
            self.altitude_m + position_m[2],
        )

    def _metres_per_degree(self) -> tuple[float, float]:
        """(East, north), from the radii of curvature in the prime vertical and in the meridian."""
        latitude = math.radians(self.latitude_deg)
        flattened = 1 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
        vertical_m = EQUATORIAL_RADIUS_M / math.sqrt(flattened) + self.altitude_m
        meridian_m = EQUATORIAL_RADIUS_M * (1 - ECCENTRICITY_SQUARED) / flattened**1.5 + self.altitude_m
        return math.radians(vertical_m * math.cos(latitude)), math.radians(meridian_m)
