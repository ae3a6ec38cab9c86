"""``circle``: flies a level circle at full speed, or as fast as its acceleration allows on that circle."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ...batch.array_types import Float, Tensor
from ...batch.streams import ChaseKey, ChaseStreams
from ...flight import direction, length
from ...scenario import Scenario
from .protocol import Swarm, Target
from .steering import Steering, turned

SMALLEST_RADIUS_M, LARGEST_RADIUS_M = 20.0, 60.0
TURNING_SHARE = 0.9
"""Of the acceleration that a target may have, the most that its circle takes; the rest holds it there."""
CORRECTION_M = 4.0
"""So far from its circle it steers by 45 degrees back to it."""


@dataclass(frozen=True)
class Loop:
    """The circle of each target."""

    center_m: Float[Tensor, "chase 3"]
    radius_m: Float[Tensor, "chase"]
    turning: Float[Tensor, "chase"]
    """1 to the left, -1 to the right."""


class Circle:
    """A ``Behaviour`` that draws radius, centre and sense once."""

    is_still = False

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._steering = Steering(scenario)
        self._device = torch.device(device)

    def begin(self, keys: Sequence[ChaseKey], start_m: Float[Tensor, "chase 3"]) -> Target:
        """At rest on the circle."""
        drawn = ChaseStreams.of(keys, "behaviour").uniform(3).to(self._device)
        start_m = start_m.to(self._device)
        angle_rad = 2 * math.pi * drawn[:, 0]
        radius_m = SMALLEST_RADIUS_M + (LARGEST_RADIUS_M - SMALLEST_RADIUS_M) * drawn[:, 1]
        outwards = torch.stack([angle_rad.cos(), angle_rad.sin(), torch.zeros_like(angle_rad)], dim=1)
        turning = 1.0 - 2.0 * (drawn[:, 2] < 0.5).double()
        return Target.at_rest(start_m, Loop(start_m - radius_m[:, None] * outwards, radius_m, turning))

    def fly(self, target: Target, seconds: Float[Tensor, "chase"], swarm: Swarm) -> Target:
        """Along the circle's tangent where it will be after the step, and back to the circle."""
        plan: Loop = target.plan
        fastest_mps = (TURNING_SHARE * self._steering.acceleration_mps2 * plan.radius_m).sqrt_()
        speed_mps = fastest_mps.clamp_max_(self._steering.speed_mps)
        outwards_m = (target.position_m - plan.center_m)[:, :2]
        back_rad = ((length(outwards_m) - plan.radius_m) / CORRECTION_M).atan_()
        along_rad = math.pi / 2 + back_rad + speed_mps * seconds / plan.radius_m
        x, y = turned(direction(outwards_m), plan.turning * along_rad)
        wanted_mps = speed_mps[:, None] * torch.stack([x, y, torch.zeros_like(x)], dim=1)
        return self._steering.flown(target, wanted_mps, seconds, plan)
