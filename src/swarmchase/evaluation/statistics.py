"""Statistics of many chases: percentiles by nearest rank, and 95 % confidence intervals."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

CONFIDENCE = 0.95
TAIL = (1 - CONFIDENCE) / 2
"""The share on either side of an interval."""
NORMAL_QUANTILE = 1.959964
"""Of (1 + CONFIDENCE) / 2."""


def nearest_rank_percentile(values: Sequence[float | int] | NDArray[Any], percent: float | int) -> float:
    """The smallest value that at least ``percent`` % of the values do not exceed."""
    return float(nearest_rank_percentiles(np.asarray(values)[None], percent)[0])


def nearest_rank_percentiles(values: NDArray[Any], percent: float | int) -> NDArray[Any]:
    """The same of each row of ``values`` [row, value]: [row], of their type."""
    rank = max(0, math.ceil(percent * values.shape[1] / 100) - 1)
    percentiles: NDArray[Any] = np.partition(values, rank, axis=1)[:, rank]
    return percentiles


def percentile_interval(values: NDArray[Any], percent: float | int) -> list[float]:
    """A 95 % confidence interval of a percentile from order statistics: binomial, whatever the distribution.

    It never leaves the range of the values, so of a few values it covers the percentile less often.
    """
    from scipy.stats import binom

    ordered = np.sort(values)
    low = int(binom.ppf(TAIL, len(ordered), percent / 100))
    high = int(binom.ppf(1 - TAIL, len(ordered), percent / 100)) + 1
    return [float(ordered[max(0, low - 1)]), float(ordered[min(len(ordered) - 1, high - 1)])]


def mean_interval(values: NDArray[Any]) -> list[float] | None:
    """A 95 % confidence interval of the mean, normal approximation; None for one value, which has no spread."""
    if len(values) < 2:
        return None
    half_width = NORMAL_QUANTILE * float(values.std(ddof=1)) / math.sqrt(len(values))
    return [float(values.mean()) - half_width, float(values.mean()) + half_width]


def ratio_interval(part: NDArray[Any], whole: NDArray[Any]) -> list[float] | None:
    """A 95 % confidence interval of the share sum(part) / sum(whole) over independent chases, normal approximation of a
    ratio's error (Cochran 1977); None for one chase, which has no spread. What is of one chase need not be independent.
    """
    number, ratio = len(part), part.sum() / whole.sum()
    if number < 2:
        return None
    variance = number / (number - 1) * np.square(part - ratio * whole).sum() / whole.sum() ** 2
    half_width = NORMAL_QUANTILE * math.sqrt(variance)
    return [max(0.0, float(ratio) - half_width), min(1.0, float(ratio) + half_width)]


def share_interval(number: int, of: int) -> list[float]:
    """Clopper and Pearson's exact 95 % confidence interval of a share, of which ``number`` of ``of`` were seen."""
    from scipy.stats import binomtest

    interval = binomtest(number, of).proportion_ci(CONFIDENCE, method="exact")
    return [float(interval.low), float(interval.high)]
