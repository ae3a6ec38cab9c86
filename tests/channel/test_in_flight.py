"""Fading in flight: the process as the cycles that were travelled, against closed forms, whoever flies how fast."""

import itertools
import math

import numpy as np
import pytest
import torch
from scipy.special import ive, j0
from scipy.stats import rice

from swarmchase.batch.selection import join_chases, select_chases
from swarmchase.batch.streams import chase_keys
from swarmchase.channel import in_flight
from swarmchase.channel.in_flight import POINTS_PER_CYCLE, TABLE_CYCLES, InFlight
from swarmchase.scenario import SPEED_OF_LIGHT_MPS, Scenario, paper_scenario

WAVELENGTH_M = SPEED_OF_LIGHT_MPS / 3e9


def world(**changes: object) -> Scenario:
    return paper_scenario(continuity="in_flight", **changes)


def flown(
    scenario: Scenario, speed_mps: np.ndarray, num_chases: int, sampling_hz: float = 100.0, seed: int = 1
) -> np.ndarray:
    """h [chase, tracker, sample] of trackers with these relative speeds before each sample, [sample] or [sample,
    tracker]."""
    speed_mps = np.broadcast_to(speed_mps.reshape(len(speed_mps), -1), (len(speed_mps), 6))
    moved_m = torch.from_numpy(speed_mps / sampling_hz).expand(num_chases, -1, -1)
    time_s = (torch.arange(len(speed_mps), dtype=torch.float64) / sampling_hz).expand(num_chases, -1)
    process = InFlight(scenario)
    h, _ = process.gain(process.begin(chase_keys(seed, num_chases)), time_s, moved_m)
    return (h[:, :, 0] + 1j * h[:, :, 1]).numpy()


def autocorrelation(cycles: np.ndarray) -> np.ndarray:
    """J0 between all samples of a process that has travelled so many cycles at each."""
    return np.asarray(j0(2 * np.pi * (cycles[:, None] - cycles)))


def test_the_table_has_the_spectrum_of_clarke() -> None:
    """Unit power and J0 around the circle, for the one table that there is; its power is exponential."""
    value = in_flight.cubic_table()[0].numpy().astype(np.complex128)
    assert len(value) == TABLE_CYCLES * POINTS_PER_CYCLE
    circular = np.fft.ifft(np.abs(np.fft.fft(value)) ** 2) / len(value)
    lag = np.arange(100 * POINTS_PER_CYCLE)
    np.testing.assert_allclose(circular[lag], j0(2 * np.pi * lag / POINTS_PER_CYCLE), atol=3e-4)
    power = np.sort(np.abs(value) ** 2)
    empirical = (np.arange(len(power)) + 0.5) / len(power)
    assert np.abs(empirical - (1 - np.exp(-power))).max() < 0.003
    angle = np.sort(np.angle(value)) / (2 * np.pi) + 0.5
    assert np.abs(empirical - angle).max() < 0.01


def test_between_its_points_the_table_is_the_same_process() -> None:
    """Against its spectrum evaluated eight times as finely: 3e-4 of the standard deviation on average, 2e-3 at most."""
    coefficients = in_flight.cubic_table().numpy().astype(np.complex128)
    finer = 8
    spectrum = np.fft.fftshift(np.fft.fft(coefficients[0]))
    padding = (finer - 1) * len(spectrum) // 2
    exact = np.fft.ifft(np.fft.ifftshift(np.pad(spectrum, padding))) * finer
    beyond = np.arange(finer)[:, None] / finer
    read = coefficients[0] + beyond * (coefficients[1] + beyond * (coefficients[2] + beyond * coefficients[3]))
    error = np.abs(read.T.ravel() - exact)
    assert math.sqrt((error**2).mean()) < 4e-4
    assert error.max() < 2e-3


