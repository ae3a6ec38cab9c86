"""Fading: none at all, so that the level tells the distance alone."""

from typing import Any

import torch

from swarmchase import Scenario
from swarmchase.scenario import NUM_TRACKERS


class NoFading:
    """h = 1 at every tracker and time."""

    heeds_motion = False

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._device = device

    def begin(self, keys: list[tuple[int, int]], purpose: str = "fading") -> torch.Tensor:
        """Nothing is remembered: a number a chase."""
        return torch.zeros(len(keys), device=self._device)

    def gain(self, state: Any, time_s: torch.Tensor, moved_m: torch.Tensor | None = None) -> tuple[torch.Tensor, Any]:
        """[chase, tracker, 2, sample]: in phase 1, in quadrature 0."""
        chases, samples = time_s.shape
        fading = torch.zeros(chases, NUM_TRACKERS, 2, samples, device=self._device)
        fading[:, :, 0] = 1.0
        return fading, state
