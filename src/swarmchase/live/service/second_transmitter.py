"""Whether what is heard in flight is of one transmitter alone, or of two whose powers add up in each receiver.

Where the levels come from does not tell: one transmitter that moves explains those of two nearly as well. How they fade
does. The weaker of two fills the deep fades of the stronger, all the more the more alike they are; and beside one of
them that one alone is heard. So levels that fade less the weaker they are, as if a constant lay under them, are of two.
That constant is what the other transmitter is while the swarm comes nearer to the one it chases: it is taken to be the
same all the way, and is unknown.

The samples of each interval are weighed, tracker by tracker, under one transmitter and under two (``summed_fading``),
for levels ``OTHER_DBM`` of the other one and K-factors ``RICIAN_K``, of which those near the scenario's are likelier:
levels that fade little near and far are of one. What they say adds up from interval to interval, and nothing else is
remembered. The evidence is the logarithm of how much better two explain them than one, on average over levels and
factors (a Bayes factor), whichever single tracker is left out.

Samples count where they fade independently, that is while swarm and target fly against each other; not beside the
target, where the way alone changes the level within an interval; and not near a receiver's floor, below which fades are
missing.
"""

import functools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from ...channel.summed_fading import LEAST_NP, STEP_NP, log_density
from ...controllers.belief import Belief
from ...controllers.sample_likeness import correlation_of_powers
from ...observation import NEPERS_PER_DB
from ...scenario import NUM_TRACKERS, SPEED_OF_LIGHT_MPS, Scenario
from .pace import Window
from .sample_window import Levels, Point

RICIAN_K = np.geomspace(0.5, 20.0, 16)
"""Of the fading, from hardly any line of sight to hardly any fading. With wider steps two of one factor would explain
better than one what is of one of a factor in between."""
NOT_JUDGED_K = 10.0
"""What fades less on the whole way is not judged: its fades are as shallow as what else changes levels."""
SHALLOW_K = 7.0
"""Where levels fade less, little evidence is no news."""
WEAKER = (0.0, 0.005, 0.015, 0.04, 0.1, 0.25, 1.0)
"""For these powers of the weaker transmitter, in that of the stronger, the law is tabulated."""
OTHER_DBM = np.arange(-100.0, -30.0, 4.0)
SCALE_NP = np.linspace(-1.25, 1.25, 11)
"""By what the mean of an interval's samples may be off."""
FACTOR_SPREAD = 1.0
"""Standard deviation of the K-factor's natural logarithm about the scenario's."""
LEAST_POWER = 1e-300
REMEMBERED = 400
"""Intervals that count: older ones fade away, since the world changes."""
LEAST_SAMPLES, MOST_SAMPLES = 3, 10
"""Of one tracker in an interval; with more they are not independent."""
LEAST_WAVELENGTHS = 15.0
"""That swarm and target fly against each other in an interval of ``decision_s``."""
BESIDE_M = 15.0
ABOVE_FLOOR_DB = 15.0
"""One fade in 100 is deeper where the line of sight is three times as strong as the rest."""
FEW_INTERVALS = 12
"""Where fewer have been weighed, it is no news either: a target that starts beside the swarm is there in seconds."""
CERTAIN, ENOUGH, ANY = 4.0, 0.9, 0.0
"""Evidence by which two are told of: on the way; beside a transmitter, where it is known how one alone fades, if levels
fade little or few were weighed; and there if they fade more."""
DISPROVED = -0.5
"""With less they are told of no more. Of one alone it comes to -0.7. Already by less than 0, four of 72 targets beside
another transmitter would be called reached at the wrong place that are refused now."""

_COUNTED_NP = np.log([WEAKER[1] / 4, *WEAKER[1:]])
"""Where a weaker power stands in the table; less than the first is none."""


class SecondTransmitter:
    """Remembers what the intervals of one chase say."""

    def __init__(self, scenario: Scenario) -> None:
        floor_dbm = -math.inf if scenario.receiver_floor_dbm is None else scenario.receiver_floor_dbm
        self._least_dbm, self._exponent = floor_dbm + ABOVE_FLOOR_DB, scenario.path_loss_exponent
        # Of six trackers that fade alike the samples are worth those of so many fewer.
        self._counts = 1 / (1 + (NUM_TRACKERS - 1) * correlation_of_powers(scenario) ** 2)
        told = np.log(RICIAN_K / max(scenario.rician_k, RICIAN_K[0])) / FACTOR_SPREAD
        self._log_prior = -np.square(told) / 2
        self._least_mps = LEAST_WAVELENGTHS * SPEED_OF_LIGHT_MPS / scenario.carrier_hz / scenario.decision_s
        self._log_likelihood = np.zeros((NUM_TRACKERS, 1 + len(OTHER_DBM), len(RICIAN_K)))
        _table()  # not in the first decision: it takes a while
        self.evidence = 0.0
        """For two."""
        self._is_shallow = False
        """Whether one alone would fade little."""
        self._weighed = 0
        """Intervals."""
        self.is_heard = False
        """Whether what is heard does not fit one transmitter."""

    def take(self, window: Window, origin_m: Point, belief: Belief | None, is_beside: bool) -> None:
        """Take in a window, and what is believed after it.

        Args:
            origin_m: Of the belief's frame.
            is_beside: The swarm has come to a transmitter.
        """
        if belief is not None and self._fades(window, origin_m, belief):
            every = slice(None, None, math.ceil(len(window.rssi_dbm) / MOST_SAMPLES))
            lost_np = self._lost_np(window, origin_m, belief)[every]
            self._weighed += 1
            self._log_likelihood *= 1 - 1 / REMEMBERED
            self._log_likelihood += _log_likelihood(window.rssi_dbm[every], lost_np, self._least_dbm)
            self.evidence, rician_k = _evidence(self._counts * self._log_likelihood, self._log_prior)
            self._is_shallow = rician_k > SHALLOW_K
        enough = ENOUGH if self._is_shallow or self._weighed < FEW_INTERVALS else ANY
        self.is_heard = self.evidence > (DISPROVED if self.is_heard else enough if is_beside else CERTAIN)

    def _lost_np(self, window: Window, origin_m: Point, belief: Belief) -> Levels:
        """The path loss to where the target was, as far as that is known [sample, tracker]: what the way alone makes of
        the levels.
        """
        assert window.time_s is not None
        target_mps = np.zeros(3) if belief.velocity_mps is None else belief.velocity_mps[0].numpy()
        ago_s = window.time_s[-1] - window.time_s
        target_m = belief.mean_m[0].numpy() + origin_m - target_mps * ago_s[:, None]
        squared_m2 = np.square(window.position_m - target_m[:, None]).sum(axis=2) + float(belief.radius_m[0]) ** 2
        return np.asarray(self._exponent / 2 * np.log(squared_m2))

    def _fades(self, window: Window, origin_m: Point, belief: Belief) -> bool:
        """Whether this window's samples count."""
        assert window.time_s is not None
        lasted_s = float(window.time_s[-1] - window.time_s[0])
        if lasted_s <= 0:
            return False
        swarm_mps = (window.position_m[-1] - window.position_m[0]).mean(axis=0) / lasted_s
        target_mps = np.zeros(3) if belief.velocity_mps is None else belief.velocity_mps[0].numpy()
        apart_m = belief.mean_m[0].numpy() + origin_m - window.position_m[-1].mean(axis=0)
        is_beside = max(float(np.linalg.norm(apart_m)), float(belief.radius_m[0])) < BESIDE_M
        return not is_beside and float(np.linalg.norm(swarm_mps - target_mps)) >= self._least_mps


