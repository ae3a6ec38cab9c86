"""Whether the trackers' levels can be of one transmitter, judged without knowing where it is.

Two trackers D apart that hear a target at d and d' have d - D <= d' <= d + D. So what one hears says how much another
can hear: what the path loss (Eq. 2) leaves between these two distances, give or take what the fading of a window lends
(the told channel's law) and what receivers and antennas differ by. Far from the target that is little; beside it the
nearest may hear far more than the others. Each tracker is judged by the median of what all others say, so that one that
lies does not make others look wrong.
"""

import functools

import numpy as np
import torch

from ...channel.fading_law import LOWEST_DB, TABLE_STEP_DB, fading_law
from ...channel.propagation import reference_dbm
from ...observation import mean_power_dbm
from ...scenario import Scenario
from .sample_window import Flags, Levels, Points

RARE = 0.001
"""In so many windows two trackers' fading differs by more than is taken to be possible."""
EQUIPMENT_DB = 10.0
"""Equal receivers differ by 2 to 3 dB, how they are mounted by as much, antennas and bodies by 7 to 10 dB from front to
back."""
FEWEST_OTHERS = 3
"""Of two that contradict one another nobody can say which one is wrong."""
DRAWS = 200_000
DRAWS_SEED = 1 << 61


class LevelConsistency:
    """Of the windows of one scenario."""

    def __init__(self, scenario: Scenario) -> None:
        self._slope_db = 10 * scenario.path_loss_exponent
        """A distance ten times as long costs so much."""
        self._reference_dbm, self._reference_m = reference_dbm(scenario), scenario.reference_distance_m
        self.lent_db = _fading_difference_db(scenario) + EQUIPMENT_DB + 2 * scenario.receiver_offset_db
        """By so much two trackers in one place may differ."""

    def contradicts(self, rssi_dbm: Levels, position_m: Points, counts: Flags, share: float = 1.0) -> Flags:
        """Which trackers hear more or less than the others' levels allow [tracker]; who hears nothing does not.

        Args:
            rssi_dbm: [sample, tracker]; NaN where nothing valid came.
            position_m: [tracker, 3]
            counts: Whose word counts about others [tracker].
            share: Of what is lent to differences.
        """
        level_dbm = mean_power_dbm(torch.from_numpy(rssi_dbm)[None])[0].double().numpy()
        lent_db, heard = share * self.lent_db, np.isfinite(level_dbm)
        nearest_m, farthest_m = self._distance_m(level_dbm + lent_db), self._distance_m(level_dbm - lent_db)
        found = np.zeros(len(level_dbm), dtype=bool)
        for tracker in np.flatnonzero(heard).tolist():
            others = heard & counts & (np.arange(len(level_dbm)) != tracker)
            if others.sum() < FEWEST_OTHERS:
                continue
            apart_m = np.linalg.norm(position_m[others] - position_m[tracker], axis=1)
            highest_dbm = np.sort(self._level_dbm(nearest_m[others] - apart_m, lent_db))
            lowest_dbm = np.sort(self._level_dbm(farthest_m[others] + apart_m, lent_db))
            # The median; of an even number the one of the two in the middle that allows more.
            middle = len(apart_m) // 2
            found[tracker] = not lowest_dbm[-1 - middle] <= level_dbm[tracker] <= highest_dbm[middle]
        return found

    def _distance_m(self, level_dbm: Levels) -> Levels:
        """Where this is heard without fading, be it within the reference distance."""
        return np.asarray(self._reference_m * 10 ** ((self._reference_dbm - level_dbm) / self._slope_db))

    def _level_dbm(self, distance_m: Levels, lent_db: float) -> Levels:
        """What is heard there without fading, and no more than a tracker at the reference distance may hear."""
        nearest_m = self._reference_m * 10 ** (-lent_db / self._slope_db)
        ratio = np.maximum(distance_m, nearest_m) / self._reference_m
        return np.asarray(self._reference_dbm - self._slope_db * np.log10(ratio))


@functools.lru_cache(maxsize=32)
def _fading_difference_db(scenario: Scenario) -> float:
    """By how much the fading of two trackers' windows differs at most, but for ``RARE`` windows."""
    law, random = fading_law(scenario), np.random.default_rng(DRAWS_SEED)
    correlation = max(law.correlation, 0.0)
    common, *own = random.standard_normal((3, DRAWS))
    level_db = LOWEST_DB + TABLE_STEP_DB * np.arange(len(law.normal))
    one_db, other_db = (
        np.interp(np.sqrt(correlation) * common + np.sqrt(1 - correlation) * each, law.normal.numpy(), level_db)
        for each in own
    )
    return float(np.quantile(np.abs(one_db - other_db), 1 - RARE))
