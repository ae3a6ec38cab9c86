"""What a source of RSSI samples says of itself, so that a person can name it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ...address import AddressKind
from .protocol import RssiSource
from .transmitters import Transmitters


@dataclass(frozen=True)
class SourceDetails:
    """What some sources want to know besides their address."""

    sampling_hz: float = 10.0
    """F, RSSI samples a second."""
    rssi_column: str = "rssi_dbm"
    """Of a replayed CSV or JSON file; in JSON records the name of the field, or its way through others."""
    time_column: str = "time_s"
    """Of the same, in seconds or as ISO 8601; empty: the rows of a CSV file are 1/F apart."""
    rssi_unit: Literal["dbm", "sik"] = "dbm"
    """Of a replayed CSV or JSON file: dBm, or the numbers of a SiK radio."""
    mac_column: str = "mac"
    """Of JSON records: whose transmission it is."""
    transmitter_mac: str | None = None
    """The device that is chased; Kismet needs it."""
    transmitter_name: str | None = None
    """What the device that is chased calls itself: the UAS id of its Remote ID, or the name of its network."""
    frequency_hz: tuple[float, float] | None = None
    """From, to: the band whose power is the level, of what rtl_power sweeps; None: all of it."""
    mqtt_password_file: Path | None = None
    """Of the user in the address of an MQTT broker."""
    kismet_token_file: Path | None = None
    """Holds the API key of the Kismet server."""
    serial_baud: int = 115_200
    same_clock: bool = False
    """The times in JSON records are of this machine's monotonic clock: they come from another process here."""

    def transmitters(self) -> Transmitters:
        """Of a source that tells transmitters apart.

        Raises:
            InputError: the address of the device that is chased is none.
        """
        return Transmitters(self.transmitter_mac, self.transmitter_name)


DEFAULT_DETAILS = SourceDetails()


@dataclass(frozen=True, kw_only=True)
class SourceKind(AddressKind):
    """One kind of source."""

    open: Callable[[str, SourceDetails], RssiSource]
    """The source at a place; ``InputError`` where there is none, or a detail is missing."""
