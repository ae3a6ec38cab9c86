"""How probable a place of the target makes all that was heard, when transmit power, path-loss exponent and receivers are
not known: they are integrated out.

In dB a level is linear in what is not known. Of tracker t in window w, with the target at the distance d (Eqs. 1-2),

    level = reference - 10 n log10 d + u_t - 10 x log10 d + shadowing + fading,

u_t the excess of transmit power plus the receiver's offset and x the error of the exponent n. All have Gaussian priors,
so for a place of the target the likelihood has a closed form. What the six u_t have to do with the places is the same
for all of them: it is eliminated once, and a place costs a handful of sums. (Bishop 2006, Pattern recognition and
machine learning, chapter 3, for the algebra.)

Which prior holds is not known either: ``MODELS`` lists them, and each is weighed by its evidence. That the fading's
spread may be misjudged as a whole makes the likelihood a Student's t with ``DEGREES_OF_FREEDOM``.
"""

import itertools
from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Int, Tensor
from ..scenario import NUM_TRACKERS

DEGREES_OF_FREEDOM = 60.0
"""As if the spread had been learned from so many values beforehand."""
TOLD_SHARE = 0.7
"""Probability that the transmit power is as told; and so for the exponent, and for receivers."""
POWER_SPREADS_DB = (0.3, 7.0)
EXPONENT_SPREADS = (0.0, 0.4)
"""As told, and not."""
OFFSET_SPREADS_DB = (0.2, 2.0, 5.0)
WRONG_BY_DB = 20.0
"""Standard deviation of a receiver that is plainly wrong."""


@dataclass(frozen=True)
class Model:
    """Standard deviations of what is not known."""

    prior: float
    power_db: float
    exponent: float
    offset_db: tuple[float, ...]
    """Of each receiver."""


def _models() -> list[Model]:
    even = [(spread_db,) * NUM_TRACKERS for spread_db in OFFSET_SPREADS_DB]
    wrong = [
        tuple(WRONG_BY_DB if other == tracker else OFFSET_SPREADS_DB[0] for other in range(NUM_TRACKERS))
        for tracker in range(NUM_TRACKERS)
    ]
    off = 1 - TOLD_SHARE
    receivers = [
        *zip(even, (TOLD_SHARE, off / 3, off / 3), strict=True),
        *((offset_db, off / 3 / NUM_TRACKERS) for offset_db in wrong),
    ]
    told = (TOLD_SHARE, 1 - TOLD_SHARE)
    return [
        Model(receivers_prior * power_prior * exponent_prior, power_db, exponent, offset_db)
        for (offset_db, receivers_prior), (power_db, power_prior), (exponent, exponent_prior) in itertools.product(
            receivers, zip(POWER_SPREADS_DB, told, strict=True), zip(EXPONENT_SPREADS, told, strict=True)
        )
    ]


MODELS = _models()
_NUM_PAIRS = len(MODELS) // 2
"""Models come in pairs that differ by the exponent alone."""
_LOG_PRIOR = torch.tensor([model.prior for model in MODELS], dtype=torch.float64).log().view(_NUM_PAIRS, 2)
_COVARIANCE = torch.stack(
    [
        torch.tensor(model.offset_db, dtype=torch.float64).square().diag() + model.power_db**2
        for model in MODELS[::2]
    ]
)
_EXPONENT_VARIANCE = EXPONENT_SPREADS[1] ** 2
assert all(model.exponent == EXPONENT_SPREADS[place % 2] for place, model in enumerate(MODELS))
OFFSETS_LIKELY = torch.tensor([model.offset_db[0] == model.offset_db[1] == model.offset_db[2] and model.offset_db[0] > OFFSET_SPREADS_DB[0] for model in MODELS])


FIELDS = tuple(itertools.product((3.0, 10.0, 30.0), (2.5, 5.0)))
"""Shadowing as a field of the trackers' places: its length in metres and its standard deviation in dB."""


@dataclass(frozen=True)
class Heard:
    """All windows of a chase, each less what its fading is expected to be."""

    excess_db: Float[Tensor, "window 6"]
    """Level above the reference level, the expected fading taken off; 0 of a tracker that was not heard."""
    precision: Float[Tensor, "window 6"]
    """1 / apart^2 of the fading; 0 of a tracker that was not heard."""
    together_db: Float[Tensor, "window"]
    """Standard deviation of the fading that the trackers have in common."""


@dataclass(frozen=True)
class Sums:
    """What a place costs before anything unknown is eliminated. The residual r is what is left of the levels without the
    path loss to the place, the slope s what an exponent one larger takes off them; both are multiplied by the inverse
    of the errors' covariance."""

    rr: Float[Tensor, "place"]
    rs: Float[Tensor, "place"]
    ss: Float[Tensor, "place"]
    r_by_tracker: Float[Tensor, "6 place"]
    s_by_tracker: Float[Tensor, "6 place"]


def heard(
    excess_db: Float[Tensor, "window 6"], apart_db: Float[Tensor, "window 6"], together_db: Float[Tensor, "window"]
) -> Heard:
    """Of levels above the reference (NaN: not heard), with the law of their fading."""
    counts = excess_db.isfinite()
    return Heard(excess_db.nan_to_num(0.0), torch.where(counts, apart_db.square().reciprocal(), 0.0), together_db)


