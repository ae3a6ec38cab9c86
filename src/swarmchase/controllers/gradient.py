"""``gradient``: goes up the gradient of the signal strength, averaged over movements.

The difference of the mean powers of two opposite trackers over their distance is one component of the gradient. The
components are averaged with weights that fall by ``FORGETTING`` a movement. Under the path-loss law (Eq. 2) the
gradient's length is 10 n / (ln 10 d) dB/m, so its inverse is a distance: far away it takes the longest displacement in
its direction, near the target shorter ones. It needs neither the transmit power nor the fading's law. It is the hill
climbing that RSSI hunters use (a P controller on the gradient).

In flight it flies along the gradient at full speed, and forgets by the way it has flown: what it heard counts 1 / e
when it has flown ``FORGOTTEN_SHARE`` of the distance that the gradient tells. From far away it averages for long, and
near a target it does not go by where the target was before they passed each other.

Missing samples do not count; a pair with a silent tracker leaves its component as it was. In a window without any
sample it holds still, in flight it flies on as it did.
"""

from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Int, Tensor
from ..channel.propagation import slope_db
from ..formation import Action, displacement_towards, spacing_towards
from ..observation import Observation, checked_observation, mean_position_m, mean_power_dbm
from ..scenario import Scenario
from .condition import Condition
from .described import Described

FORGETTING = 0.9
"""Weight of a window against that of the one after it."""
FORGOTTEN_SHARE = 0.25
"""Of the distance; with 0.5 a target that hovers takes 10 s longer."""
MOST_REMEMBERED = 0.95
"""In flight the weight of a window against that of the one after it is no more, however far the target seems."""
LEAST_PAIR_DISTANCE_M = 1e-3
"""Trackers nearer to each other than this tell no gradient."""


@dataclass(frozen=True)
class GradientMemory:
    """The averages of each chase."""

    weighted_sum_db_per_m: Float[Tensor, "chase 3"]
    """Sum of the weighted gradients, float64."""
    weight: Float[Tensor, "chase 3"]
    """Sum of the weights."""
    condition: Int[Tensor, "chase"]
    """A ``Condition``."""


class GradientController(Described):
    """Climbs the averaged gradient."""

    name = "gradient"

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._in_flight = scenario.pace == "listen_in_flight"
        self._slope_db = slope_db(scenario)
        self._steepest_db_per_m = self._slope_db / scenario.reference_distance_m

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> GradientMemory:
        """No gradient yet."""
        nothing = torch.zeros(num_chases, 3, dtype=torch.float64)
        return GradientMemory(nothing, nothing.clone(), torch.zeros(num_chases, dtype=torch.int64))

    def decide(self, observation: Observation, memory: GradientMemory) -> tuple[Action, GradientMemory]:
        """Average the gradient and step along it."""
        observation = checked_observation(observation, self._scenario)
        power_dbm = mean_power_dbm(observation.rssi_dbm).double()
        position_m = mean_position_m(observation)
        axis = torch.arange(3)
        apart_m = position_m[:, 2 * axis, axis] - position_m[:, 2 * axis + 1, axis]
        gradient_db_per_m = (power_dbm[:, 0::2] - power_dbm[:, 1::2]) / apart_m
        told = gradient_db_per_m.isfinite() & (apart_m.abs() > LEAST_PAIR_DISTANCE_M)
        # Nothing is steeper than the path loss is anywhere: one wild sample must not rule for ever.
        gradient_db_per_m = gradient_db_per_m.clamp(-self._steepest_db_per_m, self._steepest_db_per_m)
        forgetting = self._forgetting_in_flight(memory) if self._in_flight else FORGETTING
        weighted_sum = memory.weighted_sum_db_per_m * torch.where(told, forgetting, 1.0)
        weighted_sum = weighted_sum + torch.where(told, gradient_db_per_m, 0.0)
        weight = torch.where(told, forgetting * memory.weight + 1, memory.weight)
        average = weighted_sum / weight.clamp(min=1)
        deaf = ~power_dbm.isfinite().any(dim=1)
        holds = deaf & (not self._in_flight)
        left_m = torch.where(holds[:, None], 0.0, self._way_m(average))
        action = Action(
            spacing_m=spacing_towards(self._scenario, left_m),
            displacement_m=displacement_towards(self._scenario, left_m),
        )
        condition = torch.where(deaf, int(Condition.DEAF), int(Condition.TRACKING))
        return action, GradientMemory(weighted_sum, weight, condition)

    def _forgetting_in_flight(self, memory: GradientMemory) -> Float[Tensor, "chase 1"]:
        average = memory.weighted_sum_db_per_m / memory.weight.clamp(min=1)
        steepness_db_per_m = average.square().sum(dim=1, keepdim=True).sqrt()
        flown_m = self._scenario.tracker_speed_mps * self._scenario.decision_s
        share = flown_m * steepness_db_per_m / self._slope_db
        return (-share / FORGOTTEN_SHARE).exp().clamp(max=MOST_REMEMBERED)

    def _way_m(self, gradient_db_per_m: Float[Tensor, "chase 3"]) -> Float[Tensor, "chase 3"]:
        """The way to the target: as long as the gradient says, but on no axis longer than the longest displacement."""
        squared = gradient_db_per_m.square().sum(dim=1, keepdim=True)
        way_m = self._slope_db * gradient_db_per_m / squared.clamp(min=1e-12)
        longest_m = max(abs(choice_m) for choice_m in self._scenario.displacement_choices_m)
        return way_m * (longest_m / way_m.abs().amax(dim=1, keepdim=True).clamp(min=1e-12)).clamp(max=1)
