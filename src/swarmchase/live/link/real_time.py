"""Real time as an end of the link has it: no step of this machine's clock changes it while the other end agrees.

Clocks are stepped in mid-flight by GPS, NTP and people. Both ends refuse what is not of now, so such a step would part
them. Whose clock has been confirmed by the other end goes on by the monotonic clock, until long after the last of it.
"""

import time
from collections.abc import Callable

CONFIRMED_FOR_S = 60.0
"""After the other end last agreed, the machine's own clock counts again."""


class RealTime:
    """Follows ``wall_time_ns`` until the other end confirms it.

    Args:
        wall_time_ns: real time since 1970, as this machine has it.
        monotonic_ns: any clock that nobody steps.
    """

    def __init__(
        self,
        wall_time_ns: Callable[[], int] = time.time_ns,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._wall_time_ns, self._monotonic_ns = wall_time_ns, monotonic_ns
        self._ahead_ns = 0
        """Real time less the monotonic clock."""
        self._confirmed_ns: int | None = None

    def now_ns(self) -> int:
        """Nanoseconds since 1970."""
        now_ns = self._monotonic_ns()
        if self._confirmed_ns is None or now_ns - self._confirmed_ns > CONFIRMED_FOR_S * 1e9:
            self._ahead_ns = self._wall_time_ns() - now_ns
        return now_ns + self._ahead_ns

    def confirm(self) -> None:
        """The other end has just shown that its clock agrees."""
        self._confirmed_ns = self._monotonic_ns()
