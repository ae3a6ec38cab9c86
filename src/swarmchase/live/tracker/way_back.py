"""The way a tracker came, to be flown back as a film runs backwards: at each moment it is where it was that long before
the controller was lost.

Trackers that lose their controller together so pass one another at the distances, and at the speeds, at which they
came; none of them needs to know where another is, and detours and waiting are flown back, too.
"""

from collections import deque

from ..link.messages import Metres

STEP_M = 0.1
"""A place is remembered when the last one remembered is so far away."""
MOST_PLACES = 100_000
"""Of 10 km and more; what lies further back is forgotten."""


class WayBack:
    """Empty at first. Times are of the tracker's clock and rise."""

    def __init__(self) -> None:
        self._way: deque[tuple[int, Metres]] = deque(maxlen=MOST_PLACES)

    @property
    def has_begun(self) -> bool:
        """Whether there is anywhere to go back to."""
        return bool(self._way)

    def note(self, time_ns: int, position_m: Metres) -> None:
        """It is there now."""
        if not self._way or _apart_squared(position_m, self._way[-1][1]) >= STEP_M**2:
            self._way.append((time_ns, position_m))

    def back_at(self, time_ns: int) -> tuple[Metres, bool]:
        """Where it was at this moment, and whether that is where the way began. What came later is forgotten.

        Raises:
            IndexError: the way has not begun.
        """
        while len(self._way) > 1 and self._way[-2][0] >= time_ns:
            self._way.pop()
        last_ns, last_m = self._way[-1]
        if len(self._way) == 1 or time_ns >= last_ns:
            return last_m, len(self._way) == 1
        before_ns, before_m = self._way[-2]
        share = (time_ns - before_ns) / (last_ns - before_ns)
        x_m, y_m, z_m = (start + share * (end - start) for start, end in zip(before_m, last_m, strict=True))
        return (x_m, y_m, z_m), False


def _apart_squared(one_m: Metres, other_m: Metres) -> float:
    return sum((a - b) ** 2 for a, b in zip(one_m, other_m, strict=True))
