"""Who of the trackers counts, and why somebody does not.

A tracker is left out

- when it says before the start, or in a window, that it is more than ``ASTRAY_M`` from where it must be, that is as far
  from the place that it was told as the others are from theirs: at once, and it is left behind, which means commanded
  no more;
- when it comes back after it was lost, or flown by somebody else, and says that it is where it cannot have flown to:
  left behind;
- when it has not come to its place in ``MOVEMENTS_NOT_FOLLOWED`` movements in a row, while most others came to theirs:
  left behind;
- when its level contradicts those of the others in ``CONTRADICTING_WINDOWS`` windows in a row. It flies on with the
  others; it is not heard. (Nobody hears a contradicting level before that either, window by window.)

One that is left behind is led again when it has been where it was last told to be, within ``BACK_M``, for
``BACK_WINDOWS`` windows in a row; it counts when it was then in its place, with a level that needs no more than half of
what the channel lends, for as many windows; those in which nothing of it was heard say nothing. Each time that it is
left out again it must be so for twice as long, and for half as long each time that it has counted for
``FORGIVEN_WINDOWS`` in a row: in an hour somebody is left out now and then who does no wrong.
"""

from dataclasses import dataclass

import numpy as np

from ...scenario import NUM_TRACKERS
from .formation_estimate import ASTRAY_M, median_m
from .sample_window import Flags, Levels, Points

MOVEMENTS_NOT_FOLLOWED = 2
CONTRADICTING_WINDOWS = 3
BACK_WINDOWS = 3
BACK_M = ASTRAY_M / 2
LONGEST_BACK_WINDOWS = 1000
"""However often it was left out."""
FORGIVEN_WINDOWS = 100


