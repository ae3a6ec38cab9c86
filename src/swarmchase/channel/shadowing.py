"""What stands in the way of the signal: log-normal shadowing, a stationary Gaussian field in space, in dB.

Its correlation falls with the distance r as exp(-r / d_cor) (M. Gudmundson, Correlation model for shadow fading in
mobile radio systems, Electronics Letters 27, 1991). It has two parts. What surrounds the target is a field of the
target's place, and all trackers have it in common; what lies elsewhere is a field of the tracker's place. With the
common part's share c of the variance, trackers at x_u and x_v that hear a target move from y to y' have the correlation

    c exp(-|y - y'| / d_cor) + (1 - c) exp(-|x_u - x_v| / d_cor)

Each field is a sum of waves (A. Rahimi and B. Recht, Random features for large-scale kernel machines, 2007). Their wave
vectors follow the spectrum of exp(-r / d_cor) in space, a Cauchy distribution of three dimensions, and their amplitudes
and phases make the sum Gaussian: over many chases its law is exact, however few waves there are.
"""

import math
from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Tensor
from ..batch.streams import ChaseKey, ChaseStreams
from ..scenario import Scenario

NUM_WAVES = 32
"""In a field of one chase: so many that each has little."""
EVALUATED_S = 0.5
"""At most so long apart the fields are evaluated; what samples in between hear is interpolated."""


@dataclass(frozen=True)
class ShadowingState:
    """The two fields of each chase, the target's and the trackers', float32."""

    wave_rad_per_m: Float[Tensor, "chase field 3 wave"]
    """Wave vectors."""
    phase_rad: Float[Tensor, "chase field wave"]
    """At the origin."""
    amplitude_db: Float[Tensor, "chase field wave"]
    """Of each wave."""


class Shadowing:
    """The shadowing of one scenario."""

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._scenario = scenario
        self._device = torch.device(device)

    def begin(self, keys: list[ChaseKey]) -> ShadowingState:
        """The fields that these chases have drawn."""
        streams = ChaseStreams.of(keys, "shadowing")
        scenario = self._scenario
        normals = streams.standard_normal(2, 4, NUM_WAVES)
        wave = normals[:, :, :3] / normals[:, :, 3:].abs().clamp_min(1e-6) / scenario.shadowing_distance_m
        share = torch.tensor([scenario.shadowing_common_share, 1 - scenario.shadowing_common_share])
        rayleigh = (-2 * torch.log1p(-streams.uniform(2, NUM_WAVES))).sqrt()
        amplitude_db = scenario.shadowing_db * (share.sqrt()[:, None] * rayleigh / math.sqrt(NUM_WAVES))
        phase_rad = 2 * math.pi * streams.uniform(2, NUM_WAVES)
        return ShadowingState(
            wave.to(self._device), phase_rad.float().to(self._device), amplitude_db.float().to(self._device)
        )

    def added_db(
        self,
        state: ShadowingState,
        target_position_m: Float[Tensor, "chase place 3"],
        tracker_position_m: Float[Tensor, "chase place tracker 3"],
    ) -> Float[Tensor, "chase place tracker"]:
        """What it adds to the level at each tracker, float32."""
        num_places = target_position_m.shape[1]
        lasts_s = (num_places - 1) / self._scenario.sampling_hz
        num_intervals = min(num_places - 1, math.ceil(lasts_s / EVALUATED_S))
        if num_intervals == num_places - 1:
            return self._evaluated_db(state, target_position_m, tracker_position_m)
        place = [round(number * (num_places - 1) / num_intervals) for number in range(num_intervals + 1)]
        ends_db = self._evaluated_db(state, target_position_m[:, place], tracker_position_m[:, place])
        pieces = []
        for number in range(num_intervals):
            num_samples = place[number + 1] - place[number]
            share = torch.arange(num_samples, device=self._device)[:, None] / num_samples
            begin_db, end_db = ends_db[:, number, None], ends_db[:, number + 1, None]
            pieces.append(begin_db + share * (end_db - begin_db))
        return torch.cat([*pieces, ends_db[:, -1:]], dim=1)

    @staticmethod
    def _evaluated_db(
        state: ShadowingState,
        target_position_m: Float[Tensor, "chase place 3"],
        tracker_position_m: Float[Tensor, "chase place tracker 3"],
    ) -> Float[Tensor, "chase place tracker"]:
        return _field_db(state, 0, target_position_m[:, :, None]) + _field_db(state, 1, tracker_position_m)


def _field_db(
    state: ShadowingState, field: int, position_m: Float[Tensor, "chase place point 3"]
) -> Float[Tensor, "chase place point"]:
    position_m = position_m.float()
    phase_rad = state.phase_rad[:, field, None, None]
    for axis in range(3):  # one after the other, so that a chase is the same in any batch
        phase_rad = phase_rad + position_m[..., axis, None] * state.wave_rad_per_m[:, field, axis, None, None]
    field_db: Tensor = (state.amplitude_db[:, field, None, None] * phase_rad.cos()).sum(dim=3)
    return field_db
