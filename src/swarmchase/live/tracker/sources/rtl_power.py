"""The power that rtl_power measures in a band, from the CSV that it writes, while it writes it, or from a pipe.

    rtl_power -f 2.4G:2.402G:10k -i 1 - | swarmchase tracker --source rtl_power:/dev/stdin ...

rtl_power's own help: "date, time, Hz low, Hz high, Hz step, samples, dB, dB, dB, ...", one row a hop of the dongle; the
rows of a sweep go upwards in frequency. hackrf_sweep and soapy_power write the same. The levels are no dBm: see
``--calibration-offset-db``.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from ....errors import InputError
from ....levels import HIGHEST_DBM
from ....reading import opened
from .growing_file import GrowingFile
from .iso_time import time_s
from .kind import SourceDetails, SourceKind
from .line_source import LineSource
from .lines import LineParts
from .protocol import Row, Sample
from .rejected import Rejected

LONGEST_LINE_BYTES = 2**21
"""Of a row with rtl_power's finest bins."""
READ_BYTES = 262_144
NUM_HEADS = 6


class Hop(NamedTuple):
    """One row."""

    time_s: float
    """Of the clock of the computer that sweeps."""
    low_hz: float
    step_hz: float
    level_db: tuple[float, ...]
    """Of each bin, upwards."""

    @property
    def high_hz(self) -> float:
        """Where the last bin ends."""
        return self.low_hz + self.step_hz * len(self.level_db)

    def power(self, band_hz: tuple[float, float]) -> float:
        """Of the bins whose middles lie within the band, together; 0 where there are none."""
        middles_hz = (self.low_hz + (number + 0.5) * self.step_hz for number in range(len(self.level_db)))
        within = (
            level_db
            for middle_hz, level_db in zip(middles_hz, self.level_db, strict=True)
            if band_hz[0] <= middle_hz <= band_hz[1] and math.isfinite(level_db)
        )
        return math.fsum(10 ** (level_db / 10) for level_db in within)


class Sweeps:
    """Adds up the power of a sweep, hop by hop.

    A sweep is over with the hop that reaches the end of the band, or, where that is not known, of the last sweep; else
    when the next one begins. Times do not tell sweeps apart: some are the hop's, some the sweep's.

    Raises:
        InputError: the band is none.
    """

    def __init__(self, band_hz: tuple[float, float] | None = None) -> None:
        if band_hz is not None and not 0 <= band_hz[0] < band_hz[1] < math.inf:
            raise InputError(f"frequency_hz = {band_hz} is refused: allowed is from a frequency to a higher one, in Hz")
        self._band_hz = (0.0, math.inf) if band_hz is None else band_hz
        self._end_hz = math.inf if band_hz is None else band_hz[1]
        self._highest_hz = 0.0
        self._last: Hop | None = None
        self._power = 0.0
        self._is_told = False

    def add(self, hop: Hop) -> Row | None:
        """(time in s, level in dB) of the sweep that is over with this row; NaN where none of it was in the band."""
        found = None
        if self._last is not None and hop.low_hz <= self._last.low_hz:
            found = None if self._is_told else self._row(self._last)
            self._end_hz = min(self._end_hz, self._highest_hz)
            self._power, self._highest_hz, self._is_told = 0.0, 0.0, False
        self._last = hop
        self._power += hop.power(self._band_hz)
        self._highest_hz = max(self._highest_hz, hop.high_hz)
        if not self._is_told and self._highest_hz >= self._end_hz:
            self._is_told = True
            return self._row(hop)
        return found

    def _row(self, hop: Hop) -> Row:
        return hop.time_s, 10 * math.log10(self._power) if self._power > 0 else math.nan


class RtlPowerRecords:
    """``LineRecords`` of such rows. A level counts when its row comes: the times in them are whole seconds."""

    longest_line_bytes = LONGEST_LINE_BYTES

    def __init__(self, band_hz: tuple[float, float] | None = None) -> None:
        self.rejected = Rejected()
        self._sweeps = Sweeps(band_hz)

    def sample(self, line: bytes, now_ns: int) -> Sample | None:
        """The sample that is whole with this line."""
        row = self.row(line)
        return None if row is None else (now_ns, row[1])

    def row(self, line: bytes) -> Row | None:
        """The same with the time in the row."""
        hop = parse_hop(line)
        if hop is None:
            self.rejected.add("no row of rtl_power", line[:24].decode(errors="replace"))
            return None
        row = self._sweeps.add(hop)
        if row is not None and math.isnan(row[1]):
            self.rejected.add("a sweep without the band")
            return None
        return row

    def require_one(self, what: str, now_ns: int) -> None:
        """A band is nobody's."""


def parse_hop(line: bytes) -> Hop | None:
    """What a row says; None where it is none. Never raises."""
    cells = [cell.strip() for cell in line.decode(errors="replace").split(",")]
    try:
        low_hz, high_hz, step_hz = (float(cell) for cell in cells[2:5])
        levels_db = tuple(float(cell) for cell in cells[NUM_HEADS:] if cell)
    except ValueError:
        return None
    hop = Hop(time_s(f"{cells[0]} {cells[1]}"), low_hz, step_hz, levels_db)
    is_one = 0 <= low_hz < high_hz < math.inf and 0 < step_hz < math.inf and math.isfinite(hop.time_s)
    return hop if is_one and levels_db and not any(level_db > HIGHEST_DBM for level_db in levels_db) else None


def rtl_power_rows(path: Path, band_hz: tuple[float, float] | None = None) -> Iterator[Row]:
    """The levels of finished sweeps, for ``ReplaySource``.

    Raises:
        InputError: the file cannot be read.
    """
    records, parts = RtlPowerRecords(band_hz), LineParts(LONGEST_LINE_BYTES)
    with opened(path, "recording") as file:
        while piece := file.read(READ_BYTES):
            for line in parts.lines(piece):
                row = records.row(line)
                if row is not None:
                    yield row


def _open(place: str, details: SourceDetails) -> LineSource:
    records = RtlPowerRecords(details.frequency_hz)
    file = GrowingFile(Path(place), "sweeps")
    while file.held():  # how strong the signal was is not how strong it is now
        pass
    return LineSource(file, place, records)


KIND = SourceKind(scheme="rtl_power", place="FILE", note="CSV that grows, or a pipe", open=_open)