@dataclass
class _Standing:
    """Of one tracker."""

    reason: str = ""
    """Why it is left out; empty where it counts."""
    is_behind: bool = False
    """Whether it is not commanded either."""
    contradicting: int = 0
    """Windows in a row."""
    not_followed: int = 0
    """Movements in a row."""
    consistent: int = 0
    """Windows in a row, while it is left out."""
    back_windows: int = BACK_WINDOWS
    """So many are asked for."""
    counted: int = 0
    """Windows in a row, since it came back or was forgiven."""

    def leave_out(self, reason: str, is_behind: bool) -> None:
        if self.reason:
            self.back_windows = min(2 * self.back_windows, LONGEST_BACK_WINDOWS)
        self.reason, self.is_behind = reason, is_behind
        self.contradicting = self.not_followed = self.consistent = self.counted = 0

    def take_counted(self) -> None:
        """Take in another window in which it counts."""
        self.counted += 1
        if self.counted >= FORGIVEN_WINDOWS:
            self.counted, self.back_windows = 0, max(self.back_windows // 2, BACK_WINDOWS)

    def is_consistent(self, it_is: bool) -> bool:
        """Take in another window; whether there were enough by now."""
        self.consistent = self.consistent + 1 if it_is else 0
        return self.consistent >= self.back_windows

    def come_back(self) -> None:
        """From behind to being led, then to counting."""
        self.consistent = 0
        if not self.is_behind:
            self.reason = ""
            self.back_windows = min(2 * self.back_windows, LONGEST_BACK_WINDOWS)
        self.is_behind = False


class Reliability:
    """Remembers the last windows and movements of one chase. Arrays are [tracker]."""

    def __init__(self) -> None:
        self._standings = [_Standing() for _ in range(NUM_TRACKERS)]

    @property
    def reasons(self) -> list[str]:
        """Why each is left out; empty where it counts."""
        return [standing.reason for standing in self._standings]

    @property
    def counts(self) -> Flags:
        """Who counts."""
        return np.array([not standing.reason for standing in self._standings])

    @property
    def may_be_commanded(self) -> Flags:
        """Who counts, or is led although it does not."""
        return np.array([not standing.is_behind for standing in self._standings])

    def take_start(self, there: Flags, agrees: Flags, off_m: Levels) -> None:
        """Before a chase: who is there, who of them agrees with most, and how far each is from where those say that it
        must be. Who agrees counts, whatever was before.
        """
        for tracker in np.flatnonzero(there).tolist():
            standing = self._standings[tracker]
            if agrees[tracker]:
                self._standings[tracker] = _Standing()
            elif not standing.reason:
                reason = _astray(off_m[tracker]) if agrees.any() else "no formation fits most of what trackers say"
                standing.leave_out(reason, is_behind=True)

    def forgive(self, position_m: Points, left_m: Points) -> None:
        """Everybody counts, but who is left behind and not where it was last told to be; arguments as below."""
        waits_m = np.linalg.norm(position_m - left_m, axis=1)
        for tracker, standing in enumerate(self._standings):
            if not standing.is_behind or waits_m[tracker] <= BACK_M:
                self._standings[tracker] = _Standing()

    def leave_out_jump(self, tracker: int, jump_m: float) -> None:
        """One that was not commanded says that it is so far from where it was, further than it can have flown."""
        reason = f"it says that it is {jump_m:.1f} m from where it was, further than it can have flown"
        self._standings[tracker].leave_out(reason, is_behind=True)

    def take_positions(
        self, set_point_m: Points, position_m: Points, left_m: Points, astray_m: float | Levels = ASTRAY_M
    ) -> None:
        """Where they were in a window, worst moment by worst moment, and where they were told to be.

        Args:
            set_point_m: [tracker, 3]; NaN where it is not commanded.
            position_m: [tracker, 3]
            left_m: Where each was last told to be [tracker, 3], where it is not commanded any more.
            astray_m: Who is further off is left behind; one for all, or of each [tracker].
        """
        off_m = off_set_points_m(set_point_m, position_m, self.counts)
        for tracker in np.flatnonzero(off_m > astray_m).tolist():
            self._standings[tracker].leave_out(_astray(off_m[tracker]), is_behind=True)
        waits_m = np.linalg.norm(position_m - left_m, axis=1)
        for standing, one_m in zip(self._standings, waits_m.tolist(), strict=True):
            if standing.is_behind and standing.is_consistent(one_m <= BACK_M):
                standing.come_back()

    def take_levels(self, is_heard: Flags, contradicts: Flags, is_doubtful: Flags) -> None:
        """Who is heard where it must be in a window, whose level contradicts the others', and whose nearly does."""
        for tracker, standing in enumerate(self._standings):
            if not standing.reason:
                standing.take_counted()
                standing.contradicting = standing.contradicting + 1 if contradicts[tracker] else 0
                if standing.contradicting >= CONTRADICTING_WINDOWS:
                    standing.leave_out("its level contradicts what the others hear", is_behind=False)
            elif not standing.is_behind and is_heard[tracker] and standing.is_consistent(not is_doubtful[tracker]):
                standing.come_back()

    def take_movement(self, set_out: list[int], came: list[int]) -> None:
        """Who was told to fly, and who of them came to its place. Where many did not, nobody is to blame."""
        late = [tracker for tracker in set_out if tracker not in came]
        for tracker in set_out:
            standing = self._standings[tracker]
            standing.not_followed = standing.not_followed + 1 if tracker in late else 0
            if standing.not_followed >= MOVEMENTS_NOT_FOLLOWED and 2 * len(late) < len(set_out):
                standing.leave_out(f"it has not followed for {MOVEMENTS_NOT_FOLLOWED} movements", is_behind=True)


def _astray(off_m: float) -> str:
    return f"it says that it is {off_m:.1f} m from where the others say that it must be"


def off_set_points_m(set_point_m: Points, position_m: Points, counts: Flags) -> Levels:
    """How much further each is from the place that it was told than those that count are in the median [tracker]; NaN
    where it was told none.
    """
    way_m = position_m - set_point_m
    told = np.isfinite(way_m).all(axis=1)
    if not (told & counts).any():
        return np.full(len(way_m), np.nan)
    return np.asarray(np.linalg.norm(way_m - median_m(way_m[told & counts]), axis=1))
