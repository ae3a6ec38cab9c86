"""Lines for people on their way to the controller: cut to MAVLink's length, bounded in number and rate, repeated."""

import textwrap
from collections import deque
from dataclasses import dataclass

from ..link.messages import LONGEST_NOTICE, MOST_NOTICES, Notice, Severity, printable

TIMES = 3
"""Each line is sent so often: datagrams get lost."""
PERIOD_S = 0.25
"""From one line to the next, and between the repetitions of all."""
MOST_WAITING = 20
"""What comes on top of so many lines is dropped: an autopilot that does not stop talking must not fill the link."""


@dataclass
class _Waiting:
    notice: Notice
    left: int


class Notices:
    """Of one tracker."""

    def __init__(self, tracker: int) -> None:
        self.dropped = 0
        """Lines that found no room."""
        self._tracker = tracker
        self._number = 0
        self._waiting: deque[_Waiting] = deque()
        self._due_ns = 0

    def put(self, severity: Severity, text: str) -> None:
        """Have a text sent, in as many lines as it needs."""
        for line in textwrap.wrap(printable(text), LONGEST_NOTICE):
            if len(self._waiting) >= MOST_WAITING:
                self.dropped += 1
                continue
            self._number = self._number % MOST_NOTICES + 1
            self._waiting.append(_Waiting(Notice(self._tracker, self._number, severity, line), TIMES))

    def due(self, now_ns: int) -> Notice | None:
        """The line to be sent now; None where there is none, or one was sent a moment ago."""
        if not self._waiting or now_ns < self._due_ns:
            return None
        self._due_ns = now_ns + round(PERIOD_S * 1e9)
        one = self._waiting.popleft()
        one.left -= 1
        if one.left:
            self._waiting.append(one)
        return one.notice
