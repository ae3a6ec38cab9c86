"""From what a person writes to a source of RSSI samples."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ....errors import InputError
from ...address import LOOPBACK, host_and_port, kind_and_place
from ...link.messages import HIGHEST_RSSI_DBM, LOWEST_RSSI_DBM
from . import (
    JsonDatagramSource,
    JsonLinesSource,
    KismetSource,
    PcapSource,
    ReplaySource,
    RssiSource,
    SimulatedSource,
    csv_rows,
    json_rows,
    open_serial_port,
    pcap_rows,
)
from .replay import Row

KINDS = {
    "replay": "FILE",
    "jsonl": "-",
    "serial": "PATH",
    "udp": "PORT",
    "kismet": "URL",
    "pcap": "FILE",
    "simulated": "LEVEL_DBM",
}
STANDARD_INPUT = 0


@dataclass(frozen=True)
class SourceDetails:
    """What some sources want to know besides."""

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


def open_source(text: str, sampling_hz: float, details: SourceDetails) -> RssiSource:
    """The source of ``replay:FILE``, ``udp:PORT`` and so on: ``KINDS``.

    Raises:
        InputError: there is no such source, or it cannot be opened.
    """
    kind, place = kind_and_place(text, KINDS, "source")
    openers: dict[str, Callable[[], RssiSource]] = {
        "replay": lambda: ReplaySource(_rows(Path(place), details)),
        "jsonl": lambda: _standard_input(place),
        "serial": lambda: JsonLinesSource(open_serial_port(Path(place), details.serial_baud)),
        "udp": lambda: _datagrams(*host_and_port(place, LOOPBACK), details.same_clock),
        "kismet": lambda: _kismet(place, details),
        "pcap": lambda: PcapSource(Path(place), details.transmitter_mac),
        "simulated": lambda: _simulated(place, sampling_hz),
    }
    return openers[kind]()


def _standard_input(place: str) -> JsonLinesSource:
    if place != "-":
        raise InputError(f"source 'jsonl:{place}' is refused: allowed is jsonl:-, which is standard input")
    return JsonLinesSource(STANDARD_INPUT)


def _datagrams(host: str, port: int, same_clock: bool) -> JsonDatagramSource:
    return JsonDatagramSource(port, host, same_clock)


def _kismet(url: str, details: SourceDetails) -> KismetSource:
    if details.transmitter_mac is None:
        raise InputError("Kismet hears many devices: say which one with --transmitter-mac")
    return KismetSource(url, details.transmitter_mac, _token(details.kismet_token_file))


def _rows(path: Path, details: SourceDetails) -> Iterator[Row]:
    """By the file's ending."""
    if path.suffix == ".csv":
        return csv_rows(path, details.rssi_column, details.time_column)
    if path.suffix == ".json":
        return json_rows(path, details.rssi_column, details.time_column)
    if path.suffix == ".pcap":
        return pcap_rows(path, details.transmitter_mac)
    raise InputError(f"cannot replay {path}: allowed are .csv, .json and .pcap")


def _token(path: Path | None) -> str | None:
    if path is None:
        return None
    try:
        return path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read the token in {path}: {getattr(error, 'strerror', None) or error}") from None


def _simulated(text: str, sampling_hz: float) -> SimulatedSource:
    try:
        level_dbm = float(text)
    except ValueError:
        raise InputError(f"level {text!r} is refused: allowed is a number of dBm") from None
    if not LOWEST_RSSI_DBM <= level_dbm <= HIGHEST_RSSI_DBM:
        raise InputError(f"level {text} dBm is refused: allowed is {LOWEST_RSSI_DBM:g} to {HIGHEST_RSSI_DBM:g}")
    return SimulatedSource(lambda _time_ns: level_dbm, sampling_hz)
