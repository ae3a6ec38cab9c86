r"""Records that a receiver, a microcontroller or a bridge prints, one JSON object a line or a datagram.

    {"rssi_dbm": -61.5, "time_ns": 1234567890}

``rssi_dbm`` is a number, or null where the receiver has no level; ``time_ns``, or ``time_s``, is optional and of the
sender's own clock; ``mac``, optional too, says whose transmission it is. Other fields are ignored. An ESP32 prints such
lines to its serial port; an MQTT broker's messages come with ``mosquitto_sub -t rssi | swarmchase tracker ...`` or over
UDP. Nothing here is authenticated: UDP is bound to loopback unless told otherwise.
"""

import json
import math
from typing import Any

from ....errors import InputError
from .mac import mac_address
from .protocol import Sample
from .rejected import Rejected
from .sender_clock import SenderClock

LONGEST_LINE_BYTES = 4096
LONGEST_EXAMPLE = 24
"""Characters of what people are shown of a line that is no record."""


class JsonRecords:
    """Turns lines into samples and counts those that are none.

    Args:
        same_clock: the sender's times are of the clock that ``read`` is given (another process of this machine);
            otherwise the offset is estimated.
        transmitter_mac: of records that say whose transmission they are, only those of this device count.
    """

    def __init__(self, same_clock: bool = False, transmitter_mac: str | None = None) -> None:
        self.rejected = Rejected()
        self._transmitter = None if transmitter_mac is None else mac_address(transmitter_mac)
        self._sender_clock = None if same_clock else SenderClock()

    def sample(self, line: bytes, now_ns: int) -> Sample | None:
        """The sample in the line; None where there is none."""
        record = parse_record(line, self.rejected)
        if record is None:
            return None
        rssi_dbm, sender_ns, transmitter = record
        if self._transmitter is not None and transmitter not in (None, self._transmitter):
            return None
        if sender_ns is None:
            return now_ns, rssi_dbm
        if self._sender_clock is None:
            return sender_ns, rssi_dbm
        return self._sender_clock.local_ns(sender_ns, now_ns), rssi_dbm


def parse_record(line: bytes, rejected: Rejected) -> tuple[float, int | None, bytes | None] | None:
    """(rssi_dbm, the sender's time in nanoseconds or None, whose transmission it is or None), or None where the line is
    no record, which is counted. Never raises.
    """
    if len(line) > LONGEST_LINE_BYTES:
        rejected.add("too long a line")
        return None
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        record = None
    if not isinstance(record, dict):
        rejected.add("no JSON object", line[:LONGEST_EXAMPLE].decode(errors="replace"))
        return None
    if "rssi_dbm" not in record:
        rejected.add("without the field rssi_dbm", *(name[:LONGEST_EXAMPLE] for name in record))
        return None
    try:
        transmitter = None if record.get("mac") is None else mac_address(str(record["mac"]))
    except InputError:
        rejected.add("with a mac that is none", str(record["mac"])[:LONGEST_EXAMPLE])
        return None
    try:
        return _level_dbm(record), _time_ns(record), transmitter
    except ValueError as error:
        rejected.add("with a field that is no number", str(error)[:LONGEST_EXAMPLE])
        return None


def _level_dbm(record: dict[str, Any]) -> float:
    """NaN for null, and for a whole number that is too large for a float."""
    try:
        return math.nan if record["rssi_dbm"] is None else float(_number(record, "rssi_dbm"))
    except OverflowError:
        return math.nan


def _time_ns(record: dict[str, Any]) -> int | None:
    for name, nanoseconds in (("time_ns", 1), ("time_s", 10**9)):
        if record.get(name) is not None:
            time = _number(record, name)
            if not 0 <= time < 2**63 / nanoseconds:
                raise ValueError(name)
            return round(time * nanoseconds)
    return None


def _number(record: dict[str, Any], name: str) -> int | float:
    value = record[name]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(name)
    return value
