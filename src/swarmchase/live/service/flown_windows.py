"""What trackers hear that never stop to listen, cut into windows: one an interval, without a gap between them."""

import math
from collections import deque

import numpy as np

from ...scenario import Scenario
from .formation_estimate import claimed_centers_m, median_m, medians
from .formation_motion import FormationMotion
from .pace import Window
from .safety import formation_m
from .sample_window import Levels, Points
from .swarm import Swarm

FIRST_WINDOW_S = 0.3
"""So long before it begins a chase's first window is announced."""
PATIENCE_S = 0.25
"""After the end of an interval what trackers heard in it is waited for so long, from those of which anything comes."""
REMEMBERED_STEPS = 200
"""Ten seconds at 20 steps a second: longer than any window is waited for."""


class FlownWindows:
    """Of one chase. Intervals begin half way between two samples, so that it is plain which belong to one."""

    def __init__(self, scenario: Scenario, swarm: Swarm) -> None:
        self._swarm = swarm
        self._period_ns = round(1e9 / scenario.sampling_hz)
        self._interval_ns = round(1e9 * scenario.decision_s)
        self._turns: deque[tuple[int, float]] = deque(maxlen=REMEMBERED_STEPS)
        """How far the cross had turned at each step."""
        self._chase_ns: int | None = None
        """When the chase's own time began."""
        self._begins_ns = 0
        """The interval that is listened to begins."""

    @property
    def since_ns(self) -> int:
        """When the first interval began."""
        return self._chase_ns or 0

    def begin(self, now_ns: int) -> None:
        """An interval begins soon, whatever was heard before."""
        newest_ns = self._swarm.newest_sample_ns() or now_ns
        periods = math.ceil((now_ns + FIRST_WINDOW_S * 1e9 - newest_ns) / self._period_ns)
        self._begins_ns = newest_ns + periods * self._period_ns - self._period_ns // 2
        self._chase_ns = self._begins_ns if self._chase_ns is None else self._chase_ns

    def note_turned(self, now_ns: int, turned_rad: float) -> None:
        """How far the cross has turned now."""
        self._turns.append((now_ns, turned_rad))

    def is_due(self, now_ns: int) -> bool:
        """Whether what was heard in the interval that has ended is there, or was waited for."""
        late_ns = self._late_ns(now_ns)
        if late_ns < 0:
            return False
        return late_ns >= PATIENCE_S * 1e9 or not self._swarm.awaits_flown_window(self._begins_ns)

    def take(self, now_ns: int, motion: FormationMotion, told_m: Points, rest_m: Points, excused_m: Levels) -> Window:
        """What was heard in the interval that has ended; the next one begins where it has.

        Args:
            motion: Of the formation, now.
            told_m: As ``Swarm.flown`` has it; so are ``rest_m`` and ``excused_m``.
        """
        # After a pause of the loop what is old is left out.
        too_late_ns = self._late_ns(now_ns) - PATIENCE_S * 1e9
        self._begins_ns += max(0, math.floor(too_late_ns / self._interval_ns)) * self._interval_ns
        rssi_dbm, position_m, after_s = self._swarm.flown(self._begins_ns, told_m, rest_m, excused_m)
        since_s = (self._begins_ns - self.since_ns) / 1e9
        # Who is not commanded has no times, and there is always one who is.
        sampled_s = medians(after_s[:, np.isfinite(after_s).all(axis=0)].T)
        turned_rad = self._turned_at_rad(self._begins_ns, sampled_s)
        self._begins_ns += self._interval_ns
        place_m = _places_m(self._swarm.counted_positions_m(position_m), motion, turned_rad)
        rssi_dbm, position_m = self._swarm.window(rssi_dbm, position_m, place_m)
        return Window(rssi_dbm, position_m, position_m[-1].mean(axis=0), since_s + sampled_s)

    def _late_ns(self, now_ns: int) -> int:
        """How long ago the interval has ended; below 0 it has not."""
        return now_ns - self._begins_ns - self._interval_ns

    def _turned_at_rad(self, since_ns: int, after_s: Levels) -> Levels:
        """How far the cross had turned so long after this moment [sample]."""
        known_s = [(time_ns - since_ns) / 1e9 for time_ns, _ in self._turns]
        return np.interp(after_s, known_s, [rad for _, rad in self._turns]) if known_s else 0.0 * after_s


def _places_m(position_m: Points, motion: FormationMotion, turned_rad: Levels) -> Points:
    """Where each must have been at each sample for the others' sake [sample, tracker, 3]."""
    places_m = []
    for each_m, rad in zip(position_m, turned_rad.tolist(), strict=True):
        is_known = np.isfinite(each_m).any()
        center_m = median_m(claimed_centers_m(each_m, motion.spacing_m, rad)) if is_known else motion.center_m
        places_m.append(formation_m(center_m, motion.spacing_m, rad))
    return np.stack(places_m)
