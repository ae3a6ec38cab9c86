"""What every source of RSSI samples is to the tracker agent."""

from typing import Protocol, runtime_checkable

from ....levels import is_level
from .rejected import Rejected

Sample = tuple[int, float]
"""When it was taken, in nanoseconds of the agent's own clock, and what the receiver reports, in dBm; NaN where it says
that it has nothing. Whether it is a level is decided where it is taken up (``SampleBuffer``)."""

Row = tuple[float, float]
"""Of a recording: when, in seconds of any clock, and the RSSI in dBm, NaN where there is none."""

MOST_PER_READ = 1000
"""Records taken up by one ``read``: a flood waits, or is lost, and does not keep the agent from its other work."""


@runtime_checkable
class RssiSource(Protocol):
    """One tracker's receiver."""

    @property
    def rejected(self) -> Rejected:
        """What has come and was no sample."""

    @property
    def silence(self) -> str:
        """What to tell people where nothing at all has come: "no datagram has come to port 7000"."""

    def read(self, now_ns: int) -> list[Sample]:
        """The samples that have come since the last call. Never blocks, and bad input is never fatal."""

    def close(self) -> None:
        """Give back what it holds."""


class CalibratedSource:
    """Adds what this receiver reports too little: six cheap receivers differ by several dB."""

    def __init__(self, source: RssiSource, calibration_offset_db: float) -> None:
        self._source = source
        self._calibration_offset_db = calibration_offset_db

    @property
    def rejected(self) -> Rejected:
        """The source's."""
        return self._source.rejected

    @property
    def silence(self) -> str:
        """The source's."""
        return self._source.silence

    def read(self, now_ns: int) -> list[Sample]:
        """The samples of the source, each level with the offset added."""
        return [
            # What is none stays as it is: the offset must not make it look like one.
            (time_ns, rssi_dbm + self._calibration_offset_db if is_level(rssi_dbm) else rssi_dbm)
            for time_ns, rssi_dbm in self._source.read(now_ns)
        ]

    def close(self) -> None:
        """Close the source."""
        self._source.close()
