"""Lines from whatever writes them, and the samples in them."""

from typing import Protocol, runtime_checkable

from .protocol import Sample
from .rejected import Rejected


@runtime_checkable
class LineRecords(Protocol):
    """Turns lines, or messages, into samples and counts those that are none."""

    rejected: Rejected
    longest_line_bytes: int
    """More is no record of this kind."""

    def sample(self, line: bytes, now_ns: int) -> Sample | None:
        """The sample in the line; None where there is none."""

    def require_one(self, what: str, now_ns: int) -> None:
        """Ask whose transmissions are meant.

        Raises:
            InputError: several transmit, and none was chosen.
        """


class LineParts:
    """Puts lines together from the pieces in which they come."""

    def __init__(self, longest_line_bytes: int) -> None:
        self.num_too_long = 0
        self._longest_line_bytes = longest_line_bytes
        self._rest = b""
        self._is_too_long = False

    def lines(self, piece: bytes) -> list[bytes]:
        """Those that are whole now. A line without an end does not fill the memory."""
        *lines, self._rest = (self._rest + piece).split(b"\n")
        if lines and self._is_too_long:
            # The end of a line whose beginning is gone.
            lines, self._is_too_long = lines[1:], False
        if len(self._rest) > self._longest_line_bytes:
            self._rest = b""
            self.num_too_long += not self._is_too_long
            self._is_too_long = True
        return [line for line in lines if line.strip()]
