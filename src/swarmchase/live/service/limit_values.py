"""The operator's limits as plain numbers, with what they mean and what they are where nobody says: what
``SafetyLimits`` checks and ``swarmchase serve`` offers as options. It needs no numpy, which is slow to import.
"""

from dataclasses import dataclass

from ...ranges import Range, ranged
from ..link.messages import FARTHEST_M, FASTEST_MPS

PLACE = Range(-FARTHEST_M, FARTHEST_M)
"""Of one coordinate."""


@dataclass(frozen=True)
class LimitValues:
    """In the local frame that all trackers share (x east, y north, z up).

    The defaults leave room for a target 100 m from a start near the origin; altitudes count from the origin, so set the
    lowest one to the ground's where there is any. In the paper's narrowest formation neighbours are 1.41 m apart.
    """

    fence_west_m: float = ranged(-200.0, PLACE)
    """Lowest x of any tracker; x is east, y north, z up, from the origin that all trackers share."""
    fence_east_m: float = ranged(200.0, PLACE)
    """Highest x."""
    fence_south_m: float = ranged(-200.0, PLACE)
    """Lowest y."""
    fence_north_m: float = ranged(200.0, PLACE)
    """Highest y."""
    lowest_altitude_m: float = ranged(-150.0, PLACE)
    """Lowest z: set it to what lies above the ground."""
    highest_altitude_m: float = ranged(150.0, PLACE)
    """Highest z."""
    highest_speed_mps: float = ranged(5.0, Range(0, FASTEST_MPS, low_is_allowed=False))
    """Of any tracker's set-points."""
    minimum_separation_m: float = ranged(1.0, Range(0, FARTHEST_M))
    """Of any two trackers."""
