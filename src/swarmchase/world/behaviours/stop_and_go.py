"""``stop-and-go``: hovers for a while, flies in any direction for a while, and hovers again."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ...batch.array_types import Bool, Float, Tensor
from ...batch.streams import ChaseKey, ChaseStreams
from ...scenario import Scenario
from .protocol import Swarm, Target
from .steering import Steering, drawn_course, drawn_where

SHORTEST_S, LONGEST_S = 5.0, 15.0
"""Of hovering, and of flying."""


@dataclass(frozen=True)
class Leg:
    """What each target does, and for how long."""

    wanted_mps: Float[Tensor, "chase 3"]
    is_going: Bool[Tensor, "chase"]
    left_s: Float[Tensor, "chase"]


class StopAndGo:
    """A ``Behaviour`` that draws every leg when it begins; the first is a stop or a flight, as it happens."""

    is_still = False

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._steering = Steering(scenario)
        self._device = torch.device(device)

    def begin(self, keys: Sequence[ChaseKey], start_m: Float[Tensor, "chase 3"]) -> Target:
        """At rest, the first leg due."""
        streams = ChaseStreams.of(keys, "behaviour")
        start_m = start_m.to(self._device)
        is_going = (streams.uniform(1)[:, 0] < 0.5).to(self._device)
        return Target.at_rest(
            start_m, Leg(torch.zeros_like(start_m), is_going, torch.zeros_like(start_m[:, 0])), streams
        )

    def fly(self, target: Target, seconds: Float[Tensor, "chase"], swarm: Swarm) -> Target:
        """At full speed, or not at all."""
        plan: Leg = target.plan
        assert target.streams is not None
        due = (plan.left_s <= 0) & (seconds > 0)
        drawn = drawn_where(due, target.streams, lambda streams: streams.uniform(3))
        is_going = plan.is_going ^ due
        following_mps = self._steering.speed_mps * drawn_course(drawn[:, :2]) * is_going[:, None]
        wanted_mps = torch.where(due[:, None], following_mps, plan.wanted_mps)
        left_s = plan.left_s + due * (SHORTEST_S + (LONGEST_S - SHORTEST_S) * drawn[:, 2]) - seconds
        return self._steering.flown(target, wanted_mps, seconds, Leg(wanted_mps, is_going, left_s))
