"""The operator's words, and how they are typed: a word a line."""

import os
import select
from enum import StrEnum

LONGEST_LINE_BYTES = 1000
READ_BYTES = 4096


class OperatorWord(StrEnum):
    """What there is to say, at a page or a terminal."""

    START = "start"
    """Begin to command trackers."""
    OVERRIDE = "override"
    """Begin although the preflight has not passed."""
    HOLD = "hold"
    """Stay until ``RESUME``."""
    RESUME = "resume"
    """Go on after ``HOLD``, or where the target was taken for reached and is not."""
    REACHED = "reached"
    """The target is seen."""
    ABORT = "abort"
    """Tell the trackers to hold, then nothing any more."""
    QUIT = "quit"
    """End: abort what is under way, leave what has ended."""


WORDS = tuple(word.value for word in OperatorWord)


class OperatorWords:
    """Lines of a file descriptor; its end means no more words.

    It is read only where something waits, so that its blocking mode, which others may share, stays as it is.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._ended = False
        self._rest = b""

    def read(self) -> list[str]:
        """The words that have come since the last call. Never blocks."""
        *lines, self._rest = (self._rest + self._bytes()).split(b"\n")
        if len(self._rest) > LONGEST_LINE_BYTES:
            self._rest = b""
        words = [line.decode(errors="replace").strip() for line in lines]
        return [word for word in words if word]

    def _bytes(self) -> bytes:
        try:
            if self._ended or not select.select([self._descriptor], [], [], 0)[0]:
                return b""
            found = os.read(self._descriptor, READ_BYTES)
        except BlockingIOError:
            return b""
        except (OSError, ValueError):  # closed before this process began, or a terminal that has gone
            found = b""
        # A last word without a line's end counts, too.
        self._ended = not found
        return found or b"\n"
