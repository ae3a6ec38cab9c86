"""Fading that runs as fast as target and trackers fly: Clarke's process in travelled wavelengths.

A receiver that moves by one wavelength against its transmitter has gone through one cycle of Clarke's process, however
long that took, so the scattered part at tracker u is a stationary process of the cycles s_u that it has travelled:

    E[z_u(t) z_u*(t')] = J0(2 pi (s_u(t') - s_u(t))),    ds_u = max(|relative velocity| f_c / c, f_d) dt

(R. H. Clarke, A statistical theory of mobile-radio reception, Bell System Technical Journal 47, 1968). The scenario's
Doppler spread f_d is the floor: what surrounds a swarm that hovers moves, too. Trackers are correlated as the scenario
says, at equal times exactly:

    z_u(t) = sqrt(1 - rho) w_u(s_u) + sqrt(rho) w(s),    s the mean of the six s_u

so that a swarm that flies as one body has the autocorrelation above at every tracker; while it turns, the shared part
goes by the mean. (Were the shared process read at s_u, a swarm that has once turned would never again hear alike.)

The seven processes of a chase are read from one periodic table at places and with phases of the chase's own. The line
of sight keeps its phase, as it does in the closed forms of a Rician channel that the paper uses; the scattered waves
come from everywhere, so that the Doppler shift of one more wave changes what the envelope does by little.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
import torch

from ..batch.array_types import Float, Tensor
from ..batch.streams import ChaseKey, ChaseStreams, Purpose
from ..scenario import NUM_TRACKERS, SPEED_OF_LIGHT_MPS, Scenario
from .fading import amplitudes, drawn_los_phase_rad

TABLE_CYCLES = 1 << 13
"""After so many wavelengths the table begins anew: 10 m/s at 3 GHz take 82 s."""
POINTS_PER_CYCLE = 1 << 3
"""Between two points a cubic with the process's own values and slopes errs by 3e-4 of its standard deviation."""
NUM_POINTS = TABLE_CYCLES * POINTS_PER_CYCLE
TABLE_SEED = 7
"""Of the table's phases: of the first sixteen seeds the one whose power is nearest to exponential."""
NUM_PROCESSES = NUM_TRACKERS + 1
"""One of each tracker's own, and the shared one, which is the last."""


@dataclass(frozen=True)
class InFlightState:
    """Where each chase stands in its processes."""

    point: Float[Tensor, "chase process"]
    """Place in the table at the last sample, counted in its points, float64."""
    rotation: Float[Tensor, "chase process 2"]
    """What each process is multiplied by: its phase, its amplitude and its share in the trackers' correlation."""
    los_phase_rad: Float[Tensor, "chase tracker"] | None
    """The line-of-sight phases with ``los_phase = "independent"``; else None."""
    time_s: Float[Tensor, "chase"]
    """Of the last sample, float64."""


