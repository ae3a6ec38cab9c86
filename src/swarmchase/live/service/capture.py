"""When a target that flies counts as reached: judged from the controller's belief, and by the levels.

Over the last second enough of the belief must have been within the success radius of the centre, at each decision with
the target and the centre where they were then. And the newest levels must be those of a target there: if it is within
the success radius r, no tracker is further from it than r plus its own distance from the centre, so each one's mean
power must be at least what the path loss (Eq. 2) leaves at that distance, less what the scenario says that transmitter
and receivers may be off by. The weakest tracker has no say: it may lie, or be deaf.

The figures were set with ``particle`` on targets that hover, fly from place to place and flee.
"""

from collections import deque

import numpy as np
import torch

from ...channel.propagation import unfaded_dbm
from ...controllers.belief import Belief
from ...observation import mean_power_dbm
from ...scenario import Scenario
from .pace import Window

LEAST_SHARE = 0.45
"""Of the belief within the success radius, on average over the last decisions."""


class CaptureJudge:
    """Remembers the last decisions of one chase.

    Args:
        decisions: Over which the belief is averaged; 0: nothing ever counts as reached.
        minimum_trackers: With fewer that hear nobody can say it.
    """

    def __init__(self, scenario: Scenario, decisions: int, minimum_trackers: int) -> None:
        self._scenario, self._minimum_trackers = scenario, minimum_trackers
        self._allowance_db = scenario.transmit_power_error_db + scenario.receiver_offset_db
        self._decisions = decisions
        self._share: deque[float] = deque(maxlen=max(decisions, 1))

    @property
    def newest_share(self) -> float | None:
        """Of the belief within the radius, after the last decision; None before the first."""
        return self._share[-1] if self._share else None

    def forget(self) -> None:
        """Judge by decisions to come alone."""
        self._share.clear()

    def is_reached(self, window: Window, center_m: torch.Tensor, belief: Belief) -> bool:
        """Take in a window and what is believed after it, and judge.

        Args:
            center_m: Where the centre was at its end, in the belief's frame [1, 3].
        """
        self._share.append(float(belief.share_within(center_m, self._scenario.success_radius_m)[0]))
        if self._decisions == 0 or len(self._share) < self._decisions or np.mean(self._share) < LEAST_SHARE:
            return False
        level_dbm = mean_power_dbm(torch.from_numpy(window.rssi_dbm)[None])[0].double()
        reach_m = self._scenario.success_radius_m + np.linalg.norm(window.offset_m, axis=1)
        needed_dbm = unfaded_dbm(self._scenario, torch.from_numpy(reach_m)) - self._allowance_db
        over_db = (level_dbm - needed_dbm)[level_dbm.isfinite()].sort().values
        return len(over_db) >= self._minimum_trackers and float(over_db[min(1, len(over_db) - 1)]) >= 0.0
