"""The set-points as they are streamed: towards the legs' way-points, never faster than permitted, never going further
ahead of a tracker than it can fly in ``LEAD_S``, and each checked against the limits before it is let out.
"""

import numpy as np
import numpy.typing as npt

from ...scenario import NUM_TRACKERS
from .safety import Legs, SafetyLimits, is_clear
from .sample_window import Point, Points

LEAD_S = 1.0
"""All wait where a set-point would be further ahead of its tracker than this at the highest speed."""
LONGEST_STEP_S = 0.25
"""A loop that stood still does not make up for it."""


class SetPointStream:
    """Six set-points in metres of the shared frame [tracker, 3]; NaN where a tracker is not commanded."""

    def __init__(self, limits: SafetyLimits) -> None:
        self._limits = limits
        self._legs: list[Points] = []
        self.set_point_m: Points = np.full((NUM_TRACKERS, 3), np.nan)

    @property
    def commanded(self) -> npt.NDArray[np.bool_]:
        """Which trackers have a set-point."""
        return np.asarray(np.isfinite(self.set_point_m).all(axis=1))

    @property
    def has_arrived(self) -> bool:
        """Whether the last way-point has been given out. The trackers may still be on their way."""
        return not self._legs

    def hold(self, tracker: int, position_m: Point) -> None:
        """Command a tracker that was not: it stays where it is until the next flight."""
        self.set_point_m[tracker] = position_m

    def release(self, tracker: int) -> None:
        """Command it no more; a flight goes on without it."""
        self.set_point_m[tracker] = np.nan
        for leg_m in self._legs:
            leg_m[tracker] = np.nan

    def fly(self, legs: Legs) -> None:
        """Set out along these legs, from wherever the set-points are."""
        self._legs = [leg_m.copy() for leg_m in legs]

    def stop(self) -> None:
        """Stay at the set-points of now."""
        self._legs = []

    def longest_way_m(self) -> float:
        """What is left to fly: the longest way of each leg, summed."""
        at_m, total_m = self.set_point_m, 0.0
        for leg_m in self._legs:
            total_m += _longest_m(leg_m - at_m)
            at_m = leg_m
        return total_m

    def advance(self, elapsed_s: float, position_m: Points, obstacles_m: Points) -> None:
        """Go on for this long, unless a tracker lags behind or an obstacle has come in between."""
        if not self._legs:
            return
        flown_m = self._limits.highest_speed_mps * min(max(elapsed_s, 0.0), LONGEST_STEP_S)
        way_m = self._legs[0] - self.set_point_m
        way_m[~np.isfinite(way_m)] = 0.0
        longest_m = _longest_m(way_m)
        ends = longest_m <= flown_m
        # All fly the same share of their way, so that they stay on the straight lines that were checked.
        share = 1.0 if ends else flown_m / longest_m
        flies = self.commanded & np.isfinite(self._legs[0]).all(axis=1)
        target_m = self._legs[0] if ends else self.set_point_m + share * way_m
        following_m = np.where(flies[:, None], target_m, self.set_point_m)
        low_m = np.minimum(self._limits.low_m, self.set_point_m)
        high_m = np.maximum(self._limits.high_m, self.set_point_m)
        following_m = np.clip(following_m, low_m, high_m)
        if _longest_m(following_m - position_m) > self._limits.highest_speed_mps * LEAD_S:
            return
        if is_clear(self.set_point_m, following_m, obstacles_m, self._limits.minimum_separation_m):
            self.set_point_m = following_m
            if ends:
                self._legs.pop(0)


def _longest_m(way_m: Points) -> float:
    """The longest of these vectors [tracker, 3]; those of NaN do not count."""
    return float(np.nan_to_num(np.linalg.norm(way_m, axis=1)).max())