FLIGHTS = {
    "slowly": np.full(50, 2.0),
    "fast": np.full(50, 15.0),
    "a turn": np.r_[np.full(25, 3.0), np.full(25, 12.0)],
    "faster and faster": np.linspace(0, 10, 50),
    "hovering": np.zeros(50),
    "slower than what surrounds it": np.full(50, 0.05),  # half a cycle a second, where the floor is one
}


@pytest.mark.parametrize("speed_mps", FLIGHTS.values(), ids=FLIGHTS.keys())
def test_autocorrelation_is_that_of_the_cycles_travelled(speed_mps: np.ndarray) -> None:
    """All 50 x 50 of them, from 30,000 processes: 1 / sqrt(30,000) = .006, and the largest of 2,500 four times that."""
    z = flown(world(rician_k=0, spatial_correlation=0), speed_mps, 5_000).reshape(-1, 50)
    steps = np.maximum(speed_mps / WAVELENGTH_M, 1.0) / 100
    covariance = z.T @ z.conj() / len(z)
    assert np.abs(covariance - autocorrelation(steps.cumsum())).max() < 0.026
    assert np.abs(z.T @ z / len(z)).max() < 0.026
    assert np.abs(z.mean(axis=0)).max() < 0.026


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, 1.0])
def test_trackers_are_correlated_by_rho_even_if_they_turn(rho: float) -> None:
    """At equal times exactly, although one flies at 1 m/s and another at 6: what they share goes by the mean."""
    num_chases, num_samples = 12_000, 20
    speed_mps = np.tile(np.arange(1.0, 7), (num_samples, 1))
    z = flown(world(rician_k=0, spatial_correlation=rho), speed_mps, num_chases)
    correlation = np.full((6, 6), rho)
    np.fill_diagonal(correlation, 1)
    for sample in (0, 7, 19):
        at_once = z[:, :, sample]
        assert np.abs(at_once.T @ at_once.conj() / num_chases - correlation).max() < 0.035
    cycles = speed_mps.cumsum(axis=0) / WAVELENGTH_M / 100
    for tracker in range(6):
        own, shared = autocorrelation(cycles[:, tracker]), autocorrelation(cycles.mean(axis=1))
        covariance = z[:, tracker].T @ z[:, tracker].conj() / num_chases
        assert np.abs(covariance - (1 - rho) * own - rho * shared).max() < 0.045


@pytest.mark.parametrize("los_phase", ["common", "independent"])
@pytest.mark.parametrize("rician_k", [0.0, 3.0, 10.0])
def test_amplitude_is_rice_and_the_mean_power_is_one(rician_k: float, los_phase: str) -> None:
    """3 million samples, three cycles apart."""
    scenario = world(rician_k=rician_k, spatial_correlation=0, los_phase=los_phase)
    h = flown(scenario, np.full(50, 30.0), 10_000)
    assert (np.abs(h) ** 2).mean() == pytest.approx(1, abs=0.003)
    assert (np.abs(h) ** 2).mean(axis=(0, 2)) == pytest.approx(np.ones(6), abs=0.015)
    amplitude = np.sort(np.abs(h).ravel())
    law = rice(math.sqrt(2 * rician_k), scale=math.sqrt(0.5 / (rician_k + 1)))
    empirical = (np.arange(len(amplitude)) + 0.5) / len(amplitude)
    assert np.abs(empirical - law.cdf(amplitude)).max() <= 0.004


@pytest.mark.parametrize("speed_mps", [2.0, 10.0])
def test_fades_come_as_often_as_rice_crosses_its_level(speed_mps: float) -> None:
    """sqrt(2 pi (K + 1)) f r exp(-K - (K + 1) r^2) I0(2 r sqrt(K (K + 1))) crossings a second, f = v f_c / c."""
    sampling_hz, num_samples, num_chases = 100 * speed_mps / WAVELENGTH_M, 1_000, 400  # a hundred samples a cycle
    h = flown(world(spatial_correlation=0), np.full(num_samples, speed_mps), num_chases, sampling_hz)
    amplitude = np.abs(h)
    seconds = num_chases * 6 * (num_samples - 1) / sampling_hz
    for level in (0.3, 0.5, 1.0, 1.5):
        crossings = ((amplitude[..., :-1] < level) & (amplitude[..., 1:] >= level)).sum()
        argument = 2 * level * math.sqrt(12)
        law = math.sqrt(8 * math.pi) * level * math.exp(argument - 3 - 4 * level**2) * ive(0, argument)
        assert crossings / seconds == pytest.approx(law * speed_mps / WAVELENGTH_M, rel=0.04), level


