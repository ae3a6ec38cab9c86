"""When the target counts as reached, judged by signal strength alone.

If the centre is within the success radius r of the target, no tracker is further from it than r plus its own distance
from the centre (triangle inequality). So each tracker's power, averaged in milliwatts, must be at least what the path
loss (Eq. 2) leaves at that distance: in the last window, and in the mean over the last windows. It is the weakest
tracker that decides: the mean over all six is ruled by the nearest one, and would already be as high with one tracker
beside the target and the centre a spacing away.

How far a false alarm can be: without fading and with all six trackers at the spacing d, all are within r + d only where
the centre is within x of the target, x^2 + 2 d x / sqrt(3) <= r^2 + 2 r d, that is 2.3 m for d = 1 m and 2.8 m for
d = 5 m (r = 2 m). From 10 m away at d = 5 m the weakest tracker is at least 13.5 m from the target and lacks 7.4 dB in
every window, more than a Rician channel with K = 3 lends. The mean over windows narrows what fading blurs while the
swarm stays; the last window keeps a swarm that only passes the target from being taken for one that is there. A tracker
that was silent in any of the windows cannot object: on its side the criterion reaches further.
"""

from collections import deque

import numpy as np
import torch

from ...channel.propagation import unfaded_dbm
from ...scenario import Scenario
from .sample_window import Levels


class NearnessJudge:
    """Remembers the last windows of one chase."""

    def __init__(self, scenario: Scenario, windows: int, minimum_trackers: int) -> None:
        self._scenario = scenario
        self._minimum_trackers = minimum_trackers
        self._windows = windows
        self._power_share: deque[Levels] = deque(maxlen=max(windows, 1))
        """Of each window: each tracker's mean power over what is needed of it, NaN where it heard nothing."""

    def forget(self) -> None:
        """Judge by windows to come alone."""
        self._power_share.clear()

    def is_reached(self, rssi_dbm: Levels, center_distance_m: Levels) -> bool:
        """Take in a window [sample, tracker] and judge; with no windows to judge by never.

        Args:
            rssi_dbm: NaN where nothing valid came.
            center_distance_m: How far each tracker was from the centre [tracker].
        """
        # Without fading, for a target at the success radius behind the centre.
        farthest_m = torch.from_numpy(self._scenario.success_radius_m + center_distance_m)
        needed_dbm = unfaded_dbm(self._scenario, farthest_m).numpy()
        self._power_share.append(_mean(10 ** ((rssi_dbm - needed_dbm) / 10)))
        if len(self._power_share) < self._windows or self._windows == 0:
            return False
        heard = np.minimum(np.array(self._power_share).mean(axis=0), self._power_share[-1])
        heard = heard[np.isfinite(heard)]
        return bool(len(heard) >= self._minimum_trackers and heard.min() >= 1)


def _mean(power: Levels) -> Levels:
    """Along the first axis, without NaN; NaN where there is nothing else."""
    valid = np.isfinite(power)
    number = valid.sum(axis=0)
    total = np.where(valid, power, 0.0).sum(axis=0)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)
