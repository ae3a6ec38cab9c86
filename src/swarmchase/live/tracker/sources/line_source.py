"""A source whose samples stand in lines, whatever the lines come from and whatever is in them."""

import os
import select
from typing import Protocol, runtime_checkable

from .lines import LineParts, LineRecords
from .protocol import Sample
from .rejected import Rejected

READ_BYTES = 65536


@runtime_checkable
class ByteStream(Protocol):
    """Bytes as they come."""

    is_over: bool
    """Nothing will come any more."""

    def come(self) -> bytes:
        """What has come since the last call; never waits."""

    def close(self) -> None:
        """Give back what it holds."""


class OpenDescriptor:
    """A ``ByteStream`` of a file descriptor: standard input (0), a pipe, a serial port.

    It is read only where something waits, so that its blocking mode, which others may share, stays as it is.
    """

    def __init__(self, descriptor: int) -> None:
        self.is_over = False
        self._descriptor = descriptor

    def come(self) -> bytes:
        """What has come since the last call."""
        if self.is_over or not select.select([self._descriptor], [], [], 0)[0]:
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

    def close(self) -> None:
        """Close the descriptor, but for standard input, which is not ours."""
        if self._descriptor > 0 and not self.is_over:
            os.close(self._descriptor)
        self.is_over = True


class LineSource:
    """Lines from a stream of bytes.

    Args:
        name: what people call the stream.
        records: what a line is.
    """

    def __init__(self, stream: ByteStream, name: str, records: LineRecords) -> None:
        self._stream, self._name, self._records = stream, name, records
        self._parts = LineParts(records.longest_line_bytes)

    @property
    def rejected(self) -> Rejected:
        """The lines that were no records."""
        return self._records.rejected

    @property
    def ended(self) -> bool:
        """Whether nothing will come any more."""
        return self._stream.is_over

    @property
    def silence(self) -> str:
        """Nothing is printed, or nobody is there to print."""
        return f"{self._name} has ended" if self.ended else f"no line has come from {self._name}"

    def read(self, now_ns: int) -> list[Sample]:
        """The samples of the whole lines that have come.

        Raises:
            InputError: several transmit, and none was chosen.
        """
        lines = self._parts.lines(self._stream.come())
        if self._parts.num_too_long:
            self.rejected.add("too long a line")
            self._parts.num_too_long = 0
        samples = [self._records.sample(line, now_ns) for line in lines]
        self._records.require_one(self._name, now_ns)
        return [sample for sample in samples if sample is not None]

    def close(self) -> None:
        """Close the stream."""
        self._stream.close()
