"""What places of the target are worth when power, exponent, receivers and shadowing are unknown: as by brute force.

The brute force writes every level as one Gaussian vector and asks SciPy and NumPy; the product eliminates what is
common to all places first.
"""

import itertools
import math

import numpy as np
import pytest
import torch

from swarmchase.controllers.unknown_channel import (
    DEGREES_OF_FREEDOM,
    EXPONENT_SPREAD,
    PAIRS,
    TOLD_SHARE,
    Eliminated,
    Errors,
    FadingErrors,
    FieldErrors,
    Levels,
    has_offsets,
    levels,
    power_db,
    residual_and_slope,
    wrong_receiver,
)

WINDOWS, PLACES, EXPONENT = 4, 3, 2.6
LENGTH_M, SPREAD_DB = 10.0, 2.5


class _Chase:
    """Levels heard in four windows, two of them missing, and three places."""

    def __init__(self, seed: int = 1) -> None:
        draw = np.random.default_rng(seed)
        self.tracker_m = 20 * draw.standard_normal((WINDOWS, 6, 3))
        self.place_m = 60 * draw.standard_normal((3, PLACES))
        self.apart_db = 0.5 + draw.random((WINDOWS, 6))
        self.together_db = 0.5 + draw.random(WINDOWS)
        distance_m = np.linalg.norm(self.tracker_m[..., None] - self.place_m, axis=2)
        self.log_distance = np.log10(distance_m)
        self.excess_db = 4 - 10 * EXPONENT * self.log_distance[..., 0] + 3 * draw.standard_normal((WINDOWS, 6))
        self.excess_db[1, 2] = self.excess_db[3, 5] = math.nan

    @property
    def heard(self) -> Levels:
        return levels(*(torch.from_numpy(part).float() for part in (self.excess_db, self.apart_db, self.together_db)))

    def residual_and_slope(self) -> tuple[torch.Tensor, torch.Tensor]:
        return residual_and_slope(self.heard, EXPONENT, torch.from_numpy(self.log_distance).float())

    def errors(self, kind: str) -> Errors:
        if kind == "fading":
            return FadingErrors(self.heard)
        return FieldErrors(self.heard, torch.from_numpy(self.tracker_m).float(), LENGTH_M, SPREAD_DB)

    def gaussian(self, kind: str, place: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Residual, errors' covariance, and what the u_t and the exponent do to each level that was heard."""
        is_heard = np.isfinite(self.excess_db).flatten()
        window = np.repeat(np.arange(WINDOWS), 6)[is_heard]
        covariance = np.diag(self.apart_db.flatten()[is_heard] ** 2)
        covariance += (window[:, None] == window) * self.together_db[window] ** 2
        if kind == "field":
            place_m = self.tracker_m.reshape(-1, 3)[is_heard]
            apart_m = np.linalg.norm(place_m[:, None] - place_m, axis=2)
            covariance += SPREAD_DB**2 * np.exp(-apart_m / LENGTH_M)
        slope = -10 * self.log_distance[..., place].flatten()[is_heard]
        residual = self.excess_db.flatten()[is_heard] - EXPONENT * slope
        by_tracker = np.eye(6)[np.tile(np.arange(6), WINDOWS)][is_heard]
        return residual, covariance, by_tracker, slope


def _prior_covariance(pair: int) -> np.ndarray:
    return np.diag(np.square(PAIRS[pair].offset_db)) + PAIRS[pair].power_db ** 2


@pytest.mark.parametrize("kind", ["fading", "field"])
def test_places_are_worth_what_one_great_gaussian_says(kind: str) -> None:
    chase = _Chase()
    found = Eliminated(chase.errors(kind), math.log(0.3)).log_likelihoods(*chase.residual_and_slope()).double().numpy()
    expected = np.empty((len(PAIRS), 2, PLACES))
    for pair, is_off, place in itertools.product(range(len(PAIRS)), range(2), range(PLACES)):
        residual, errors, by_tracker, slope = chase.gaussian(kind, place)
        total = errors + by_tracker @ _prior_covariance(pair) @ by_tracker.T
        total += is_off * EXPONENT_SPREAD**2 * np.outer(slope, slope)
        squared = residual @ np.linalg.solve(total, residual)
        freedom = DEGREES_OF_FREEDOM
        student = -(freedom + len(residual)) / 2 * np.log1p(squared / freedom) - np.linalg.slogdet(total)[1] / 2
        prior = PAIRS[pair].prior * (1 - TOLD_SHARE if is_off else TOLD_SHARE) * 0.3
        expected[pair, is_off, place] = math.log(prior) + student
    # The determinant of the fading alone is the same for all models and places, and left out.
    left_out = found[0, 0, 0] - expected[0, 0, 0]
    _, fading, _, _ = chase.gaussian("fading", 0)
    assert left_out == pytest.approx(np.linalg.slogdet(fading)[1] / 2, abs=2e-3)
    np.testing.assert_allclose(found - left_out, expected, atol=5e-3)


def test_some_pairs_are_worth_what_they_are_among_all() -> None:
    chase = _Chase(2)
    chosen = torch.tensor([0, 5, 17])
    some = Eliminated(chase.errors("fading"), 0.0).of(chosen).log_likelihoods(*chase.residual_and_slope())
    every = Eliminated(chase.errors("fading"), 0.0).log_likelihoods(*chase.residual_and_slope())
    torch.testing.assert_close(some, every[chosen])


@pytest.mark.parametrize("kind", ["fading", "field"])
def test_what_is_found_of_power_offsets_and_exponent_is_the_gaussian_s_mean(kind: str) -> None:
    chase = _Chase(3)
    models = Eliminated(chase.errors(kind), 0.0)
    residual, slope = (part[..., :1] for part in chase.residual_and_slope())
    level_db, exponent_error = models.found(residual, slope)
    power = power_db(level_db, models.pairs)
    r, errors, by_tracker, s = chase.gaussian(kind, 0)
    for pair in (0, 3, 9, len(PAIRS) - 1):
        # Unknown: power, six offsets, the exponent's error.
        design = np.column_stack([np.ones(len(r)), by_tracker, s])
        prior = np.diag([PAIRS[pair].power_db ** 2, *np.square(PAIRS[pair].offset_db), EXPONENT_SPREAD**2])
        mean = prior @ design.T @ np.linalg.solve(design @ prior @ design.T + errors, r)
        assert power[pair, 1] == pytest.approx(mean[0], abs=0.02)
        np.testing.assert_allclose(level_db[pair, 1] - power[pair, 1], mean[1:7], atol=0.02)
        assert exponent_error[pair, 1] == pytest.approx(mean[7], abs=2e-3)
        assert exponent_error[pair, 0] == 0


def test_the_priors_are_probabilities_and_each_receiver_has_its_own_models() -> None:
    assert sum(pair.prior for pair in PAIRS) == pytest.approx(1)
    assert wrong_receiver().sum(dim=1).tolist() == [4.0] * 6
    wrong = wrong_receiver().any(dim=0)
    assert not (wrong & has_offsets()).any()
    as_told = ~wrong & ~has_offsets()
    assert as_told.sum() == 2  # power as told, and not
    assert sum(pair.prior for pair, plain in zip(PAIRS, as_told.tolist(), strict=True) if plain) == pytest.approx(0.7)
