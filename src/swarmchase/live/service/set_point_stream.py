"""The set-points as they are streamed: towards the legs' way-points, never faster than permitted, never going further
ahead of a tracker than it can fly in ``LEAD_S``, and each only if the way to it from where its tracker was last seen
keeps clear of the ways of all others (``separation``). Where somebody comes in between, set-points are pulled back to
where their trackers can stop.
"""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ...scenario import NUM_TRACKERS
from .orders import Onward
from .safety import Legs, SafetyLimits
from .sample_window import Point, Points
from .separation import Traffic, stopping_m

LEAD_S = 1.0
"""All wait where a set-point would be further ahead of its tracker than this at the highest speed."""
LONGEST_STEP_S = 0.25
"""A loop that stood still does not make up for it."""
STEP_SHARES = (1.0, 0.5, 0.25, 0.125)
"""Where a whole step is not free, a part of it may be."""
INTRUSION_M = 0.2
"""Ways that have come so much nearer than they may are pulled back; less is the trackers' swinging."""


class SetPointStream:
    """Six set-points in metres of the shared frame [tracker, 3]; NaN where a tracker is not commanded."""

    def __init__(self, limits: SafetyLimits) -> None:
        self._limits = limits
        self._legs: list[Points] = []
        self.is_at_corner = False
        """Whether a leg has been given out and the next one has not been begun."""
        self.set_point_m: Points = np.full((NUM_TRACKERS, 3), np.nan)
        self.onward: Onward | None = None
        """None: all come to rest at their set-points."""
        self.pulled_back = 0
        """In so many steps a set-point was pulled back, or in flight moved away from another."""
        self.blocked_s = 0.0
        """So long not even a part of a step has been free."""

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
        if self.onward is not None:
            self.onward.valid_s[tracker] = 0.0

    def last_m(self, tracker: int) -> Point:
        """Where it comes to rest, told nothing more."""
        rest_m, onward = self.set_point_m[tracker], self.onward
        return np.asarray(rest_m if onward is None else rest_m + onward.valid_s[tracker] * onward.velocity_mps)

    def release(self, tracker: int) -> None:
        """Command it no more; a flight goes on without it."""
        self.set_point_m[tracker] = np.nan
        for leg_m in self._legs:
            leg_m[tracker] = np.nan

    def fly(self, legs: Legs) -> None:
        """Set out along these legs, from wherever the set-points are."""
        self._legs, self.is_at_corner, self.blocked_s = [leg_m.copy() for leg_m in legs], False, 0.0

    def turn(self) -> None:
        """Begin the next leg: all have arrived at the corner."""
        self.is_at_corner = False

    def stop(self) -> None:
        """Stay at the set-points of now."""
        self._legs, self.is_at_corner, self.blocked_s = [], False, 0.0

    def ways_m(self) -> list[float]:
        """The longest way of each leg that is left to fly."""
        starts = [self.set_point_m, *self._legs[:-1]]
        return [_longest_m(end_m - start_m) for start_m, end_m in zip(starts, self._legs, strict=False)]

    def advance(self, elapsed_s: float, traffic: Traffic) -> None:
        """Go on for this long, as far as no tracker lags behind and all ways are clear of one another."""
        self._pull_back(traffic)
        if not self._legs or self.is_at_corner:
            return
        ways = traffic.ways(self.set_point_m)
        elapsed_s = min(max(elapsed_s, 0.0), LONGEST_STEP_S)
        for following_m, ends in self._steps(self._limits.highest_speed_mps * elapsed_s):
            if _longest_m(following_m - traffic.position_m) > self._limits.highest_speed_mps * LEAD_S:
                self.blocked_s = 0.0
            elif ways.may_become(traffic.ways(following_m), self._limits.minimum_separation_m):
                self.set_point_m, self.blocked_s = following_m, 0.0
                if ends:
                    self._legs.pop(0)
                    self.is_at_corner = bool(self._legs)
                return
        self.blocked_s += elapsed_s

    def _steps(self, flown_m: float) -> Iterator[tuple[Points, bool]]:
        """The set-points after a step this long, and after shorter ones, and whether the leg ends there."""
        way_m = self._legs[0] - self.set_point_m
        way_m[~np.isfinite(way_m)] = 0.0
        longest_m = _longest_m(way_m)
        flies = self.commanded & np.isfinite(self._legs[0]).all(axis=1)
        low_m = np.minimum(self._limits.low_m, self.set_point_m)
        high_m = np.maximum(self._limits.high_m, self.set_point_m)
        for step_share in STEP_SHARES:
            ends = longest_m <= step_share * flown_m
            # All fly the same share of their way, so that they stay on the straight lines that were planned.
            share = 1.0 if ends else step_share * flown_m / longest_m
            target_m = self._legs[0] if ends else self.set_point_m + share * way_m
            following_m = np.where(flies[:, None], target_m, self.set_point_m)
            yield np.clip(following_m, low_m, high_m), ends

    def _pull_back(self, traffic: Traffic) -> None:
        """Have those stop whose way somebody has come into."""
        blocked = traffic.ways(self.set_point_m).blocked(self._limits.minimum_separation_m - INTRUSION_M)
        blocked &= self.commanded
        if not blocked.any():
            return
        way_m = self.set_point_m - traffic.position_m
        length_m = np.maximum(np.linalg.norm(way_m, axis=1, keepdims=True), 1e-9)
        along_mps = np.maximum((traffic.velocity_mps * way_m).sum(axis=1, keepdims=True) / length_m, 0.0)
        stop_m = np.linalg.norm(stopping_m(along_mps * way_m / length_m), axis=1, keepdims=True)
        shorter_m = traffic.position_m + np.minimum(stop_m / length_m, 1.0) * way_m
        self.set_point_m = np.where(blocked[:, None], shorter_m, self.set_point_m)
        self.pulled_back += 1


def _longest_m(way_m: Points) -> float:
    """The longest of these vectors [tracker, 3]; those of NaN do not count."""
    return float(np.nan_to_num(np.linalg.norm(way_m, axis=1)).max())
