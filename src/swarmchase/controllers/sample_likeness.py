"""How alike the powers of samples are that fade as fast as target and trackers fly against each other."""

import math

import torch

from ..batch.array_types import Float, Tensor
from ..scenario import SPEED_OF_LIGHT_MPS, Scenario

SPEED_STEP_MPS, NUM_SPEEDS = 0.02, 2000
"""Speeds of target and tracker against each other for which the fading is tabulated."""


class SampleLikeness:
    """By the scenario's channel."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._alike_of: dict[int, Tensor] = {}

    def alike(self, speed_mps: Float[Tensor, "*batch"], num_samples: int) -> Float[Tensor, "*batch"]:
        """The mean correlation between the powers of two different samples of an interval, at these speeds."""
        step = (speed_mps / SPEED_STEP_MPS).round_().clamp_(max=NUM_SPEEDS - 1).long()
        return self._table(num_samples).index_select(0, step.flatten()).view(step.shape)

    def _table(self, num_samples: int) -> Float[Tensor, "speed"]:
        """Speed by speed.

        Two samples are correlated like (J0(x)^2 + 2 K J0(x)) / (1 + 2 K), x being 2 pi times the wavelengths that
        target and trackers have flown against each other between them. A negative mean counts as none: it takes a speed
        that is exactly even.
        """
        if num_samples not in self._alike_of:
            scenario = self._scenario
            speed_mps = torch.arange(NUM_SPEEDS, dtype=torch.float64) * SPEED_STEP_MPS
            if scenario.continuity != "in_flight":
                speed_mps = torch.zeros_like(speed_mps)
            doppler_hz = (speed_mps * scenario.carrier_hz / SPEED_OF_LIGHT_MPS).clamp(min=scenario.doppler_spread_hz)
            lag = torch.arange(1, num_samples, dtype=torch.float64)
            bessel = torch.special.bessel_j0(2 * math.pi * doppler_hz[:, None] * lag / scenario.sampling_hz)
            alike = (bessel.square() + 2 * scenario.rician_k * bessel) / (1 + 2 * scenario.rician_k)
            pairs = num_samples - lag
            mean = (alike * pairs).sum(dim=1) / pairs.sum().clamp(min=1)
            self._alike_of[num_samples] = mean.clamp(min=0.0).float()
        return self._alike_of[num_samples]


def variance_of_power(scenario: Scenario) -> float:
    """Of one sample relative to its mean: (2 K + 1) / (K + 1)^2."""
    k = scenario.rician_k
    return (2 * k + 1) / (k + 1) ** 2


def correlation_of_powers(scenario: Scenario) -> float:
    """Between two trackers at one moment: (rho^2 + 2 K rho) / (1 + 2 K), without what the line of sight has in common
    where its phase is another at each.
    """
    rho, k = scenario.spatial_correlation, scenario.rician_k
    in_step = 2 * k * rho if scenario.los_phase == "common" else 0.0
    return (rho**2 + in_step) / (1 + 2 * k)
