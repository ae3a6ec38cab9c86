"""Locks on open files, which the system takes back however the process that holds them ends."""

import os
import sys
from pathlib import Path

from .errors import InputError

if sys.platform != "win32":
    import fcntl


def try_lock(descriptor: int) -> bool:
    """Whether this process holds the lock of an open file now: until the file is closed.

    Raises:
        OSError: the file system has no locks.
    """
    if sys.platform == "win32":  # nobody else is kept out
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


class LockFile:
    """A file of its own for a lock. It stays where it is: were it removed or replaced, two could hold it.

    Raises:
        InputError: another process holds it (in the words of ``refusal``), or it cannot be made.
    """

    def __init__(self, path: Path, refusal: str) -> None:
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise InputError(f"cannot write {path}: {error.strerror or error}") from error
        try:
            is_ours = try_lock(self._descriptor)
        except OSError as error:
            self.close()
            raise InputError(f"cannot lock {path}: {error.strerror or error}") from error
        if not is_ours:
            self.close()
            raise InputError(refusal)

    def close(self) -> None:
        """Give the lock back."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor = -1
