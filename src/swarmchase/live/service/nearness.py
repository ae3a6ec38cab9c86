"""When the target counts as reached, judged by signal strength alone.

Two things must be so, and no single tracker decides.

**The levels are strong enough.** If the centre is within the success radius r of the target, no tracker is further from
it than r plus its own distance from the centre (triangle inequality). So each tracker's power, averaged in milliwatts,
must be at least what the path loss (Eq. 2) leaves at that distance, and ``MARGIN_DB`` more: in the last window, and in
the mean over the last windows. The mean over windows narrows what fading blurs while the swarm stays; the last window
keeps a swarm that only passes the target from being taken for one that is there. The weakest tracker is left out: it
may lie, or be deaf. The strongest decides nothing: one tracker beside the target is a centre a spacing away.

**A target near the centre explains them.** Real places are not the told channel: levels depart from the best path loss
by 5 dB and more, and all trackers of a small swarm share most of that. So the six levels are weighed against targets at
any distance, with a departure that all share and one of each tracker's own, whose tails are long (Student's
t), so that one tracker that lies moves little. (At spacings of 3 m and more one that is far too loud can still hold
the word up: it might be beside the target.) Within the success radius must lie ``LEAST_SHARE`` of the belief.

The figures were set on a map of 81 places of a furnished hall with 12 emitters, where the path loss is fitted to all of
it (``swarmchase.benchmarks.nearness``), so that few distant places are called reached, and so that in the told channel
the word comes in the same window as by the levels alone, or one movement later. A tracker that was silent in any of the
windows cannot object.
"""

from collections import deque

import numpy as np
import torch

from ...channel.propagation import unfaded_dbm
from ...scenario import Scenario
from .sample_window import Levels, Points

MARGIN_DB = 1.15
"""Of the levels: it makes up for the weakest tracker's say. From 1.2 dB on, a target at 1.9 m need not be reached."""
LEAST_SHARE = 0.25
"""Of the belief within the success radius. Before anything is heard it is 5 %: distances up to twenty times as far are
as likely as one another."""
OWN_DEPARTURE_DB, SHARED_DEPARTURE_DB = 4.0, 6.0
"""Standard deviation of what a place adds to all trackers' levels, and scale of what it adds to each one's."""
DEGREES_OF_FREEDOM = 4
"""Of Student's t."""

_DISTANCE = np.array([0.25, 0.5, 0.75, 1, 1.25, 1.5, 2, 2.5, 3, 4, 5, 6.5, 8.5, 11, 15])
"""Of the targets that are weighed, in success radii."""
_NEAREST, _FARTHEST = 0.125, 20.0
"""The first stands for all from the one on, the last for all up to the other."""
_NUM_DIRECTIONS = 40
_DEPARTURES = np.linspace(-3, 3, 13)
"""Of what all share, in standard deviations."""


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

    def is_reached(self, rssi_dbm: Levels, offset_m: Points) -> bool:
        """Take in a window [sample, tracker] and judge; with no windows to judge by never.

        Args:
            rssi_dbm: NaN where nothing valid came.
            offset_m: From the centre to each tracker [tracker, xyz].
        """
        # Without fading, for a target at the success radius behind the centre.
        needed_dbm = self._unfaded_dbm(self._scenario.success_radius_m + np.linalg.norm(offset_m, axis=1))
        self._power_share.append(_mean(10 ** ((rssi_dbm - needed_dbm) / 10)))
        if len(self._power_share) < self._windows or self._windows == 0:
            return False
        share = np.array(self._power_share).mean(axis=0)
        heard = np.isfinite(share)
        if heard.sum() < self._minimum_trackers:
            return False
        rising = np.sort(np.minimum(share, self._power_share[-1])[heard])
        if rising[min(1, len(rising) - 1)] < 10 ** (MARGIN_DB / 10):
            return False
        level_dbm = needed_dbm[heard] + 10 * np.log10(share[heard])
        return self._belief_within_radius(level_dbm, offset_m[heard]) >= LEAST_SHARE

    def _belief_within_radius(self, level_dbm: Levels, offset_m: Points) -> float:
        """How much of the belief lies there, after these levels [tracker] at these places [tracker, xyz]."""
        distance_m = np.linalg.norm(self._scenario.success_radius_m * _TARGET[:, None] - offset_m, axis=2)
        departure_db = level_dbm - self._unfaded_dbm(distance_m)
        own_db = departure_db[:, None] - SHARED_DEPARTURE_DB * _DEPARTURES[:, None]
        squared = (own_db / OWN_DEPARTURE_DB) ** 2 / DEGREES_OF_FREEDOM
        log_likelihood = -(DEGREES_OF_FREEDOM + 1) / 2 * np.log1p(squared).sum(axis=2)
        log_belief = log_likelihood - _DEPARTURES**2 / 2 + _LOG_PRIOR[:, None]
        belief = np.exp(log_belief - log_belief.max()).sum(axis=1)
        return float(belief[: _NUM_DIRECTIONS * int((_DISTANCE <= 1).sum())].sum() / belief.sum())

    def _unfaded_dbm(self, distance_m: Levels) -> Levels:
        return unfaded_dbm(self._scenario, torch.from_numpy(distance_m)).numpy()


def _directions() -> Points:
    """Spread evenly over the sphere, on a golden spiral."""
    number = np.arange(_NUM_DIRECTIONS) + 0.5
    height, turn = 1 - 2 * number / _NUM_DIRECTIONS, np.pi * (1 + 5**0.5) * number
    across = np.sqrt(1 - height**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)


def _log_prior() -> Levels:
    """Of each target that is weighed: of the length of way that its distance stands for."""
    between = np.sqrt(_DISTANCE[1:] * _DISTANCE[:-1])
    return np.repeat(np.log(np.diff(np.concatenate([[_NEAREST], between, [_FARTHEST]]))), _NUM_DIRECTIONS)


_TARGET: Points = (_DISTANCE[:, None, None] * _directions()).reshape(-1, 3)
"""[target, xyz], in success radii."""
_LOG_PRIOR = _log_prior()


def _mean(power: Levels) -> Levels:
    """Along the first axis, without NaN; NaN where there is nothing else."""
    valid = np.isfinite(power)
    number = valid.sum(axis=0)
    total = np.where(valid, power, 0.0).sum(axis=0)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)
