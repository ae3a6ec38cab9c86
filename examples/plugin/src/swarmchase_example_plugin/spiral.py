"""A behaviour: the target climbs around where it started, in a circle that widens."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from swarmchase import Scenario
from swarmchase.batch.streams import ChaseKey
from swarmchase.world.behaviours.protocol import Swarm, Target
from swarmchase.world.behaviours.steering import Steering

WIDENS_BY_M = 0.5
"""Every second."""
CLIMB_SHARE = 0.1
"""Of its speed."""


@dataclass(frozen=True)
class Since:
    """How long each target has flown."""

    seconds: torch.Tensor


class Spiral:
    """Its direction turns as fast as its circle, at its speed, demands."""

    is_still = False

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._steering = Steering(scenario)
        self._speed_mps = scenario.target_speed_mps
        self._device = torch.device(device)

    def begin(self, keys: Sequence[ChaseKey], start_m: torch.Tensor) -> Target:
        """At rest."""
        start_m = start_m.to(self._device)
        return Target.at_rest(start_m, Since(torch.zeros(len(keys), dtype=torch.float64, device=self._device)))

    def fly(self, target: Target, seconds: torch.Tensor, swarm: Swarm) -> Target:
        """Along the spiral."""
        since_s = target.plan.seconds + seconds
        # The angle of a circle that widens evenly: the integral of speed / radius.
        angle_rad = self._speed_mps / WIDENS_BY_M * torch.log1p(WIDENS_BY_M * since_s / 10.0)
        level_mps = self._speed_mps * math.sqrt(1 - CLIMB_SHARE**2)
        climb_mps = torch.full_like(angle_rad, CLIMB_SHARE * self._speed_mps)
        wanted_mps = torch.stack([level_mps * angle_rad.cos(), level_mps * angle_rad.sin(), climb_mps], dim=1)
        return self._steering.flown(target, wanted_mps, seconds, Since(since_s))
