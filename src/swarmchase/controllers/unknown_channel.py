"""How probable a place of the target makes all that was heard, when transmit power, path-loss exponent, receivers and
shadowing are not known: they are integrated out.

In dB a level is linear in what is not known. Of tracker t in window w, with the target at the distance d (Eqs. 1-2),

    level = reference - 10 n log10 d + u_t - 10 x log10 d + shadowing + fading,

u_t the excess of transmit power plus the receiver's offset and x the error of the exponent n. All have Gaussian priors,
so for a place of the target the likelihood has a closed form (Bishop 2006, Pattern recognition and machine learning,
chapter 2.3). What the six u_t have to do with the levels is the same for all places: they are eliminated once, and a
place costs a handful of sums.

Which prior holds is not known either: ``PAIRS`` lists them, and each is weighed by its evidence. That the errors may be
misjudged as a whole makes the likelihood a Student's t with ``DEGREES_OF_FREEDOM``.
"""

import copy
import itertools
import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch

from ..batch.array_types import Bool, Float, Int, Tensor
from ..scenario import NUM_TRACKERS

DEGREES_OF_FREEDOM = 60.0
"""As if the errors' spread had been learned from so many levels beforehand."""
TOLD_SHARE = 0.7
"""Probability that the transmit power is as told; that the exponent is; that receivers are without offsets."""
POWER_SPREADS_DB = (0.3, 7.0)
"""Standard deviation of the transmit power about what is told: where it is as told, and where it is not."""
EXPONENT_SPREAD = 0.4
"""Of the exponent, where it is not as told."""
OFFSET_SPREADS_DB = (0.2, 2.0, 5.0, 15.0)
"""Of receivers' offsets: none, and more and more."""
WRONG_BY_DB = 20.0
"""Of one receiver that is plainly wrong."""
FIELDS = ((2.0, 4.0), (2.0, 8.0), (7.0, 3.0), (7.0, 6.0), (25.0, 3.0), (25.0, 6.0))
"""Shadowing as a field over the trackers' places: in metres, over which its correlation falls to 1 / e (Gudmundson
1991), and its standard deviation in dB. A part that surrounds the target is the same everywhere: it is transmit power.
"""
FIELD_TRUST = 0.7
"""Real shadowing is no such field: where there is one, a place's likelihood counts to this power (Miller and Dunson
2019, Robust Bayesian inference via coarsening). The whole of it is too sure on recordings."""


@dataclass(frozen=True)
class Pair:
    """Standard deviations of what is not known, in two models: the exponent is as told, and it is not."""

    prior: float
    power_db: float
    offset_db: tuple[float, ...]
    """Of each receiver."""
    wrong: int | None
    """The receiver that is plainly wrong."""


def _pairs() -> tuple[Pair, ...]:
    off = 1 - TOLD_SHARE
    # Of what is not as told, half are offsets of all receivers and half one receiver alone.
    receivers: list[tuple[float, tuple[float, ...], int | None]] = [
        (TOLD_SHARE, (OFFSET_SPREADS_DB[0],) * NUM_TRACKERS, None)
    ]
    others = OFFSET_SPREADS_DB[1:]
    receivers += [(off / 2 / len(others), (offset_db,) * NUM_TRACKERS, None) for offset_db in others]
    for wrong, offset_db in itertools.product(range(NUM_TRACKERS), OFFSET_SPREADS_DB[:2]):
        one = tuple(WRONG_BY_DB if tracker == wrong else offset_db for tracker in range(NUM_TRACKERS))
        receivers.append((off / 2 / NUM_TRACKERS / 2, one, wrong))
    powers = zip(POWER_SPREADS_DB, (TOLD_SHARE, off), strict=True)
    return tuple(
        Pair(prior * power_prior, power_db, offset_db, wrong)
        for (power_db, power_prior), (prior, offset_db, wrong) in itertools.product(powers, receivers)
    )


PAIRS = _pairs()
_LOG_PRIOR = torch.tensor([[pair.prior * TOLD_SHARE, pair.prior * (1 - TOLD_SHARE)] for pair in PAIRS]).double().log()
_COVARIANCE = torch.stack([torch.tensor(pair.offset_db).double().square().diag() + pair.power_db**2 for pair in PAIRS])
"""Of the u_t."""


@dataclass(frozen=True)
class Levels:
    """All that was heard, each level less the fading that is expected in it."""

    excess_db: Float[Tensor, "window 6"]
    """Above the reference level; 0 of a tracker that was not heard."""
    precision: Float[Tensor, "window 6"]
    """1 / variance of the fading that each tracker has alone; 0 of one that was not heard."""
    together_db: Float[Tensor, "window"]
    """Standard deviation of the fading that the trackers have in common."""


