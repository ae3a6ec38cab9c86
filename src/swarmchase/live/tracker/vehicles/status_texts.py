"""What an autopilot tells people (STATUSTEXT), put together from its pieces, and no more of it than people can read."""

from collections import deque
from typing import Any

from ...link.messages import Severity
from .protocol import Said

LEAST_SEVERITY = Severity.WARNING
"""What matters less is for those who look for it: ground stations show it."""
PIECE = 50
"""Characters of one message; a shorter one is the last of its text."""
MOST_PIECES = 4
MOST_KEPT = 8


class StatusTexts:
    """Filled with messages, emptied by ``taken``: of what nobody takes the newest stay."""

    def __init__(self) -> None:
        self._said: deque[Said] = deque(maxlen=MOST_KEPT)
        self._number = 0
        self._pieces: list[str] = []

    def say(self, severity: Severity, text: str) -> None:
        """A line of our own about the vehicle."""
        self._said.append((severity, text))

    def take_up(self, message: Any) -> None:
        """A STATUSTEXT has come. A text whose pieces do not come one after the other is shown as far as it came."""
        if not 0 <= message.severity <= LEAST_SEVERITY:
            return
        if message.id == 0 or message.id != self._number or message.chunk_seq != len(self._pieces):
            self._pieces = []
        self._number = message.id
        self._pieces.append(message.text)
        is_last = message.id == 0 or len(message.text) < PIECE or len(self._pieces) == MOST_PIECES
        if is_last:
            text = "".join(self._pieces).strip()
            self._number, self._pieces = 0, []
            if text:
                self.say(Severity(message.severity), text)

    def taken(self) -> list[Said]:
        """What has been said since the last call."""
        said = list(self._said)
        self._said.clear()
        return said
