"""``oracle``: knows the target. No controller with these action sets needs fewer movements.

On each axis it takes the displacement that leaves the least distance; every axis then is as near as the 2 m grid
allows at every movement, so no other sequence reaches the target sooner. It does not listen, so missing samples change
nothing.
"""

from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Tensor
from ..batch.streams import chase_keys
from ..formation import Action, nearest_choice
from ..observation import Observation, center_m
from ..scenario import Scenario
from ..world.target import draw_target_position_m


@dataclass(frozen=True)
class OracleMemory:
    """The truth: the target of each chase."""

    target_position_m: Float[Tensor, "chase 3"]


class OracleController:
    """Moves straight to the target of run ``seed``, which it draws as the world does."""

    name = "oracle"

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> OracleMemory:
        """The targets of these chases. In somebody else's world, build an ``OracleMemory`` from its own targets."""
        return OracleMemory(draw_target_position_m(self._scenario, chase_keys(seed, num_chases, first_chase)))

    def decide(self, observation: Observation, memory: OracleMemory) -> tuple[Action, OracleMemory]:
        """On each axis the displacement that leaves the least distance, at the widest spacing."""
        left_m = memory.target_position_m - center_m(observation)
        widest_m = torch.full((len(left_m),), max(self._scenario.spacing_choices_m), dtype=torch.float64)
        return Action(widest_m, nearest_choice(self._scenario.displacement_choices_m, left_m)), memory
