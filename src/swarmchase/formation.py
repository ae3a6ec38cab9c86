"""The swarm's geometry: where the six trackers are, and what an action does (Sections II.A and III.A)."""

from dataclasses import dataclass

import torch

from .batch.array_types import Float, Int, Tensor
from .flight import direction
from .scenario import Scenario

TRACKER_DIRECTION = torch.tensor(
    [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=torch.float64
)
"""Tracker u = 0..5 sits at +x, -x, +y, -y, +z, -z of the centre."""


@dataclass(frozen=True)
class Action:
    """What the controller decides for each chase of a batch."""

    spacing_m: Float[Tensor, "chase"]
    """Distance of every tracker from the centre: one of A^d, or in flight any between them."""
    displacement_m: Float[Tensor, "chase 3"]
    """Movement of the centre: each axis one of A^x, A^y, A^z, or in flight any that its speed permits."""


def tracker_position_m(
    center_m: Float[Tensor, "chase 3"], spacing_m: Float[Tensor, "chase"]
) -> Float[Tensor, "chase tracker 3"]:
    """Positions of the six trackers around their centre."""
    return center_m[:, None, :] + spacing_m[:, None, None] * TRACKER_DIRECTION.to(center_m.device)


def action_from_choice(scenario: Scenario, choice: Int[Tensor, "chase 4"]) -> Action:
    """The action of four choices 0..4 in the order d, x, y, z."""
    spacing_choices_m = torch.tensor(scenario.spacing_choices_m, dtype=torch.float64, device=choice.device)
    displacement_choices_m = torch.tensor(scenario.displacement_choices_m, dtype=torch.float64, device=choice.device)
    return Action(spacing_m=spacing_choices_m[choice[:, 0]], displacement_m=displacement_choices_m[choice[:, 1:]])


def nearest_choice(choices_m: tuple[float, ...], wanted_m: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """The choice next to what is wanted, element by element, float64."""
    choice_m = torch.tensor(choices_m, dtype=torch.float64, device=wanted_m.device)
    nearest_m: Tensor = choice_m[(wanted_m[..., None] - choice_m).abs().argmin(dim=-1)]
    return nearest_m


def displacement_towards(scenario: Scenario, way_m: Float[Tensor, "chase 3"]) -> Float[Tensor, "chase 3"]:
    """What brings the centre nearest to the end of this way, float64.

    Where trackers stop to listen, the nearest choice on each axis. In flight, at full speed that way: the target counts
    as reached on the way too, and who slows down behind one that flees keeps its distance from it.
    """
    if scenario.pace == "stop_and_listen":
        return nearest_choice(scenario.displacement_choices_m, way_m)
    return scenario.tracker_speed_mps * scenario.decision_s * direction(way_m)


def spacing_towards(scenario: Scenario, way_m: Float[Tensor, "chase 3"]) -> Float[Tensor, "chase"]:
    """Where trackers stop to listen, the choice next to the length of this way; in flight the widest, where they
    differ most.
    """
    if scenario.pace == "stop_and_listen":
        return nearest_choice(scenario.spacing_choices_m, way_m.norm(dim=1))
    return torch.full((len(way_m),), max(scenario.spacing_choices_m), dtype=torch.float64)
