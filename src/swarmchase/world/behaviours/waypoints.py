"""``waypoints``: flies at full speed from one random place to the next, all of them around where it started."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ...batch.array_types import Float, Tensor
from ...batch.streams import ChaseKey, ChaseStreams
from ...flight import direction, length
from ...scenario import Scenario
from .protocol import Swarm, Target
from .steering import Steering, drawn_where

REACH_M = (100.0, 100.0, 25.0)
"""So far from its start, on each axis and in both directions, a place may be."""
ARRIVAL_M = 5.0
"""A place has been reached when it is so near."""


@dataclass(frozen=True)
class Route:
    """Where each target is going, and the corners of what it flies in."""

    lowest_m: Float[Tensor, "chase 3"]
    highest_m: Float[Tensor, "chase 3"]
    next_m: Float[Tensor, "chase 3"]


class Waypoints:
    """A ``Behaviour`` that draws a place, uniformly, whenever it has reached one."""

    is_still = False

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._steering = Steering(scenario)
        self._device = torch.device(device)
        self._reach_m = torch.tensor(REACH_M, dtype=torch.float64, device=self._device)

    def begin(self, keys: Sequence[ChaseKey], start_m: Float[Tensor, "chase 3"]) -> Target:
        """At rest in a place, so that the next is due."""
        start_m = start_m.to(self._device)
        lowest_m, highest_m = start_m - self._reach_m, start_m + self._reach_m
        for corner_m in (lowest_m, highest_m):
            corner_m[:, 2] = self._steering.band.inside_m(corner_m[:, 2])
        return Target.at_rest(start_m, Route(lowest_m, highest_m, start_m), ChaseStreams.of(keys, "behaviour"))

    def fly(self, target: Target, seconds: Float[Tensor, "chase"], swarm: Swarm) -> Target:
        """Towards the next place."""
        plan: Route = target.plan
        assert target.streams is not None
        due = (length(plan.next_m - target.position_m) <= ARRIVAL_M) & (seconds > 0)
        drawn = drawn_where(due, target.streams, lambda streams: streams.uniform(3))
        next_m = torch.where(due[:, None], torch.lerp(plan.lowest_m, plan.highest_m, drawn), plan.next_m)
        wanted_mps = self._steering.speed_mps * direction(next_m - target.position_m)
        return self._steering.flown(target, wanted_mps, seconds, Route(plan.lowest_m, plan.highest_m, next_m))
