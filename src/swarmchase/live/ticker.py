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
        now_ns = time.monotonic_ns()
        self._last_ns = next_moment_ns(self._last_ns, self._period_ns, now_ns)
        if self._last_ns > now_ns:
            time.sleep((self._last_ns - now_ns) / 1e9)
