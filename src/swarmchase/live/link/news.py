"""What one end of a link tells people of what it drops and of clocks that do not agree: which lines, and when."""

import time
from collections import Counter
from collections.abc import Callable

from .mavlink import ControllerMavlinkLink, TrackerMavlinkLink
from .rejection import Reason, Tally
from .timestamps import FRESH_S

TOLD_AGAIN_S = 60.0
"""So long after it was told, what goes on is told again."""


class LinkNews:
    """Gives each line when it is new, and again after ``TOLD_AGAIN_S`` while it goes on.

    Args:
        now_s: any clock that nobody steps.
    """

    def __init__(
        self, end: ControllerMavlinkLink | TrackerMavlinkLink, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._end, self._now_s = end, now_s
        self._told_s: dict[object, float] = {}
        self._told_count: Counter[object] = Counter()

    def lines(self) -> list[str]:
        """What is to be told now: who waits for a tracker wants to know that it is turned away."""
        lines = []
        if self._end.state_errors and self._is_due("state"):
            lines.append("the link's timestamps cannot be written: after a restart, recorded packets could be accepted")
        for (reason, sender), tally in self._end.rejections.tallies.items():
            lines += self._told_of((reason, sender), tally)
        for sender, skew_s in self._end.skew_s.items():
            if skew_s > FRESH_S and self._is_due(sender):
                lines.append(f"the clock of {sender} is {skew_s:.1f} s ahead: it takes what it is sent for too old")
        return lines

    def _told_of(self, what: tuple[Reason, str], tally: Tally) -> list[str]:
        more, told_s = tally.count - self._told_count[what], self._told_s.get(what)
        if not more or not self._is_due(what):
            return []
        self._told_count[what] = tally.count
        number = "a datagram" if told_s is None else f"{more} more ({more / (self._now_s() - told_s):.1f} a second)"
        reason, sender = what
        in_whose_name = f" in the name of {sender}" if sender else ""
        return [f"rejected {number}{in_whose_name}: {reason}{_shown(reason, tally.skew_s)}"]

    def _is_due(self, what: object) -> bool:
        """Whether it is to be told now; then it has been."""
        now_s, told_s = self._now_s(), self._told_s.get(what)
        if told_s is not None and now_s - told_s < TOLD_AGAIN_S:
            return False
        self._told_s[what] = now_s
        return True


def _shown(reason: Reason, skew_s: float | None) -> str:
    """How far its time is off, and why that may be."""
    if skew_s is None:
        return ""
    if reason is Reason.REPLAYED:
        return f": {-skew_s:.1f} s before the newest that was accepted"
    if reason is Reason.TOO_OLD:
        return f": its clock is {-skew_s:.1f} s behind, or it was held up so long"
    return f": its clock is {skew_s:.1f} s ahead, or ours so much behind"
