"""Where the formation is, as most of its trackers say: no single one can move it far, whatever it says.

A tracker's place claims a centre: the place less the spacing times the tracker's direction. Where the spacing is known
the centre is the median of these claims; where it is not, centre and spacing are fitted to the largest set of trackers
that agree with one another.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from .safety import TRACKER_DIRECTION, cross
from .sample_window import Flags, Levels, Point, Points

TrackerNumbers = npt.NDArray[np.int64]

ASTRAY_M = 5.0
"""Who says that it is further than this from where the others say it must be has a broken receiver of positions, a
frame of its own, or lies. Two receivers of GNSS that err by 1 m on each axis are off by more once in 8,000 times; a
vehicle that hovers reports its place within decimetres of where it is told to be."""
FEWEST_TO_JUDGE = 3
"""Of fewer trackers nobody can say which one errs."""


@dataclass(frozen=True, eq=False)
class FormationEstimate:
    """A formation fitted to reported places. Metres are of the shared frame."""

    center_m: Point
    spacing_m: float
    agrees: Flags
    """Which trackers are where the others of them say [tracker]; nobody where most of them contradict one another."""


def claimed_centers_m(position_m: Points, spacing_m: float, turned_rad: float = 0.0) -> Points:
    """Where each tracker's place says that the centre is [tracker, 3], the cross having turned so far."""
    return position_m - spacing_m * cross(turned_rad)


def median_m(point_m: Points) -> Point:
    """The median on each axis; rows of NaN do not count, and at least one row must be a point."""
    return medians(point_m[np.isfinite(point_m).all(axis=1)])


def medians(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Over the first axis, without NaN: of few values it takes a tenth of the time that numpy's own does."""
    rising, half = np.sort(values, axis=0), len(values) // 2
    return np.asarray(rising[half] if len(values) % 2 else (rising[half - 1] + rising[half]) / 2)


def fitted_formation(position_m: Points) -> FormationEstimate:
    """The formation next to where the trackers of the largest set are that agree (least squares); of sets as large, the
    one that agrees best. With all six its centre is the mean.

    Each of a set that agrees is at most ``ASTRAY_M`` from where the formation of the others has its place.

    Args:
        position_m: Where each says that it is [tracker, 3]; rows of NaN do not count, and at least one row must be a
            point.
    """
    there = np.flatnonzero(np.isfinite(position_m).all(axis=1))
    if len(there) < FEWEST_TO_JUDGE:
        return _estimate(position_m, there, there)
    for size in range(len(there), max(len(there) // 2, FEWEST_TO_JUDGE - 1), -1):
        off_m = {chosen: _off_m(position_m, np.array(chosen)) for chosen in combinations(there.tolist(), size)}
        agreeing = [chosen for chosen, each_m in off_m.items() if each_m.max() <= ASTRAY_M]
        if agreeing:
            best = np.array(min(agreeing, key=lambda chosen: float((off_m[chosen] ** 2).sum())))
            return _estimate(position_m, best, best)
    return _estimate(position_m, there, there[:0])


def _estimate(position_m: Points, fitted: TrackerNumbers, agreeing: TrackerNumbers) -> FormationEstimate:
    agrees = np.zeros(len(position_m), dtype=bool)
    agrees[agreeing] = True
    return FormationEstimate(*_fit(position_m, fitted), agrees)


def _fit(position_m: Points, trackers: TrackerNumbers) -> tuple[Point, float]:
    """Centre and spacing by least squares."""
    position_m, direction = position_m[trackers], TRACKER_DIRECTION[trackers]
    mean_m, mean_direction = position_m.mean(axis=0), direction.mean(axis=0)
    spread = direction - mean_direction
    squared = max(float((spread**2).sum()), 1e-9)
    spacing_m = max(float((spread * (position_m - mean_m)).sum()) / squared, 0.0)
    return mean_m - spacing_m * mean_direction, spacing_m


def _off_m(position_m: Points, trackers: TrackerNumbers) -> Levels:
    """How far each of these is from where the others of them say [tracker]."""
    off_m = []
    for tracker in trackers.tolist():
        center_m, spacing_m = _fit(position_m, trackers[trackers != tracker])
        off_m.append(np.linalg.norm(position_m[tracker] - center_m - spacing_m * TRACKER_DIRECTION[tracker]))
    return np.array(off_m)
