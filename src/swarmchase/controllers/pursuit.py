"""``pursuit``: a network that has learned to chase in flight from its own flights, by reward (``training.pursuit``).

It flies as the network commands, with the widest spacing. Its belief is Gaussian, the same on all axes. What it cannot
do is say what the channel is like, or leave a receiver out: it knows the channels that it was trained in. In an
interval without any sample it goes on by what it remembers.
"""

import dataclasses
from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Int, Tensor
from ..errors import InputError
from ..formation import Action
from ..networks.pursuit import PursuitNetwork, at_most_one
from ..observation import Observation, center_m, checked_observation, mean_position_m
from ..scenario import Scenario
from .belief import GAUSSIAN_REACH, LEAST_VARIANCE_M2, Belief
from .condition import Condition
from .described import Described
from .explanation import Explanation


@dataclass(frozen=True)
class PursuitMemory:
    """What each chase carries from interval to interval."""

    network_memory: Float[Tensor, "chase memory"]
    target_m: Float[Tensor, "chase 3"]
    """Where it believes the target to be, in the chase's own frame, float64."""
    velocity_mps: Float[Tensor, "chase 3"]
    """Of the target, float64."""
    spread_m: Float[Tensor, "chase"]
    """Standard deviation of its place on each axis, float64."""
    condition: Int[Tensor, "chase"]
    """A ``Condition``."""


class PursuitController(Described):
    """Flies as its network commands.

    Raises:
        InputError: a scenario in which trackers stop to listen.
    """

    def __init__(self, scenario: Scenario, network: PursuitNetwork, name: str = "pursuit") -> None:
        require_flight(scenario, name)
        self.name = name
        self._scenario = scenario
        self._network = network.eval()
        self._full_m = scenario.tracker_speed_mps * scenario.decision_s
        self._widest_m = max(scenario.spacing_choices_m)

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> PursuitMemory:
        """Nothing heard yet: the target may be as far as it may start."""
        farthest_m = self._scenario.farthest_start_m or self._scenario.start_distance_m
        return PursuitMemory(
            self._network.begin(self._scenario, num_chases),
            torch.zeros(num_chases, 3, dtype=torch.float64),
            torch.zeros(num_chases, 3, dtype=torch.float64),
            torch.full((num_chases,), farthest_m, dtype=torch.float64),
            torch.zeros(num_chases, dtype=torch.int64),
        )

    def decide(self, observation: Observation, memory: PursuitMemory) -> tuple[Action, PursuitMemory]:
        """Where the target is, from all that was heard; the command that the network has learned."""
        observation = checked_observation(observation, self._scenario)
        center = center_m(observation)
        rssi_dbm = observation.rssi_dbm.float()
        inputs = [rssi_dbm, mean_position_m(observation).float(), center.float(), memory.network_memory]
        num_chases = len(center)
        missing = -num_chases % self._network.batch_multiple
        if missing > 0:
            inputs = [torch.cat([part, part[:1].expand(missing, *part.shape[1:])]) for part in inputs]
        with torch.inference_mode():
            reading, following = self._network(*inputs)
            command = at_most_one(reading.command[:num_chases].double())  # once more: float32 may round up
        spacing_m = torch.full((num_chases,), self._widest_m, dtype=torch.float64)
        action = Action(spacing_m, command * self._full_m)
        deaf = ~rssi_dbm.isfinite().flatten(1).any(dim=1)
        return action, dataclasses.replace(
            memory,
            network_memory=following[:num_chases].clone(),
            target_m=center + reading.way_m[:num_chases].double().clone(),
            velocity_mps=reading.velocity_mps[:num_chases].double().clone(),
            spread_m=reading.spread_m[:num_chases].double().clone(),
            condition=torch.where(deaf, int(Condition.DEAF), int(Condition.TRACKING)),
        )

    def belief(self, memory: PursuitMemory) -> Belief:
        """As ``belief.Believing``."""
        variance_m2 = memory.spread_m.square().clamp(min=LEAST_VARIANCE_M2)
        covariance_m2 = variance_m2[:, None, None] * torch.eye(3, dtype=torch.float64)
        reach = torch.full_like(variance_m2, GAUSSIAN_REACH)
        return Belief(memory.target_m, covariance_m2, reach, memory.velocity_mps)

    def explain(self, observation: Observation, memory: PursuitMemory) -> Explanation:
        """Where it believes the target to be, and how fast it flies."""
        return Explanation(None, memory.target_m[:1], None, memory.velocity_mps[0])


def require_flight(scenario: Scenario, name: str) -> None:
    """Refuse a scenario that the network has no commands for.

    Raises:
        InputError: trackers stop to listen there.
    """
    if scenario.pace != "listen_in_flight":
        raise InputError(
            f"{name} flies where trackers listen in flight; in this scenario they stop to listen: choose another "
            "controller, or a scenario of flight"
        )
