"""The secret keys of the trackers: one each, so that none can speak for another.

A key file is text: one line ``tracker key`` for each key, the tracker's number 0 to 5 and 64 hexadecimal digits;
empty lines and lines that start with # are skipped. The controller's file holds every tracker's key, a tracker's
file only its own. Nobody but its owner may read it (mode 0600).
"""

import os
import secrets
import stat
import tempfile
from collections.abc import Mapping
from pathlib import Path

from ...errors import InputError
from ...scenario import NUM_TRACKERS

KEY_BYTES = 32
"""MAVLink 2's secret keys."""
MOST_FILE_BYTES = 64 * 1024
"""Nobody's key file is longer; a wrong path must not fill the memory."""


def new_key() -> bytes:
    """From the system's random source."""
    return secrets.token_bytes(KEY_BYTES)


def new_keys() -> dict[int, bytes]:
    """A fresh key for each tracker."""
    return {tracker: new_key() for tracker in range(NUM_TRACKERS)}


def write_keys(path: Path, keys: Mapping[int, bytes]) -> None:
    """Make a key file that only its owner can read; it is there whole or not at all.

    Raises:
        InputError: the file exists (the keys in it may be in use), or it cannot be written.
    """
    if path.exists():
        raise InputError(f"key file {path} exists already: remove it first if its keys are not in use")
    _write(path, keys)


def renew_key(path: Path, tracker: int) -> None:
    """Give one tracker of a key file a fresh key, also if it had none. Comments in the file are not kept.

    Raises:
        InputError: no such tracker, or the file is refused or cannot be written.
    """
    _write(path, {**read_keys(path), tracker: new_key()})


def revoke_key(path: Path, tracker: int) -> None:
    """Take one tracker's key out of a key file. Comments in the file are not kept.

    Raises:
        InputError: it holds no key of this tracker, or no other; or the file is refused or cannot be written.
    """
    keys = read_keys(path)
    if tracker not in keys:
        raise InputError(f"key file {path} holds no key of tracker {tracker}")
    del keys[tracker]
    if not keys:
        raise InputError(f"tracker {tracker} is the only one in key file {path}: remove the file instead")
    _write(path, keys)


def _write(path: Path, keys: Mapping[int, bytes]) -> None:
    require_keys(keys)
    lines = [f"{tracker} {key.hex()}\n" for tracker, key in sorted(keys.items())]
    # The file itself, not a link to it: a key that is revoked must not stay where the link points.
    path = Path(os.path.realpath(path))
    try:
        # mkstemp makes it with mode 0600: at no moment can anybody else read it.
        descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
        temporary = Path(name)
        try:
            with open(descriptor, "w", encoding="ascii") as file:
                file.writelines(["# tracker key\n", *lines])
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"cannot write key file {path}: {error.strerror or error}") from error


def read_keys(path: Path) -> dict[int, bytes]:
    """The keys of a key file, by tracker.

    Raises:
        InputError: the file is missing or unreadable, others may read or write it, or a line is not a key's. No
            message shows any part of a key.
    """
    try:
        with open(path, "rb") as file:
            # Of the open file, so that nobody exchanges it between the question and the reading.
            mode = os.fstat(file.fileno()).st_mode
            if not stat.S_ISREG(mode):
                raise InputError(f"key file {path} is no regular file")
            if mode & (stat.S_IRWXG | stat.S_IRWXO):
                raise InputError(
                    f"key file {path} is open to others (mode {stat.S_IMODE(mode):04o}): run chmod 600 {path}"
                )
            content = file.read(MOST_FILE_BYTES + 1)
    except OSError as error:
        raise InputError(f"cannot read key file {path}: {error.strerror or error}") from error
    if len(content) > MOST_FILE_BYTES:
        raise InputError(f"key file {path} is longer than {MOST_FILE_BYTES} bytes")
    keys = _parse(path, content.decode("ascii", errors="replace"))
    try:
        require_keys(keys)
    except InputError as error:
        raise InputError(f"key file {path}: {error}") from error
    return keys


def require_keys(keys: Mapping[int, bytes]) -> None:
    """Refuse what cannot be the keys of trackers.

    Raises:
        InputError: no key at all, a tracker or key that cannot be, or two trackers with the same key: each could
            speak for the other.
    """
    if not keys:
        raise InputError("there is no key")
    for tracker, key in keys.items():
        if not 0 <= tracker < NUM_TRACKERS:
            raise InputError(f"tracker {tracker} is refused: allowed is 0 to {NUM_TRACKERS - 1}")
        if len(key) != KEY_BYTES:
            raise InputError(f"the key of tracker {tracker} has {len(key)} bytes: needed are {KEY_BYTES}")
    if len(set(keys.values())) < len(keys):
        raise InputError("two trackers have the same key: each needs its own")


def _parse(path: Path, text: str) -> dict[int, bytes]:
    keys: dict[int, bytes] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            tracker, key = int(words[0]), bytes.fromhex(words[1])
        except (ValueError, IndexError):
            # Not chained, not quoted: what stands there may be most of a key.
            raise InputError(f"key file {path}, line {number}: expected is: tracker, 64 hexadecimal digits") from None
        if len(words) > 2 or tracker in keys:
            raise InputError(f"key file {path}, line {number}: more than one key of a tracker, or more than two words")
        keys[tracker] = key
    return keys
