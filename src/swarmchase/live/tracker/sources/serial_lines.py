"""What an ESP32 or another board prints to its serial port: JSON records or a sketch's text, as they come."""

from pathlib import Path

from ...serial_port import open_serial_port
from .kind import SourceDetails, SourceKind
from .line_source import LineSource, OpenDescriptor
from .printed_records import PrintedRecords


def _open(place: str, details: SourceDetails) -> LineSource:
    port = OpenDescriptor(open_serial_port(Path(place), details.serial_baud))
    return LineSource(port, place, PrintedRecords(details))


KIND = SourceKind(scheme="serial", place="PATH", note="JSON lines or a sketch's text", open=_open)
