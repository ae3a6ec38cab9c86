"""Files that another program writes to while they are read, and pipes, which are read the same."""

import os
import select
import stat
from pathlib import Path

from ....reading import open_descriptor, refused

READ_BYTES = 262_144


class GrowingFile:
    """A ``ByteStream`` that goes on for ever. Nothing here ever waits.

    Args:
        kind: what it is called in refusals.

    Raises:
        InputError: it cannot be opened, or is no file, pipe or socket.
    """

    def __init__(self, path: Path, kind: str) -> None:
        self.is_over = False
        with refused(path, kind):
            self._descriptor = open_descriptor(path, _can_be_written_to)
        self._is_file = stat.S_ISREG(os.fstat(self._descriptor).st_mode)

    def held(self) -> bytes:
        """A piece of what a file holds already; empty at its end, and of a pipe."""
        return os.read(self._descriptor, READ_BYTES) if self._is_file else b""

    def come(self) -> bytes:
        """What has come since."""
        try:
            return os.read(self._descriptor, READ_BYTES) if select.select([self._descriptor], [], [], 0)[0] else b""
        except OSError:
            return b""

    def close(self) -> None:
        """Close it."""
        os.close(self._descriptor)


def _can_be_written_to(mode: int) -> bool:
    return stat.S_ISREG(mode) or stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)
