"""The recorder: writes what a chase does to an MCAP file, and never makes the chase wait for the disk.

Whoever records only appends to a list in memory. A thread of the recorder empties it twice a second, as one compressed
chunk, and hands that to the operating system: a process that is killed loses little more than the last half second.
"""

import contextlib
import threading
from collections import Counter, deque
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

from ...errors import InputError
from ...files import new_file
from ..alarms import Alarm
from ..events import Event
from ..frame import Frame
from ..service.chase_state import Decision, Transition
from .entries import LogHead
from .file import LogFile

FLUSH_S = 0.5
MOST_WAITING_FRAMES = 200
"""With more than this waiting for the disk, frames are lost; transitions, decisions and events"""
MOST_WAITING = 2000
"""only with more than this."""
CLOSE_S = 5.0
"""So long ``close`` waits for the disk."""

Entry = Transition | Decision | Event
Item = Entry | Frame


class ChaseRecorder:
    """Records one chase in a new file. One thread records, and it may be the one that flies.

    Raises:
        InputError: the file exists already or cannot be written.
    """

    def __init__(self, path: Path, head: LogHead) -> None:
        self._waiting: deque[Item] = deque()
        self._refused: Counter[str] = Counter()
        """What was lost before it waited: counted by whoever records,"""
        self._unwritten: Counter[str] = Counter()
        """and what was lost after: counted by the writing thread."""
        self._told_lost = (0, 0)
        self._failure: str | None = None
        self._is_closed = False
        self._log = _begun(path, head)
        self._is_ending = threading.Event()
        self._thread = threading.Thread(target=self._write_all, name="chase recorder", daemon=True)
        self._thread.start()

    def record(self, entry: Entry) -> None:
        """Take in what the service records, or an event; never waits, never raises."""
        self._take(entry, MOST_WAITING)

    def record_frame(self, frame: Frame) -> None:
        """Take in a frame, which nobody may change any more; never waits, never raises."""
        self._take(frame, MOST_WAITING_FRAMES)

    @property
    def failure(self) -> str | None:
        """Why nothing is written any more."""
        return self._failure

    @property
    def lost_frames(self) -> int:
        """Frames that are not in the file: the disk is too slow, or it has failed."""
        return self._refused["frames"] + self._unwritten["frames"]

    @property
    def lost_entries(self) -> int:
        """The same for transitions, decisions and events."""
        return self._refused["entries"] + self._unwritten["entries"]

    @property
    def alarms(self) -> list[Alarm]:
        """What the operator should know of it."""
        lost = f"{self.lost_frames} frames and {self.lost_entries} transitions, decisions and events"
        if self._failure is not None:
            return [Alarm("log", f"{self._failure}; {lost} are lost", news=self._failure)]
        if not (self.lost_frames or self.lost_entries):
            return []
        return [Alarm("log", f"the log has lost {lost}", news="the log loses what is to be recorded")]

    def close(self) -> None:
        """Write the rest and end the file. A disk that does not answer is not waited for for ever."""
        self._is_closed = True
        self._is_ending.set()
        self._thread.join(CLOSE_S)
        if self._thread.is_alive():
            self._failure = "cannot write the log: the disk does not answer"

    def __enter__(self) -> "ChaseRecorder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _take(self, item: Item, most_waiting: int) -> None:
        if self._is_closed or self._failure is not None or len(self._waiting) >= most_waiting:
            self._refused[_kind(item)] += 1
        else:
            self._waiting.append(item)

    # In the thread

    def _write_all(self) -> None:
        is_last = False
        while not is_last:
            is_last = self._is_ending.wait(FLUSH_S)
            with self._noting_failure():
                self._write_waiting()
        with self._noting_failure():
            if self._failure is None:
                self._log.finish()
        with self._noting_failure():
            self._log.close()

    @contextlib.contextmanager
    def _noting_failure(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            reason = error.strerror if isinstance(error, OSError) else None
            self._failure = self._failure or f"cannot write the log: {reason or error}"

    def _write_waiting(self) -> None:
        """Write and flush what waits now, or count what is lost."""
        unflushed: Counter[str] = Counter()
        try:
            for _ in range(len(self._waiting)):
                item = self._waiting.popleft()
                unflushed[_kind(item)] += 1
                if self._failure is None:
                    self._write(item)
            if self._failure is None:
                self._write_losses()
                self._log.flush()
                unflushed.clear()
        finally:
            self._unwritten += unflushed

    def _write(self, item: Item) -> None:
        """One item that is no JSON is not the end of the log."""
        try:
            self._log.write(item)
        except (TypeError, ValueError):
            self._refused[_kind(item)] += 1

    def _write_losses(self) -> None:
        lost = self.lost_frames, self.lost_entries
        if lost != self._told_lost:
            self._log.write_loss(*lost)
            self._told_lost = lost


def _begun(path: Path, head: LogHead) -> LogFile:
    """The file with its head."""
    file = new_file(path, "log")
    try:
        return LogFile(file, head)
    except OSError as error:
        with contextlib.suppress(OSError):
            file.close()
        path.unlink(missing_ok=True)
        raise InputError(f"cannot write the log {path}: {error.strerror or error}") from error


def _kind(item: Item) -> str:
    return "entries" if isinstance(item, Entry) else "frames"
