"""What a tracker tells people, through the controller: in lines, each said a few times since datagrams get lost, and
never more than people can read, whatever its autopilot has to say.
"""

import textwrap
from collections import deque

from ..link.messages import LONGEST_NOTICE, MOST_NOTICES, Notice, Severity

SAID_AGAIN_S = 60.0
"""The same text is said no more often: what lasts may be named in every step."""
MOST_A_MINUTE = 20
"""Lines."""
MOST_LINES = 4
"""Of one text."""
TIMES, PERIOD_S = 3, 0.2
"""Each line is sent so often; datagrams are so far apart."""


class NoticeBoard:
    """Of one tracker. ``left_out`` counts the lines that were too many."""

    def __init__(self, tracker: int) -> None:
        self.left_out = 0
        self._tracker = tracker
        self._number = 0
        self._said_ns: dict[str, int] = {}
        """When a text was last said; of the last minute only."""
        self._lines_ns: deque[int] = deque(maxlen=MOST_A_MINUTE)
        """When the last lines were accepted."""
        self._waiting: deque[tuple[Notice, int]] = deque()
        """And how often each is still to be sent."""
        self._due_ns = 0

    def say(self, severity: Severity, text: str, now_ns: int) -> None:
        """Have it sent, in printable ASCII and cut to lines, unless it has been of late."""
        text = "".join(one if one.isascii() and one.isprintable() else "?" for one in text)
        oldest_ns = now_ns - round(SAID_AGAIN_S * 1e9)
        self._said_ns = {said: said_ns for said, said_ns in self._said_ns.items() if said_ns > oldest_ns}
        if text in self._said_ns:
            return
        lines = textwrap.wrap(text, LONGEST_NOTICE, max_lines=MOST_LINES, placeholder=" ...")
        for line in lines:
            if len(self._lines_ns) == MOST_A_MINUTE and self._lines_ns[0] > oldest_ns:
                self.left_out += 1
                continue
            self._said_ns[text] = now_ns
            self._lines_ns.append(now_ns)
            self._number = self._number % MOST_NOTICES + 1
            self._waiting.append((Notice(self._tracker, self._number, severity, line), TIMES))

    def due(self, now_ns: int) -> Notice | None:
        """What is to be sent now."""
        if not self._waiting or now_ns < self._due_ns:
            return None
        self._due_ns = now_ns + round(PERIOD_S * 1e9)
        notice, times = self._waiting.popleft()
        if times > 1:
            self._waiting.append((notice, times - 1))
        return notice
