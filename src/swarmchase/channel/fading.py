"""From distance to RSSI: path loss (Eqs. 1-2) and correlated Rician fading with Jakes Doppler (Eqs. 3-5).

For tracker u, with path loss L(d_u) and fading h_u of unit mean power,

    rssi_u(t) = P_tx - L(d_u) + 20 log10 |h_u(t)|                                          [dBm]
    h_u(t)    = sqrt(K / (K + 1)) los_u + sqrt(1 / (K + 1)) z_u(t)
    E[z_u(t) z_v*(t + tau)] = C_uv J0(2 pi f_d tau),    C = 1 on the diagonal and rho off it

The correlation acts on the scattered part z alone; the line of sight is added after it, so that K and the mean power
are the same at every tracker. Fading is held as [chase, tracker, part, sample], part 0 in phase and 1 in quadrature.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.linalg import eigh, toeplitz
from scipy.special import j0, jv

from ..batch.array_types import Float, Tensor
from ..batch.streams import ChaseKey, ChaseStreams, Purpose
from ..scenario import NUM_TRACKERS, Scenario

DISCARDED_POWER = 1e-9
"""Share of the scattered power that the truncated eigendecomposition may leave out (its error in any covariance)."""
HARMONIC_TOLERANCE = 1e-12
"""Largest error of the harmonic sampler's autocorrelation within its horizon."""
CONTINUOUS_HORIZON_S = 60.0
"""Lags up to which the continuous process has the exact autocorrelation; a window and a movement last at most 6 s."""
DEEPEST_FADE_DB = -200.0
"""Fading is never reported deeper than this, so that a sample is finite even if |h| underflows."""


def fading_db(fading: Float[Tensor, "chase tracker 2 sample"]) -> Float[Tensor, "chase tracker sample"]:
    """20 log10 |h|, at least ``DEEPEST_FADE_DB``."""
    power = fading[:, :, 0].square().addcmul_(fading[:, :, 1], fading[:, :, 1])
    return power.clamp_min_(10 ** (DEEPEST_FADE_DB / 10)).log10_().mul_(10)


@dataclass(frozen=True)
class FadingState:
    """What the fading carries from window to window; row = chase."""

    streams: ChaseStreams
    """Each chase's own random numbers; drawing advances them in place."""
    los_phase_rad: Float[Tensor, "chase tracker"] | None
    """The line-of-sight phases of a continuous process with ``los_phase = "independent"``; else None."""
    harmonics: Float[Tensor, "chase tracker 2 harmonic"] | None
    """Amplitudes of the harmonics at time 0, continuous process only."""
    time_s: Float[Tensor, "chase"]
    """Clock of the process: when the next window begins."""


