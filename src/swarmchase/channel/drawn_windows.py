"""Fading drawn anew for every window: the paper's world, where a movement is tens of wavelengths long."""

from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Tensor
from ..batch.streams import ChaseKey, ChaseStreams, Purpose
from ..scenario import NUM_TRACKERS, Scenario
from .fading import amplitudes, drawn_los_phase_rad, mixed, spatial_mixing, with_line_of_sight
from .jakes_basis import jakes_basis


@dataclass(frozen=True)
class DrawnWindowsState:
    """What the fading carries from window to window."""

    streams: ChaseStreams
    """Each chase's own random numbers; drawing advances them in place."""


class DrawnWindows:
    """``Fading`` of which each call draws a window from the exact truncated eigendecomposition of its covariance.

    Within a window it goes as if trackers and target hovered, with the scenario's Doppler spread, and the samples are
    1 / F apart whatever their times; a window's line-of-sight phases, where they are independent, are its own.
    """

    heeds_motion = False

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._scenario = scenario
        self._device = torch.device(device)
        self._los_amplitude, self._scattered_amplitude = amplitudes(scenario)
        self._mixing = spatial_mixing(scenario.spatial_correlation)
        self._bases: dict[int, Tensor] = {}

    def begin(self, keys: list[ChaseKey], purpose: Purpose = "fading") -> DrawnWindowsState:
        """The streams of these chases: nothing else outlasts a window."""
        return DrawnWindowsState(ChaseStreams.of(keys, purpose))

    def gain(
        self,
        state: DrawnWindowsState,
        time_s: Float[Tensor, "chase sample"],
        moved_m: Float[Tensor, "chase sample tracker"] | None = None,
    ) -> tuple[Float[Tensor, "chase tracker 2 sample"], DrawnWindowsState]:
        """A window of as many samples as there are times."""
        basis = self._basis(time_s.shape[1])
        normals = state.streams.standard_normal(NUM_TRACKERS, 2, basis.shape[0]).to(self._device)
        scattered = mixed(normals, self._mixing) @ basis
        los_phase_rad = None
        if self._scenario.los_phase == "independent":
            los_phase_rad = drawn_los_phase_rad(state.streams).to(self._device)
        return with_line_of_sight(scattered, self._los_amplitude, los_phase_rad), state

    def _basis(self, num_samples: int) -> Float[Tensor, "rank sample"]:
        if num_samples not in self._bases:
            scenario = self._scenario
            basis = jakes_basis(num_samples, scenario.sampling_hz, scenario.doppler_spread_hz)
            basis = self._scattered_amplitude * basis
            self._bases[num_samples] = torch.from_numpy(basis).float().to(self._device)
        return self._bases[num_samples]
