"""The way a tracker came, to be flown back as a film runs backwards: at each moment it is where it was that long before
the controller was lost.

Trackers that lose their controller together so pass one another at the distances, and at the speeds, at which they
came; none of them needs to know where another is, and detours and waiting are flown back, too.
"""

import math
from array import array

from ..link.messages import Metres

STEP_M = 0.1
"""A place is remembered when the last one remembered is so far away."""
MOST_PLACES = 50_000
"""Of 5 km and more, in 1.6 MB; then the older half is forgotten, and the way begins later."""


class WayBack:
    """Empty at first. Times are of the tracker's clock and rise."""

    def __init__(self) -> None:
        self._time_ns = array("q")
        self._place_m = array("d")
        """Three numbers for each moment."""

    @property
    def has_begun(self) -> bool:
        """Whether there is anywhere to go back to."""
        return len(self._time_ns) > 0

    def note(self, time_ns: int, position_m: Metres) -> None:
        """It is there now."""
        if self.has_begun and math.dist(position_m, self._noted_m(-1)) < STEP_M:
            return
        if len(self._time_ns) >= MOST_PLACES:
            del self._time_ns[: MOST_PLACES // 2], self._place_m[: 3 * (MOST_PLACES // 2)]
        self._time_ns.append(time_ns)
        self._place_m.extend(position_m)

    def back_at(self, time_ns: int) -> tuple[Metres, bool]:
        """Where it was at this moment, and whether that is where the way began. What came later is forgotten.

        Raises:
            IndexError: the way has not begun.
        """
        while len(self._time_ns) > 1 and self._time_ns[-2] >= time_ns:
            del self._time_ns[-1:], self._place_m[-3:]
        last_ns, last_m = self._time_ns[-1], self._noted_m(-1)
        if len(self._time_ns) == 1 or time_ns >= last_ns:
            return last_m, len(self._time_ns) == 1
        before_ns, before_m = self._time_ns[-2], self._noted_m(-2)
        share = (time_ns - before_ns) / (last_ns - before_ns)
        x_m, y_m, z_m = (start + share * (end - start) for start, end in zip(before_m, last_m, strict=True))
        return (x_m, y_m, z_m), False

    def _noted_m(self, number: int) -> Metres:
        """The last one is -1."""
        end = len(self._place_m) + 3 * (number + 1)
        x_m, y_m, z_m = self._place_m[end - 3 : end]
        return x_m, y_m, z_m
