"""The fading's distributions against closed forms, by effect size: an error that would matter fails, chance does not.

Every figure is deterministic (seeded). Bounds are about four standard errors of the figure at its sample size.
"""

import functools
import math

import numpy as np
import pytest
import torch
from scipy.linalg import toeplitz
from scipy.special import exp1, ive, j0
from scipy.stats import rice

from swarmchase.batch.streams import chase_keys
from swarmchase.channel.fading import fading_db, window_time_s
from swarmchase.channel.fading_process import fading_process
from swarmchase.scenario import Scenario, paper_scenario

K_FACTORS = [0.0, 1.0, 3.0, 10.0]
CORRELATIONS = [0.0, 0.1, 0.5, 0.9, 1.0]


def fading(scenario: Scenario, num_windows: int) -> np.ndarray:
    """Independent windows, h[window, tracker, sample]: the first of as many chases, or 50 of each of fewer chases."""
    process = fading_process(scenario)
    windows_a_chase = 50 if scenario.continuity == "independent" else 1
    state = process.begin(chase_keys(1, num_windows // windows_a_chase))
    time_s = window_time_s(scenario, torch.zeros(num_windows // windows_a_chase, dtype=torch.float64))
    return np.concatenate([as_complex(process.gain(state, time_s)[0]) for _ in range(windows_a_chase)])


def as_complex(parts: torch.Tensor) -> np.ndarray:
    return (parts[:, :, 0] + 1j * parts[:, :, 1]).numpy()


def lone_samples(rician_k: float, rho: float = 0.0, **changes: object) -> np.ndarray:
    """One sample a window, 20 000 windows x 6 trackers: at rho = 0 these are 120 000 independent draws of h."""
    scenario = paper_scenario(rician_k=rician_k, spatial_correlation=rho, window_samples=1, **changes)
    return fading(scenario, 20_000)[:, :, 0]


@functools.cache
def separate_trackers(continuity: str = "independent") -> np.ndarray:
    """6 x 5000 independent windows of 50 samples at 10 Hz, K = 3."""
    return fading(paper_scenario(spatial_correlation=0.0, continuity=continuity), 5_000).reshape(-1, 50)


# Every rho with both samplers, and the longest and the shortest window with both.
COVARIANCE_CASES = [(rho, 10, "independent") for rho in CORRELATIONS]
COVARIANCE_CASES += [(0.5, 100, "independent"), (0.1, 20, "continuous"), (0.9, 100, "continuous")]
COVARIANCE_CASES += [(0.1, 20, "in_flight"), (0.9, 10, "in_flight")]


@pytest.mark.parametrize(("rho", "sampling_hz", "continuity"), COVARIANCE_CASES)
def test_covariance_of_a_window_is_trackers_kron_time(rho: float, sampling_hz: float, continuity: str) -> None:
    """All 300 x 300 covariances of the scattered part (K = 0) are C kron J0, and it is circular: E[z z^T] = 0."""
    num_windows = 6_000
    scenario = paper_scenario(
        rician_k=0, spatial_correlation=rho, sampling_hz=sampling_hz, doppler_spread_hz=1.5, continuity=continuity
    )
    scattered = fading(scenario, num_windows).reshape(num_windows, 300)
    trackers = np.full((6, 6), rho)
    np.fill_diagonal(trackers, 1)
    expected = np.kron(trackers, toeplitz(j0(2 * np.pi * 1.5 * np.arange(50) / sampling_hz)))
    bound = 5 / math.sqrt(num_windows)  # the largest of 90 000 errors: .065
    assert np.abs(scattered.T @ scattered.conj() / num_windows - expected).max() < bound
    assert np.abs(scattered.T @ scattered[:, :50] / num_windows).max() < bound
    assert np.abs(scattered.mean(axis=0)).max() < bound


@pytest.mark.parametrize("los_phase", ["common", "independent"])
@pytest.mark.parametrize("rician_k", K_FACTORS)
def test_amplitude_is_rice(rician_k: float, los_phase: str) -> None:
    amplitude = np.sort(np.abs(lone_samples(rician_k, los_phase=los_phase)).ravel())
    law = rice(math.sqrt(2 * rician_k), scale=math.sqrt(0.5 / (rician_k + 1)))
    empirical = (np.arange(len(amplitude)) + 0.5) / len(amplitude)
    assert np.abs(empirical - law.cdf(amplitude)).max() <= 0.006  # 120 k samples


@pytest.mark.parametrize(
    ("rician_k", "mean_db", "std_db"), [(0, -2.507, 5.570), (1, -2.058, 5.094), (3, -1.193, 3.750), (10, -0.414, 1.999)]
)
def test_mean_and_standard_deviation_in_db(rician_k: float, mean_db: float, std_db: float) -> None:
    h = lone_samples(rician_k)
    level_db = fading_db(torch.from_numpy(np.stack([h.real, h.imag], axis=2)[..., None])).double()
    assert level_db.mean().item() == pytest.approx(mean_db, abs=0.06)
    assert level_db.std().item() == pytest.approx(std_db, abs=0.05)
    # The table's means are (10 / ln 10) (ln(K / (K + 1)) + E1(K)), and Euler's constant at K = 0.
    natural = -np.euler_gamma if rician_k == 0 else math.log(rician_k / (rician_k + 1)) + exp1(rician_k)
    assert 10 / math.log(10) * natural == pytest.approx(mean_db, abs=5e-4)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("rician_k", K_FACTORS)
def test_every_tracker_has_unit_power_and_the_same_k(rician_k: float, rho: float) -> None:
    """K estimated from Var p / E^2 p = (2K + 1) / (K + 1)^2. Correlating after the line of sight would fail here."""
    power = np.abs(lone_samples(rician_k, rho)) ** 2
    np.testing.assert_allclose(power.mean(axis=0), 1, atol=0.03)
    ratio = power.var(axis=0) / power.mean(axis=0) ** 2
    np.testing.assert_allclose(ratio, (2 * rician_k + 1) / (rician_k + 1) ** 2, rtol=0.07)
    if rician_k > 0:  # at K = 0 the estimate is the root of a difference that is nought but for chance
        line_of_sight_share = math.sqrt(1 - ratio.mean())
        assert line_of_sight_share / (1 - line_of_sight_share) == pytest.approx(rician_k, rel=0.08)


@pytest.mark.parametrize("continuity", ["independent", "continuous", "in_flight"])
def test_power_autocovariance_within_a_window(continuity: str) -> None:
    """(2K J0 + J0^2) / (K + 1)^2 at lags 0, .1, ... 2 s: it starts at 7/16."""
    power = np.abs(separate_trackers(continuity)) ** 2
    deviation = power - power.mean()
    measured = [(deviation[:, : 50 - lag] * deviation[:, lag:]).mean() for lag in range(21)]
    bessel = j0(2 * np.pi * np.arange(21) / 10)
    np.testing.assert_allclose(measured, (6 * bessel + bessel**2) / 16, atol=0.012)


@pytest.mark.parametrize(
    ("los_phase", "rician_k", "rho", "correlation"),
    [
        ("common", 3, 0.0, 0.0),
        ("common", 3, 0.1, 0.087),  # (2 K rho + rho^2) / (2 K + 1) = (.6 + .01) / 7
        ("common", 3, 0.5, 0.464),
        ("common", 3, 0.9, 0.887),
        ("common", 3, 1.0, 1.0),
        ("common", 0, 0.9, 0.81),
        ("common", 10, 0.9, 0.896),
        ("independent", 3, 0.0, 0.0),
        ("independent", 3, 0.5, 0.036),  # rho^2 / (2 K + 1): the phases average the other term away
        ("independent", 3, 0.9, 0.116),
        ("independent", 3, 1.0, 0.143),
        ("independent", 0, 0.9, 0.81),
    ],
)
def test_power_correlation_between_trackers(los_phase: str, rician_k: float, rho: float, correlation: float) -> None:
    power = np.abs(lone_samples(rician_k, rho, los_phase=los_phase)) ** 2
    pairs = np.corrcoef(power.T)[np.triu_indices(6, 1)]
    assert pairs.mean() == pytest.approx(correlation, abs=0.01)
    assert np.abs(pairs - correlation).max() < 0.035


@pytest.mark.parametrize("continuity", ["independent", "continuous", "in_flight"])
def test_fades_come_as_often_as_rice_crosses_its_level(continuity: str) -> None:
    """sqrt(2 pi (K + 1)) f_d r exp(-K - (K + 1) r^2) I0(2 r sqrt(K (K + 1))) upward crossings of r a second."""
    scenario = paper_scenario(sampling_hz=100, spatial_correlation=0, continuity=continuity)
    num_windows = 20_000 if continuity == "independent" else 8_000
    amplitude = np.abs(fading(scenario, num_windows))
    seconds = num_windows * 6 * 49 / 100  # 49 steps of 10 ms in a window
    for level, per_second in ((0.3, 0.126), (0.5, 0.329), (1.0, 0.721), (1.5, 0.189)):
        crossings = ((amplitude[..., :-1] < level) & (amplitude[..., 1:] >= level)).sum()
        assert crossings / seconds == pytest.approx(per_second, rel=0.04)
        argument = 2 * level * math.sqrt(12)
        law = math.sqrt(8 * math.pi) * level * math.exp(argument - 3 - 4 * level**2) * ive(0, argument)
        assert law == pytest.approx(per_second, abs=1e-3)


@pytest.mark.parametrize(
    ("continuity", "travel_s"),
    [
        ("continuous", 0.0),
        ("continuous", 0.4),
        ("continuous", 1.386),
        ("in_flight", 0.4),
        ("independent", 0.0),
    ],  # 0, 2 and 6.9 m at 5 m/s
)
@pytest.mark.parametrize("sampling_hz", [20, 100])
def test_covariance_across_a_window_boundary(sampling_hz: float, continuity: str, travel_s: float) -> None:
    """Sample j of the next window comes (50 - i + j) / F + travel after sample i of this one; or is a stranger."""
    scenario = paper_scenario(rician_k=0, spatial_correlation=0, sampling_hz=sampling_hz, continuity=continuity)
    process = fading_process(scenario)
    time_s = window_time_s(scenario, torch.zeros(4_000, dtype=torch.float64))
    first, state = process.gain(process.begin(chase_keys(1, 4_000)), time_s)
    second, _ = process.gain(state, time_s + scenario.window_s + travel_s)
    first, second = as_complex(first).reshape(-1, 50), as_complex(second).reshape(-1, 50)
    sample = np.arange(50)
    lag_s = (50 - sample[:, None] + sample) / sampling_hz + travel_s
    expected = j0(2 * np.pi * lag_s) if continuity != "independent" else np.zeros((50, 50))
    assert np.abs(first.T @ second.conj() / len(first) - expected).max() < 0.03  # 24 000 pairs
