"""When a target that flies counts as reached: judged from the controller's belief, and by the levels.

A swarm that chases at full speed passes a target in less than the time between two decisions. So at each decision the
way that the centre has truly flown since the one before is laid over the belief, with the target where it was then: how
much of the belief was within the success radius at some moment of it? On average over the last decisions that must be
``LEAST_SHARE``. And the newest levels must be those of a target there: if it was within the success radius r of the
centre where the way is nearest to where it is believed to be, no tracker has since been further from it than r, what
centre and target have moved apart, and its own distance from the centre. So each one's mean power must be at least what
the path loss (Eq. 2) leaves at these distances, less what the scenario says that transmitter and receivers may be off
by. The weakest tracker has no say: it may lie, or be deaf.

``LEAST_SHARE`` was set on 210 evaluated flights of ``particle`` (waypoints, 5 m/s, 20 Hz); docs/live.md has what came
of it in live ones.
"""

from collections import deque

import numpy as np
import torch

from ...channel.propagation import unfaded_dbm
from ...controllers.belief import Belief
from ...observation import mean_power_dbm
from ...scenario import Scenario
from .pace import Window
from .sample_window import Levels, Point, Points

LEAST_SHARE = 0.45
"""Of the belief that the swarm has passed within the success radius, on average over the last decisions."""


class CaptureJudge:
    """Remembers the last decisions of one chase.

    Args:
        decisions: Over which the share is averaged; 0: nothing ever counts as reached.
        minimum_trackers: With fewer that hear nobody can say it.
    """

    def __init__(self, scenario: Scenario, decisions: int, minimum_trackers: int) -> None:
        self._scenario, self._minimum_trackers = scenario, minimum_trackers
        self._allowance_db = scenario.transmit_power_error_db + scenario.receiver_offset_db
        self._decisions = decisions
        self._share: deque[float] = deque(maxlen=max(decisions, 1))
        self._last: tuple[float, Point] | None = None
        """When the last window ended, and where the centre was then, in the belief's frame."""

    @property
    def newest_share(self) -> float | None:
        """Of the belief within the radius, after the last decision; None before the first."""
        return self._share[-1] if self._share else None

    def forget(self) -> None:
        """Judge by decisions to come alone."""
        self._share.clear()
        self._last = None

    def is_reached(self, window: Window, origin_m: Point, belief: Belief) -> bool:
        """Take in a window and what is believed after it, and judge.

        Args:
            origin_m: Of the belief's frame.
        """
        assert window.time_s is not None
        center_m = window.position_m.mean(axis=1) - origin_m
        time_s, way_m = self._way(window.time_s, center_m)
        at_m, age_s = torch.from_numpy(way_m)[None], torch.from_numpy(time_s[-1] - time_s)[None]
        self._share.append(float(belief.share_passed(at_m, age_s, self._scenario.success_radius_m)[0]))
        is_passed = self._decisions > 0 and sum(self._share) / self._decisions >= LEAST_SHARE
        return is_passed and self._is_heard_there(window, belief.from_target_m(at_m, age_s)[0].numpy())

    def _way(self, time_s: Levels, center_m: Points) -> tuple[Levels, Points]:
        """When and where the centre was, from the end of the last window to that of this one."""
        last, self._last = self._last, (float(time_s[-1]), center_m[-1])
        if last is None or not 0 < time_s[0] - last[0] <= self._scenario.decision_s:
            last = float(time_s[0]), center_m[0]
        return np.concatenate([[last[0]], time_s]), np.concatenate([last[1][None], center_m])

    def _is_heard_there(self, window: Window, apart_m: Points) -> bool:
        """Whether the levels are those of a target within the success radius when the centre was nearest to where it is
        believed to be.

        Args:
            apart_m: From there to the centre, at each moment of the way; at the end those of the samples.
        """
        nearest_m = apart_m[np.linalg.norm(apart_m, axis=1).argmin()]
        apart_m = apart_m[-len(window.rssi_dbm) :] - nearest_m
        offset_m = window.position_m - window.position_m.mean(axis=1, keepdims=True)
        reach_m = self._scenario.success_radius_m + np.linalg.norm(apart_m, axis=1)[:, None]
        reach_m = reach_m + np.linalg.norm(offset_m, axis=2)
        over_db = torch.from_numpy(window.rssi_dbm) - unfaded_dbm(self._scenario, torch.from_numpy(reach_m))
        over_db = mean_power_dbm((over_db + self._allowance_db)[None])[0].double()
        over_db = over_db[over_db.isfinite()].sort().values
        return len(over_db) >= self._minimum_trackers and float(over_db[min(1, len(over_db) - 1)]) >= 0.0
