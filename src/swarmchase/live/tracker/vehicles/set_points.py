"""When set-points are sent to an autopilot."""

import math

from ...link.messages import Metres
from .firmware import Rhythm

SOONEST_S = 0.1


class SetPointPace:
    """Told each set-point that is sent, it says when the next one is due."""

    def __init__(self) -> None:
        self._sent_m: Metres | None = None
        """None: none yet, and the next one is due at once."""
        self._sent_ns = 0

    def is_due(self, position_m: Metres, velocity_mps: Metres | None, rhythm: Rhythm, now_ns: int) -> bool:
        """Whether this one is to be sent now; then it counts as sent. One with a velocity is old at once."""
        wait_s = self._wait_s(position_m, rhythm) if velocity_mps is None else SOONEST_S
        if now_ns - self._sent_ns < wait_s * 1e9:
            return False
        # What comes to rest after velocities is another one, wherever it is.
        self._sent_m, self._sent_ns = position_m if velocity_mps is None else None, now_ns
        return True

    def _wait_s(self, position_m: Metres, rhythm: Rhythm) -> float:
        if self._sent_m is None:
            return 0.0
        moved_m = math.dist(position_m, self._sent_m)
        if moved_m == 0:
            return rhythm.repeat_s
        return SOONEST_S if moved_m >= rhythm.least_change_m else rhythm.settled_s

    def forget(self) -> None:
        """The next one is another one, and is due at once: the autopilot has had other orders meanwhile."""
        self._sent_m = None
