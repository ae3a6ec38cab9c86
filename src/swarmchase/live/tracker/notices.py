"""Lines for people on their way to the controller: cut to pieces of MAVLink's length, bounded in number and rate,
repeated.
"""

from collections import deque
from dataclasses import dataclass

from ..link.messages import (
    MOST_NOTICES,
    MOST_PIECES,
    MOST_WAITING_PIECES,
    NOTICE_PERIOD_S,
    NOTICE_TIMES,
    PIECE_CHARACTERS,
    Notice,
    Severity,
    printable,
)


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
        """Have a text sent, in as many pieces as it needs; what is longer than they may be is cut."""
        pieces = _pieces(printable(text))
        if len(self._waiting) + len(pieces) > MOST_WAITING_PIECES:
            self.dropped += 1
            return
        self._number = self._number % MOST_NOTICES + 1
        for place, piece in enumerate(pieces):
            self._waiting.append(_Waiting(Notice(self._tracker, self._number, severity, piece, place), NOTICE_TIMES))

    def due(self, now_ns: int) -> Notice | None:
        """The piece to be sent now; None where there is none, or one was sent a moment ago."""
        if not self._waiting or now_ns < self._due_ns:
            return None
        self._due_ns = now_ns + round(NOTICE_PERIOD_S * 1e9)
        one = self._waiting.popleft()
        one.left -= 1
        if one.left:
            self._waiting.append(one)
        return one.notice


def _pieces(text: str) -> list[str]:
    """The last is shorter than the others: after full ones an empty one says that nothing follows."""
    pieces = [text[start : start + PIECE_CHARACTERS] for start in range(0, len(text), PIECE_CHARACTERS)]
    if pieces and len(pieces[-1]) == PIECE_CHARACTERS:
        pieces.append("")
    return pieces[:MOST_PIECES]
