"""Files that are there whole or not at all."""

import contextlib
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from .errors import InputError
from .locks import try_lock

PART_SUFFIX = ".swarmchase.part"
"""Of a file that is being written. Its writer holds its lock."""
OLD_PART_S = 60.0
"""A part that nobody holds and nobody has written to for so long has lost its writer."""


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that becomes it when the block ends well, and is removed when it does not.

    What writers left in the folder that were killed is swept away, whatever they were to write.

    Raises:
        InputError: the folder cannot be made or written, the disk is full, or ``path`` is a folder or a device.
    """
    _require_replaceable(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _sweep(path.parent)
        descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=PART_SUFFIX)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error
    temporary = Path(name)
    try:
        with os.fdopen(descriptor, "rb") as held:
            with contextlib.suppress(OSError):  # where there are no locks, nothing is swept either
                try_lock(held.fileno())
            yield temporary
            with open(temporary, "rb") as file:
                os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def write_text_atomically(path: Path, text: str) -> None:
    """Write ``text`` to ``path``, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def new_file(path: Path, what: str, buffering: int = -1) -> IO[bytes]:
    """A new file, to be written bit by bit; its folder is made if need be. None is ever overwritten.

    Args:
        what: it is, for the refusal.
        buffering: as of ``open``.

    Raises:
        InputError: it exists already, or it cannot be made.
    """
    require_writable_folder(path.parent)
    try:
        return open(path, "xb", buffering)
    except FileExistsError:
        raise InputError(f"cannot write the {what} {path}: it exists already") from None
    except OSError as error:
        raise InputError(f"cannot write the {what} {path}: {error.strerror or error}") from error


def require_writable_file(path: Path, *, replaces: bool) -> None:
    """Prove that ``atomic_path`` can write this file, before hours of work are spent; makes nothing, no folder either.

    The one rule for what is there already: a file that a person has named is never replaced, unless they have said so
    (``--overwrite``). Results in a folder that a command works in are, and the command says which.

    Args:
        replaces: whether one that exists may be replaced.

    Raises:
        InputError: it cannot be written, or exists and must not be replaced.
    """
    _require_replaceable(path)
    if path.exists() and not replaces:
        raise InputError(f"cannot write {path}: it exists already; give --overwrite to replace it, or another name")
    try:
        folder = next(folder for folder in path.absolute().parents if folder.exists())
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error


def require_writable_folder(folder: Path) -> None:
    """Make the folder and prove that a file can be written there, before hours of work are spent.

    Raises:
        InputError: it cannot.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(f"cannot write to folder {folder}: {error.strerror or error}") from error


def _require_replaceable(path: Path) -> None:
    """A new file takes the name: that must never be the name of a folder or of a device such as /dev/full."""
    if path.exists() and not path.is_file():
        raise InputError(f"cannot write {path}: it exists and is no regular file")


def _sweep(folder: Path) -> None:
    """Remove what was to become files of this folder and has lost its writer; what cannot be removed stays."""
    for part in folder.glob(f".*{PART_SUFFIX}"):
        with contextlib.suppress(OSError):
            if time.time() - part.stat().st_mtime > OLD_PART_S:
                _remove_unless_held(part)


def _remove_unless_held(part: Path) -> None:
    """Of two that sweep at once one holds it."""
    descriptor = os.open(part, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0))
    try:
        if try_lock(descriptor):
            part.unlink()
    finally:
        os.close(descriptor)
