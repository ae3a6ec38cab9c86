"""Where a swarm goes that gets nowhere and does not know where the target is.

The movement that leaves the least expected distance parks in the middle of a belief that is wide: from there each way
is as good as the others, and what is heard there again says nothing new. It also runs against a fence for ever where
the belief lies behind it. So a swarm that stays where it is though its belief is wide goes to a place drawn from the
belief (Thompson 1933, On the likelihood that one unknown probability exceeds another), until it is there, can get no
farther, or is sure.
"""

import math
from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Int, Tensor
from ..formation import nearest_choice
from ..scenario import Scenario
from .belief import Belief

WIDE_M = 5.0
"""A belief is wide whose region has a larger radius: about one movement."""
NEAR_M = 3.0
"""A swarm that goes no farther than this stays where it is; nearer to its goal it is there."""
BLOCKED_M = 1.0
"""On the way to its goal: what moved less was stopped, by a fence for one."""
PATIENCE = 3
"""It may stay for so many windows."""


@dataclass(frozen=True)
class Exploration:
    """Of each chase."""

    goal_m: Float[Tensor, "chase 3"]
    """Where it goes; NaN of one that does not explore."""
    anchor_m: Float[Tensor, "chase 3"]
    """Where it last came to."""
    stays: Int[Tensor, "chase"]
    """Windows that it heard there."""
    last_m: Float[Tensor, "chase 3"]
    """Where it was in the last window."""

    def instead_of(
        self, displacement_m: Float[Tensor, "chase 3"], center_m: Float[Tensor, "chase 3"], scenario: Scenario
    ) -> Float[Tensor, "chase 3"]:
        """The displacement towards the goal where there is one."""
        has_goal = self.goal_m.isfinite().all(dim=1, keepdim=True)
        towards_m = nearest_choice(scenario.displacement_choices_m, (self.goal_m - center_m).nan_to_num(0.0))
        return torch.where(has_goal, towards_m, displacement_m)


def no_exploration(num_chases: int) -> Exploration:
    """At the start."""
    return Exploration(
        goal_m=torch.full((num_chases, 3), math.nan, dtype=torch.float64),
        anchor_m=torch.zeros(num_chases, 3, dtype=torch.float64),
        stays=torch.zeros(num_chases, dtype=torch.int64),
        last_m=torch.zeros(num_chases, 3, dtype=torch.float64),
    )


def explored(
    exploration: Exploration, center_m: Float[Tensor, "chase 3"], belief: Belief, drawn_m: Float[Tensor, "chase 3"]
) -> Exploration:
    """After another window, heard around the centre; ``drawn_m`` is a place drawn from the belief."""
    has_moved = (center_m - exploration.anchor_m).norm(dim=1) > NEAR_M
    stays = torch.where(has_moved, 1, exploration.stays + 1)
    anchor_m = torch.where(has_moved[:, None], center_m, exploration.anchor_m)
    is_wide = belief.radius_m > WIDE_M
    is_blocked = exploration.goal_m.isfinite().all(dim=1) & ((center_m - exploration.last_m).norm(dim=1) < BLOCKED_M)
    is_parked = (stays >= PATIENCE) | is_blocked
    is_there = (exploration.goal_m - center_m).norm(dim=1) < NEAR_M
    goal_m = torch.where((is_there | is_parked | ~is_wide)[:, None], math.nan, exploration.goal_m)
    begins = is_parked & is_wide
    return Exploration(
        goal_m=torch.where(begins[:, None], drawn_m, goal_m),
        anchor_m=anchor_m,
        stays=torch.where(begins, 0, stays),
        last_m=center_m,
    )