def _evidence(log_likelihood: NDArray[np.float64], log_prior: Levels) -> tuple[float, float]:
    """For two, without the tracker that speaks most for them; and the likeliest K-factor of one.

    Args:
        log_likelihood: What each tracker says of each other level, the first being none, and each K-factor [tracker,
            other, K].
        log_prior: Of each K-factor.
    """
    of_all = log_likelihood.sum(axis=0)
    rician_k = float(RICIAN_K[of_all[0].argmax()])
    if rician_k > NOT_JUDGED_K:
        return 0.0, rician_k
    several = np.concatenate([of_all[None], of_all - log_likelihood]) + log_prior
    evidence = logsumexp(several[:, 1:], axis=(1, 2)) - logsumexp(several[:, 0], axis=1) - math.log(len(OTHER_DBM))
    return float(evidence.min()), rician_k


def _log_likelihood(rssi_dbm: Levels, lost_np: Levels, least_dbm: float) -> NDArray[np.float64]:
    """Of these samples [sample, tracker], up to what is the same for all: [tracker, other, K].

    The mean of an interval is what two add up to, and is not known better than its samples say: all that it may be are
    weighed alike.

    Args:
        lost_np: By what they differ without fading [sample, tracker], up to what is the same for all of a tracker's.
        least_dbm: Who hears less on average counts for nothing. So does a receiver that repeats its level.
    """
    level_np, table = rssi_dbm * NEPERS_PER_DB, _table()
    heard, mean_np = np.isfinite(level_np), _mean_np(level_np)
    spread = np.where(heard, level_np, -np.inf).max(axis=0) > np.where(heard, level_np, np.inf).min(axis=0)
    counts = (heard.sum(axis=0) >= LEAST_SAMPLES) & spread & (mean_np >= least_dbm * NEPERS_PER_DB)
    level_np = level_np + lost_np
    over_np = np.where(heard, level_np - _mean_np(level_np), 0.0)[..., None] - SCALE_NP
    level = np.clip(np.rint((over_np - LEAST_NP) / STEP_NP).astype(np.int64), 0, len(table) - 2)
    level = np.where((heard & counts)[..., None], level, len(table) - 1)
    by_weaker = logsumexp(table.take(level, axis=0).sum(axis=0), axis=1).reshape(-1, len(WEAKER), len(RICIAN_K))
    # The other one's share of the mean. One that would be stronger than all of the rest counts as just as strong: to be
    # the weaker one it is no more than half.
    share = np.minimum(np.exp(OTHER_DBM * NEPERS_PER_DB - mean_np[:, None]), 0.5)
    place = np.interp(np.log(share / (1 - share)), _COUNTED_NP, np.arange(len(WEAKER)))
    before = np.minimum(place.astype(np.int64), len(WEAKER) - 2)
    after = (place - before)[..., None]
    trackers = np.arange(len(before))[:, None]
    two = by_weaker[trackers, before] * (1 - after) + by_weaker[trackers, before + 1] * after
    return np.concatenate([by_weaker[:, :1], two], axis=1)


def _mean_np(level_np: Levels) -> Levels:
    """Of the powers of each tracker's samples; next to nothing where it has heard nothing."""
    heard = np.isfinite(level_np)
    power = np.where(heard, np.exp(level_np), 0.0).sum(axis=0) / np.maximum(heard.sum(axis=0), 1)
    return np.asarray(np.log(np.maximum(power, LEAST_POWER)))


@functools.cache
def _table() -> NDArray[np.float64]:
    """The logarithm of the density of each level, under each ``WEAKER`` and ``RICIAN_K`` [level, weaker x K]; the last
    row is of a sample that does not count.
    """
    rows = np.array([log_density(float(rician_k), weaker) for weaker in WEAKER for rician_k in RICIAN_K])
    return np.concatenate([rows.T, np.zeros((1, len(rows)))])
