"""The channel where it is exact: path loss, the matrices behind the fading, batches and edges.

Distributions are in test_channel_statistics.py.
"""

import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh, toeplitz
from scipy.special import j0

from swarmchase.batch.selection import join_chases, select_chases
from swarmchase.batch.streams import chase_keys
from swarmchase.channel.fading import DEEPEST_FADE_DB, Fading, spatial_mixing, window_time_s
from swarmchase.channel.fading_process import fading_process, first_window
from swarmchase.channel.jakes_basis import SIGNS, jakes_basis
from swarmchase.channel.propagation import path_loss_db
from swarmchase.channel.running_process import harmonic_frequency_hz
from swarmchase.scenario import Scenario, paper_scenario
from swarmchase.world.radio import rssi_dbm

NUM_TRACKERS = 6


@pytest.mark.parametrize(
    ("distance_m", "loss_db"),
    [
        (0.0, 30.0),  # nearer than d_0 = 1 m counts as 1 m
        (0.5, 30.0),
        (1.0, 30.0),
        (2.0, 37.827),  # 26 dB a decade is 7.827 dB an octave
        (10.0, 56.0),
        (20.0, 63.827),
        (100.0, 82.0),
        (1000.0, 108.0),
    ],
)
def test_path_loss_is_thirty_db_and_twenty_six_a_decade(distance_m: float, loss_db: float) -> None:
    loss = path_loss_db(paper_scenario(), torch.tensor([distance_m], dtype=torch.float64))
    assert loss.item() == pytest.approx(loss_db, abs=5e-4)


@pytest.mark.parametrize(
    ("distance_m", "spacing_m", "difference_db"),
    [(100, 5, 1.130), (100, 1, 0.226), (10, 5, 12.405), (10, 1, 2.266)],  # 26 log10((D + d) / (D - d))
)
def test_opposite_trackers_differ_by_geometry(distance_m: float, spacing_m: float, difference_db: float) -> None:
    far_and_near_m = torch.tensor([distance_m + spacing_m, distance_m - spacing_m], dtype=torch.float64)
    far_db, near_db = path_loss_db(paper_scenario(), far_and_near_m)
    assert (far_db - near_db).item() == pytest.approx(difference_db, abs=5e-4)


def test_path_loss_follows_its_scenario() -> None:
    scenario = paper_scenario(reference_distance_m=10.0, reference_path_loss_db=50.0, path_loss_exponent=2.0)
    loss = path_loss_db(scenario, torch.tensor([5.0, 10.0, 100.0, 1000.0], dtype=torch.float64))
    assert loss.tolist() == pytest.approx([50, 50, 70, 90])


def test_rssi_is_power_minus_path_loss_plus_fading() -> None:
    """One chase, two samples: |h| = 1, then |h| = 1/2 in quadrature (-6.02 dB); tracker u at 10 or 100 m."""
    distance_m = torch.tensor([[[10.0, 100, 10, 100, 10, 100]]], dtype=torch.float64)
    fading = torch.zeros(1, NUM_TRACKERS, 2, 2)
    fading[:, :, 0, 0] = 1.0
    fading[:, :, 1, 1] = 0.5
    fading[:, 5, :, 1] = 0.0  # the last tracker hears nothing at all in the second sample
    window = rssi_dbm(paper_scenario(), distance_m, fading)[0]
    assert window[0].tolist() == pytest.approx([-33, -59, -33, -59, -33, -59], abs=1e-4)
    assert window[1].tolist() == pytest.approx(
        [-39.021, -65.021, -39.021, -65.021, -39.021, -59 + DEEPEST_FADE_DB], abs=5e-4
    )


@pytest.mark.parametrize("rho", [0.0, 0.1, 0.5, 0.9, 1.0])
def test_mixing_is_a_square_root_of_the_correlation(rho: float) -> None:
    own, shared = spatial_mixing(rho)
    root = own * np.eye(NUM_TRACKERS) + shared
    correlation = np.full((NUM_TRACKERS, NUM_TRACKERS), rho)
    np.fill_diagonal(correlation, 1)
    np.testing.assert_allclose(root @ root, correlation, atol=1e-14)


@pytest.mark.parametrize(("sampling_hz", "rank"), [(10.0, 18), (20.0, 12), (50.0, 8), (100.0, 6)])
def test_jakes_basis_is_short_and_reproduces_the_covariance(sampling_hz: float, rank: int) -> None:
    time_s = np.arange(50) / sampling_hz
    basis = jakes_basis(50, sampling_hz, 1.0)
    assert abs(len(basis) - rank) <= 1
    # Both parts of a CN(0, 1) have variance 1/2.
    np.testing.assert_allclose(2 * basis.T @ basis, toeplitz(j0(2 * np.pi * time_s)), atol=1e-8)


