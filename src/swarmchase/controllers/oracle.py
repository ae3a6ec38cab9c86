"""``oracle``: is told where the target is. No controller with these action sets needs fewer movements.

On each axis it takes the displacement that leaves the least distance; every axis then is as near as the 2 m grid
allows at every movement, so no other sequence reaches the target sooner. It does not listen, so missing samples change
nothing; whoever drives it tells it (``controllers.protocol.KnowsTarget``), and until then it holds still.
"""

import dataclasses
from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Int, Tensor
from ..formation import Action, nearest_choice
from ..observation import Observation, center_m, checked_observation
from ..scenario import Scenario
from .condition import Condition


@dataclass(frozen=True)
class OracleMemory:
    """What it was told of each chase."""

    target_position_m: Float[Tensor, "chase 3"]
    """Float64, in the chase's own frame; NaN where nobody has told it."""
    condition: Int[Tensor, "chase"]
    """A ``Condition``: ``DEAF`` where it decided untold."""


class OracleController:
    """Moves straight to the target. A ``KnowsTarget``."""

    name = "oracle"

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> OracleMemory:
        """Told nothing yet."""
        nowhere_m = torch.full((num_chases, 3), float("nan"), dtype=torch.float64)
        return OracleMemory(nowhere_m, torch.zeros(num_chases, dtype=torch.int64))

    def told(self, memory: OracleMemory, target_position_m: Float[Tensor, "chase 3"]) -> OracleMemory:
        """The memory of one that knows where the target of each chase is, float64, in the chase's own frame."""
        return dataclasses.replace(memory, target_position_m=target_position_m)

    def decide(self, observation: Observation, memory: OracleMemory) -> tuple[Action, OracleMemory]:
        """On each axis the displacement that leaves the least distance, none where it is untold; the widest spacing."""
        observation = checked_observation(observation, self._scenario)
        untold = memory.target_position_m.isnan().any(dim=1)
        left_m = torch.where(untold[:, None], 0.0, memory.target_position_m - center_m(observation))
        widest_m = torch.full((len(left_m),), max(self._scenario.spacing_choices_m), dtype=torch.float64)
        condition = torch.where(untold, int(Condition.DEAF), int(Condition.TRACKING))
        action = Action(widest_m, nearest_choice(self._scenario.displacement_choices_m, left_m))
        return action, dataclasses.replace(memory, condition=condition)
