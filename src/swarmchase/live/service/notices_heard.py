"""A tracker's lines for people, put together from the pieces that have come: each comes three times, in any order."""

from dataclasses import dataclass, field

from ..link.messages import MOST_PIECES, MOST_WAITING_PIECES, NOTICE_PERIOD_S, NOTICE_TIMES, PIECE_CHARACTERS, Notice
from .chase_state import TrackerLine

KEPT_LINES = 8
REMEMBERED_LINES = KEPT_LINES + MOST_WAITING_PIECES
"""What is sent again of a line that is kept no more must not be taken for another one."""
WAITED_S = NOTICE_TIMES * MOST_WAITING_PIECES * NOTICE_PERIOD_S + 1.0
"""A line of which pieces are missing for so long is shown without them: nothing of it is under way any more. One that
was shown sooner would be another line with the rest.
"""
MISSING = "(...)"


@dataclass
class _Pieces:
    first_ns: int
    """When the first of them came."""
    by_place: dict[int, Notice] = field(default_factory=dict)

    @property
    def is_complete(self) -> bool:
        last = max(self.by_place)
        ends = last == MOST_PIECES - 1 or len(self.by_place[last].text) < PIECE_CHARACTERS
        return ends and len(self.by_place) == last + 1

    def line(self) -> TrackerLine:
        last = max(self.by_place)
        texts = [self.by_place[place].text if place in self.by_place else MISSING for place in range(last + 1)]
        if not self.is_complete and len(self.by_place) == last + 1:
            texts.append(MISSING)
        any_piece = self.by_place[last]
        return TrackerLine(any_piece.number, any_piece.severity, "".join(texts).strip())


class NoticesHeard:
    """Of one tracker, the newest ``KEPT_LINES``."""

    def __init__(self) -> None:
        self._pieces: dict[int, _Pieces] = {}
        """By number, in the order of their coming."""

    def hear(self, notice: Notice, now_ns: int) -> None:
        """A piece has come. A number that comes again with another text is another line: its tracker began anew."""
        known = self._pieces.get(notice.number)
        if known is not None and known.by_place.get(notice.piece, notice) != notice:
            del self._pieces[notice.number]
        pieces = self._pieces.setdefault(notice.number, _Pieces(now_ns))
        pieces.by_place[notice.piece] = notice
        while len(self._pieces) > REMEMBERED_LINES:
            del self._pieces[next(iter(self._pieces))]

    def lines(self, now_ns: int) -> tuple[TrackerLine, ...]:
        """Those that are all there, or were waited for, oldest first."""
        waited_ns = round(WAITED_S * 1e9)
        told = [one for one in self._pieces.values() if one.is_complete or now_ns - one.first_ns >= waited_ns]
        return tuple(one.line() for one in told[-KEPT_LINES:])