@dataclass(frozen=True)
class Sums:
    """What a place costs before anything is eliminated. The residual r is what is left of the levels without the path
    loss to the place, the slope s what an exponent one larger takes off them; products are by the inverse of the
    errors' covariance."""

    rr: Float[Tensor, "place"]
    rs: Float[Tensor, "place"]
    ss: Float[Tensor, "place"]
    r_by_tracker: Float[Tensor, "6 place"]
    s_by_tracker: Float[Tensor, "6 place"]


@runtime_checkable
class Errors(Protocol):
    """The law of the levels' errors, which is the same for all places."""

    information: Float[Tensor, "6 6"]
    """Of the u_t, float64."""
    log_determinant: float
    """Of the errors' covariance, over that of the fading alone."""
    number: int
    """Of levels."""

    def sums(self, residual: Float[Tensor, "window 6 place"], slope: Float[Tensor, "window 6 place"]) -> Sums:
        """Of each place."""


def levels(
    excess_db: Float[Tensor, "window 6"], apart_db: Float[Tensor, "window 6"], together_db: Float[Tensor, "window"]
) -> Levels:
    """Of levels above the reference (NaN: not heard), with the law of their fading."""
    is_heard = excess_db.isfinite()
    precision = torch.where(is_heard, apart_db.square().reciprocal(), 0.0)
    return Levels(excess_db.nan_to_num(0.0), precision, together_db)


def residual_and_slope(
    heard: Levels, exponent: float, log_distance: Float[Tensor, "window 6 place"]
) -> tuple[Float[Tensor, "window 6 place"], Float[Tensor, "window 6 place"]]:
    """What ``Sums`` are of.

    Args:
        heard: all levels.
        exponent: of the path loss, as told.
        log_distance: decimal, of the distance from each tracker in each window to each place over d_0.
    """
    slope = -10 * log_distance
    return heard.excess_db[..., None] - exponent * slope, slope


class FadingErrors:
    """The fading's alone: windows by themselves, each with the covariance 1 / p + v 1 1^T."""

    def __init__(self, heard: Levels) -> None:
        self._precision = heard.precision
        variance = heard.together_db.square()
        self._shared = variance / (1 + variance * heard.precision.sum(dim=1))
        precision = heard.precision.double()
        self.information = precision.sum(dim=0).diag() - (precision * self._shared.double()[:, None]).T @ precision
        self.log_determinant = 0.0
        self.number = int((heard.precision > 0).sum())

    def sums(self, residual: Float[Tensor, "window 6 place"], slope: Float[Tensor, "window 6 place"]) -> Sums:
        """The inverse of a window's covariance is diag(p) - shared p p^T (Sherman and Morrison 1950)."""
        shared = self._shared[:, None]
        r, s = self._precision[..., None] * residual, self._precision[..., None] * slope
        sum_r, sum_s = r.sum(dim=1), s.sum(dim=1)
        together = (self._precision * shared).T
        return Sums(
            rr=(residual * r).sum(dim=(0, 1)) - (shared * sum_r.square()).sum(dim=0),
            rs=(slope * r).sum(dim=(0, 1)) - (shared * sum_r * sum_s).sum(dim=0),
            ss=(slope * s).sum(dim=(0, 1)) - (shared * sum_s.square()).sum(dim=0),
            r_by_tracker=r.sum(dim=0) - together @ sum_r,
            s_by_tracker=s.sum(dim=0) - together @ sum_s,
        )


class FieldErrors:
    """The fading's, and those of a field of shadowing that all windows share: a level that is too low here is too low
    when a tracker comes back, and counts once."""

    def __init__(
        self, heard: Levels, tracker_position_m: Float[Tensor, "window 6 3"], length_m: float, spread_db: float
    ) -> None:
        self._is_heard = (heard.precision > 0).flatten()
        precision = heard.precision.flatten()[self._is_heard].double()
        place_m = tracker_position_m.flatten(0, 1)[self._is_heard].double()
        window = torch.arange(len(heard.precision)).repeat_interleave(NUM_TRACKERS)[self._is_heard]
        variance = heard.together_db.double().square()
        together = torch.where(window[:, None] == window, variance[window], 0.0)
        field = spread_db**2 * (-torch.cdist(place_m, place_m) / length_m).exp()
        factor = torch.linalg.cholesky(precision.reciprocal().diag() + together + field)
        self._inverse = torch.cholesky_inverse(factor).float()
        without_field = (1 + variance * heard.precision.double().sum(dim=1)).log().sum() - precision.log().sum()
        tracker = torch.arange(NUM_TRACKERS).repeat(len(heard.precision))[self._is_heard]
        self._by_tracker = (tracker == torch.arange(NUM_TRACKERS)[:, None]).float()
        self.information = (self._by_tracker @ self._inverse @ self._by_tracker.T).double()
        self.log_determinant = float(2 * factor.diagonal().log().sum() - without_field)
        self.number = len(precision)

    def sums(self, residual: Float[Tensor, "window 6 place"], slope: Float[Tensor, "window 6 place"]) -> Sums:
        """By the whole matrix."""
        residual, slope = residual.flatten(0, 1)[self._is_heard], slope.flatten(0, 1)[self._is_heard]
        r, s = (self._inverse @ torch.stack([residual, slope])).unbind()
        return Sums(
            rr=(residual * r).sum(dim=0),
            rs=(slope * r).sum(dim=0),
            ss=(slope * s).sum(dim=0),
            r_by_tracker=self._by_tracker @ r,
            s_by_tracker=self._by_tracker @ s,
        )


