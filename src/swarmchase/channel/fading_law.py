"""What a window's power says of the distance: the law of the fading in it, under a scenario's channel.

The six mean powers of a window are a path gain each plus the fading's mean power in dB, whose joint law does not
depend on the distances. It has no closed form. Here it is a Gaussian copula: each tracker's fading is mapped to a
standard normal by the quantiles of many windows drawn from the scenario's own ``Fading``, and the six normals have
one correlation, since all trackers fade alike. At 100 Hz the law has a long tail towards deep fades: as a plain
Gaussian it costs a particle filter 4 % more movements.

A window may also enter by another statistic of its power than the mean (``WindowPower``); the law is that of what
fading does to it.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ..batch.array_types import Bool, Float, Tensor
from ..batch.streams import chase_keys
from ..observation import mean_power_dbm
from ..scenario import NUM_TRACKERS, Scenario, paper_scenario
from .fading import fading_db as samples_db
from .fading import window_time_s
from .fading_process import fading_process

LAW_WINDOWS = 20_000
"""Windows from which the law is read; each is heard by six trackers."""
LAW_SEED = 1 << 61
"""Of these windows: neither an evaluation's nor a training's."""
MOST_NORMAL = 3.6
"""The quantiles of 120,000 values reach this far; beyond, the map to normals goes on as a straight line."""
KNOT_STEP = 0.2
LOWEST_DB, HIGHEST_DB, TABLE_STEP_DB = -80.0, 40.0, 0.01
"""Range and resolution of the tabulated map; what lies outside counts as its end."""
LEAST_SPREAD_DB = 0.1
"""Trackers are never taken to differ by less than this (standard deviation), although nothing at all may fade (K
without bound) or all of them as one (rho = 1): no fit and no particles would be near enough to a window that says so
much."""

_FIELDS_OF_FADING = (
    "rician_k",
    "doppler_spread_hz",
    "window_samples",
    "sampling_hz",
    "spatial_correlation",
    "los_phase",
    "continuity",
)
"""All that the fading of a swarm that hovers depends on."""

WindowPower = Callable[[Float[Tensor, "chase sample tracker"]], Float[Tensor, "chase tracker"]]
"""One level in dBm of each tracker for a window in dBm; if all samples rise by 1 dB, so does the level."""


@dataclass(frozen=True)
class FadingLaw:
    """The joint law of what fading adds to the six trackers' levels in a window, in dB."""

    normal: Float[Tensor, "level"]
    """The standard normal that a level stands for, level by level of the table."""
    log_slope: Float[Tensor, "level"]
    """The logarithm of its derivative by dB: the Jacobian of the map."""
    correlation: float
    """Between the normals of two trackers."""
    least_log_likelihood: float
    """The lowest log likelihood that any of the windows had."""

    def log_likelihood(
        self, fading_db: Float[Tensor, "chase tracker hypothesis"], heard: Bool[Tensor, "chase tracker"]
    ) -> Float[Tensor, "chase hypothesis"]:
        """The logarithm of the density of these fadings, up to a constant; only trackers that ``heard`` count."""
        level = ((fading_db - LOWEST_DB) / TABLE_STEP_DB).round_().clamp_(0, len(self.normal) - 1).to(torch.int32)
        counts = heard[:, :, None]
        # index_select is five times as fast as an index in brackets.
        normal, log_slope = (
            torch.where(counts, table.index_select(0, level.flatten()).view_as(fading_db), 0.0)
            for table in (self.normal, self.log_slope)
        )
        log_slope = log_slope.sum(dim=1)
        # The correlation matrix (1 - c) I + c 1 1^T of as many trackers as have heard something has the variance 1 - c
        # apart from their mean and 1 + (k - 1) c along it. (With 1 1^T subtracted as a whole nothing but rounding would
        # be left where c is nearly 1.)
        num_heard = heard.sum(dim=1, keepdim=True)
        mean = normal.sum(dim=1) / num_heard.clamp(min=1)
        apart = torch.where(counts, normal - mean[:, None], 0.0).square().sum(dim=1)
        along = num_heard * mean.square()
        return log_slope - 0.5 * (apart / (1 - self.correlation) + along / (1 + (num_heard - 1) * self.correlation))

    @property
    def median_db(self) -> float:
        """Of one tracker's fading."""
        return LOWEST_DB + TABLE_STEP_DB * int(torch.searchsorted(self.normal, 0.0))

    @property
    def standard_deviation_db(self) -> float:
        """Of one tracker's fading: half of the way between the normals -1 and 1."""
        low, high = torch.searchsorted(self.normal, torch.tensor([-1.0, 1.0]))
        return float(high - low) * TABLE_STEP_DB / 2


