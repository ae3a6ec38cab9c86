"""Where a controller takes the target to be, as a person says it: how far, in which direction, give or take what."""

import math
from typing import TypedDict

import numpy as np

from ..evaluation.statistics import nearest_rank_percentile
from .link.messages import Metres
from .service.sample_window import Points

BELIEVED_PERCENT = 95
"""Of a belief, so much lies within the radius that is told."""


class EstimateFrame(TypedDict):
    """The middle of a belief, seen from the formation's centre."""

    position_m: list[float]
    """The median of the belief on each axis, in the shared frame."""
    radius_m: float | None
    """95 % of the belief is within this of it; null of one that has a single point."""
    distance_m: float
    bearing_deg: float
    """Clockwise from north, 0 to 360."""
    elevation_deg: float
    """Upwards from the horizon, -90 to 90."""


def estimate_of(belief_m: Points | None, center_m: Metres | None) -> EstimateFrame | None:
    """What this belief comes to; None where there is none, or no place to look from.

    Args:
        belief_m: points of equal weight [point, 3].
        center_m: the formation's.
    """
    if belief_m is None or center_m is None or not len(belief_m):
        return None
    middle_m = np.median(belief_m, axis=0)
    radius_m = nearest_rank_percentile(np.linalg.norm(belief_m - middle_m, axis=1), BELIEVED_PERCENT)
    east_m, north_m, up_m = (middle_m - center_m).tolist()
    return EstimateFrame(
        position_m=np.round(middle_m, 1).tolist(),
        radius_m=None if len(belief_m) == 1 else round(radius_m, 1),
        distance_m=round(math.hypot(east_m, north_m, up_m), 1),
        bearing_deg=round(math.degrees(math.atan2(east_m, north_m)) % 360, 1),
        elevation_deg=round(math.degrees(math.atan2(up_m, math.hypot(east_m, north_m))), 1),
    )
