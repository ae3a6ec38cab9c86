"""``oracle``: is told where the target is. ``oracle-intercept`` is also told how fast it flies.

Where trackers stop to listen, on each axis it takes the displacement that leaves the least distance; every axis then is
as near as the 2 m grid allows at every movement, so no other sequence reaches a target that stands still sooner. In
flight it flies to where the target is, or, with its velocity, straight to where the two meet if that stays as it is
(constant bearing). It does not listen, so missing samples change nothing; whoever drives it tells it
(``controllers.protocol.KnowsTarget``), and until then it holds still.
"""

import dataclasses
from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Int, Tensor
from ..flight import intercept_s
from ..formation import Action, displacement_towards
from ..observation import Observation, center_m, checked_observation
from ..scenario import Scenario
from .condition import Condition
from .described import Described

ORACLES = ("oracle", "oracle-intercept")
"""By name."""


@dataclass(frozen=True)
class OracleMemory:
    """What it was told of each chase."""

    target_position_m: Float[Tensor, "chase 3"]
    """Float64, in the chase's own frame; NaN where nobody has told it."""
    target_velocity_mps: Float[Tensor, "chase 3"]
    """Float64."""
    condition: Int[Tensor, "chase"]
    """A ``Condition``: ``DEAF`` where it decided untold."""


class OracleController(Described):
    """Moves straight to the target, or to where it will be. A ``KnowsTarget``."""

    def __init__(self, scenario: Scenario, name: str = "oracle", knows_velocity: bool = False) -> None:
        self.name = name
        self._scenario = scenario
        self._knows_velocity = knows_velocity

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> OracleMemory:
        """Told nothing yet."""
        nowhere_m = torch.full((num_chases, 3), float("nan"), dtype=torch.float64)
        return OracleMemory(nowhere_m, torch.zeros_like(nowhere_m), torch.zeros(num_chases, dtype=torch.int64))

    def told(
        self,
        memory: OracleMemory,
        target_position_m: Float[Tensor, "chase 3"],
        target_velocity_mps: Float[Tensor, "chase 3"] | None = None,
    ) -> OracleMemory:
        """The memory of one that knows where the target of each chase is, float64, in the chase's own frame, and how
        fast it flies; None where it stands.
        """
        if target_velocity_mps is None:
            target_velocity_mps = torch.zeros_like(target_position_m)
        return dataclasses.replace(memory, target_position_m=target_position_m, target_velocity_mps=target_velocity_mps)

    def decide(self, observation: Observation, memory: OracleMemory) -> tuple[Action, OracleMemory]:
        """Towards the target, not at all where it is untold; the widest spacing."""
        observation = checked_observation(observation, self._scenario)
        untold = memory.target_position_m.isnan().any(dim=1)
        way_m = memory.target_position_m - center_m(observation)
        if self._knows_velocity:
            meeting_s = intercept_s(way_m, memory.target_velocity_mps, self._scenario.tracker_speed_mps)
            # One that it never meets it follows.
            ahead_s = torch.where(meeting_s.isfinite(), meeting_s, 0.0)
            way_m = way_m + memory.target_velocity_mps * ahead_s[:, None]
        widest_m = torch.full((len(way_m),), max(self._scenario.spacing_choices_m), dtype=torch.float64)
        condition = torch.where(untold, int(Condition.DEAF), int(Condition.TRACKING))
        action = Action(widest_m, displacement_towards(self._scenario, torch.where(untold[:, None], 0.0, way_m)))
        return action, dataclasses.replace(memory, condition=condition)
