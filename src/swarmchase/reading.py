"""Files from outside, read within bounds: regular files alone, no more of them than is said, one line where it is more.

Every file that the package reads is opened here. A pipe without a writer, a device without an end or a document of a
million brackets costs a line and not the process. Nothing here needs torch or numpy.
"""

import contextlib
import csv
import errno
import io
import json
import math
import os
import stat
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from .errors import InputError

MOST_ROW_CHARACTERS = 2**20
"""Of one row of a CSV table, however many lines it has."""
MOST_DOTS_A_LINE = 256
"""In TOML, where the time that a dotted key takes grows with the square of its parts."""
LARGEST_WHOLE_BITS = 64


@dataclass(frozen=True)
class Bounds:
    """What a document may be."""

    most_bytes: int
    most_values: int
    """Counted by its commas and opening brackets, those in texts included, before it is parsed."""
    most_levels: int = 32
    """Of values within values."""
    is_finite: bool = True
    """Whether NaN and infinity are refused here; else whoever asked looks at each number."""


def open_descriptor(path: Path, is_allowed: Callable[[int], bool] = stat.S_ISREG) -> int:
    """The descriptor of a file whose mode is allowed; never waits for the other end of a pipe.

    Raises:
        OSError: it cannot be opened, or is another kind of file.
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
    descriptor = os.open(path, flags)
    # Of the open file, so that nobody exchanges it between the question and the reading.
    if not is_allowed(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it is no regular file")
    return descriptor


@contextlib.contextmanager
def opened(path: Path, kind: str) -> Iterator[IO[bytes]]:
    """A regular file, to be read in the block; ``kind`` names it in refusals.

    Raises:
        InputError: there is none, or reading fails.
    """
    with refused(path, kind), os.fdopen(open_descriptor(path), "rb") as file:
        yield file


def read_bytes(path: Path, kind: str, most_bytes: int) -> bytes:
    """All of a regular file.

    Raises:
        InputError: as ``opened``, or it is longer.
    """
    with opened(path, kind) as file:
        size = os.fstat(file.fileno()).st_size
        content = file.read(min(size, most_bytes) + 1)
        if len(content) > most_bytes:
            raise InputError(f"cannot read {kind} {path}: it has more than {most_bytes} bytes")
        if len(content) != size:
            raise InputError(f"cannot read {kind} {path}: it changes while it is read")
    return content


def read_unpacked(path: Path, kind: str, most_bytes: int) -> bytes:
    """What is packed in a file in the format xz; neither it nor the file may be longer.

    Raises:
        InputError: as ``read_bytes``, or it is no whole file of this format.
    """
    import lzma  # some small computers' Python has none

    unpacker = lzma.LZMADecompressor(lzma.FORMAT_XZ)
    with refused(path, kind):
        try:
            content = unpacker.decompress(read_bytes(path, kind, most_bytes), most_bytes + 1)
        except lzma.LZMAError as error:
            raise DocumentError(f"it is damaged: {error}") from error
        if len(content) > most_bytes:
            raise DocumentError(f"it holds more than {most_bytes} bytes")
        if not unpacker.eof or unpacker.unused_data:
            raise DocumentError("it is damaged: it ends too early or too late")
    return content


def read_toml(path: Path, kind: str, bounds: Bounds) -> dict[str, Any]:
    """A TOML document.

    Raises:
        InputError: as ``read_bytes``, no TOML, or beyond the bounds.
    """
    content = read_bytes(path, kind, bounds.most_bytes)
    with refused(path, kind):
        return parsed_toml(content, bounds)


def read_json(path: Path, kind: str, bounds: Bounds) -> Any:
    """A JSON document.

    Raises:
        InputError: as ``read_bytes``, no JSON, or beyond the bounds.
    """
    content = read_bytes(path, kind, bounds.most_bytes)
    with refused(path, kind):
        return parsed_json(content, bounds)


@contextlib.contextmanager
def opened_table(path: Path, kind: str) -> Iterator["csv.DictReader[str]"]:
    """The rows of a CSV file with a header line, to be read in the block one by one.

    Raises:
        InputError: as ``opened``, no CSV, or a row that is too long.
    """
    with opened(path, kind) as file:
        try:
            with io.TextIOWrapper(file, encoding="utf-8", errors="replace", newline="") as text:
                yield _Table(text)
        except csv.Error as error:
            raise InputError(f"cannot read {kind} {path}: {error}") from error


@contextlib.contextmanager
def refused(path: Path, kind: str) -> Iterator[None]:
    """Whatever is found wrong with a file, in one line that names it.

    Raises:
        InputError: for an ``OSError`` and for a ``DocumentError``.
    """
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot read {kind} {path}: {error.strerror or error}") from error
    except DocumentError as error:
        raise InputError(f"cannot read {kind} {path}: {error}") from error


class DocumentError(InputError):
    """Why a document is none, or beyond its bounds; where it lies is not known here."""


def parsed_json(content: bytes | str, bounds: Bounds) -> Any:
    """A JSON document that lies in memory already.

    Raises:
        DocumentError: it is none, or beyond its bounds.
    """
    _require_size(content, bounds)
    try:
        document = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise DocumentError(f"it is no JSON: {_reason(error)}") from None
    _require_within(document, bounds)
    return document


def parsed_toml(content: bytes, bounds: Bounds) -> dict[str, Any]:
    """A TOML document that lies in memory already.

    Raises:
        DocumentError: it is none, or beyond its bounds.
    """
    _require_size(content, bounds)
    if any(line.count(b".") > MOST_DOTS_A_LINE for line in content.splitlines()):
        raise DocumentError(f"a line has more than {MOST_DOTS_A_LINE} dots")
    try:
        document = tomllib.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise DocumentError(f"it is no TOML: {_reason(error)}") from None
    _require_within(document, bounds)
    return document


def _require_size(content: bytes | str, bounds: Bounds) -> None:
    if len(content) > bounds.most_bytes:
        raise DocumentError(f"it has more than {bounds.most_bytes} bytes")
    marks: tuple[Any, ...] = (b",", b"[", b"{") if isinstance(content, bytes) else (",", "[", "{")
    if sum(content.count(mark) for mark in marks) > bounds.most_values:
        raise DocumentError(f"it has more than {bounds.most_values} values")


def _require_within(document: Any, bounds: Bounds) -> None:
    """Level by level: recursion would have a limit of its own."""
    level = [document]
    for _ in range(bounds.most_levels):
        _require_plain(level, bounds)
        following: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                following.extend(value)
                following.extend(value.values())
            elif isinstance(value, list):
                following.extend(value)
        level = following
    if level:
        raise DocumentError(f"it has values within values on more than {bounds.most_levels} levels")


def _require_plain(values: list[Any], bounds: Bounds) -> None:
    if bounds.is_finite:
        strange = [value for value in values if isinstance(value, float) and not math.isfinite(value)]
        if strange:
            raise DocumentError(f"it holds {strange[0]}, which is no finite number")
    if any(value.bit_length() > LARGEST_WHOLE_BITS for value in values if isinstance(value, int)):
        raise DocumentError(f"it holds a whole number of more than {LARGEST_WHOLE_BITS} bits")
    try:
        for value in values:
            if isinstance(value, str):
                value.encode()
    except UnicodeEncodeError:  # JSON can say halves of characters, which nobody can print
        raise DocumentError("it holds a text that is no Unicode") from None


def _reason(error: Exception) -> str:
    return "too many brackets within brackets" if isinstance(error, RecursionError) else str(error)


class _Table(csv.DictReader):  # type: ignore[type-arg]
    def __init__(self, file: io.TextIOWrapper) -> None:
        self._characters = 0
        super().__init__(self._lines(file))

    def __next__(self) -> dict[str | Any, str | Any]:
        self._characters = 0
        return super().__next__()

    def _lines(self, file: io.TextIOWrapper) -> Iterator[str]:
        while line := file.readline(MOST_ROW_CHARACTERS):
            self._characters += len(line)
            if self._characters >= MOST_ROW_CHARACTERS:
                raise csv.Error(f"a row has more than {MOST_ROW_CHARACTERS} characters")
            yield line
