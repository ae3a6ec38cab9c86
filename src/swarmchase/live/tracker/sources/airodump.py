"""The level at which airodump-ng hears one device, from the CSV file that it writes anew every second or so.

    airodump-ng --write hall --output-format csv --write-interval 1 wlan0mon

The file has two tables (aircrack-ng's documentation of airodump-ng): access points by BSSID, with their names (ESSID),
and stations by MAC. Power is in dBm; -1 is a driver that does not say, or a device that is only known from others.
"""

import csv
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ....errors import InputError
from ....reading import opened
from .kind import SourceDetails, SourceKind
from .mac import mac_address
from .protocol import Sample
from .rejected import Rejected
from .transmitters import Transmitters

LARGEST_FILE_BYTES = 4 * 2**20
UNKNOWN_POWER = -1.0
_KEYS = ("BSSID", "Station MAC")
"""What the heads of the two tables begin with."""
_COUNTS = ("# beacons", "# IV", "# packets")
"""One of them grows with each packet."""


@dataclass(frozen=True)
class HeardDevice:
    """A row of either table."""

    mac: str
    name: str | None
    power_dbm: float
    """NaN where it is not known."""
    seen: tuple[str, ...]
    """What changes with each packet."""


class AirodumpSource:
    """Reads the file again when it has changed. A device of which nothing new was heard gives no sample.

    Raises:
        InputError: the file cannot be read; several devices are in it, and none was chosen.
    """

    def __init__(self, path: Path, transmitters: Transmitters) -> None:
        self.rejected = Rejected()
        self._path, self._transmitters = path, transmitters
        self._what = f"airodump-ng's {path}"
        self._changed_ns = 0
        self._seen: dict[str, tuple[str, ...]] = {}
        for device in self._changed_devices():
            self._counts(device)
        transmitters.require_one(self._what)

    @property
    def silence(self) -> str:
        """The file stays as it is, or the device in it."""
        return f"{self._path} says nothing new of it"

    def read(self, now_ns: int) -> list[Sample]:
        """The levels that are new: their own times are whole seconds and of no use here.

        Raises:
            InputError: several devices are in it, and none was chosen.
        """
        try:
            devices = list(self._changed_devices())
        except InputError as error:  # it is being written, or is gone for a moment
            self.rejected.add("not to be read", str(error))
            return []
        samples = [(now_ns, device.power_dbm) for device in devices if self._counts(device)]
        self._transmitters.require_one_in_time(self._what, now_ns)
        return samples

    def close(self) -> None:
        """Nothing is held."""

    def _changed_devices(self) -> Iterator[HeardDevice]:
        """Those that were heard since the last call."""
        with opened(self._path, "CSV of airodump-ng") as file:
            changed_ns = os.fstat(file.fileno()).st_mtime_ns
            if changed_ns == self._changed_ns:
                return
            content = file.read(LARGEST_FILE_BYTES)
        self._changed_ns = changed_ns
        devices = parse_devices(content)
        yield from (device for device in devices if self._seen.get(device.mac) != device.seen)
        self._seen = {device.mac: device.seen for device in devices}

    def _counts(self, device: HeardDevice) -> bool:
        if math.isnan(device.power_dbm):
            self.rejected.add("of unknown power", device.mac)
            return False
        names = [] if device.name is None else [device.name]
        if self._transmitters.counts(device.mac, names, device.power_dbm):
            return True
        self.rejected.add("of another transmitter", device.mac)
        return False


def parse_devices(content: bytes) -> list[HeardDevice]:
    """The whole rows of both tables. Never raises."""
    devices: list[HeardDevice] = []
    head: list[str] = []
    # What follows the last end of a line is not whole yet.
    whole, _, _ = content.rpartition(b"\n")
    for line in whole.decode(errors="replace").split("\n"):
        cells = _cells(line)
        if cells and cells[0] in _KEYS:
            head = cells
        elif head and len(cells) >= len(head) - 1:  # the key at the end, or the names asked for, may be empty
            device = _device(dict(zip(head, cells, strict=False)))
            devices += [] if device is None else [device]
    return devices


def _cells(line: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line], skipinitialspace=True), [])]
    except csv.Error:
        return []


def _device(row: dict[str, str]) -> HeardDevice | None:
    try:
        mac = mac_address(row.get("Station MAC") or row["BSSID"]).hex(":")
        power_dbm = float(row["Power"])
    except (InputError, KeyError, ValueError):
        return None
    seen = tuple(row.get(name, "") for name in ("Last time seen", *_COUNTS))
    return HeardDevice(mac, row.get("ESSID") or None, math.nan if power_dbm == UNKNOWN_POWER else power_dbm, seen)


def _open(place: str, details: SourceDetails) -> AirodumpSource:
    return AirodumpSource(Path(place), details.transmitters())


KIND = SourceKind(scheme="airodump-ng", place="FILE", note="CSV that it writes", open=_open)
