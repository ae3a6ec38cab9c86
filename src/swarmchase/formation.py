"""The swarm's geometry: where the six trackers are, and what an action does (Sections II.A and III.A)."""

import math
from dataclasses import dataclass

import torch

from .batch.array_types import Float, Int, Tensor
from .batch.shown import shown_chases, shown_range
from .flight import direction
from .scenario import Scenario

TRACKER_DIRECTION = torch.tensor(
    [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=torch.float64
)
"""Tracker u = 0..5 sits at +x, -x, +y, -y, +z, -z of the centre."""


@dataclass(frozen=True, repr=False)
class Action:
    """What the controller decides for each chase of a batch.

    >>> Action(torch.tensor([5.0]), torch.tensor([[4.0, -4.0, 0.0]]))
    Action(1 chase: spacing 5 m, displacement (4, -4, 0) m)
    >>> Action(torch.tensor([5.0, 1.0]), torch.tensor([[4.0, -4.0, 0.0], [0.0, 0.0, 2.0]]))
    Action(2 chases: spacing 1 to 5 m, displacement 2 to 5.66 m)
    """

    spacing_m: Float[Tensor, "chase"]
    """Distance of every tracker from the centre: one of A^d, or in flight any between them."""
    displacement_m: Float[Tensor, "chase 3"]
    """Movement of the centre: each axis one of A^x, A^y, A^z, or in flight any that its speed permits."""
    turn_rad: Float[Tensor, "chase"] | None = None
    """In flight, how far the cross turns about its vertical on its way, from +x towards +y; None where it does not."""

    def __repr__(self) -> str:
        chases = len(self.spacing_m)
        if chases == 1:
            moved = "(" + ", ".join(f"{metres:.3g}" for metres in self.displacement_m[0].tolist()) + ")"
        else:
            moved = shown_range(self.displacement_m.norm(dim=1))
        turn = "" if self.turn_rad is None else f", turn {shown_range(self.turn_rad)} rad"
        spacing = shown_range(self.spacing_m)
        return f"Action({shown_chases(chases)}: spacing {spacing} m, displacement {moved} m{turn})"


def tracker_position_m(
    center_m: Float[Tensor, "*batch 3"],
    spacing_m: Float[Tensor, "*batch"],
    turned_rad: Float[Tensor, "*batch"] | None = None,
) -> Float[Tensor, "*batch tracker 3"]:
    """Positions of the six trackers around their centre, their cross having turned so far."""
    unturned = TRACKER_DIRECTION.to(center_m.device)
    direction = unturned if turned_rad is None else turned_direction(turned_rad)
    return center_m[..., None, :] + spacing_m[..., None, None] * direction


def turned_direction(turned_rad: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch tracker 3"]:
    """``TRACKER_DIRECTION`` of a cross that has turned so far about its vertical; exactly that of one that has not."""
    cos, sin = turned_rad.cos()[..., None], turned_rad.sin()[..., None]
    x, y, z = TRACKER_DIRECTION.to(turned_rad.device).unbind(dim=1)
    return torch.stack([x * cos - y * sin, x * sin + y * cos, z.expand_as(x * cos)], dim=-1)


def fastest_turn_rad_per_s(scenario: Scenario) -> float:
    """How fast the cross may turn at its widest spacing r: trackers go round at r w, with an acceleration of r w^2, and
    neither is more than the scenario's for its trackers.
    """
    widest_m = max(scenario.spacing_choices_m)
    by_speed = scenario.tracker_speed_mps / widest_m
    if scenario.tracker_acceleration_mps2 is None:
        return by_speed
    return min(by_speed, math.sqrt(scenario.tracker_acceleration_mps2 / widest_m))


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
