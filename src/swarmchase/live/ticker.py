"""The pace of a loop."""

import time


def next_moment_ns(last_ns: int, period_ns: int, now_ns: int) -> int:
    """The moment after ``last_ns`` on a grid that does not drift. Of moments that were missed only the latest counts:
    after a stall the loop goes on at once, and once."""
    missed = max((now_ns - last_ns) // period_ns, 1)
    return last_ns + missed * period_ns


class Ticker:
    """``wait`` returns ``rate_hz`` times a second, by the monotonic clock."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(1e9 / rate_hz)
        self._last_ns = time.monotonic_ns()

    def wait(self) -> None:
        """Sleep until the next moment."""
        self.next()
        time.sleep(self.left_s())

    def next(self) -> None:
        """Look forward to the next moment."""
        self._last_ns = next_moment_ns(self._last_ns, self._period_ns, time.monotonic_ns())

    def left_s(self) -> float:
        """Seconds until then; 0 where it has come."""
        return max(self._last_ns - time.monotonic_ns(), 0) / 1e9