class FadingProcess:
    """Correlated Rician fading, window by window.

    ``continuity = "independent"`` draws each window anew from the exact truncated eigendecomposition of its
    covariance; ``"continuous"`` runs one process through all windows of a chase as a sum of harmonics.
    Every chase draws from its own stream, so batches are free to change from window to window.
    """

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._scenario = scenario
        self._device = torch.device(device)
        self._los_amplitude = math.sqrt(scenario.rician_k / (scenario.rician_k + 1))
        scattered_amplitude = math.sqrt(1 / (scenario.rician_k + 1))
        self._mixing = spatial_mixing(scenario.spatial_correlation)
        self._sample_time_s = np.arange(scenario.window_samples) / scenario.sampling_hz
        if scenario.continuity == "independent":
            basis = scattered_amplitude * jakes_basis(self._sample_time_s, scenario.doppler_spread_hz)
            self._basis = torch.from_numpy(basis).float().to(device)
        else:
            horizon_s = max(CONTINUOUS_HORIZON_S, 2 * scenario.window_s)
            frequency_hz = harmonic_frequency_hz(scenario.doppler_spread_hz, horizon_s)
            self._frequency_hz = torch.from_numpy(frequency_hz).to(device)
            self._harmonic_amplitude = scattered_amplitude * math.sqrt(0.5 / len(frequency_hz))

    def begin(self, keys: list[ChaseKey], purpose: Purpose = "fading") -> FadingState:
        """The fading of these chases before their first window, from the streams of this purpose."""
        streams = ChaseStreams.of(keys, purpose)
        los_phase_rad = harmonics = None
        if self._scenario.continuity == "continuous":
            normals = streams.standard_normal(NUM_TRACKERS, 2, len(self._frequency_hz)).to(self._device)
            harmonics = self._mixed(normals) * self._harmonic_amplitude
            if self._scenario.los_phase == "independent":
                los_phase_rad = self._drawn_phase_rad(streams)
        return FadingState(
            streams, los_phase_rad, harmonics, torch.zeros(len(keys), dtype=torch.float64, device=self._device)
        )

    def window(self, state: FadingState) -> Float[Tensor, "chase tracker 2 sample"]:
        """The next window of every chase, float32; draws from the streams where windows are independent."""
        if state.harmonics is None:
            normals = state.streams.standard_normal(NUM_TRACKERS, 2, self._basis.shape[0]).to(self._device)
            scattered = self._mixed(normals) @ self._basis
        else:
            scattered = self._sum_of_harmonics(state.harmonics, state.time_s)
        return self._with_line_of_sight(scattered, state)

    def after_movement(self, state: FadingState, travel_m: Float[Tensor, "chase"]) -> FadingState:
        """When the window after the next movement begins: one window and the way at the trackers' speed later."""
        travel_s = travel_m / self._scenario.tracker_speed_mps
        return replace(state, time_s=state.time_s + self._scenario.window_s + travel_s)

    def _mixed(self, normals: Float[Tensor, "chase tracker 2 k"]) -> Float[Tensor, "chase tracker 2 k"]:
        """The matrix square root of C (Eq. 3) applied across trackers."""
        own, shared = self._mixing
        return torch.add(normals.sum(dim=1, keepdim=True).mul_(shared), normals, alpha=own)

    def _sum_of_harmonics(
        self, harmonics: Float[Tensor, "chase tracker 2 harmonic"], time_s: Float[Tensor, "chase"]
    ) -> Float[Tensor, "chase tracker 2 sample"]:
        amplitudes = torch.complex(harmonics[:, :, 0].contiguous(), harmonics[:, :, 1].contiguous())
        angular = 2 * math.pi * self._frequency_hz
        rotation = torch.polar(torch.ones_like(angular), angular * time_s[:, None])
        sample_time_s = torch.from_numpy(self._sample_time_s).to(self._device)
        steering = torch.polar(
            torch.ones(1, dtype=torch.float64, device=self._device), angular[:, None] * sample_time_s
        )
        process = (amplitudes * rotation.to(torch.complex64)[:, None, :]) @ steering.to(torch.complex64)
        return torch.view_as_real(process).movedim(-1, 2).contiguous()

    def _with_line_of_sight(
        self, scattered: Float[Tensor, "chase tracker 2 sample"], state: FadingState
    ) -> Float[Tensor, "chase tracker 2 sample"]:
        if self._scenario.los_phase == "common":
            scattered[:, :, 0] += self._los_amplitude
            return scattered
        phase_rad = self._drawn_phase_rad(state.streams) if state.los_phase_rad is None else state.los_phase_rad
        scattered[:, :, 0] += (self._los_amplitude * phase_rad.cos()).float()[:, :, None]
        scattered[:, :, 1] += (self._los_amplitude * phase_rad.sin()).float()[:, :, None]
        return scattered

    def _drawn_phase_rad(self, streams: ChaseStreams) -> Float[Tensor, "chase tracker"]:
        return (2 * math.pi * streams.uniform(NUM_TRACKERS)).to(self._device)


def spatial_mixing(spatial_correlation: float) -> tuple[float, float]:
    """(own, shared) of the symmetric square root ``own I + shared 1 1^T`` of C, uniform correlation rho (Eq. 4)."""
    own = math.sqrt(1 - spatial_correlation)
    shared = (math.sqrt(1 + (NUM_TRACKERS - 1) * spatial_correlation) - own) / NUM_TRACKERS
    return own, shared


def jakes_basis(
    sample_time_s: "np.ndarray[tuple[int], np.dtype[np.float64]]", doppler_spread_hz: float
) -> "np.ndarray[tuple[int, int], np.dtype[np.float64]]":
    """B [rank, sample] such that w B, w of CN(0, 1), has the covariance J0(2 pi f_d tau) of Clarke's model.

    The Toeplitz matrix is numerically singular (its condition passes 1e15), so Cholesky fails; the eigenvectors
    that hold all but ``DISCARDED_POWER`` of the power are exact to that figure. Each of the two parts of w has
    variance 1/2, which is folded into B: feed standard normals for both.
    """
    covariance = toeplitz(j0(2 * np.pi * doppler_spread_hz * sample_time_s))
    eigenvalue, eigenvector = eigh(covariance)
    kept = eigenvalue > DISCARDED_POWER * eigenvalue.sum()
    return np.asarray((eigenvector[:, kept] * np.sqrt(eigenvalue[kept] / 2)).T)


def harmonic_frequency_hz(doppler_spread_hz: float, horizon_s: float) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    """Frequencies f_d cos(pi (p + 1/2) / P) whose equal sum is Clarke's process up to ``horizon_s``.

    With P angles the autocorrelation errs by J_2P(2 pi f_d tau), which falls faster than exponentially once
    2 P exceeds its argument; P is the smallest that meets ``HARMONIC_TOLERANCE`` at the horizon.
    """
    reach = 2 * math.pi * doppler_spread_hz * horizon_s
    num_harmonics = max(1, math.ceil(reach / 2))
    while abs(float(jv(2 * num_harmonics, reach))) > HARMONIC_TOLERANCE:
        num_harmonics += 1
    angle_rad = np.pi * (np.arange(num_harmonics) + 0.5) / num_harmonics
    return np.asarray(doppler_spread_hz * np.cos(angle_rad))
