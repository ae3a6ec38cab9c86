"""Where a controller takes the target to be, as a person says it: how far, in which direction, give or take what."""

import math
from typing import TypedDict

import numpy as np
import torch

from ..controllers.belief import belief_of_particles
from ..evaluation.statistics import nearest_rank_percentile
from .link.messages import Metres
from .service.sample_window import Points

BELIEVED_PERCENT = 95
"""Of a belief, so much lies within the radius that is told."""


class RegionFrame(TypedDict):
    """The ellipsoid that holds 95 % of a belief, in the shared frame."""

    center_m: list[float]
    """The belief's mean."""
    half_axes_m: list[list[float]]
    """Three vectors from there, at right angles to one another."""


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
    velocity_mps: list[float] | None
    """Of the target, as the controller has it; null where it does not say."""
    region: RegionFrame | None
    """Null of a belief that has a single point."""


def estimate_of(
    belief_m: Points | None, center_m: Metres | None, velocity_mps: Metres | None = None
) -> EstimateFrame | None:
    """What this belief comes to; None where there is none, or no place to look from.

    Args:
        belief_m: points of equal weight [point, 3].
        center_m: the formation's.
        velocity_mps: the target's, where the controller says it.
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
        velocity_mps=None if velocity_mps is None else [round(one, 2) for one in velocity_mps],
        region=None if len(belief_m) == 1 else region_of(belief_m),
    )


def region_of(belief_m: Points) -> RegionFrame:
    """The region of ``controllers.belief`` of these points of equal weight [point, 3]."""
    belief = belief_of_particles(torch.from_numpy(belief_m.T.copy())[None])
    variance_m2, axes = np.linalg.eigh(belief.covariance_m2[0].numpy())
    half_axes_m = (axes * np.sqrt(variance_m2 * float(belief.reach[0]))).T
    return RegionFrame(
        center_m=np.round(belief.mean_m[0].numpy(), 1).tolist(), half_axes_m=half_axes_m.round(2).tolist()
    )
