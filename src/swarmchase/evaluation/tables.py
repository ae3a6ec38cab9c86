"""Tables on disk: Parquet files with a JSON document in their metadata that says what the rows are a function of."""

import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from ..errors import InputError
from ..files import atomic_path

if TYPE_CHECKING:
    import pyarrow as pa

Document = dict[str, Any]
Row = dict[str, Any]
Parsed = TypeVar("Parsed")

_DOCUMENT_KEY = "swarmchase"


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

    ``parse`` may fail with a KeyError, TypeError or ValueError on what is no such table; ``name`` is what the refusal
    then calls it.

    Raises:
        InputError: no such file, or not such a table.
    """
    import pyarrow.parquet as pq

    with _refusing(path, name):
        table = pq.read_table(path)
        return parse(table.to_pylist(), _document(table.schema))


def read_document(path: Path, name: str) -> Document:
    """The document alone of a file that ``write_table`` wrote.

    Raises:
        InputError: no such file, or not such a table.
    """
    import pyarrow.parquet as pq

    with _refusing(path, name):
        return _document(pq.read_schema(path))


def read_rows(path: Path, name: str) -> list[Row]:
    """The rows alone of a Parquet file, whoever wrote it.

    Raises:
        InputError: no such file, or not a Parquet file.
    """
    import pyarrow.parquet as pq

    with _refusing(path, name):
        rows: list[Row] = pq.read_table(path).to_pylist()
        return rows


@contextlib.contextmanager
def _refusing(path: Path, name: str) -> Iterator[None]:
    import pyarrow as pa

    try:
        yield
    except (OSError, pa.ArrowInvalid, KeyError, TypeError, ValueError) as error:
        raise InputError(f"cannot read the {name} {path}: {error}") from error


def _document(schema: "pa.Schema") -> Document:
    document: Document = json.loads(schema.metadata[_DOCUMENT_KEY.encode()])
    return document