class FadingErrors:
    """Errors of the levels that are the fading's alone: windows by themselves."""

    def __init__(self, heard: Heard) -> None:
        self._precision = heard.precision
        variance = heard.together_db.square()
        self._shared = variance / (1 + variance * heard.precision.sum(dim=1))
        precision = heard.precision.double()
        self.information = precision.sum(dim=0).diag()
        self.information -= (precision * self._shared.double()[:, None]).T @ precision
        self.number = int((heard.precision > 0).sum())
        self.log_determinant = 0.0

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
    """Errors of the levels that are the fading's and those of a field of shadowing, which all windows share."""

    def __init__(
        self, heard: Heard, tracker_position_m: Float[Tensor, "window 6 3"], length_m: float, spread_db: float
    ) -> None:
        self._counts = (heard.precision > 0).flatten()
        precision = heard.precision.flatten()[self._counts].double()
        place_m = tracker_position_m.flatten(0, 1)[self._counts].double()
        window = torch.arange(len(heard.precision)).repeat_interleave(NUM_TRACKERS)[self._counts]
        variance = heard.together_db.double().square()
        same = window[:, None] == window
        fading = precision.reciprocal().diag() + torch.where(same, variance[window], 0.0)
        errors = fading + spread_db**2 * (-torch.cdist(place_m, place_m) / length_m).exp()
        factor = torch.linalg.cholesky(errors)
        self._inverse = torch.cholesky_inverse(factor).float()
        self.log_determinant = float(
            2 * factor.diagonal().log().sum()
            + precision.log().sum()
            - (1 + variance * heard.precision.double().sum(dim=1)).log().sum()
        )
        tracker = torch.arange(NUM_TRACKERS).repeat(len(heard.precision))[self._counts]
        self._by_tracker = (tracker == torch.arange(NUM_TRACKERS)[:, None]).float()
        self.information = (self._by_tracker @ self._inverse @ self._by_tracker.T).double()
        self.number = len(precision)

    def sums(self, residual: Float[Tensor, "window 6 place"], slope: Float[Tensor, "window 6 place"]) -> Sums:
        """By the whole matrix."""
        residual, slope = residual.flatten(0, 1)[self._counts], slope.flatten(0, 1)[self._counts]
        r, s = (self._inverse @ torch.cat([residual, slope], dim=1)).split(residual.shape[1], dim=1)
        by_tracker = self._by_tracker
        return Sums(
            rr=(residual * r).sum(dim=0),
            rs=(slope * r).sum(dim=0),
            ss=(slope * s).sum(dim=0),
            r_by_tracker=by_tracker @ r,
            s_by_tracker=by_tracker @ s,
        )


def residual_and_slope(
    heard: Heard, exponent: float, log_distance: Float[Tensor, "window 6 place"]
) -> tuple[Float[Tensor, "window 6 place"], Float[Tensor, "window 6 place"]]:
    """What is left of the levels without the path loss to each place, and what an exponent one larger would change.

    Args:
        exponent: of the path loss, as told.
        log_distance: decimal, of the distance from each tracker in each window to each place over d_0.
    """
    slope = -10 * log_distance
    return heard.excess_db[..., None] - exponent * slope, slope


class Priors:
    """Some of the ``MODELS``' pairs, joined with what one kind of errors says of the trackers' own levels."""

    def __init__(self, errors: "FadingErrors | FieldErrors", pairs: Int[Tensor, "pair"] | None = None) -> None:
        self._errors = errors
        covariance = _COVARIANCE if pairs is None else _COVARIANCE[pairs]
        grown = torch.eye(NUM_TRACKERS, dtype=torch.float64) + covariance @ errors.information
        self._gain = torch.linalg.solve(grown, covariance).float()
        log_prior = _LOG_PRIOR if pairs is None else _LOG_PRIOR[pairs]
        self._constant = (log_prior - (grown.logdet()[:, None] + errors.log_determinant) / 2).float()[..., None]
        self._power = -(DEGREES_OF_FREEDOM + errors.number) / 2

    def log_likelihoods(
        self, residual: Float[Tensor, "window 6 place"], slope: Float[Tensor, "window 6 place"]
    ) -> Float[Tensor, "pair 2 place"]:
        """Of everything heard if the target were at each place, with the models' priors."""
        sums = self._errors.sums(residual, slope)
        explained = self._gain @ sums.r_by_tracker
        rr = sums.rr - (explained * sums.r_by_tracker).sum(dim=1)
        rs = sums.rs - (explained * sums.s_by_tracker).sum(dim=1)
        ss = (sums.ss - ((self._gain @ sums.s_by_tracker) * sums.s_by_tracker).sum(dim=1)).clamp_(min=0.0)
        grows = 1 + _EXPONENT_VARIANCE * ss
        squared = torch.stack([rr, rr - _EXPONENT_VARIANCE * rs.square_() / grows], dim=1).clamp_(min=0.0)
        likely = squared.mul_(1 / DEGREES_OF_FREEDOM).log1p_().mul_(self._power).add_(self._constant)
        likely[:, 1] -= grows.log_().mul_(0.5)
        return likely
