"""What every source of RSSI samples is to the tracker agent, and what a sample may be."""

import math
from typing import Protocol, runtime_checkable

from ...link.messages import HIGHEST_RSSI_DBM, LOWEST_RSSI_DBM

Sample = tuple[int, float]
"""When it was taken, in nanoseconds of the agent's own clock, and the RSSI in dBm; NaN where the receiver says that it
has none."""

Row = tuple[float, float]
"""Of a recording: when, in seconds of any clock, and the RSSI in dBm, NaN where there is none."""

MOST_PER_READ = 1000
"""Records taken up by one ``read``: a flood waits, or is lost, and does not keep the agent from its other work."""


@runtime_checkable
class RssiSource(Protocol):
    """One tracker's receiver."""

    def read(self, now_ns: int) -> list[Sample]:
        """The samples that have come since the last call. Never blocks, and bad input is never fatal."""

    def close(self) -> None:
        """Give back what it holds."""


class CalibratedSource:
    """Adds what this receiver reports too little: six cheap receivers differ by several dB."""

    def __init__(self, source: RssiSource, calibration_offset_db: float) -> None:
        self._source = source
        self._calibration_offset_db = calibration_offset_db

    def read(self, now_ns: int) -> list[Sample]:
        """The samples of the source, each with the offset added."""
        return [
            # Garbage is recognised before the offset could make it look like something.
            (time_ns, plausible_dbm(plausible_dbm(rssi_dbm) + self._calibration_offset_db))
            for time_ns, rssi_dbm in self._source.read(now_ns)
        ]

    def close(self) -> None:
        """Close the source."""
        self._source.close()


def plausible_dbm(rssi_dbm: float) -> float:
    """The level itself, or NaN where no receiver can have meant it."""
    return rssi_dbm if LOWEST_RSSI_DBM <= rssi_dbm <= HIGHEST_RSSI_DBM else math.nan
