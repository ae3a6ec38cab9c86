"""A source of RSSI samples: a beacon that is turned up and down, for trying a link without a radio."""

from swarmchase.live.tracker.sources.kind import SourceDetails, SourceKind
from swarmchase.live.tracker.sources.simulated import SimulatedSource

LOUD_DBM, QUIET_DBM = -50.0, -80.0


def _open(place: str, details: SourceDetails) -> SimulatedSource:
    """``beacon:SECONDS``: loud for so long, then quiet for as long."""
    half_ns = round(float(place) * 1e9)
    return SimulatedSource(lambda time_ns: LOUD_DBM if time_ns // half_ns % 2 == 0 else QUIET_DBM, details.sampling_hz)


KIND = SourceKind(scheme="beacon", place="SECONDS", open=_open)
