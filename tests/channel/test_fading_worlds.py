"""Fading drawn for many worlds at once: its law is that of windows drawn for one world, and that of closed forms."""

import math

import pytest
import torch
from scipy.special import j0

from swarmchase.batch.streams import chase_keys
from swarmchase.channel.fading import fading_db, window_time_s
from swarmchase.channel.fading_process import fading_process
from swarmchase.channel.fading_worlds import FadingWorlds, WorldsFading
from swarmchase.scenario import paper_scenario

NUM_WINDOWS = 4000
SAMPLES = 50


def _drawn_db(doppler_per_sample: float, k: float, rho: float, los_is_common: bool) -> torch.Tensor:
    worlds = FadingWorlds(*(torch.tensor([value]) for value in (doppler_per_sample, k, rho, float(los_is_common))))
    return WorldsFading(SAMPLES).drawn_db(worlds, NUM_WINDOWS, torch.Generator().manual_seed(3))[0]


@pytest.mark.parametrize(
    ("doppler_per_sample", "k", "rho", "los_is_common"),
    [(0.1, 3.0, 0.5, True), (0.02, 0.0, 0.9, True), (0.05, 3.0, 0.1, False), (0.5, 10.0, 0.0, True)],
)
def test_power_is_one_on_average_and_correlates_as_the_closed_forms_say(
    doppler_per_sample: float, k: float, rho: float, los_is_common: bool
) -> None:
    power = 10 ** (_drawn_db(doppler_per_sample, k, rho, los_is_common).double() / 10)
    variance = (2 * k + 1) / (k + 1) ** 2
    assert power.mean() == pytest.approx(1, abs=0.03)
    assert power.var() == pytest.approx(variance, rel=0.08)
    apart = power - 1
    between_trackers = (apart[:, 0] * apart[:, 1]).mean() / variance
    in_step = 2 * k * rho if los_is_common else 0.0
    assert between_trackers == pytest.approx((rho**2 + in_step) / (1 + 2 * k), abs=0.05)
    for lag in (1, 5):
        bessel = j0(2 * math.pi * doppler_per_sample * lag)
        in_time = (apart[..., :-lag] * apart[..., lag:]).mean() / variance
        assert in_time == pytest.approx((bessel**2 + 2 * k * bessel) / (1 + 2 * k), abs=0.05)


def test_it_is_the_law_of_windows_drawn_for_one_world() -> None:
    """Quantiles of single samples and of windows' means, K = 3, rho = 0.5, F = 20 Hz."""
    scenario = paper_scenario(sampling_hz=20, spatial_correlation=0.5)
    process = fading_process(scenario)
    time_s = window_time_s(scenario, torch.zeros(NUM_WINDOWS, dtype=torch.float64))
    gain, _ = process.gain(process.begin(chase_keys(5, NUM_WINDOWS)), time_s)
    one_db, many_db = fading_db(gain), _drawn_db(0.05, 3.0, 0.5, True)
    share = torch.tensor([0.05, 0.25, 0.5, 0.75, 0.95])
    for statistic in (lambda db: db[..., 7].flatten(), lambda db: db.mean(dim=(1, 2))):
        one, many = (statistic(level_db).quantile(share) for level_db in (one_db, many_db))
        torch.testing.assert_close(one, many, atol=0.3, rtol=0)


def test_each_world_has_its_own_fading() -> None:
    worlds = FadingWorlds(
        doppler_per_sample=torch.tensor([0.001, 0.2]),
        rician_k=torch.tensor([0.0, 1000.0]),
        spatial_correlation=torch.tensor([0.5, 0.5]),
        los_is_common=torch.ones(2),
    )
    level_db = WorldsFading(SAMPLES).drawn_db(worlds, 200, torch.Generator().manual_seed(1))
    assert level_db[0].std() > 4
    assert level_db[1].std() < 0.5
    assert level_db[0].diff(dim=2).abs().median() < 0.1  # slow: a sample is like the next
