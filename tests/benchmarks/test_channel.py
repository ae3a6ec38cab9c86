"""The channel benchmark: everybody does the same job, and what is reported is what was measured."""

import json
import math
from typing import Any

import numpy as np
import pytest
import torch
from rich.console import Console
from scipy.special import j0

from swarmchase.benchmarks import channel as benchmark
from swarmchase.scenario import Scenario, paper_scenario

PEERS = ["pyphysim", "commpy"]
MEAN_DBM = -59.0  # 23 dBm - 82 dB at 100 m


def relative_power(name: str, scenario: Scenario, num_calls: int = 20) -> np.ndarray:
    """|h|^2 of 20 x 256 windows, [window, sample, tracker]; skips where the peer is not installed."""
    if name != benchmark.OURS:
        pytest.importorskip("commpy.channels" if name == "commpy" else "pyphysim.channels", exc_type=ImportError)
    draw = benchmark.SAMPLERS[name](scenario, 256)
    np.random.seed(1)  # noqa: NPY002  CommPy draws from numpy's global generator
    windows_dbm = np.concatenate([torch.as_tensor(draw()).numpy() for _ in range(num_calls)])
    return 10 ** ((windows_dbm - MEAN_DBM) / 10)


@pytest.mark.parametrize("rho", [0.1, 0.9])
@pytest.mark.parametrize("name", [benchmark.OURS, *PEERS])
def test_everybody_draws_the_same_channel(name: str, rho: float) -> None:
    """Unit mean power, K = 3 and the closed-form correlation between trackers, as in test_channel_statistics.py."""
    power = relative_power(name, paper_scenario(spatial_correlation=rho))
    assert power.shape == (5120, 50, 6)
    np.testing.assert_allclose(power.mean(axis=(0, 1)), 1, atol=0.03)
    ratio = (power.var(axis=(0, 1)) / power.mean(axis=(0, 1)) ** 2).mean()
    line_of_sight_share = math.sqrt(1 - ratio)
    # Eight rays of equal strength are not quite Gaussian: pyphysim's estimate of K is 3.1.
    assert line_of_sight_share / (1 - line_of_sight_share) == pytest.approx(3, rel=0.08)
    pairs = np.corrcoef(power.reshape(-1, 6).T)[np.triu_indices(6, 1)]
    assert pairs.mean() == pytest.approx((6 * rho + rho**2) / 7, abs=0.02)


@pytest.mark.parametrize(("name", "has_doppler"), [(benchmark.OURS, True), ("pyphysim", True), ("commpy", False)])
def test_who_follows_jakes(name: str, has_doppler: bool) -> None:
    """Autocovariance of power at lags .1 ... 1 s: (6 J0 + J0^2) / 16, or nothing without Doppler, as the notes say."""
    power = relative_power(name, paper_scenario(spatial_correlation=0.0))
    deviation = power - power.mean()
    measured = [(deviation[:, :-lag] * deviation[:, lag:]).mean() for lag in range(1, 11)]
    bessel = j0(2 * np.pi * np.arange(1, 11) / 10)
    np.testing.assert_allclose(measured, (6 * bessel + bessel**2) / 16 if has_doppler else 0, atol=0.015)


def installed() -> list[str]:
    return [name for name in benchmark.SAMPLERS if not benchmark._why_not(benchmark.SAMPLERS[name])]


def test_the_result_says_what_was_measured() -> None:
    result = benchmark.measure(turn_s=0.002, repeats=1, sampling_hz=(10, 100), batch_sizes=(2, 8))
    assert json.loads(json.dumps(result)) == result
    names = installed()
    assert list(result["windows_per_s"]) == names
    assert set(result["not_measured"]) == set(benchmark.SAMPLERS) - set(names)
    for name in names:
        assert result["versions"][name]
        assert set(result["batch_windows"][name].values()) <= {2, 8}
        for frequency_hz in ("10", "100"):
            rate = result["windows_per_s"][name][frequency_hz]
            assert rate > 0
            if name != benchmark.OURS:  # one turn: the ratio is that of the rates
                ours = result["windows_per_s"][benchmark.OURS][frequency_hz]
                assert result[f"ratio_to_{name}"][frequency_hz] == pytest.approx(ours / rate)
    shown = shown_text(result)
    assert f"{result['windows_per_s'][benchmark.OURS]['100']:,.0f}" in shown
    costs = result["in_flight_cost_over_drawn_windows"]
    assert set(costs) == {"20", "100"}
    assert all(f"{cost:.1f} times as much" in shown for cost in costs.values())


@pytest.mark.parametrize(("sampling_hz", "num_samples"), [(20, 10), (100, 50)])
def test_a_flight_is_drawn_call_after_call(sampling_hz: float, num_samples: int) -> None:
    """From the last sample of a call to the first of the next it goes as far as from any sample to the next."""
    draw = benchmark.fading_in_flight(paper_scenario(continuity="in_flight", sampling_hz=sampling_hz), num_samples)
    calls = [draw() for _ in range(20)]
    h = torch.cat(calls, dim=3)
    assert h.shape == (benchmark.FLYING_CHASES, 6, 2, 20 * num_samples)
    step = h.diff(dim=3).square().sum(dim=2).mean(dim=(0, 1))
    seams = torch.arange(num_samples - 1, len(step), num_samples)
    expected = 0.5 * (1 - j0(2 * np.pi * benchmark.FLYING_MPS / sampling_hz * 3e9 / 299_792_458))
    assert step.mean().item() == pytest.approx(expected, rel=0.03)
    assert step[seams].mean().item() == pytest.approx(expected, rel=0.1)


def shown_text(result: dict[str, Any]) -> str:
    console = Console(width=200)
    with console.capture() as capture:
        console.print(benchmark.table(result))
    return capture.get()


def test_a_peer_that_cannot_be_imported_says_why_and_the_rest_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(scenario: Scenario, batch: int) -> benchmark.Draw:
        raise ModuleNotFoundError("No module named 'pyphysim'\nand more lines")

    monkeypatch.setattr(benchmark, "SAMPLERS", {benchmark.OURS: benchmark.swarmchase_windows, "pyphysim": missing})
    result = benchmark.measure(turn_s=0.002, repeats=1, sampling_hz=(10,), batch_sizes=(4,))
    assert result["not_measured"] == {"pyphysim": "ModuleNotFoundError: No module named 'pyphysim'"}
    assert list(result["windows_per_s"]) == [benchmark.OURS]
    assert "ratio_to_pyphysim" not in result
    assert "pyphysim is not measured: ModuleNotFoundError" in shown_text(result)


def test_ratios_are_medians_of_neighbouring_turns() -> None:
    ours, theirs = {"10": [40.0, 100.0, 90.0]}, {"10": [2.0, 10.0, 3.0]}
    assert benchmark._ratio(ours, theirs) == {"10": 20.0}  # of 20, 10 and 30; the ratio of the medians would be 30
