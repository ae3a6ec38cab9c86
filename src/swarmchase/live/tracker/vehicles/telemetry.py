"""What an autopilot is asked to say more often.

A message that comes too rarely is asked for, after longer and longer pauses while that does not help: the line may
carry no more, or somebody else on it may want it otherwise. SET_MESSAGE_INTERVAL is asked with first; firmware that
does not know it gets REQUEST_DATA_STREAM, which brings other messages as well.
"""

from collections import deque
from dataclasses import dataclass

RATE_OVER_S = 1.0
ENOUGH_SHARE = 0.8
"""Of the wanted rate."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 32.0


@dataclass(frozen=True)
class Wanted:
    """A message that is wanted."""

    message_id: int
    rate_hz: float
    data_stream: int | None = None
    """MAV_DATA_STREAM: which of the streams of old brings it; None where none does for sure."""
    over_s: float = RATE_OVER_S
    """Over so long the rate is looked at."""


class Wish:
    """For one message, from its making on."""

    def __init__(self, wanted: Wanted) -> None:
        self.wanted = wanted
        self._came_ns: deque[int] = deque(maxlen=round(wanted.over_s * wanted.rate_hz))
        self._pause_s = FIRST_PAUSE_S
        self._due_ns: int | None = None

    def heard(self, now_ns: int) -> None:
        """It has come."""
        self._came_ns.append(now_ns)

    def is_due(self, now_ns: int) -> bool:
        """Whether it is to be asked for now."""
        if self._due_ns is None:
            self._due_ns = now_ns + round(RATE_OVER_S * 1e9)
        if self._is_often(now_ns):
            self._pause_s = FIRST_PAUSE_S
            return False
        if now_ns < self._due_ns:
            return False
        self._due_ns = now_ns + round(max(self._pause_s, self.wanted.over_s) * 1e9)
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)
        return True

    def ask_again(self, now_ns: int) -> None:
        """At once, in another way."""
        self._due_ns, self._pause_s = now_ns, FIRST_PAUSE_S

    def _is_often(self, now_ns: int) -> bool:
        recent = sum(now_ns - came_ns <= self.wanted.over_s * 1e9 for came_ns in self._came_ns)
        return recent >= ENOUGH_SHARE * self.wanted.over_s * self.wanted.rate_hz