def fading_law(scenario: Scenario, window_power: WindowPower = mean_power_dbm) -> FadingLaw:
    """The law under a scenario's channel, from ``LAW_WINDOWS`` windows drawn with streams of its own.

    It is drawn once in a process for what it is a function of: the scenario's fading and the ``window_power``, which is
    compared by ``==``. Its tensors are not to be changed.
    """
    return _drawn_law(tuple(getattr(scenario, name) for name in _FIELDS_OF_FADING), window_power)


@functools.lru_cache(maxsize=32)
def _drawn_law(fields: tuple[Any, ...], window_power: WindowPower) -> FadingLaw:
    """Of a scenario with these values of ``_FIELDS_OF_FADING``."""
    from scipy.interpolate import PchipInterpolator
    from scipy.special import ndtr

    scenario = paper_scenario(**dict(zip(_FIELDS_OF_FADING, fields, strict=True)))
    fading_db = _drawn_fading_db(scenario, window_power)
    knot = np.arange(-MOST_NORMAL, MOST_NORMAL + KNOT_STEP / 2, KNOT_STEP)
    quantile_db = np.quantile(fading_db, ndtr(knot))
    inner = PchipInterpolator(quantile_db, knot)
    level_db = np.arange(LOWEST_DB, HIGHEST_DB, TABLE_STEP_DB)
    inside = np.clip(level_db, quantile_db[0], quantile_db[-1])
    slope = inner.derivative()(inside)
    ends = np.array([_chord(knot, quantile_db, slice(0, 4)), _chord(knot, quantile_db, slice(-4, None))])
    slope = np.where(level_db < quantile_db[0], ends[0], np.where(level_db > quantile_db[-1], ends[1], slope))
    normal = inner(inside) + slope * (level_db - inside)
    normals = np.interp(fading_db, level_db, normal)
    pairs = np.corrcoef(normals.T)[np.triu_indices(NUM_TRACKERS, 1)]
    law = FadingLaw(
        normal=torch.from_numpy(normal).float(),
        log_slope=torch.from_numpy(np.log(slope.clip(min=1e-3))).float(),
        correlation=float(pairs.mean()),
        least_log_likelihood=-math.inf,
    )
    windows = torch.from_numpy(fading_db).float()
    log_likelihood = law.log_likelihood(windows[..., None], torch.ones_like(windows, dtype=torch.bool))
    return dataclasses.replace(law, least_log_likelihood=float(log_likelihood.min()))


def _drawn_fading_db(
    scenario: Scenario, window_power: WindowPower
) -> "np.ndarray[tuple[int, int], np.dtype[np.float64]]":
    """What fading adds to six trackers' levels in ``LAW_WINDOWS`` windows, spread to ``LEAST_SPREAD_DB``."""
    process = fading_process(scenario)
    time_s = window_time_s(scenario, torch.zeros(1000, dtype=torch.float64))
    drawn = []
    for first in range(0, LAW_WINDOWS, 1000):
        window, _ = process.gain(process.begin(chase_keys(LAW_SEED, 1000, first)), time_s)
        drawn.append(window_power(samples_db(window).transpose(1, 2)))
    fading_db = np.asarray(torch.cat(drawn).double().numpy())
    apart_db = fading_db - fading_db.mean(axis=1, keepdims=True)
    missing = LEAST_SPREAD_DB**2 - apart_db.var() * NUM_TRACKERS / (NUM_TRACKERS - 1)
    if missing > 0:
        fading_db += math.sqrt(missing) * np.random.default_rng(LAW_SEED).standard_normal(fading_db.shape)
    return fading_db


def _chord(knot: "np.ndarray", quantile_db: "np.ndarray", part: slice) -> float:
    """The slope of a straight line through the outermost knots."""
    return float(np.ptp(knot[part]) / np.ptp(quantile_db[part]))
