"""Tables on disk: Parquet files with a JSON document in their metadata that says what the rows are a function of."""

import contextlib
import dataclasses
import functools
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args

from ..errors import InputError
from ..files import atomic_path
from ..ranges import shown
from ..reading import Bounds, parsed_json, read_bytes

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

Document = dict[str, Any]
Row = dict[str, Any]
Parsed = TypeVar("Parsed")
RowKind = TypeVar("RowKind")

_DOCUMENT_KEY = "swarmchase"
MOST_FILE_BYTES = 512 * 2**20
"""Of a table, packed or unpacked."""
MOST_ROWS = 10_000_000
"""Twelve controllers, twelve settings and six worlds of 10,000 chases each are 8,640,000."""
MOST_COLUMNS = 100
DOCUMENT_BOUNDS = Bounds(most_bytes=16 * 2**20, most_values=2**20)


def write_table(
    path: Path, table: "pa.Table", document: Document, compression: Literal["snappy", "zstd"] = "zstd"
) -> None:
    """Write the rows of ``table`` and ``document`` as a Parquet file, whole or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    import pyarrow.parquet as pq

    with atomic_path(path) as temporary:
        pq.write_table(
            table.replace_schema_metadata({_DOCUMENT_KEY: json.dumps(document)}), temporary, compression=compression
        )


def read_table(path: Path, name: str, parse: Callable[[list[Row], Document], Parsed]) -> Parsed:
    """What ``parse`` makes of the rows and the document of a file that ``write_table`` wrote.

    ``parse`` may fail with a KeyError, TypeError, ValueError or IndexError on what is no such table; ``name`` is what
    the refusal then calls it.

    Raises:
        InputError: no such file, or not such a table.
    """
    with _opened(path, name) as file:
        return parse(_rows(file), _document(file))


def read_document(path: Path, name: str) -> Document:
    """The document alone of a file that ``write_table`` wrote.

    Raises:
        InputError: no such file, or not such a table.
    """
    with _opened(path, name) as file:
        return _document(file)


def read_rows(path: Path, name: str) -> list[Row]:
    """The rows alone of a Parquet file, whoever wrote it.

    Raises:
        InputError: no such file, or not a Parquet file.
    """
    with _opened(path, name) as file:
        return _rows(file)


def checked_row(kind: Callable[..., RowKind], row: Row) -> RowKind:
    """The dataclass ``kind`` made of a row whose values are of the types that its fields have. A field with a default
    may be missing: older tables have fewer.

    Raises:
        TypeError: a value is of another type, or there are too many or too few.
    """
    for name, types, needed in _fields(kind):
        if type(row.get(name)) not in types and (needed or name in row):
            raise TypeError(f"{name} = {shown(row.get(name))} is no {' | '.join(one.__name__ for one in types)}")
    return kind(**row)


@functools.cache
def _fields(kind: Any) -> list[tuple[str, tuple[type, ...], bool]]:
    """The name of each field of a dataclass, the types it allows, and whether it has no default."""
    return [
        (field.name, get_args(field.type) or (field.type,), field.default is dataclasses.MISSING)
        for field in dataclasses.fields(kind)
    ]


@contextlib.contextmanager
def _opened(path: Path, name: str) -> "Iterator[pq.ParquetFile]":
    import pyarrow as pa
    import pyarrow.parquet as pq

    content = read_bytes(path, f"the {name}", MOST_FILE_BYTES)
    try:
        yield pq.ParquetFile(pa.BufferReader(content))
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(f"cannot read the {name} {path}: {error}") from error


def _rows(file: "pq.ParquetFile") -> list[Row]:
    """What a file says of itself is bounded before it is unpacked."""
    metadata = file.metadata
    unpacked_bytes = sum(metadata.row_group(group).total_byte_size for group in range(metadata.num_row_groups))
    if metadata.num_rows > MOST_ROWS or metadata.num_columns > MOST_COLUMNS or unpacked_bytes > MOST_FILE_BYTES:
        raise ValueError(f"it has more than {MOST_ROWS} rows, {MOST_COLUMNS} columns or {MOST_FILE_BYTES} bytes")
    rows: list[Row] = file.read().to_pylist()
    return rows


def _document(file: "pq.ParquetFile") -> Document:
    document = parsed_json((file.schema_arrow.metadata or {})[_DOCUMENT_KEY.encode()], DOCUMENT_BOUNDS)
    if not isinstance(document, dict):
        raise TypeError(f"its {_DOCUMENT_KEY} document is no object")
    return document