def irregular(num_chases: int, num_samples: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Times and ways of a flight with samples at any time."""
    drawn = np.random.default_rng(5)
    time_s = torch.from_numpy(drawn.exponential(0.05, (num_chases, num_samples)).cumsum(axis=1))
    return time_s, torch.from_numpy(drawn.exponential(0.3, (num_chases, num_samples, 6)))


@pytest.mark.parametrize("los_phase", ["common", "independent"])
def test_a_flight_is_the_same_in_pieces(los_phase: str) -> None:
    process = InFlight(world(los_phase=los_phase))
    time_s, moved_m = irregular(7, 40)
    start = process.begin(chase_keys(3, 7))
    whole, _ = process.gain(start, time_s, moved_m)
    for cuts in ([0, 1, 40], [0, 13, 14, 31, 40], list(range(41))):
        state, pieces = start, []
        for first, end in itertools.pairwise(cuts):
            piece, state = process.gain(state, time_s[:, first:end], moved_m[:, first:end])
            pieces.append(piece)
        assert torch.allclose(torch.cat(pieces, dim=3), whole, atol=1e-5)


def test_a_chase_is_the_same_in_any_batch_whoever_joins() -> None:
    """Bit for bit, in flight, alone, in a batch, and in one that changes on the way."""
    process = InFlight(world(los_phase="independent"))
    time_s, moved_m = irregular(300, 30)
    keys = chase_keys(4711, 300)
    among_all, state = process.gain(process.begin(keys), time_s[:, :20], moved_m[:, :20])
    after, _ = process.gain(state, time_s[:, 20:], moved_m[:, 20:])
    for chase in (0, 1, 7, 127, 128, 150, 298, 299):
        for company in ([chase], [5, 6, chase], [chase, *range(10, 109)]):
            place = company.index(chase)
            part, its_state = process.gain(
                process.begin([keys[one] for one in company]), time_s[company, :20], moved_m[company, :20]
            )
            assert torch.equal(part[place], among_all[chase])
            joined = join_chases(select_chases(its_state, [place]), select_chases(state, [2, 3]))
            rows = [chase, 2, 3]
            assert torch.equal(process.gain(joined, time_s[rows, 20:], moved_m[rows, 20:])[0][0], after[chase])


def test_the_table_begins_anew_without_a_seam() -> None:
    """Twice around it, a hundredth of a cycle a sample around the seam."""
    process = InFlight(world(doppler_spread_hz=0))
    state = process.begin(chase_keys(1, 1))
    to_the_end = (TABLE_CYCLES * POINTS_PER_CYCLE - state.point[0]) / POINTS_PER_CYCLE
    _, state = process.gain(state, torch.zeros(1, 1).double(), (to_the_end - 0.5).mean().expand(1, 1, 6) * WAVELENGTH_M)
    moved_m = torch.full((1, TABLE_CYCLES // 4, 6), 0.01 * WAVELENGTH_M, dtype=torch.float64)
    h, state = process.gain(state, torch.ones(1, TABLE_CYCLES // 4).double(), moved_m)
    assert h.diff(dim=3).abs().max() < 2 * math.pi * 0.01 * 4
    assert ((state.point >= 0) & (state.point < TABLE_CYCLES * POINTS_PER_CYCLE)).all()
    around, _ = process.gain(
        state, torch.ones(1, 1).double(), torch.full((1, 1, 6), TABLE_CYCLES * WAVELENGTH_M).double()
    )
    assert torch.allclose(around, h[..., -1:], atol=1e-3)
