"""What a controller can say of its last decision, for people to look at. No decision depends on it."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import torch

from ..batch.array_types import Bool, Float, Tensor
from ..observation import Observation
from ..scenario import Scenario

MOST_POINTS = 200
"""Of a belief: enough for an eye."""


@dataclass(frozen=True)
class FoundChannel:
    """What a controller has found out about channel and receivers."""

    power_db: float
    """Transmit power above what was told."""
    exponent: float
    """Of the path loss."""
    offset_db: tuple[float, ...]
    """Of each receiver."""
    left_out: tuple[str | None, ...]
    """Why each receiver counts for nothing or little: silent, stuck or wrong; None where it counts."""
    fading_db: float | None
    """Standard deviation of a tracker's level in a window, as far as the window does not show it itself; None of a
    controller that is told the fading."""
    shadowing_db: float
    """Standard deviation of shadowing; 0 where there is none."""


@dataclass(frozen=True)
class Explanation:
    """Of the decision in one chase."""

    choice_share: Float[Tensor, "4 choice"] | None
    """How much speaks for each choice of spacing, x, y and z, in this order; each row adds up to 1. A policy's
    probabilities, or what the choice is expected to save of the way: ``share_of_savings``."""
    target_m: Float[Tensor, "point 3"] | None
    """Where the target is believed to be: points of equal weight in the chase's own frame."""
    found: FoundChannel | None = None
    velocity_mps: Float[Tensor, "3"] | None = None
    """Of the target, where it is taken to move."""


def reasons_left_out(
    is_silent: Bool[Tensor, "6"], is_stuck: Bool[Tensor, "6"], is_wrong: Bool[Tensor, "6"]
) -> tuple[str | None, ...]:
    """``FoundChannel.left_out``: the first reason that holds."""
    return tuple(
        "silent" if silent else "stuck" if stuck else "wrong" if wrong else None
        for silent, stuck, wrong in zip(is_silent.tolist(), is_stuck.tolist(), is_wrong.tolist(), strict=True)
    )


@runtime_checkable
class Explaining(Protocol):
    """A controller that can explain itself; not all can."""

    def explain(self, observation: Observation, memory: Any) -> Explanation:
        """The decision in the first chase of the batch, from the memory that ``decide`` returned with it."""


def share_of_savings(
    scenario: Scenario, left_m: Float[Tensor, "3 point"], weight: Float[Tensor, "point"]
) -> Float[Tensor, "4 choice"]:
    """What each choice saves against the worst one, as a share of what all save: of a displacement, the expected
    distance that is left on its axis; of a spacing, how far it is from the expected distance. Who takes the choice with
    the least of it takes the one with the largest share.

    Args:
        left_m: from the centre to where the target may be.
        weight: of these points; they add up to 1.
    """
    displacement_m = torch.tensor(scenario.displacement_choices_m, dtype=torch.float64)
    spacing_m = torch.tensor(scenario.spacing_choices_m, dtype=torch.float64)
    left_m, weight = left_m.double(), weight.double()
    distance_m = (left_m.square().sum(dim=0).sqrt() * weight).sum()
    expected_m = ((left_m[:, None] - displacement_m[:, None]).abs() * weight).sum(dim=2)
    rows_m = [(spacing_m - distance_m).abs(), *expected_m]
    return torch.stack([_share_of_saved(row_m) for row_m in rows_m])


def _share_of_saved(lost_m: Float[Tensor, "choice"]) -> Float[Tensor, "choice"]:
    saved_m = lost_m.max() - lost_m
    total_m = saved_m.sum()
    return saved_m / total_m if total_m > 0 else torch.full_like(saved_m, 1 / len(saved_m))
