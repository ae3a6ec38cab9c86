"""What a behaviour is: ``begin`` once for a batch of chases, then ``fly`` for every short step of their time.

Metres are in the chase's own frame: x east, y north, z up, origin where the swarm's centre starts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import torch

from ...batch.array_types import Float, Tensor
from ...batch.streams import ChaseKey, ChaseStreams


@dataclass(frozen=True)
class Swarm:
    """What a target may notice of those that chase it; float64."""

    center_m: Float[Tensor, "chase 3"]
    velocity_mps: Float[Tensor, "chase 3"]


@dataclass(frozen=True)
class Target:
    """The target of each chase at one moment; float64."""

    position_m: Float[Tensor, "chase 3"]
    velocity_mps: Float[Tensor, "chase 3"]
    plan: Any
    """What its behaviour remembers: a frozen dataclass of tensors with the chase axis first, or None."""
    streams: ChaseStreams | None
    """Each chase's own random numbers for what its behaviour draws on the way; None where it draws nothing."""

    @classmethod
    def at_rest(
        cls, start_m: Float[Tensor, "chase 3"], plan: Any = None, streams: ChaseStreams | None = None
    ) -> "Target":
        """Targets that have not moved yet."""
        return cls(start_m, torch.zeros_like(start_m), plan, streams)


@runtime_checkable
class Behaviour(Protocol):
    """What the targets of one scenario do, on one device."""

    @property
    def is_still(self) -> bool:
        """Whether it never moves, so that nobody needs to ask it."""

    def begin(self, keys: Sequence[ChaseKey], start_m: Float[Tensor, "chase 3"]) -> Target:
        """The targets of these chases at their start, float64, on the behaviour's device; they rest there."""

    def fly(self, target: Target, seconds: Float[Tensor, "chase"], swarm: Swarm) -> Target:
        """The targets so many seconds later, usually ``flight.FLIGHT_STEP_S``; what they decide holds for that long.

        Where ``seconds`` is 0, position, velocity, plan and random numbers stay as they are.
        """
