"""A receiver that is computed."""

from collections.abc import Callable

from ....errors import InputError
from ....levels import ERROR_VALUES_DBM, HIGHEST_DBM, LOWEST_DBM, is_level
from ...link.messages import MOST_SAMPLES
from .kind import SourceDetails, SourceKind
from .protocol import Sample
from .rejected import Rejected


class SimulatedSource:
    """Asks ``level_dbm(time_ns)`` at the moments of a grid of rate ``sampling_hz``, from the first ``read`` on.

    After a pause it makes up for one window of samples at most. Where the level comes from a world in another process,
    the world sends it to a ``JsonDatagramSource``.
    """

    silence = "nothing is simulated"

    def __init__(self, level_dbm: Callable[[int], float], sampling_hz: float) -> None:
        self.rejected = Rejected()
        self._level_dbm = level_dbm
        self._sampling_hz = sampling_hz
        self._first_ns: int | None = None
        self._next = 0

    def read(self, now_ns: int) -> list[Sample]:
        """The samples that have fallen due."""
        if self._first_ns is None:
            self._first_ns = now_ns
        last = int((now_ns - self._first_ns) / 1e9 * self._sampling_hz) + 1
        while self._moment_ns(self._first_ns, last) > now_ns:
            last -= 1
        self._next = max(self._next, last + 1 - MOST_SAMPLES)
        times_ns = [self._moment_ns(self._first_ns, number) for number in range(self._next, last + 1)]
        self._next = max(self._next, last + 1)
        return [(time_ns, self._level_dbm(time_ns)) for time_ns in times_ns]

    def _moment_ns(self, first_ns: int, number: int) -> int:
        return first_ns + round(number / self._sampling_hz * 1e9)

    def close(self) -> None:
        """Nothing is held."""


def _open(place: str, details: SourceDetails) -> SimulatedSource:
    """A level that stays."""
    try:
        level_dbm = float(place)
    except ValueError:
        raise InputError(f"level {place!r} is refused: allowed is a number of dBm") from None
    if not is_level(level_dbm):
        errors = ", ".join(f"{error_dbm:g}" for error_dbm in ERROR_VALUES_DBM)
        allowed = f"{LOWEST_DBM:g} to {HIGHEST_DBM:g} but for {errors}, by which receivers tell errors"
        raise InputError(f"level {place} dBm is refused: allowed is {allowed}")
    return SimulatedSource(lambda _time_ns: level_dbm, details.sampling_hz)


KIND = SourceKind(scheme="simulated", place="LEVEL_DBM", open=_open)
