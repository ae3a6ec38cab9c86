"""Time as an argument: real, or made by a test."""

import time
from typing import Protocol, runtime_checkable


@runtime_checkable
class Clock(Protocol):
    """Monotonic time. Wall-clock steps do not touch it."""

    def now_ns(self) -> int:
        """Nanoseconds since some moment of its own."""


class MonotonicClock:
    """The system's."""

    def now_ns(self) -> int:
        """Nanoseconds since boot."""
        return time.monotonic_ns()


class VirtualClock:
    """Stands still until it is told to go on."""

    def __init__(self, now_ns: int = 0) -> None:
        self._now_ns = now_ns

    def now_ns(self) -> int:
        """Nanoseconds that it was told to go."""
        return self._now_ns

    def advance(self, seconds: float) -> None:
        """Go on by so much."""
        self._now_ns += round(seconds * 1e9)
