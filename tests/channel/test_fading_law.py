"""The law of a window's mean powers: against the exact law of one sample, scipy's normal, and windows never seen."""

import itertools
import math

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal, ncx2, norm

from swarmchase.batch.streams import chase_keys
from swarmchase.channel.fading_law import HIGHEST_DB, LEAST_SPREAD_DB, LOWEST_DB, TABLE_STEP_DB, FadingLaw, fading_law
from swarmchase.channel.fading_process import first_window
from swarmchase.scenario import Scenario, paper_scenario

EVERYONE = torch.ones(1, 6, dtype=torch.bool)


def told(sampling_hz: float, rho: float) -> Scenario:
    return paper_scenario(sampling_hz=sampling_hz, spatial_correlation=rho)


def normal_at(law: FadingLaw, level_db: float) -> float:
    return law.normal[round((level_db - LOWEST_DB) / TABLE_STEP_DB)].item()


def drawn_db(scenario: Scenario, seed: int, num_windows: int) -> np.ndarray:
    """The mean fading power of so many windows at six trackers."""
    parts = [
        10 * first_window(scenario, chase_keys(seed, 500, first)).square().sum(dim=2).mean(dim=2).log10()
        for first in range(0, num_windows, 500)
    ]
    return torch.cat(parts).double().numpy()


@pytest.mark.parametrize("rician_k", [0.0, 1.0, 3.0, 10.0])
def test_of_one_sample_it_is_rician(rician_k: float) -> None:
    """|h|^2 times 2 (K + 1) is a non-central chi-square of two degrees and non-centrality 2 K.

    Of 120,000 draws the normal of a level is known to sqrt(p (1 - p) / 120,000) / density: 0.003 to 0.02.
    """
    law = fading_law(paper_scenario(rician_k=rician_k, window_samples=1, spatial_correlation=0))
    compared = 0
    for level_db in range(-30, 12):
        exact = norm.ppf(ncx2.cdf(2 * (rician_k + 1) * 10 ** (level_db / 10), 2, max(2 * rician_k, 1e-12)))
        if abs(exact) < 3:
            share = norm.cdf(exact)
            standard_error = math.sqrt(share * (1 - share) / 120_000) / norm.pdf(exact)
            assert normal_at(law, level_db) == pytest.approx(exact, abs=4 * standard_error + 0.01), level_db
            compared += 1
    assert compared >= 8


@pytest.mark.parametrize("scenario", [told(100, 0.1), told(10, 0.9), paper_scenario(window_samples=1, rician_k=0)])
def test_the_density_of_one_tracker_is_a_density(scenario: Scenario) -> None:
    law = fading_law(scenario)
    level_db = LOWEST_DB + TABLE_STEP_DB * torch.arange(len(law.normal)).float()
    alone = torch.zeros(1, 6, dtype=torch.bool)
    for tracker in range(6):
        heard = alone.clone()
        heard[0, tracker] = True
        # Only the tracker that was heard counts: the others' levels are nonsense.
        fading_db = torch.full((1, 6, len(level_db)), 17.0)
        fading_db[0, tracker] = level_db
        density = law.log_likelihood(fading_db, heard)[0].double().exp() / math.sqrt(2 * math.pi)
        assert density.sum().item() * TABLE_STEP_DB == pytest.approx(1, abs=2e-3)
    assert level_db[-1].item() == pytest.approx(HIGHEST_DB - TABLE_STEP_DB, abs=1e-3)


