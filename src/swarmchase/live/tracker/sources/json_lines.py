"""JSON records, one a line, from whatever has a file descriptor; ``json_records`` says what a record is."""

import os
import select
from collections import Counter

from ....errors import InputError
from .json_records import LONGEST_LINE_BYTES, JsonRecords
from .kind import SourceDetails, SourceKind
from .protocol import Sample

READ_BYTES = 65536
STANDARD_INPUT = 0


class JsonLinesSource:
    """Lines from a file descriptor: standard input (0), a pipe, a serial port (``serial_lines``).

    It is read only where something waits, so that its blocking mode, which others may share, stays as it is.
    """

    def __init__(self, descriptor: int, same_clock: bool = False) -> None:
        self.ended = False
        self._descriptor = descriptor
        self._records = JsonRecords(same_clock)
        self._rest = b""
        self._too_long = False

    @property
    def rejected(self) -> Counter[str]:
        """How many lines were dropped, by reason."""
        return self._records.rejected

    def read(self, now_ns: int) -> list[Sample]:
        """The samples of the whole lines that have come."""
        samples = [self._records.sample(line, now_ns) for line in self._lines() if line.strip()]
        return [sample for sample in samples if sample is not None]

    def close(self) -> None:
        """Close the descriptor, but for standard input, which is not ours."""
        if self._descriptor > 0 and not self.ended:
            os.close(self._descriptor)
        self.ended = True

    def _lines(self) -> list[bytes]:
        *lines, self._rest = (self._rest + self._bytes()).split(b"\n")
        if lines and self._too_long:
            # The end of a line whose beginning is gone.
            lines, self._too_long = lines[1:], False
        if len(self._rest) > LONGEST_LINE_BYTES:
            self._rest = b""
            if not self._too_long:
                self.rejected["line too long"] += 1
            self._too_long = True
        return lines

    def _bytes(self) -> bytes:
        if self.ended or not select.select([self._descriptor], [], [], 0)[0]:
            return b""
        try:
            found = os.read(self._descriptor, READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:  # unplugged
            found = b""
        if not found:
            self.close()
        return found


def _open(place: str, _details: SourceDetails) -> JsonLinesSource:
    if place != "-":
        raise InputError(f"source 'jsonl:{place}' is refused: allowed is jsonl:-, which is standard input")
    return JsonLinesSource(STANDARD_INPUT)


KIND = SourceKind(scheme="jsonl", place="-", note="standard input", open=_open)
