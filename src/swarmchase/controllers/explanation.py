"""What a controller can say of its last decision, for people to look at. No decision depends on it."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import torch

from ..batch.array_types import Float, Tensor
from ..observation import Observation
from ..scenario import Scenario

MOST_POINTS = 200
"""Of a belief: enough for an eye."""


@dataclass(frozen=True)
class Explanation:
    """Of the decision in one chase."""

    choice_share: Float[Tensor, "4 choice"] | None
    """How much speaks for each choice of spacing, x, y and z, in this order; each row adds up to 1. A policy's
    probabilities, or the share of a belief for which the choice is the best."""
    target_m: Float[Tensor, "point 3"] | None
    """Where the target is believed to be: points of equal weight in the chase's own frame."""


@runtime_checkable
class Explaining(Protocol):
    """A controller that can explain itself; not all can."""

    def explain(self, observation: Observation, memory: Any) -> Explanation:
        """The decision in the first chase of the batch, from the memory that ``decide`` returned with it."""


def share_of_points(
    scenario: Scenario, target_m: Float[Tensor, "point 3"], center_m: Float[Tensor, "3"]
) -> Float[Tensor, "4 choice"]:
    """For which share of these points each choice is the best: the displacement that leaves least on its axis, the
    spacing next to the distance.
    """
    left_m = target_m.double() - center_m.double()
    rows = [
        _share_of_nearest(scenario.spacing_choices_m, left_m.square().sum(dim=1).sqrt()),
        *(_share_of_nearest(scenario.displacement_choices_m, left_m[:, axis]) for axis in range(3)),
    ]
    return torch.stack(rows)


def _share_of_nearest(choices_m: tuple[float, ...], wanted_m: Float[Tensor, "point"]) -> Float[Tensor, "choice"]:
    choice_m = torch.tensor(choices_m, dtype=torch.float64)
    nearest = (wanted_m[:, None] - choice_m).abs().argmin(dim=1)
    return torch.bincount(nearest, minlength=len(choice_m)).double() / len(wanted_m)