class Eliminated:
    """Models joined with one law of the errors: all that is the same for every place is worked out."""

    def __init__(self, errors: Errors, log_share: float) -> None:
        """All ``PAIRS``; ``log_share`` is the prior of this law of the errors."""
        self._errors = errors
        self.pairs = torch.arange(len(PAIRS))
        grown = torch.eye(NUM_TRACKERS, dtype=torch.float64) + _COVARIANCE @ errors.information
        self._gain = torch.linalg.solve(grown, _COVARIANCE).float()
        log_determinant = grown.logdet()[:, None] + errors.log_determinant
        self._constant = (_LOG_PRIOR + log_share - log_determinant / 2).float()[..., None]
        self._power = -(DEGREES_OF_FREEDOM + errors.number) / 2

    def of(self, pairs: Int[Tensor, "pair"]) -> "Eliminated":
        """These numbers of ``PAIRS`` alone."""
        some = copy.copy(self)
        some.pairs, some._gain, some._constant = pairs, self._gain[pairs], self._constant[pairs]
        return some

    def log_likelihoods(
        self, residual: Float[Tensor, "window 6 place"], slope: Float[Tensor, "window 6 place"]
    ) -> Float[Tensor, "pair 2 place"]:
        """Of all that was heard if the target were at each place, in each model, with the models' priors."""
        sums = self._errors.sums(residual, slope)
        explained = self._gain @ sums.r_by_tracker
        rr = sums.rr - (explained * sums.r_by_tracker).sum(dim=1)
        rs = sums.rs - (explained * sums.s_by_tracker).sum(dim=1)
        ss = (sums.ss - ((self._gain @ sums.s_by_tracker) * sums.s_by_tracker).sum(dim=1)).clamp_(min=0.0)
        grows = 1 + EXPONENT_SPREAD**2 * ss
        squared = torch.stack([rr, rr - EXPONENT_SPREAD**2 * rs.square_() / grows], dim=1).clamp_(min=0.0)
        likely = squared.mul_(1 / DEGREES_OF_FREEDOM).log1p_().mul_(self._power).add_(self._constant)
        likely[:, 1] -= grows.log_().mul_(0.5)
        return likely

    def found(
        self, residual: Float[Tensor, "window 6 1"], slope: Float[Tensor, "window 6 1"]
    ) -> tuple[Float[Tensor, "pair 2 6"], Float[Tensor, "pair 2"]]:
        """What is to be expected of the u_t in dB, and of the exponent's error, if the target is at this place."""
        sums = self._errors.sums(residual, slope)
        explained, slopes = (self._gain @ part[:, 0] for part in (sums.r_by_tracker, sums.s_by_tracker))
        rs = sums.rs - explained @ sums.s_by_tracker[:, 0]
        ss = (sums.ss - slopes @ sums.s_by_tracker[:, 0]).clamp_(min=0.0)
        error = EXPONENT_SPREAD**2 * rs / (1 + EXPONENT_SPREAD**2 * ss)
        return torch.stack([explained, explained - error[:, None] * slopes], dim=1), torch.stack(
            [torch.zeros_like(error), error], dim=1
        )


def power_db(level_db: Float[Tensor, "pair 2 6"], pairs: Int[Tensor, "pair"]) -> Float[Tensor, "pair 2"]:
    """The part of the u_t that is transmit power, by the priors."""
    weight = torch.linalg.solve(_COVARIANCE[pairs], torch.ones(len(pairs), NUM_TRACKERS).double())
    power_variance = torch.tensor([PAIRS[pair].power_db ** 2 for pair in pairs.tolist()]).double()
    expected_db: Tensor = (power_variance[:, None] * (level_db.double() @ weight[..., None])[..., 0]).float()
    return expected_db


def has_offsets() -> Bool[Tensor, "pair"]:
    """Pairs in which all receivers have an offset."""
    return torch.tensor([pair.wrong is None and pair.offset_db[0] > OFFSET_SPREADS_DB[0] for pair in PAIRS])


def wrong_receiver() -> Float[Tensor, "6 pair"]:
    """1 for each receiver in the pairs where it is plainly wrong."""
    return torch.tensor([[float(pair.wrong == tracker) for pair in PAIRS] for tracker in range(NUM_TRACKERS)])


LOG_PLAIN, LOG_FIELD = math.log(0.85), math.log(0.15)
"""Prior that there is no shadowing, and that there is."""
