"""The timestamps of signatures: they only ever rise, also over restarts, so that no recorded packet counts twice.

Sent: real time, or one more than the last, whichever is greater. Accepted of each sender: only what is newer than

- the newest accepted so far. It is written to the state file at once, so that it outlives the process (kill -9
  included; after a power cut it may lack what the system had not written yet, some seconds);
- the moment this end was opened, by its own clock. That keeps out what was recorded while nobody listened, and makes
  up for a state file that is missing or behind. A tracker whose clock is s seconds behind waits s seconds.

MAVLink also raises its own timestamp to any that it accepts. That is left out: one tracker could then push the
controller's to the end of time, and silence it for every other.
"""

import contextlib
import fcntl
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from ...errors import InputError
from ...files import write_text_atomically
from .rejection import Reason, RejectedError

UNIX_TIME_OF_2015_NS = 1_420_070_400 * 10**9
UNIT_NS = 10_000
LARGEST = 2**48 - 1
"""In the year 2104."""


class Timestamps:
    """What was sent last, and the newest accepted of each sender, in 10 us since 2015.

    Args:
        senders: the system ids that are listened to.
        state_path: where to remember; None remembers nothing beyond this process.
        wall_time_ns: real time since 1970.

    Raises:
        InputError: the state file cannot be made or used, is not this end's, or another process uses it.
    """

    def __init__(
        self,
        senders: Sequence[int],
        state_path: Path | None = None,
        wall_time_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._wall_time_ns = wall_time_ns
        self._opened = self._now()
        self._state = None if state_path is None else _StateFile(state_path, ["sent", *map(str, senders)])
        newest = self._state.read() if self._state else {}
        self._sent = newest.get("sent", 0)
        self._accepted = {sender: newest.get(str(sender), 0) for sender in senders}

    @property
    def state_errors(self) -> int:
        """How often the state file could not be written: then it remembers less than it should."""
        return self._state.errors if self._state else 0

    def next_to_send(self) -> int:
        """The timestamp of the next packet."""
        self._sent = min(max(self._sent + 1, self._now()), LARGEST)
        if self._state:
            self._state.write("sent", self._sent)
        return self._sent

    def accept(self, sender: int, timestamp: int) -> None:
        """Accept a packet whose signature is already known to be right.

        Raises:
            RejectedError: replayed or too old.
        """
        if timestamp <= self._accepted[sender]:
            raise RejectedError(Reason.REPLAYED)
        # A clock that was ahead when this end was opened, and is put right, must not keep everybody out.
        self._opened = min(self._opened, self._now())
        if timestamp < self._opened:
            raise RejectedError(Reason.TOO_OLD)
        self._accepted[sender] = timestamp
        if self._state:
            self._state.write(str(sender), timestamp)

    def close(self) -> None:
        """Give the state file back."""
        if self._state:
            self._state.close()

    def _now(self) -> int:
        return max(self._wall_time_ns() - UNIX_TIME_OF_2015_NS, 0) // UNIT_NS


class _StateFile:
    """One line of fixed length for each name, so that one small write in place, which nobody sees half, renews it.

    Such a write goes to the system's memory and comes back in microseconds: the loop does not wait for the disk.
    """

    _TITLE = "swarmchase link timestamps, 10 us since 2015\n"

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self._path = path
        self._names = names
        self.errors = 0
        if not path.exists():
            write_text_atomically(path, self._TITLE + "".join(self._line(name, 0) for name in names))
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except OSError as error:
            raise InputError(f"cannot use state file {path}: {error.strerror or error}") from error
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(self._descriptor)
            raise InputError(f"state file {path} is in use by another process") from error

    def read(self) -> dict[str, int]:
        """The newest timestamp of each name."""
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
        if self._descriptor >= 0:
            with contextlib.suppress(OSError):
                os.fsync(self._descriptor)
            os.close(self._descriptor)
        self._descriptor = -1

    @staticmethod
    def _line(name: str, timestamp: int) -> str:
        return f"{name:>4} {timestamp:015d}\n"
