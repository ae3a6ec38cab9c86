"""Ctrl-C, SIGTERM and a terminal that goes away as a wish that a loop can look at: what flies must be told before the
process ends.
"""

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType


class StopRequest:
    """Whether somebody wants the loop to end."""

    def __init__(self) -> None:
        self.made = False

    def _make(self, _number: int, _frame: FrameType | None) -> None:
        if self.made:
            raise KeyboardInterrupt
        self.made = True


@contextlib.contextmanager
def stop_request() -> Iterator[StopRequest]:
    """Inside the block the first signal makes the request, and any further one is a ``KeyboardInterrupt``."""
    request = StopRequest()
    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as nohup has it
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, request._make) for number in numbers}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
