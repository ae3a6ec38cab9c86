"""JSON records, one a line, from a serial port, as an ESP32 prints them; ``json_records`` says what a record is."""

from pathlib import Path

from ...serial_port import open_serial_port
from .json_lines import JsonLinesSource
from .kind import SourceDetails, SourceKind


def _open(place: str, details: SourceDetails) -> JsonLinesSource:
    return JsonLinesSource(open_serial_port(Path(place), details.serial_baud), place)


KIND = SourceKind(scheme="serial", place="PATH", open=_open)
