"""How a swarm in flight closes in on the target, and where it will meet it if both fly on as they do."""

from typing import TypedDict

import numpy as np

from .service.chase_state import Decision
from .service.sample_window import Point

LONGEST_S = 120.0
"""A meeting later than this is not told: nobody flies on as it does for so long."""


class InterceptionFrame(TypedDict):
    """By the last window and what is believed after it."""

    closing_mps: float
    """How fast the distance to the target shrinks; negative where it grows."""
    time_to_go_s: float | None
    """The distance over that; null where it does not shrink, or for very long."""
    position_m: list[float] | None
    """Where the target is then."""


def flown_mps(decision: Decision) -> Point | None:
    """How fast the swarm flew in the window of this decision: the median of its trackers. None where it stood to
    listen, or a window has but one moment.
    """
    if decision.time_s is None or not (lasted_s := float(decision.time_s[-1] - decision.time_s[0])) > 0:
        return None
    flown_m = decision.tracker_position_m[-1] - decision.tracker_position_m[0]
    return np.asarray(np.median(flown_m, axis=0) / lasted_s)


def interception(center_m: Point, swarm_mps: Point, target_m: Point, target_mps: Point) -> InterceptionFrame:
    """Of a swarm at ``center_m`` and a target at ``target_m``, at these velocities, each [3]."""
    apart_m, apart_mps = target_m - center_m, target_mps - swarm_mps
    distance_m = float(np.linalg.norm(apart_m))
    closing_mps = -float(apart_m @ apart_mps) / distance_m if distance_m > 0 else 0.0
    to_go_s = distance_m / closing_mps if closing_mps > 0 else np.inf
    is_told = to_go_s <= LONGEST_S
    return InterceptionFrame(
        closing_mps=round(closing_mps, 1),
        time_to_go_s=round(to_go_s, 1) if is_told else None,
        position_m=np.round(target_m + to_go_s * target_mps, 1).tolist() if is_told else None,
    )
