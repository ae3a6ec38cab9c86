r"""Records that a receiver, a microcontroller or a bridge prints, one JSON object a line or a message.

    {"rssi_dbm": -61.5, "time_ns": 1234567890}

The level is a number, or null where the receiver has none; the time is optional and of the sender's own clock:
``time_ns``, or seconds or ISO 8601 in ``time_s``; ``mac``, optional too, says whose transmission it is. Other fields
are ignored. Where fields have other names, or lie within others, ``SourceDetails`` says which: ``rxInfo.0.rssi`` is the
level of a LoRa gateway. Nothing here is authenticated: UDP is bound to loopback unless told otherwise.
"""

import json
import math
from typing import Any

from ....errors import InputError
from .iso_time import time_s
from .kind import DEFAULT_DETAILS, SourceDetails
from .mac import mac_address
from .protocol import Sample
from .rejected import Rejected
from .sender_clock import SenderClock
from .transmitters import Transmitters

LONGEST_LINE_BYTES = 16_384
LONGEST_EXAMPLE = 24
"""Characters of what people are shown of a line that is no record."""
_NOTHING = object()


class JsonRecords:
    """``LineRecords`` of such lines. Of records that say whose transmission they are, only those of the device that is
    chased count.

    Args:
        rejected: where the lines that are none are counted, where others are counted there, too.
        transmitters: who was heard, likewise.

    Raises:
        InputError: the address of the device that is chased is none.
    """

    longest_line_bytes = LONGEST_LINE_BYTES

    def __init__(
        self, details: SourceDetails, rejected: Rejected | None = None, transmitters: Transmitters | None = None
    ) -> None:
        self.rejected = Rejected() if rejected is None else rejected
        self._details = details
        self._transmitters = transmitters or details.transmitters()
        self._sender_clock = None if details.same_clock else SenderClock()

    def sample(self, line: bytes, now_ns: int) -> Sample | None:
        """The sample in the line; None where there is none."""
        record = parse_record(line, self.rejected, self._details)
        if record is None:
            return None
        rssi_dbm, sender_ns, transmitter = record
        if transmitter is not None and not self._transmitters.counts(transmitter, (), rssi_dbm):
            self.rejected.add("of another transmitter", transmitter)
            return None
        if sender_ns is None:
            return now_ns, rssi_dbm
        if self._sender_clock is None:
            return sender_ns, rssi_dbm
        return self._sender_clock.local_ns(sender_ns, now_ns), rssi_dbm

    def require_one(self, what: str, now_ns: int) -> None:
        """Ask whose transmissions are meant.

        Raises:
            InputError: several transmit, and none was chosen.
        """
        self._transmitters.require_one_in_time(what, now_ns)


def parse_record(
    line: bytes, rejected: Rejected, details: SourceDetails = DEFAULT_DETAILS
) -> tuple[float, int | None, str | None] | None:
    """(rssi_dbm, the sender's time in nanoseconds or None, the MAC address whose transmission it is or None), or None
    where the line is no record, which is counted. Never raises.
    """
    if len(line) > LONGEST_LINE_BYTES:
        rejected.add("too long a line")
        return None
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        record = None
    if not isinstance(record, dict | list):
        rejected.add("no JSON object", line[:LONGEST_EXAMPLE].decode(errors="replace"))
        return None
    level = _field(record, details.rssi_column)
    if level is _NOTHING:
        seen = record if isinstance(record, dict) else ()
        rejected.add(f"without the field {details.rssi_column}", *(name[:LONGEST_EXAMPLE] for name in seen))
        return None
    mac = _field(record, details.mac_column)
    try:
        transmitter = None if mac in (_NOTHING, None) else mac_address(str(mac)).hex(":")
    except InputError:
        rejected.add("with a mac that is none", str(mac)[:LONGEST_EXAMPLE])
        return None
    try:
        return _level_dbm(level, details.rssi_column), _time_ns(record, details.time_column), transmitter
    except ValueError as error:
        rejected.add("with a field that is no number", str(error)[:LONGEST_EXAMPLE])
        return None


def _field(record: Any, way: str) -> Any:
    """What lies at the end of names and numbers between dots; ``_NOTHING`` where nothing does."""
    if isinstance(record, dict) and way in record:
        return record[way]
    for name in way.split("."):
        if isinstance(record, dict) and name in record:
            record = record[name]
        elif isinstance(record, list) and name.isdecimal() and int(name) < len(record):
            record = record[int(name)]
        else:
            return _NOTHING
    return record


def _level_dbm(value: Any, name: str) -> float:
    """NaN for null, and for a whole number that is too large for a float."""
    try:
        return math.nan if value is None else float(_number(value, name))
    except OverflowError:
        return math.nan


def _time_ns(record: Any, seconds_name: str) -> int | None:
    """Of a whole number of nanoseconds exactly; a float has a few hundred of them less."""
    nanoseconds = _field(record, "time_ns")
    if nanoseconds not in (_NOTHING, None):
        time_ns = _number(nanoseconds, "time_ns")
        if not 0 <= time_ns < 2**63:
            raise ValueError("time_ns")
        return round(time_ns)
    seconds = _field(record, seconds_name)
    if seconds in (_NOTHING, None):
        return None
    found_s = time_s(seconds)
    if not 0 <= found_s < 2**63 / 1e9:
        raise ValueError(seconds_name)
    return round(found_s * 10**9)


def _number(value: Any, name: str) -> int | float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(name)
    return value
