"""What a source of RSSI samples says of itself, so that a person can name it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ...address import AddressKind
from .protocol import RssiSource


@dataclass(frozen=True)
class SourceDetails:
    """What some sources want to know besides their address."""

    sampling_hz: float = 10.0
    """F, RSSI samples a second."""
    rssi_column: str = "rssi_dbm"
    """Of a replayed CSV or JSON file."""
    time_column: str = "time_s"
    """Of a replayed CSV or JSON file, in seconds."""
    transmitter_mac: str | None = None
    """The device that is chased; Kismet needs it, captures take every frame without it."""
    kismet_token_file: Path | None = None
    """Holds the API key of the Kismet server."""
    serial_baud: int = 115_200
    same_clock: bool = False
    """The times in datagrams are of this machine's monotonic clock: they come from another process here."""


@dataclass(frozen=True, kw_only=True)
class SourceKind(AddressKind):
    """One kind of source."""

    open: Callable[[str, SourceDetails], RssiSource]
    """The source at a place; ``InputError`` where there is none, or a detail is missing."""
