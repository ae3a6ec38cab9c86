"""Recorded levels, played at the pace at which they were recorded.

A recording is rows of (seconds, dBm): ``csv_rows`` reads them from a table, ``json_rows`` from an object of records
(the form of BirdsEye and GamutRF logs), ``pcap.pcap_rows`` from a capture of packets, ``rtl_power.rtl_power_rows`` from
sweeps.
"""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ....errors import InputError
from ....ranges import MOST_SHOWN_CHARACTERS
from ....reading import Bounds, opened, opened_table, read_json
from .captured_levels import is_capture
from .iso_time import time_s
from .kind import SourceDetails, SourceKind
from .pcap import pcap_rows
from .protocol import MOST_PER_READ, Row, Sample
from .radio_status import sik_dbm
from .rejected import Rejected
from .rtl_power import LONGEST_LINE_BYTES, parse_hop, rtl_power_rows

RECORDING_BOUNDS = Bounds(most_bytes=64 * 2**20, most_values=2**21, is_finite=False)
"""Of a JSON recording, which is held in memory. What is no number in it is a missing sample."""
MOST_BEGINNING_BYTES = LONGEST_LINE_BYTES
"""Enough to know a recording by."""


class ReplaySource:
    """The first row is due at the first ``read``, every other so long after it as it was recorded after it.

    A row that was recorded before its predecessor is dropped and counted; gaps stay gaps.

    Raises:
        InputError: there is no row, or the recording cannot be read.
    """

    def __init__(self, rows: Iterator[Row], name: str = "the recording") -> None:
        self.rejected = Rejected()
        self._is_over = False
        self._rows = rows
        self._waiting = next(rows, None)
        if self._waiting is None:
            raise InputError(f"{name} holds no sample")
        self._start: tuple[int, float] | None = None
        self._last_s = -math.inf

    @property
    def silence(self) -> str:
        """A gap, or the end."""
        return "the recording is over" if self._is_over else "the recording has a gap"

    def read(self, now_ns: int) -> list[Sample]:
        """The samples that have fallen due."""
        samples: list[Sample] = []
        for _ in range(MOST_PER_READ):
            row = self._waiting or next(self._rows, None)
            self._waiting = None
            if row is None:
                self._is_over = True
                break
            row_s, rssi_dbm = row
            if row_s < self._last_s:
                self.rejected.add("going back in time")
                continue
            self._start = self._start or (now_ns, row_s)
            due_ns = self._start[0] + round((row_s - self._start[1]) * 1e9)
            if due_ns > now_ns:
                self._waiting = row
                break
            self._last_s = row_s
            samples.append((due_ns, rssi_dbm))
        return samples

    def close(self) -> None:
        """Play no more."""
        self._rows, self._waiting = iter(()), None


def csv_rows(
    path: Path,
    rssi_column: str = "rssi_dbm",
    time_column: str | None = "time_s",
    interval_s: float = 1.0,
    to_dbm: Callable[[float], float] = float,
) -> Iterator[Row]:
    """The rows of a table with a header line.

    Args:
        path: the file.
        rssi_column: the levels; what is no number there is a missing sample.
        time_column: seconds; rows without a number there are skipped. None: the rows are ``interval_s`` apart.
        interval_s: seconds between rows, where the table has no times.
        to_dbm: what turns the numbers of ``rssi_column`` into dBm, e.g. ``sik_dbm``.

    Raises:
        InputError: the file cannot be read, or lacks a column.
    """
    with opened_table(path, "recording") as table:
        for column in [rssi_column] + ([time_column] if time_column else []):
            if column not in (table.fieldnames or []):
                names = ", ".join(table.fieldnames or [])[:MOST_SHOWN_CHARACTERS] or "no head line"
                raise InputError(f"{path} has no column {column!r}: it has {names}")
        for number, fields in enumerate(table):
            row_s = time_s(fields[time_column]) if time_column else number * interval_s
            if math.isfinite(row_s):
                yield row_s, to_dbm(_number(fields[rssi_column]))


def json_rows(
    path: Path, rssi_field: str = "rssi", time_field: str = "time", to_dbm: Callable[[float], float] = float
) -> Iterator[Row]:
    """The rows of a JSON object, or a list, of records, in the order of their times.

    Raises:
        InputError: the file cannot be read, or is no such object.
    """
    loaded = read_json(path, "recording", RECORDING_BOUNDS)
    records = loaded.values() if isinstance(loaded, dict) else loaded if isinstance(loaded, list) else []
    rows = [
        (time_s(record.get(time_field)), to_dbm(_number(record.get(rssi_field))))
        for record in records
        if isinstance(record, dict)
    ]
    found = sorted((row for row in rows if math.isfinite(row[0])), key=lambda row: row[0])
    if not found:
        raise InputError(f"{path} holds no record with {time_field!r}")
    yield from found


def _number(value: Any) -> float:
    """NaN for what is none."""
    if isinstance(value, bool):
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _open(place: str, details: SourceDetails) -> ReplaySource:
    return ReplaySource(_rows(Path(place), details), f"recording {place}")


_TO_DBM: dict[str, Callable[[float], float]] = {"dbm": float, "sik": sik_dbm}


def _rows(path: Path, details: SourceDetails) -> Iterator[Row]:
    """By what the file begins with, and else by its ending."""
    to_dbm = _TO_DBM[details.rssi_unit]
    if path.suffix == ".json":
        return json_rows(path, details.rssi_column, details.time_column, to_dbm)
    with opened(path, "recording") as file:
        beginning = file.read(MOST_BEGINNING_BYTES)
    if is_capture(beginning):
        return pcap_rows(path, details.transmitters())
    if parse_hop(beginning.partition(b"\n")[0]) is not None:
        return rtl_power_rows(path, details.frequency_hz)
    if path.suffix == ".csv":
        interval_s = 1 / details.sampling_hz if details.sampling_hz > 0 else math.inf
        return csv_rows(path, details.rssi_column, details.time_column, interval_s, to_dbm)
    raise InputError(f"cannot replay {path}: allowed are .csv, .json, captures (pcap, pcapng) and sweeps of rtl_power")


KIND = SourceKind(scheme="replay", place="FILE", note=".csv, .json, pcap, pcapng, rtl_power", open=_open)
