"""JSON records, one a line, on standard input; ``json_records`` says what a record is."""

from ....errors import InputError
from .json_records import JsonRecords
from .kind import SourceDetails, SourceKind
from .line_source import LineSource, OpenDescriptor

STANDARD_INPUT = 0


def _open(place: str, details: SourceDetails) -> LineSource:
    if place != "-":
        raise InputError(f"source 'jsonl:{place}' is refused: allowed is jsonl:-, which is standard input")
    return LineSource(OpenDescriptor(STANDARD_INPUT), "standard input", JsonRecords(details))


KIND = SourceKind(scheme="jsonl", place="-", note="standard input", open=_open)
