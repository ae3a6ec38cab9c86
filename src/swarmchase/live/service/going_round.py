"""Ways by which vehicles in flight that keep one another from flying on get out of each other's way."""

from collections.abc import Iterator

import numpy as np

from ...scenario import NUM_TRACKERS
from .sample_window import Flags, Point, Points

ROUND_M = 1.0
"""Who goes round another keeps so much more than the least separation from it."""
LEVEL = 0.1
"""Sine of an angle against the vertical."""
PAIRS = np.triu_indices(NUM_TRACKERS, 1)


def ways_aside(in_the_way: Flags, places_m: Points, separation_m: float) -> Iterator[Points]:
    """Directions [tracker, 3] of those that are in each other's way [pair], none of the others: around each other, one
    way round or the other, and away.
    """
    for around in (1.0, -1.0, 0.0):
        way = np.zeros((NUM_TRACKERS, 3))
        for one, other in zip(*(tracker[in_the_way] for tracker in PAIRS), strict=True):
            push = _push(places_m[one] - places_m[other], around, separation_m)
            way[one] += push
            way[other] -= push
        yield way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)


def _push(apart_m: Point, around: float, separation_m: float) -> Point:
    """Of the first of two: past the other on one side, and away as far as they are too near for that."""
    distance_m = max(float(np.linalg.norm(apart_m)), 1e-9)
    away = apart_m / distance_m
    if around == 0.0:
        return np.asarray(away)
    beside = np.cross([0.0, 0.0, 1.0], away)
    if np.linalg.norm(beside) < LEVEL:  # one is above the other
        beside = np.array([1.0, 0.0, 0.0])
    nearness = min(max(separation_m + ROUND_M - distance_m, 0.0), 1.0)
    return np.asarray(nearness * away + around * beside / np.linalg.norm(beside))