@pytest.mark.parametrize("num_heard", range(1, 7))
@pytest.mark.parametrize(("sampling_hz", "rho"), [(100, 0.1), (10, 0.9)])
def test_of_those_heard_it_is_a_normal_of_as_many_dimensions(sampling_hz: float, rho: float, num_heard: int) -> None:
    """With the map's derivative, here a central difference; up to the constant that belongs to a density."""
    law = fading_law(told(sampling_hz, rho))
    level_db = LOWEST_DB + TABLE_STEP_DB * np.arange(len(law.normal))
    normal_of_level = law.normal.double().numpy()
    slope_of_level = np.gradient(normal_of_level, TABLE_STEP_DB)
    fading_db = np.random.default_rng(num_heard).uniform(-9, 4, (6, 40)).round(2)
    covariance = np.full((num_heard, num_heard), law.correlation)
    np.fill_diagonal(covariance, 1)
    constant = num_heard / 2 * math.log(2 * math.pi) + np.linalg.slogdet(covariance)[1] / 2
    for those in itertools.islice(itertools.combinations(range(6), num_heard), 6):
        normal = np.interp(fading_db[list(those)], level_db, normal_of_level)
        jacobian = np.log(np.interp(fading_db[list(those)], level_db, slope_of_level)).sum(axis=0)
        expected = multivariate_normal(np.zeros(num_heard), covariance).logpdf(normal.T) + jacobian + constant
        heard = torch.zeros(1, 6, dtype=torch.bool)
        heard[0, list(those)] = True
        found = law.log_likelihood(torch.tensor(fading_db).float()[None], heard)[0]
        np.testing.assert_allclose(found.numpy(), expected, atol=0.05, rtol=0.002)


def test_who_was_heard_is_each_chase_s_own() -> None:
    law = fading_law(told(100, 0.1))
    heard = torch.rand(20, 6, generator=torch.Generator().manual_seed(1)) < 0.5
    fading_db = 3 * torch.randn(20, 6, 7, generator=torch.Generator().manual_seed(2))
    whole = law.log_likelihood(fading_db, heard)
    for row in range(20):
        assert torch.equal(law.log_likelihood(fading_db[row : row + 1], heard[row : row + 1]), whole[row : row + 1])
    assert law.log_likelihood(fading_db, torch.zeros_like(heard)).tolist() == [[0] * 7] * 20


def test_what_lies_outside_the_table_counts_as_its_end() -> None:
    law = fading_law(told(100, 0.1))
    levels_db = torch.tensor([LOWEST_DB, -1e9, -math.inf, HIGHEST_DB - TABLE_STEP_DB, 1e9, math.inf])
    low, lower, lowest, high, higher, highest = law.log_likelihood(levels_db.expand(1, 6, 6).clone(), EVERYONE)[0]
    assert low == lower == lowest
    assert high == higher == highest
    assert math.isfinite(low)
    assert math.isfinite(high)


def test_the_correlation_grows_with_rho() -> None:
    """At K = 3 the power of a sample has (2 K rho + rho^2) / (2 K + 1): 0, .087, .464, .887; so nearly has its map."""
    found = [
        fading_law(paper_scenario(window_samples=1, spatial_correlation=rho)).correlation for rho in (0, 0.1, 0.5, 0.9)
    ]
    assert found == pytest.approx([0, 0.087, 0.464, 0.887], abs=0.02)
    assert found == sorted(found)
    assert abs(fading_law(told(100, 0.0)).correlation) < 0.01


@pytest.mark.parametrize(("sampling_hz", "rho"), [(100, 0.1), (10, 0.9)])
def test_median_and_spread_are_those_of_other_windows(sampling_hz: float, rho: float) -> None:
    """Of 24,000 values that hang together by six."""
    law = fading_law(told(sampling_hz, rho))
    low_db, median_db, high_db = np.quantile(drawn_db(told(sampling_hz, rho), 5, 4000), norm.cdf([-1, 0, 1]))
    assert law.median_db == pytest.approx(median_db, abs=0.1)
    assert law.standard_deviation_db == pytest.approx((high_db - low_db) / 2, rel=0.04)


