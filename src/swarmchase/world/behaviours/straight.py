"""``straight``: flies off at full speed in any direction, climbing or sinking a little."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ...batch.array_types import Float, Tensor
from ...batch.streams import ChaseKey, ChaseStreams
from ...scenario import Scenario
from .protocol import Swarm, Target
from .steering import Steering, drawn_course


@dataclass(frozen=True)
class Course:
    """Where each target flies."""

    wanted_mps: Float[Tensor, "chase 3"]


class Straight:
    """A ``Behaviour`` that draws its course once."""

    is_still = False

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._steering = Steering(scenario)
        self._device = torch.device(device)

    def begin(self, keys: Sequence[ChaseKey], start_m: Float[Tensor, "chase 3"]) -> Target:
        """At rest, with a course in mind."""
        course = drawn_course(ChaseStreams.of(keys, "behaviour").uniform(2).to(self._device))
        return Target.at_rest(start_m.to(self._device), Course(self._steering.speed_mps * course))

    def fly(self, target: Target, seconds: Float[Tensor, "chase"], swarm: Swarm) -> Target:
        """Along the course; at an end of the altitude band, level."""
        return self._steering.flown(target, target.plan.wanted_mps, seconds, target.plan)
