"""``jink``: flees, but never straight: every few seconds it turns off to another side, and climbs or sinks.

It looks where the swarm is every half second. One that looked at every moment would turn with a swarm that is close,
and a pursuer could hardly ever catch it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ...batch.array_types import Float, Tensor
from ...batch.streams import ChaseKey, ChaseStreams
from ...flight import direction
from ...scenario import Scenario
from .protocol import Swarm, Target
from .steering import Steering, drawn_where, turned

SHORTEST_S, LONGEST_S = 1.5, 4.0
"""From one turn to the next."""
WIDEST_TURN_RAD = math.radians(70.0)
"""To either side of the way straight from the swarm."""
STEEPEST_JINK = 0.3
"""It climbs or sinks at most this much of the way it flies sideways."""
LOOK_S = 0.5
"""From one look at the swarm to the next."""


@dataclass(frozen=True)
class Turn:
    """Where each target has seen the swarm's centre, how it turns off, and for how long either holds."""

    seen_m: Float[Tensor, "chase 3"]
    seen_left_s: Float[Tensor, "chase"]
    turn_rad: Float[Tensor, "chase"]
    climb: Float[Tensor, "chase"]
    """Over the way sideways."""
    turn_left_s: Float[Tensor, "chase"]


class Jink:
    """A ``Behaviour`` that draws every turn when it begins; hovers while the swarm is beyond the alert distance."""

    is_still = False

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._steering = Steering(scenario)
        self._device = torch.device(device)

    def begin(self, keys: Sequence[ChaseKey], start_m: Float[Tensor, "chase 3"]) -> Target:
        """At rest; the first look and the first turn are due."""
        start_m = start_m.to(self._device)
        nothing = torch.zeros_like(start_m[:, 0])
        plan = Turn(torch.zeros_like(start_m), nothing, nothing, nothing, nothing)
        return Target.at_rest(start_m, plan, ChaseStreams.of(keys, "behaviour"))

    def fly(self, target: Target, seconds: Float[Tensor, "chase"], swarm: Swarm) -> Target:
        """Away from where the swarm was seen, turned off."""
        plan = self._looked(target, seconds, swarm)
        away_m = target.position_m - plan.seen_m
        x, y = turned(direction(away_m[:, :2]), plan.turn_rad)
        wanted_mps = self._steering.speed_mps * direction(torch.stack([x, y, plan.climb], dim=1))
        return self._steering.flown(target, self._steering.if_alert(wanted_mps, away_m), seconds, plan)

    def _looked(self, target: Target, seconds: Float[Tensor, "chase"], swarm: Swarm) -> Turn:
        """The plan after the looks and turns that are due."""
        plan: Turn = target.plan
        assert target.streams is not None
        moves = seconds > 0
        looks = (plan.seen_left_s <= 0) & moves
        turns = (plan.turn_left_s <= 0) & moves
        drawn = drawn_where(turns, target.streams, lambda streams: streams.uniform(3))
        to_either_side = 2 * drawn[:, :2] - 1
        return Turn(
            seen_m=torch.where(looks[:, None], swarm.center_m, plan.seen_m),
            seen_left_s=plan.seen_left_s + LOOK_S * looks - seconds,
            turn_rad=torch.where(turns, WIDEST_TURN_RAD * to_either_side[:, 0], plan.turn_rad),
            climb=torch.where(turns, STEEPEST_JINK * to_either_side[:, 1], plan.climb),
            turn_left_s=plan.turn_left_s + turns * (SHORTEST_S + (LONGEST_S - SHORTEST_S) * drawn[:, 2]) - seconds,
        )
