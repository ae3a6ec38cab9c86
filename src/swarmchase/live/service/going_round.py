"""Ways by which vehicles in flight that keep one another from flying on get out of each other's way."""

from collections.abc import Iterator

import numpy as np

from ...scenario import NUM_TRACKERS
from .sample_window import Flags, Point, Points

ROUND_M = 1.0
"""Who goes round another keeps so much more than the least separation from it."""
LEVEL = 0.1
"""Sine of an angle against the vertical."""
ASIDE = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
SHORTEST_MPS = 0.1
"""Differences of speed below this are not worth a word."""
SLOWER = (1.0, 0.5, 0.25)
"""Shares of the speed with which a way round is looked for."""
PAIRS = np.triu_indices(NUM_TRACKERS, 1)


def ways_aside(in_the_way: Flags, places_m: Points, separation_m: float) -> Iterator[Points]:
    """Directions [tracker, 3] of those that are in each other's way [pair], none of the others: around each other, one
    way round or the other, and away.
    """
    for around in (1.0, -1.0, 0.0):
        yield _ways(in_the_way, places_m, around, separation_m)


def ways_apart(in_the_way: Flags, places_m: Points) -> Points:
    """Directions [tracker, 3] of those that are in each other's way [pair] away from each other; none of the others."""
    return _ways(in_the_way, places_m, 0.0, 0.0)


def _ways(in_the_way: Flags, places_m: Points, around: float, separation_m: float) -> Points:
    """Of each the sum of what leads it past and away from those that it is in the way of."""
    way = np.zeros((NUM_TRACKERS, 3))
    for one, other in zip(*(tracker[in_the_way] for tracker in PAIRS), strict=True):
        push = _push(places_m[one] - places_m[other], around, separation_m)
        way[one] += push
        way[other] -= push
    return np.asarray(way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9))


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


def others_mps(velocity_mps: Point) -> Iterator[Point]:
    """A velocity, then others next to it: aside, slower, aside and slower."""
    speed_mps = float(np.linalg.norm(velocity_mps))
    for share in SLOWER:
        yield share * velocity_mps
        for aside in ASIDE:
            turned_mps = velocity_mps + speed_mps * aside
            length_mps = float(np.linalg.norm(turned_mps))
            if length_mps > SHORTEST_MPS:
                yield share * speed_mps / length_mps * turned_mps
