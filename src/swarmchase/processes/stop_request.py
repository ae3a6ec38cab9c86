"""The one rule for SIGINT (Ctrl-C), SIGTERM and SIGHUP (a terminal that goes away): the first asks the process to
stop, and it stops cleanly, keeps what was done and prints the result; only a second SIGINT forces.

A signal that was ignored when the process began stays so: SIGHUP under ``nohup``, SIGINT in a script's background job.
"""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType

STOP_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))

STOPPED_CODES = {0, *(-number for number in STOP_SIGNALS), *(128 + number for number in STOP_SIGNALS)}
"""Exit codes of a process that was told to stop: well, before it could hear it, and before it had any result."""


AGAIN_S = 0.02
"""A signal that comes during an import is heard so much later, and again so much."""
IMPORT_SYSTEM = "<frozen importlib._bootstrap>"


class Interrupted(KeyboardInterrupt):
    """A signal ended work that has no result before its end.

    Args:
        number: of the signal.
        done: how much was done, and what is kept of it.
    """

    def __init__(self, number: int, done: str = "") -> None:
        super().__init__(number, done)
        self.number, self.done = number, done


class StopRequest:
    """Whether somebody wants the process to stop."""

    def __init__(self) -> None:
        self.made = False
        self.number = int(signal.SIGTERM)
        """Of the signal that made it."""
        self._interrupts = 0

    def note(self, number: int) -> None:
        """Such a signal has come."""
        if not self.made:
            self.made, self.number = True, number
        self._interrupts += number == signal.SIGINT

    def raises(self, number: int) -> bool:
        """Whether such a signal would be ``Interrupted`` now: a second SIGINT."""
        return number == signal.SIGINT and self._interrupts > 0

    def hear(self, number: int) -> None:
        """Note it, or be ``Interrupted``."""
        raises = self.raises(number)
        self.note(number)
        if raises:
            raise Interrupted(number)

    def go_on_from(self, before: "StopRequest") -> None:
        """What has come already counts."""
        self.made, self.number, self._interrupts = before.made, before.number, before._interrupts


class _StopAtOnce(StopRequest):
    """For work without a loop that looks at the request."""

    def raises(self, number: int) -> bool:
        return not self.made or super().raises(number)


_listening: list[StopRequest] = []
"""The innermost is the last; those around it only note what comes."""


@contextlib.contextmanager
def stop_request() -> Iterator[StopRequest]:
    """Inside the block the first signal makes the request, which a loop looks at; a second SIGINT is ``Interrupted``.

    Signals are heard in the main thread; in any other, nothing makes the request.
    """
    request = StopRequest()
    with _heard_by(request):
        yield request


@contextlib.contextmanager
def stopped_at_once() -> Iterator[None]:
    """Inside the block the first signal is ``Interrupted``, where no ``stop_request`` is nearer."""
    with _heard_by(_StopAtOnce()):
        yield


def noted_signals() -> StopRequest:
    """From now on signals only make this request: for a process that another one ends."""
    request = StopRequest()
    for number in STOP_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda heard, _frame: request.note(heard))
    if hasattr(signal, "pthread_sigmask"):  # not on Windows
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOP_SIGNALS)
    return request


@contextlib.contextmanager
def kept_handlers() -> Iterator[None]:
    """Libraries that set handlers of their own inside the block have set none after it."""
    before = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for number, handler in before.items():
                signal.signal(number, handler)


@contextlib.contextmanager
def _heard_by(request: StopRequest) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    if _listening:
        request.go_on_from(_listening[-1])
    _listening.append(request)
    before = {}
    try:
        for number in STOP_SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, _hear)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        _listening.remove(request)


def _hear(number: int, frame: FrameType | None) -> None:
    *around, innermost = _listening
    if innermost.raises(number) and _is_importing(frame):
        # What is raised in the midst of an import leaves half a module behind, and what comes upon that fails in its
        # own way: the signal comes again.
        again = threading.Timer(AGAIN_S, os.kill, (os.getpid(), number))
        again.daemon = True
        again.start()
        return
    for request in around:
        request.note(number)
    innermost.hear(number)


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == IMPORT_SYSTEM:
            return True
        frame = frame.f_back
    return False
