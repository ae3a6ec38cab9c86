"""What a controller is: ``begin`` once for a batch of chases, then ``decide`` once a movement."""

from typing import Any, Protocol, runtime_checkable

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
