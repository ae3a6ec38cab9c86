"""Tells of each tracker when it comes, goes, falls silent or is heard again, and when it is left out or comes back."""

from collections.abc import Callable

from ..link.messages import TrackerMode
from .chase_state import Snapshot, TrackerSnapshot


class TrackerNews:
    """Told every snapshot of a service, it tells people what has changed with a tracker."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._known: dict[int, str] = {}

    def __call__(self, snapshot: Snapshot, decision_latency_s: float | None) -> None:
        """Take in the service as it is after a step."""
        for number, tracker in enumerate(snapshot.trackers):
            condition = _condition(tracker)
            # Who has never been there is no news.
            if condition != self._known.get(number, "is lost"):
                self._known[number] = condition
                self._tell(f"tracker {number} {condition}")


def _condition(tracker: TrackerSnapshot) -> str:
    if tracker.is_lost:
        return "is lost"
    if tracker.mode is TrackerMode.MANUAL:
        return "is flown by somebody else, or cannot be commanded"
    if tracker.left_out:
        return f"is left out: {tracker.left_out}"
    return "is silent" if tracker.is_silent else "is there"
