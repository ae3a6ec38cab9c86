"""Whether a vehicle goes where it is told: an autopilot drops what lies beyond a fence of its own without a word."""

import math

from ...link.messages import Metres

OTHER_M = 0.5
"""A destination that has moved by less is the same."""
PATIENCE_S = 5.0
STANDS_MPS, AWAY_M = 0.3, 1.0


class Obedience:
    """Looks at one vehicle while it is to follow."""

    def __init__(self) -> None:
        self._told_m: Metres | None = None
        self._since_ns = 0
        self._is_told = False

    def complaint(
        self, destination_m: Metres | None, position_m: Metres | None, velocity_mps: Metres, now_ns: int
    ) -> str | None:
        """What is to be told, once for a destination; None where all is well. A destination of None: it need not."""
        if destination_m is None or self._told_m is None or math.dist(destination_m, self._told_m) > OTHER_M:
            self._told_m, self._since_ns, self._is_told = destination_m, now_ns, False
            return None
        if self._is_told or position_m is None or now_ns - self._since_ns < PATIENCE_S * 1e9:
            return None
        away_m = math.dist(destination_m, position_m)
        if away_m <= AWAY_M or math.hypot(*velocity_mps) >= STANDS_MPS:
            return None
        self._is_told = True
        return f"stands {away_m:.1f} m from where it is told to be: is there a fence of its own?"
