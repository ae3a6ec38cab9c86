"""The state file of one end of the link: the newest timestamps, which outlive the process.

One process uses it at a time, and the lock for that is a file of its own, which is never replaced: whoever made the
state file anew would otherwise lock another file than the one who made it before.
"""

import contextlib
import fcntl
import os
from collections.abc import Sequence
from pathlib import Path

from ...errors import InputError
from ...files import write_text_atomically
from ...scenario import NUM_TRACKERS
from .codec import CONTROLLER_SYSTEM, system_of

SENT = "sent"
"""The name of what this end has sent itself; those it hears have their system ids."""
CONTROLLER_FILE = "controller.timestamps"
CONTROLLER_HEARS = [system_of(tracker) for tracker in range(NUM_TRACKERS)]
TRACKER_HEARS = [CONTROLLER_SYSTEM]


def tracker_file(tracker: int) -> str:
    """The name of a tracker's state file in its state folder."""
    return f"tracker-{tracker}.timestamps"


def sender_name(system: int) -> str:
    """Of a system id, for people."""
    return "the controller" if system == CONTROLLER_SYSTEM else f"tracker {system - system_of(0)}"


class StateFile:
    """One line of fixed length for each name, so that one small write in place, which nobody sees half, renews it.

    Such a write goes to the system's memory and comes back in microseconds: the loop does not wait for the disk.

    Raises:
        InputError: the file cannot be made or used, or another process uses it.
    """

    _TITLE = "swarmchase link timestamps, 10 us since 2015\n"

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self._path, self._names = path, names
        self.errors = 0
        self._descriptor = -1
        self._lock = _locked(path)
        try:
            if not path.exists():
                write_text_atomically(path, self._TITLE + "".join(self._line(name, 0) for name in names))
            self._descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except OSError as error:
            self.close()
            raise InputError(f"cannot use state file {path}: {error.strerror or error}") from error
        except InputError:
            self.close()
            raise

    def read(self) -> dict[str, int]:
        """The newest timestamp of each name.

        Raises:
            InputError: it is broken, or has other names; it is closed then.
        """
        try:
            content = os.pread(self._descriptor, 4096, 0).decode("ascii", errors="replace")
            newest = {name: int(value) for name, value in map(str.split, content.splitlines()[1:])}
            is_ours = content == self._TITLE + "".join(self._line(name, newest[name]) for name in self._names)
        except (OSError, ValueError, KeyError):
            is_ours = False
        if not is_ours:
            self.close()
            raise InputError(f"state file {self._path} is broken or of another end: remove it to start anew")
        return newest

    def write(self, name: str, timestamp: int) -> None:
        """Renew one line."""
        offset = len(self._TITLE) + self._names.index(name) * len(self._line(name, 0))
        try:
            os.pwrite(self._descriptor, self._line(name, timestamp).encode("ascii"), offset)
        except OSError:
            self.errors += 1  # flying on matters more than remembering

    def close(self) -> None:
        """Give file and lock back."""
        if self._descriptor >= 0:
            with contextlib.suppress(OSError):
                os.fsync(self._descriptor)
            os.close(self._descriptor)
        if self._lock >= 0:
            os.close(self._lock)
        self._descriptor = self._lock = -1

    @staticmethod
    def _line(name: str, timestamp: int) -> str:
        return f"{name:>4} {timestamp:015d}\n"


def names_of(senders: Sequence[int]) -> list[str]:
    """The lines of the state file of an end that listens to these systems."""
    return [SENT, *map(str, senders)]


def reset_sender(folder: Path, system: int) -> list[Path]:
    """Forget what a sender's newest timestamp was, in each state file of the folder that holds it.

    Returns:
        The files that have been changed.

    Raises:
        InputError: there is none; or one is broken, in use by another process, or cannot be written.
    """
    ends = {folder / CONTROLLER_FILE: (CONTROLLER_SYSTEM, CONTROLLER_HEARS)}
    ends |= {folder / tracker_file(one): (system_of(one), TRACKER_HEARS) for one in range(NUM_TRACKERS)}
    changed = []
    for path, (own_system, heard) in ends.items():
        if path.exists() and (system == own_system or system in heard):
            _reset_line(path, heard, SENT if system == own_system else str(system))
            changed.append(path)
    if not changed:
        raise InputError(f"no state file in {folder} holds anything of {sender_name(system)}")
    return changed


def _reset_line(path: Path, heard: Sequence[int], name: str) -> None:
    state = StateFile(path, names_of(heard))
    state.read()
    state.write(name, 0)
    state.close()
    if state.errors:
        raise InputError(f"cannot write state file {path}")


def _locked(path: Path) -> int:
    """The descriptor that holds the lock of this state file; the system takes it back however the process ends."""
    lock = path.with_name(f"{path.name}.lock")
    try:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise InputError(f"cannot use state file {path}: {lock}: {error.strerror or error}") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise InputError(f"state file {path} is in use by another process") from error
    return descriptor
