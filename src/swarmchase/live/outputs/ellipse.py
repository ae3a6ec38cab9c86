"""What a map shows of the ellipsoid that holds 95 % of a belief: its shadow on the ground, and how high it reaches."""

import math
from dataclasses import dataclass

from ...controllers.belief import GAUSSIAN_REACH
from ..estimate import RegionFrame

NORMAL_REACH = math.sqrt(GAUSSIAN_REACH)
"""In standard deviations."""


@dataclass(frozen=True)
class GroundEllipse:
    """Seen from above."""

    semi_major_m: float
    semi_minor_m: float
    azimuth_deg: float
    """Of the major axis, clockwise from north, 0 to 180."""
    half_height_m: float
    """Of the ellipsoid, upwards from its centre."""

    @property
    def circular_error_m(self) -> float:
        """One standard deviation on the ground, over all directions, of a normal distribution with this region."""
        return math.hypot(self.semi_major_m, self.semi_minor_m) / math.sqrt(2) / NORMAL_REACH

    @property
    def linear_error_m(self) -> float:
        """The same in height."""
        return self.half_height_m / NORMAL_REACH

    def outline_m(self, num_points: int) -> list[tuple[float, float]]:
        """East and north of its centre, counter-clockwise; so many points, none of them twice."""
        azimuth = math.radians(self.azimuth_deg)
        along, across = (math.sin(azimuth), math.cos(azimuth)), (-math.cos(azimuth), math.sin(azimuth))
        points = []
        for number in range(num_points):
            turn = 2 * math.pi * number / num_points
            major_m, minor_m = self.semi_major_m * math.cos(turn), self.semi_minor_m * math.sin(turn)
            points.append((major_m * along[0] + minor_m * across[0], major_m * along[1] + minor_m * across[1]))
        return points


def ground_ellipse(region: RegionFrame) -> GroundEllipse:
    """Of this region."""
    axes_m = region["half_axes_m"]
    east_m2, north_m2, up_m2 = (sum(axis_m[one] ** 2 for axis_m in axes_m) for one in range(3))
    both_m2 = sum(axis_m[0] * axis_m[1] for axis_m in axes_m)
    # The eigenvalues and the first eigenvector of [[east, both], [both, north]].
    middle_m2, spread_m2 = (east_m2 + north_m2) / 2, math.hypot((east_m2 - north_m2) / 2, both_m2)
    azimuth_deg = math.degrees(math.atan2(2 * both_m2, north_m2 - east_m2)) / 2
    return GroundEllipse(
        semi_major_m=math.sqrt(middle_m2 + spread_m2),
        semi_minor_m=math.sqrt(max(middle_m2 - spread_m2, 0.0)),
        azimuth_deg=azimuth_deg % 180 % 180,  # a tiny negative one becomes 180 first
        half_height_m=math.sqrt(up_m2),
    )
