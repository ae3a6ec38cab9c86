"""Between a chase and one output: whoever flies hands over frames and goes on; a thread sends them, and tries again
where nobody is reached.
"""

import threading

from ..alarms import Alarm
from ..frame import Frame
from ..log.entries import LogHead
from ..ticker import next_moment_ns
from .protocol import Output

RATE_HZ = 1.0
"""Of frames, besides one at each change of state: as often as maps and Remote ID expect news."""
RETRY_S = 5.0
"""After a failure the next frame is tried so much later."""
STEADY_FRAMES = 3
"""An output works again when so many in a row have been sent: one that takes a frame and hangs up does not."""
CLOSE_S = 1.0
"""So long ``close`` waits for the last frame."""


class Publisher:
    """Of one output, from construction to ``close``. Of frames that wait only the newest counts.

    Args:
        name: of the output, as it was asked for.
        retry_s: seconds.
    """

    def __init__(self, name: str, output: Output, head: LogHead, retry_s: float = RETRY_S) -> None:
        self._name, self._output, self._head, self._retry_s = name, output, head, retry_s
        self._newest: Frame | None = None
        self._taken_ns: int | None = None
        self._state: str | None = None
        self._failure: str | None = None
        self._has_news, self._is_closing = threading.Condition(), threading.Event()
        self._thread = threading.Thread(target=self._send_all, name=f"output {name}", daemon=True)
        self._thread.start()

    def take(self, frame: Frame) -> None:
        """Take in a frame, which nobody may change any more; never waits for the output, never raises."""
        if not self._is_due(frame):
            return
        with self._has_news:
            self._newest = frame
            self._has_news.notify()

    @property
    def alarms(self) -> list[Alarm]:
        """What the operator should know of it."""
        failure = self._failure
        if failure is None:
            return []
        what = f"output {self._name}"
        return [Alarm(what, f"{what} fails: {failure}; it is tried again", over=f"{what} works again")]

    def close(self) -> None:
        """Send what waits, if that is quick, and end."""
        self._is_closing.set()
        with self._has_news:
            self._has_news.notify()
        self._thread.join(CLOSE_S)

    def _is_due(self, frame: Frame) -> bool:
        now_ns, period_ns = round(frame["time_s"] * 1e9), round(1e9 / RATE_HZ)
        has_changed = frame["state"] != self._state
        next_ns = now_ns if self._taken_ns is None else next_moment_ns(self._taken_ns, period_ns, now_ns)
        if not has_changed and next_ns > now_ns:
            return False
        self._state, self._taken_ns = frame["state"], min(next_ns, now_ns)
        return True

    # In the thread

    def _send_all(self) -> None:
        sent = 0
        while (frame := self._next()) is not None:
            try:
                self._output.send(frame, self._head.wall_ns(self._head.began_ns + round(frame["time_s"] * 1e9)))
            except Exception as error:
                # Of one outage the first reason is told; the chase goes on whatever it is.
                reason = error.strerror if isinstance(error, OSError) else None
                self._failure = self._failure or reason or str(error) or type(error).__name__
                sent = 0
                self._is_closing.wait(self._retry_s)
            else:
                sent += 1
                self._failure = None if sent >= STEADY_FRAMES else self._failure
        self._output.close()

    def _next(self) -> Frame | None:
        """Wait for a frame; None at the end."""
        with self._has_news:
            self._has_news.wait_for(lambda: self._newest is not None or self._is_closing.is_set())
            frame, self._newest = self._newest, None
            return frame
