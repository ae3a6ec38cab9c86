"""Fading that runs on through the windows of a chase, with one Doppler spread whoever moves."""

import math
from dataclasses import dataclass

import numpy as np
import torch

from ..batch.array_types import Float, Tensor
from ..batch.streams import ChaseKey, ChaseStreams, Purpose
from ..scenario import NUM_TRACKERS, Scenario
from .fading import amplitudes, drawn_los_phase_rad, mixed, spatial_mixing, with_line_of_sight

HARMONIC_TOLERANCE = 1e-12
"""Largest error of the harmonic sampler's autocorrelation within its horizon."""
CONTINUOUS_HORIZON_S = 60.0
"""Lags up to which the continuous process has the exact autocorrelation; a window and a movement last at most 6 s."""
CLOCK_HZ = 1e9
"""Times between samples count in whole nanoseconds, so that they are the same early and late in a chase."""


@dataclass(frozen=True)
class RunningProcessState:
    """The one process of each chase."""

    harmonics: Float[Tensor, "chase tracker 2 harmonic"]
    """Amplitudes of the harmonics at time 0, float32."""
    los_phase_rad: Float[Tensor, "chase tracker"] | None
    """The line-of-sight phases with ``los_phase = "independent"``; else None."""


class RunningProcess:
    """``Fading`` as a sum of harmonics that is evaluated at any times."""

    heeds_motion = False

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._scenario = scenario
        self._device = torch.device(device)
        self._los_amplitude, scattered_amplitude = amplitudes(scenario)
        self._mixing = spatial_mixing(scenario.spatial_correlation)
        horizon_s = max(CONTINUOUS_HORIZON_S, 2 * scenario.window_s)
        frequency_hz = harmonic_frequency_hz(scenario.doppler_spread_hz, horizon_s)
        self._angular = 2 * math.pi * torch.from_numpy(frequency_hz).to(device)
        self._harmonic_amplitude = scattered_amplitude * math.sqrt(0.5 / len(frequency_hz))

    def begin(self, keys: list[ChaseKey], purpose: Purpose = "fading") -> RunningProcessState:
        """The processes of these chases."""
        streams = ChaseStreams.of(keys, purpose)
        normals = streams.standard_normal(NUM_TRACKERS, 2, len(self._angular)).to(self._device)
        harmonics = mixed(normals, self._mixing) * self._harmonic_amplitude
        los_phase_rad = None
        if self._scenario.los_phase == "independent":
            los_phase_rad = drawn_los_phase_rad(streams).to(self._device)
        return RunningProcessState(harmonics, los_phase_rad)

    def gain(
        self,
        state: RunningProcessState,
        time_s: Float[Tensor, "chase sample"],
        moved_m: Float[Tensor, "chase sample tracker"] | None = None,
    ) -> tuple[Float[Tensor, "chase tracker 2 sample"], RunningProcessState]:
        """The processes at these times, in any order."""
        begin_s = time_s[:, 0]
        since_begin_s = (time_s - begin_s[:, None]).mul_(CLOCK_HZ).round_().div_(CLOCK_HZ)
        if (since_begin_s == since_begin_s[:1]).all():
            # The sum is that of the first row, and noughts in a batch of no chases.
            scattered = self._sum_of_harmonics(state.harmonics, begin_s, since_begin_s[:1].sum(dim=0))
        else:  # nothing is to be gained for many chases at once
            scattered = torch.cat(
                [
                    self._sum_of_harmonics(state.harmonics[row : row + 1], begin_s[row : row + 1], since_begin_s[row])
                    for row in range(len(time_s))
                ]
            )
        return with_line_of_sight(scattered, self._los_amplitude, state.los_phase_rad), state

    def _sum_of_harmonics(
        self,
        harmonics: Float[Tensor, "chase tracker 2 harmonic"],
        begin_s: Float[Tensor, "chase"],
        since_begin_s: Float[Tensor, "sample"],
    ) -> Float[Tensor, "chase tracker 2 sample"]:
        amplitude = torch.complex(harmonics[:, :, 0].contiguous(), harmonics[:, :, 1].contiguous())
        one = torch.ones(1, dtype=torch.float64, device=self._device)
        rotation = torch.polar(one, self._angular * begin_s[:, None])
        steering = torch.polar(one, self._angular[:, None] * since_begin_s)
        process = (amplitude * rotation.to(torch.complex64)[:, None, :]) @ steering.to(torch.complex64)
        return torch.view_as_real(process).movedim(-1, 2).contiguous()


def harmonic_frequency_hz(doppler_spread_hz: float, horizon_s: float) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    """Frequencies f_d cos(pi (p + 1/2) / P) whose equal sum is Clarke's process up to ``horizon_s``.

    With P angles the autocorrelation errs by J_2P(2 pi f_d tau), which falls faster than exponentially once
    2 P exceeds its argument; P is the smallest that meets ``HARMONIC_TOLERANCE`` at the horizon.
    """
    from scipy.special import jv

    reach = 2 * math.pi * doppler_spread_hz * horizon_s
    num_harmonics = max(1, math.ceil(reach / 2))
    while abs(float(jv(2 * num_harmonics, reach))) > HARMONIC_TOLERANCE:
        num_harmonics += 1
    angle_rad = np.pi * (np.arange(num_harmonics) + 0.5) / num_harmonics
    return np.asarray(doppler_spread_hz * np.cos(angle_rad))
