"""``flee``: straight away from the swarm's centre at full speed; hovers while that is beyond the alert distance."""

from collections.abc import Sequence

import torch

from ...batch.array_types import Float, Tensor
from ...batch.streams import ChaseKey
from ...flight import direction
from ...scenario import Scenario
from .protocol import Swarm, Target
from .steering import Steering


class Flee:
    """A ``Behaviour`` that draws nothing and remembers nothing."""

    is_still = False

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._steering = Steering(scenario)
        self._device = torch.device(device)

    def begin(self, keys: Sequence[ChaseKey], start_m: Float[Tensor, "chase 3"]) -> Target:
        """At rest."""
        return Target.at_rest(start_m.to(self._device))

    def fly(self, target: Target, seconds: Float[Tensor, "chase"], swarm: Swarm) -> Target:
        """Away; at an end of the altitude band, with the level part of that velocity."""
        away_m = target.position_m - swarm.center_m
        wanted_mps = self._steering.if_alert(self._steering.speed_mps * direction(away_m), away_m)
        return self._steering.flown(target, wanted_mps, seconds)