@pytest.mark.parametrize(
    ("num_samples", "sampling_hz", "doppler_spread_hz"),
    [*SIGNS, (35, 10.0, 1.0), (50, 30.0, 1.0), (500, 100.0, 1.0), (50, 10.0, 0.0), (1, 10.0, 1.0)],
)
def test_jakes_basis_is_the_same_whatever_signs_the_eigensolver_chooses(
    num_samples: int, sampling_hz: float, doppler_spread_hz: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They differ between processors, and so did a chase of the same seed once."""

    def other_signs(matrix: Any) -> Any:
        value, vector = eigh(matrix)
        return value, vector * np.random.default_rng(0).choice([-1.0, 1.0], size=num_samples)

    first = jakes_basis(num_samples, sampling_hz, doppler_spread_hz)
    monkeypatch.setattr("scipy.linalg.eigh", other_signs)
    np.testing.assert_array_equal(jakes_basis(num_samples, sampling_hz, doppler_spread_hz), first)
    told = SIGNS.get((num_samples, sampling_hz, doppler_spread_hz), "+" * len(first))
    assert "".join("+" if begin > 0 else "-" for begin in first[:, 0]) == told
    assert (np.abs(first[:, 0]) > 0.01 * np.abs(first).max(axis=1)).all()  # rounding decides nothing


@pytest.mark.parametrize(("horizon_s", "num_harmonics"), [(5.0, 31), (60.0, 221)])
def test_harmonics_are_few_and_reproduce_the_autocorrelation(horizon_s: float, num_harmonics: int) -> None:
    frequency_hz = harmonic_frequency_hz(1.0, horizon_s)
    assert abs(len(frequency_hz) - num_harmonics) <= 3
    lag_s = np.linspace(0, horizon_s, 2001)
    autocorrelation = np.exp(2j * np.pi * frequency_hz * lag_s[:, None]).mean(axis=1)
    assert np.abs(autocorrelation - j0(2 * np.pi * lag_s)).max() <= 2e-12  # 1e-12, and the rounding of 2000 sums


def windows(process: Fading[Any], scenario: Scenario, state: Any, count: int, begin_s: float = 0.0) -> torch.Tensor:
    """Successive windows of every chase, no travel between them, [chase, window, tracker, 2, sample]."""
    drawn = []
    for number in range(count):
        begins_s = torch.full((num_chases(state),), begin_s + number * scenario.window_s, dtype=torch.float64)
        window, state = process.gain(state, window_time_s(scenario, begins_s))
        drawn.append(window)
    return torch.stack(drawn, dim=1)


def num_chases(state: Any) -> int:
    return len(state.streams if hasattr(state, "streams") else next(iter(vars(state).values())))


WORLDS = [
    pytest.param(paper_scenario(), id="paper"),
    pytest.param(paper_scenario(sampling_hz=100, los_phase="independent"), id="independent phases"),
    pytest.param(paper_scenario(continuity="continuous"), id="continuous"),
    pytest.param(paper_scenario(continuity="continuous", los_phase="independent"), id="continuous, independent phases"),
    pytest.param(paper_scenario(continuity="in_flight"), id="in flight"),
    pytest.param(paper_scenario(continuity="in_flight", los_phase="independent"), id="in flight, independent phases"),
    pytest.param(paper_scenario(window_samples=1), id="one sample"),
    pytest.param(paper_scenario(window_samples=7, doppler_spread_hz=0), id="no Doppler"),
]


@pytest.mark.parametrize("scenario", WORLDS)
def test_a_chase_is_the_same_in_any_batch(scenario: Scenario) -> None:
    """Bit for bit, dBm included: alone, among 3, among 300, first, in the middle and last."""
    process = fading_process(scenario)
    keys = chase_keys(4711, 300)

    def heard_dbm(batch: list[tuple[int, int]]) -> torch.Tensor:
        drawn = windows(process, scenario, process.begin(batch), 2)
        distance_m = torch.tensor([[[90.0 + chase % 20 + u for u in range(6)]] for _, chase in batch]).double()
        return torch.stack([rssi_dbm(scenario, distance_m, drawn[:, i]) for i in range(2)], dim=1)

    among_all = heard_dbm(keys)
    for chase in (0, 1, 127, 128, 150, 299):
        alone = heard_dbm([keys[chase]])[0]
        assert torch.equal(alone, among_all[chase])
        assert torch.equal(alone, heard_dbm([keys[5], keys[6], keys[chase]])[2])
        assert torch.equal(alone, heard_dbm([keys[chase], *keys[10:109]])[0])


@pytest.mark.parametrize("scenario", WORLDS)
def test_a_chase_goes_on_when_its_batch_changes(scenario: Scenario) -> None:
    """Two windows in one batch equal one window there and the next in a batch of other company."""
    process = fading_process(scenario)
    undisturbed = windows(process, scenario, process.begin(chase_keys(2, 6)), 2)
    _, state = process.gain(process.begin(chase_keys(2, 6)), window_time_s(scenario, torch.zeros(6).double()))
    regrouped = join_chases(select_chases(state, [4]), process.begin(chase_keys(3, 2)))
    after = windows(process, scenario, regrouped, 1, scenario.window_s)
    assert torch.equal(after[0, 0], undisturbed[4, 1])


def test_the_running_process_is_a_function_of_time() -> None:
    """A window that begins k samples later repeats the samples it shares with the first, and so does any one of it."""
    scenario = paper_scenario(sampling_hz=20, continuity="continuous")
    process = fading_process(scenario)
    state = process.begin(chase_keys(1, 3))
    time_s = window_time_s(scenario, torch.zeros(3).double())
    first, _ = process.gain(state, time_s)
    later, _ = process.gain(state, time_s + 15 / 20)
    assert torch.allclose(first[..., 15:], later[..., :-15], atol=2e-6)
    assert not torch.allclose(first, later, atol=0.1)
    sample = torch.tensor([[3, 20, 49], [4, 5, 6], [0, 48, 49]])  # chases whose clocks differ
    some, _ = process.gain(state, time_s.gather(1, sample))
    assert torch.allclose(some, first.gather(3, sample[:, None, None].expand(3, 6, 2, 3)), atol=2e-6)


@pytest.mark.parametrize("continuity", ["independent", "continuous", "in_flight"])
def test_edges_are_what_the_formula_says(continuity: str) -> None:
    def drawn(**changes: object) -> torch.Tensor:
        scenario = paper_scenario(continuity=continuity, **changes)
        process = fading_process(scenario)
        return windows(process, scenario, process.begin(chase_keys(9, 20)), 2)

    still = drawn(doppler_spread_hz=0)
    assert torch.allclose(still, still[..., :1].expand_as(still), atol=1e-5)  # constant within a window
    assert torch.allclose(still[:, 0], still[:, 1], atol=1e-5) == (
        continuity != "independent"
    )  # and if running, for ever
    alike = drawn(spatial_correlation=1)
    assert torch.allclose(alike, alike[:, :, :1].expand_as(alike), atol=1e-5)  # all trackers hear the same
    apart = drawn(spatial_correlation=0)
    assert (apart - apart[:, :, :1])[:, :, 1:].abs().amax(dim=(3, 4)).min() > 0.1  # no two trackers do
    lit = drawn(rician_k=1e12)
    assert torch.allclose(lit[..., 0, :], torch.ones(()), atol=1e-4)  # line of sight alone: h = 1
    assert torch.allclose(lit[..., 1, :], torch.zeros(()), atol=1e-4)


def test_independent_phases_stay_with_a_running_process_only() -> None:
    """Without scattering h is the line of sight: one phase per tracker, redrawn with every independent window."""
    for continuity, stays in (("continuous", True), ("in_flight", True), ("independent", False)):
        scenario = paper_scenario(rician_k=1e12, los_phase="independent", continuity=continuity)
        process = fading_process(scenario)
        drawn = windows(process, scenario, process.begin(chase_keys(9, 20)), 2)
        phase_rad = torch.atan2(drawn[..., 1, 0], drawn[..., 0, 0])
        assert torch.allclose(drawn.square().sum(dim=3), torch.ones(()), atol=1e-4)
        assert torch.allclose(phase_rad[:, 0], phase_rad[:, 1], atol=1e-4) is stays
        assert phase_rad.std() == pytest.approx(2 * math.pi / math.sqrt(12), abs=0.25)  # spread over the circle


CHANGES = st.fixed_dictionaries(
    {
        "rician_k": st.sampled_from([0.0, 1e-9, 3.0, 1e6]),
        "spatial_correlation": st.sampled_from([0.0, 1e-12, 0.5, 1 - 1e-12, 1.0]),
        "doppler_spread_hz": st.sampled_from([0.0, 1e-6, 1.0, 20.0]),
        "window_samples": st.integers(1, 20),
        "sampling_hz": st.floats(0.5, 1000),
        "continuity": st.sampled_from(["independent", "continuous", "in_flight"]),
        "los_phase": st.sampled_from(["common", "independent"]),
    }
)


@settings(max_examples=40, deadline=None)
@given(changes=CHANGES, distance_m=st.floats(0, 1e6))
def test_every_sample_is_a_number_wherever_the_edge(changes: dict[str, Any], distance_m: float) -> None:
    scenario = paper_scenario(**changes)
    distances_m = torch.full((2, 1, NUM_TRACKERS), distance_m, dtype=torch.float64)
    fading = first_window(scenario, chase_keys(1, 2))
    window = rssi_dbm(scenario, distances_m, fading)
    assert window.shape == (2, scenario.window_samples, NUM_TRACKERS)
    assert window.dtype == torch.float32
    assert torch.isfinite(window).all()
    mean_dbm = 23 - path_loss_db(scenario, distances_m[:1, :, :1]).item()
    assert mean_dbm + DEEPEST_FADE_DB - 0.01 <= window.min().item() <= window.max().item() <= mean_dbm + 20
