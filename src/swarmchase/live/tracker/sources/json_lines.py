r"""Records that a receiver, a microcontroller or a bridge prints, one JSON object a line or a datagram.

    {"rssi_dbm": -61.5, "time_ns": 1234567890}

``rssi_dbm`` is a number, or null where the receiver has no level; ``time_ns``, or ``time_s``, is optional and of the
sender's own clock. Other fields are ignored. An ESP32 prints such lines to its serial port; an MQTT broker's messages
come with ``mosquitto_sub -t rssi | swarmchase tracker ...`` or over UDP. Nothing here is authenticated: UDP is bound
to loopback unless told otherwise.
"""

import json
import math
import os
import select
from collections import Counter
from typing import Any

from ...link.udp_socket import bound_udp_socket
from .protocol import MOST_PER_READ, Sample
from .sender_clock import SenderClock

LONGEST_LINE_BYTES = 4096
READ_BYTES = 65536


class Records:
    """Turns lines into samples and counts those that are none.

    Args:
        same_clock: the sender's times are of the clock that ``read`` is given (another process of this machine);
            otherwise the offset is estimated.
    """

    def __init__(self, same_clock: bool = False) -> None:
        self.rejected: Counter[str] = Counter()
        self._sender_clock = None if same_clock else SenderClock()

    def sample(self, line: bytes, now_ns: int) -> Sample | None:
        """The sample in the line; None where there is none."""
        record = parse_record(line)
        if record is None:
            self.rejected["no record"] += 1
            return None
        rssi_dbm, sender_ns = record
        if sender_ns is None:
            return now_ns, rssi_dbm
        if self._sender_clock is None:
            return sender_ns, rssi_dbm
        return self._sender_clock.local_ns(sender_ns, now_ns), rssi_dbm


class JsonLinesSource:
    """Lines from a file descriptor: standard input (0), a pipe, a serial port (``serial_port.open_serial_port``).

    It is read only where something waits, so that its blocking mode, which others may share, stays as it is.
    """

    def __init__(self, descriptor: int, same_clock: bool = False) -> None:
        self.ended = False
        self._descriptor = descriptor
        self._records = Records(same_clock)
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


class JsonDatagramSource:
    """Datagrams of one record or of several lines, from anybody who can reach the port.

    Raises:
        InputError: the address cannot be had.
    """

    def __init__(self, port: int, host: str = "127.0.0.1", same_clock: bool = False) -> None:
        self._records = Records(same_clock)
        self._socket = bound_udp_socket(host, port)

    @property
    def port(self) -> int:
        """Where it listens: found by the system where 0 was asked for."""
        return int(self._socket.getsockname()[1])

    @property
    def rejected(self) -> Counter[str]:
        """How many lines were dropped, by reason."""
        return self._records.rejected

    def read(self, now_ns: int) -> list[Sample]:
        """The samples that have come."""
        samples: list[Sample] = []
        for line in self._lines():
            sample = self._records.sample(line, now_ns)
            if sample is not None:
                samples.append(sample)
        return samples

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _lines(self) -> list[bytes]:
        """Of as many datagrams as make up so many lines; the rest waits for the next call."""
        lines: list[bytes] = []
        while len(lines) < MOST_PER_READ:
            try:
                # A datagram without a line counts as one, or a flood of them would be read for ever.
                lines.extend(self._socket.recv(READ_BYTES).strip().split(b"\n"))
            except OSError:  # nothing waits
                break
        return lines


def parse_record(line: bytes) -> tuple[float, int | None] | None:
    """(rssi_dbm, the sender's time in nanoseconds or None), or None where the line is no record. Never raises."""
    if len(line) > LONGEST_LINE_BYTES:
        return None
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(record, dict) or "rssi_dbm" not in record:
        return None
    try:
        return _level_dbm(record["rssi_dbm"]), _time_ns(record)
    except ValueError:
        return None


def _level_dbm(value: Any) -> float:
    """NaN for null, and for a whole number that is too large for a float."""
    try:
        return math.nan if value is None else float(_number(value))
    except OverflowError:
        return math.nan


def _time_ns(record: dict[str, Any]) -> int | None:
    for name, nanoseconds in (("time_ns", 1), ("time_s", 10**9)):
        if record.get(name) is not None:
            time = _number(record[name])
            if not 0 <= time < 2**63 / nanoseconds:
                raise ValueError(name)
            return round(time * nanoseconds)
    return None


def _number(value: Any) -> int | float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(value)
    return value
