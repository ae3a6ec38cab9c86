"""JSON records, one a line, from a serial port, as an ESP32 prints them; ``json_records`` says what a record is."""

from pathlib import Path

from ...serial_port import open_serial_port
from .json_lines import JsonLinesSource
from .kind import SourceDetails, SourceKind


def _open(place: str, details: SourceDetails) -> JsonLinesSource:
    port = open_serial_port(Path(place), details.serial_baud)
    return JsonLinesSource(port, place, transmitter_mac=details.transmitter_mac)


KIND = SourceKind(scheme="serial", place="PATH", open=_open)
