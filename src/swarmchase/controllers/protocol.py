"""What a controller is: ``begin`` once for a batch of chases, then ``decide`` once a movement.

One that knows the target is told it by whoever drives it: no controller knows the simulator.
"""

from typing import Any, Protocol, runtime_checkable

from ..batch.array_types import Float, Tensor
from ..formation import Action
from ..observation import Observation


@runtime_checkable
class Controller(Protocol):
    """Turns what was heard into the next spacing and movement. Evaluation, training and live service drive this."""

    @property
    def name(self) -> str:
        """How tables name it."""

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> Any:
        """The memory of ``num_chases`` chases of run ``seed`` before their first window, random streams included.

        A memory can be given to ``swarmchase.batch.selection.select_chases`` and ``join_chases``.
        """

    def decide(self, observation: Observation, memory: Any) -> tuple[Action, Any]:
        """The action of every chase, and the memory for its next movement."""


@runtime_checkable
class KnowsTarget(Controller, Protocol):
    """A controller that wants to know where the target is; only a simulation can tell it."""

    def told(
        self,
        memory: Any,
        target_position_m: Float[Tensor, "chase 3"],
        target_velocity_mps: Float[Tensor, "chase 3"] | None = None,
    ) -> Any:
        """The memory with the target of every chase in it, float64, in the chase's own frame; None where all stand."""
