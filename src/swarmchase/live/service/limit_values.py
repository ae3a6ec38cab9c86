"""The operator's limits as plain numbers, with what they mean and what they are where nobody says: what
``SafetyLimits`` checks and ``swarmchase serve`` offers as options. It needs no numpy, which is slow to import.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class LimitValues:
    """In the local frame that all trackers share (x east, y north, z up).

    The defaults leave room for a target 100 m from a start near the origin; altitudes count from the origin, so set the
    lowest one to the ground's where there is any. In the paper's narrowest formation neighbours are 1.41 m apart.
    """

    fence_west_m: float = -200.0
    """Lowest x of any tracker; x is east, y north, z up, from the origin that all trackers share."""
    fence_east_m: float = 200.0
    """Highest x."""
    fence_south_m: float = -200.0
    """Lowest y."""
    fence_north_m: float = 200.0
    """Highest y."""
    lowest_altitude_m: float = -150.0
    """Lowest z: set it to what lies above the ground."""
    highest_altitude_m: float = 150.0
    """Highest z."""
    highest_speed_mps: float = 5.0
    """Of any tracker's set-points."""
    minimum_separation_m: float = 1.0
    """Of any two trackers."""
