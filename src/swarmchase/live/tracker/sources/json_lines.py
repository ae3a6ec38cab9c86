"""JSON records, one a line, from whatever has a file descriptor; ``json_records`` says what a record is."""

import os
import select

from ....errors import InputError
from .json_records import LONGEST_LINE_BYTES, JsonRecords
from .kind import SourceDetails, SourceKind
from .protocol import Sample
from .rejected import Rejected

READ_BYTES = 65536
STANDARD_INPUT = 0


class JsonLinesSource:
    """Lines from a file descriptor: standard input (0), a pipe, a serial port (``serial_lines``).

    It is read only where something waits, so that its blocking mode, which others may share, stays as it is.

    Args:
        name: what people call it.
        same_clock: ``JsonRecords``,
        transmitter_mac: too.
    """

    def __init__(
        self,
        descriptor: int,
        name: str = "standard input",
        same_clock: bool = False,
        transmitter_mac: str | None = None,
    ) -> None:
        self.ended = False
        self._name = name
        self._descriptor = descriptor
        self._records = JsonRecords(same_clock, transmitter_mac)
        self._rest = b""
        self._too_long = False

    @property
    def rejected(self) -> Rejected:
        """The lines that were no records."""
        return self._records.rejected

    @property
    def silence(self) -> str:
        """Nothing is printed, or nobody is there to print."""
        return f"{self._name} has ended" if self.ended else f"no line has come from {self._name}"

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
                self.rejected.add("too long a line")
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


def _open(place: str, details: SourceDetails) -> JsonLinesSource:
    if place != "-":
        raise InputError(f"source 'jsonl:{place}' is refused: allowed is jsonl:-, which is standard input")
    return JsonLinesSource(STANDARD_INPUT, transmitter_mac=details.transmitter_mac)


KIND = SourceKind(scheme="jsonl", place="-", note="standard input", open=_open)