def level_is_covered(law: FadingLaw, windows_db: np.ndarray) -> np.ndarray:
    """Window by window: whether the central 90 % of the posterior of a level that all six share hold the truth, 0."""
    shift_db = torch.linspace(-20, 20, 801)
    covered = []
    for part in torch.from_numpy(windows_db).float().split(250):
        log_likelihood = law.log_likelihood(part[..., None] - shift_db, EVERYONE.expand(len(part), -1))
        cumulative = log_likelihood.double().softmax(dim=1).cumsum(dim=1)
        below = cumulative[:, len(shift_db) // 2]
        covered.append((below > 0.05) & (below < 0.95))
    return torch.cat(covered).numpy()


@pytest.mark.parametrize(("sampling_hz", "rho"), [(100, 0.1), (10, 0.9)])
def test_its_credible_intervals_hold_what_they_say(sampling_hz: float, rho: float) -> None:
    """A level that is the same at all six trackers, with a flat prior, from one window of other seeds.

    4000 windows: a standard error of half a percent.
    """
    windows_db = drawn_db(told(sampling_hz, rho), 6, 4000)
    covered = level_is_covered(fading_law(told(sampling_hz, rho)), windows_db)
    assert covered.mean() == pytest.approx(0.9, abs=0.02)


EDGES = {
    "K = 0": {"rician_k": 0.0},
    "K = 10^6": {"rician_k": 1e6},
    "K = 10^12": {"rician_k": 1e12},
    "rho = 0": {"spatial_correlation": 0.0},
    "rho = 1": {"spatial_correlation": 1.0},
    "rho = 1, K = 10^6": {"spatial_correlation": 1.0, "rician_k": 1e6},
    "no Doppler": {"doppler_spread_hz": 0.0},
    "one sample": {"window_samples": 1},
    "continuous": {"continuity": "continuous"},
    "phases of their own": {"los_phase": "independent"},
}


@pytest.mark.parametrize("changes", EDGES.values(), ids=EDGES.keys())
def test_it_is_finite_at_the_edges(changes: dict[str, float]) -> None:
    law = fading_law(paper_scenario(**changes))
    assert law.normal.isfinite().all()
    assert law.log_slope.isfinite().all()
    assert (law.normal.diff() > 0).all()
    assert -0.2 < law.correlation < 1
    assert math.isfinite(law.least_log_likelihood)
    assert -4 < law.median_db < 0.1
    assert law.standard_deviation_db * math.sqrt(1 - law.correlation) > 0.95 * LEAST_SPREAD_DB
    levels_db = torch.linspace(-90, 50, 2000)
    log_likelihood = law.log_likelihood(levels_db.expand(1, 6, -1).clone(), EVERYONE)
    assert log_likelihood.isfinite().all()
    # The likeliest common level is near the median. (A common level well above it is likely where a single sample
    # counts: the louder the trackers, the less they differ in dB.)
    assert levels_db[log_likelihood[0].argmax()].item() == pytest.approx(
        law.median_db, abs=2 * law.standard_deviation_db + 0.1
    )


@pytest.mark.parametrize(("rician_k", "rho"), [(1e12, 0.5), (3.0, 1.0), (1e6, 1.0)])
def test_where_trackers_hardly_differ_the_law_is_a_normal_of_the_least_spread(rician_k: float, rho: float) -> None:
    """Two trackers 0.1, 0.2, 0.3 dB above and below the others: -sum of squares / (2 LEAST_SPREAD_DB^2)."""
    law = fading_law(paper_scenario(rician_k=rician_k, spatial_correlation=rho))
    apart_db = torch.tensor([0.0, 0.1, 0.2, 0.3])
    fading_db = torch.full((1, 6, 4), law.median_db)
    fading_db[0, 1] += apart_db
    fading_db[0, 4] -= apart_db
    log_likelihood = law.log_likelihood(fading_db, EVERYONE)[0]
    assert (log_likelihood - log_likelihood[0]).tolist() == pytest.approx([0, -1, -4, -9], rel=0.15, abs=0.1)


def test_the_least_log_likelihood_is_hardly_ever_undercut() -> None:
    for scenario in (told(100, 0.1), told(10, 0.9)):
        law = fading_law(scenario)
        windows_db = torch.from_numpy(drawn_db(scenario, 7, 4000)).float()
        below = law.log_likelihood(windows_db[..., None], EVERYONE.expand(4000, -1)) < law.least_log_likelihood
        assert below.double().mean() <= 0.001
        # And a window that is 15 dB off at one tracker undercuts it.
        windows_db[:, 2] += 15
        below = law.log_likelihood(windows_db[..., None], EVERYONE.expand(4000, -1)) < law.least_log_likelihood
        assert below.double().mean() > 0.9
