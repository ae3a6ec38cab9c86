"""``wander``: no aim, but a velocity in mind, which is an Ornstein-Uhlenbeck process."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ...batch.array_types import Float, Tensor
from ...batch.streams import ChaseKey, ChaseStreams
from ...scenario import Scenario
from .protocol import Swarm, Target
from .steering import Steering, drawn_where

CORRELATION_S = 5.0
"""Over this time the correlation of the velocity in mind with itself falls to 1 / e."""
SPREAD = (1.5, 1.5, 0.5)
"""Standard deviation of that velocity on each axis, over the speed of the target: mostly it is flown at full speed."""
CHANGE_S = 0.5
"""So often the process is looked up, by its exact discretisation; between, the velocity in mind stays."""


@dataclass(frozen=True)
class Whim:
    """What each target has in mind, and for how long."""

    wanted_mps: Float[Tensor, "chase 3"]
    """Not limited by any speed."""
    left_s: Float[Tensor, "chase"]


class Wander:
    """A ``Behaviour`` that draws at every change of mind."""

    is_still = False

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._steering = Steering(scenario)
        self._device = torch.device(device)
        spread = torch.tensor(SPREAD, dtype=torch.float64, device=self._device)
        self._spread_mps = self._steering.speed_mps * spread
        self._kept = math.exp(-CHANGE_S / CORRELATION_S)

    def begin(self, keys: Sequence[ChaseKey], start_m: Float[Tensor, "chase 3"]) -> Target:
        """At rest, with any velocity in mind."""
        streams = ChaseStreams.of(keys, "behaviour")
        wanted_mps = self._spread_mps * streams.standard_normal(3).double().to(self._device)
        left_s = torch.full((len(keys),), CHANGE_S, dtype=torch.float64, device=self._device)
        return Target.at_rest(start_m.to(self._device), Whim(wanted_mps, left_s), streams)

    def fly(self, target: Target, seconds: Float[Tensor, "chase"], swarm: Swarm) -> Target:
        """With the velocity in mind, or as much of it as the limits allow."""
        plan: Whim = target.plan
        assert target.streams is not None
        due = (plan.left_s <= 0) & (seconds > 0)
        drawn = drawn_where(due, target.streams, lambda streams: streams.standard_normal(3))
        following_mps = self._kept * plan.wanted_mps + math.sqrt(1 - self._kept**2) * self._spread_mps * drawn
        wanted_mps = torch.where(due[:, None], following_mps, plan.wanted_mps)
        left_s = plan.left_s + CHANGE_S * due - seconds
        return self._steering.flown(target, wanted_mps, seconds, Whim(wanted_mps, left_s))