class InFlight:
    """``Fading`` that is continuous in time, from sample to sample and from call to call."""

    heeds_motion = True

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._scenario = scenario
        self._device = torch.device(device)
        self._los_amplitude, self._scattered_amplitude = amplitudes(scenario)
        self._table = cubic_table().to(device)

    def begin(self, keys: list[ChaseKey], purpose: Purpose = "fading") -> InFlightState:
        """The processes of these chases, and their line-of-sight phases, for the whole chase.

        Places in the table are drawn a seventh of it apart, give or take a quarter of that, so that no process follows
        another.
        """
        streams = ChaseStreams.of(keys, purpose)
        drawn = streams.uniform(2, NUM_PROCESSES)
        apart = torch.arange(NUM_PROCESSES, dtype=torch.float64) / NUM_PROCESSES
        place = drawn[:, 0, -1:] + apart + drawn[:, 0] / (2 * NUM_PROCESSES)
        phase_rad = 2 * math.pi * drawn[:, 1]
        share = torch.full((NUM_PROCESSES,), math.sqrt(1 - self._scenario.spatial_correlation), dtype=torch.float64)
        share[-1] = math.sqrt(self._scenario.spatial_correlation)
        rotation = (self._scattered_amplitude * share)[:, None] * torch.stack([phase_rad.cos(), phase_rad.sin()], dim=2)
        los_phase_rad = None
        if self._scenario.los_phase == "independent":
            los_phase_rad = drawn_los_phase_rad(streams).to(self._device)
        return InFlightState(
            point=(place % 1 * NUM_POINTS).to(self._device),
            rotation=rotation.float().to(self._device),
            los_phase_rad=los_phase_rad,
            time_s=torch.zeros(len(keys), dtype=torch.float64, device=self._device),
        )

    def gain(
        self,
        state: InFlightState,
        time_s: Float[Tensor, "chase sample"],
        moved_m: Float[Tensor, "chase sample tracker"] | None = None,
    ) -> tuple[Float[Tensor, "chase tracker 2 sample"], InFlightState]:
        """The processes at the cycles travelled at these times."""
        point = self._travelled_points(state, time_s, moved_m).add_(state.point[:, :, None])
        last = point[:, :, -1]
        last = last - (last / NUM_POINTS).floor_() * NUM_POINTS
        processes = self._read(point).mul_(torch.view_as_complex(state.rotation)[:, :, None])
        fading, shared = processes[:, :NUM_TRACKERS], processes[:, NUM_TRACKERS:]
        if state.los_phase_rad is None:
            shared.add_(self._los_amplitude)
        fading.add_(shared)
        if state.los_phase_rad is not None:
            amplitude = torch.full_like(state.los_phase_rad, self._los_amplitude)
            fading.add_(torch.polar(amplitude, state.los_phase_rad).to(torch.complex64)[:, :, None])
        following = InFlightState(
            point=last,
            rotation=state.rotation,
            los_phase_rad=state.los_phase_rad,
            time_s=time_s[:, -1].clone(),
        )
        return torch.view_as_real(fading).movedim(-1, 2), following

    def _travelled_points(
        self,
        state: InFlightState,
        time_s: Float[Tensor, "chase sample"],
        moved_m: Float[Tensor, "chase sample tracker"] | None,
    ) -> Float[Tensor, "chase process sample"]:
        """Since the last sample of the call before."""
        wavelength_m = SPEED_OF_LIGHT_MPS / self._scenario.carrier_hz
        lasted_s = time_s.diff(dim=1, prepend=state.time_s[:, None])
        least = lasted_s * (self._scenario.doppler_spread_hz * POINTS_PER_CYCLE)
        travelled = least.new_empty(len(least), NUM_PROCESSES, least.shape[1])
        own, shared = travelled[:, :NUM_TRACKERS], travelled[:, -1]
        if moved_m is None:
            own.copy_(least[:, None])
        else:
            torch.mul(moved_m.transpose(1, 2), POINTS_PER_CYCLE / wavelength_m, out=own)
            torch.maximum(own, least[:, None], out=own)
        own.cumsum_(dim=2)
        torch.sum(own, dim=1, out=shared).mul_(1 / NUM_TRACKERS)
        return travelled

    def _read(self, point: Float[Tensor, "chase process sample"]) -> Tensor:
        """The table here, complex64, by the cubic of the cell that each lies in; overwrites ``point``."""
        index = point.int().bitwise_and_(NUM_POINTS - 1).flatten()
        # A product of two complex numbers takes less time than one with a real number.
        beyond = point.frac_().to(torch.complex64).flatten()
        value = self._table[3].index_select(0, index)
        following = torch.empty_like(value)
        for power in (2, 1, 0):
            torch.index_select(self._table[power], 0, index, out=following)
            value, following = following.addcmul_(value, beyond), value
        return value.view(point.shape)


@functools.cache
def cubic_table() -> Tensor:
    """The coefficients of a cubic in each cell, complex64 [coefficient, cell].

    Each frequency of the period has the power that Clarke's spectrum has around it, 1 / (pi sqrt(1 - f^2)), and a phase
    that is drawn: the autocorrelation around the circle is J0 for this one table and not only on average.
    """
    number = np.arange(-TABLE_CYCLES, TABLE_CYCLES + 1)
    edges = np.clip(np.arange(-TABLE_CYCLES - 0.5, TABLE_CYCLES + 1) / TABLE_CYCLES, -1, 1)
    power = np.diff(np.arcsin(edges)) / np.pi
    phase_rad = np.random.default_rng(TABLE_SEED).uniform(0, 2 * np.pi, len(number))
    spectrum = np.zeros((2, NUM_POINTS), dtype=np.complex128)
    spectrum[0, number] = np.sqrt(power) * np.exp(1j * phase_rad)
    spectrum[1, number] = spectrum[0, number] * 2j * np.pi * number / NUM_POINTS
    value, slope = np.fft.ifft(spectrum, norm="forward")
    following, its_slope = np.roll(value, -1), np.roll(slope, -1)
    cubic = [
        value,
        slope,
        3 * (following - value) - 2 * slope - its_slope,
        2 * (value - following) + slope + its_slope,
    ]
    return torch.from_numpy(np.stack(cubic)).to(torch.complex64)
