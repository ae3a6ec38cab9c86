"""``random``: every choice equally likely, the floor of any comparison.

It does not listen, so missing samples change nothing.
"""

from dataclasses import dataclass

import torch

from ..batch.streams import ChaseStreams, chase_keys
from ..formation import Action, action_from_choice
from ..observation import Observation
from ..scenario import Scenario
from .described import Described


@dataclass(frozen=True)
class RandomMemory:
    """Each chase's random stream."""

    streams: ChaseStreams


class RandomController(Described):
    """Uniform over all four action sets."""

    name = "random"

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        axis_choices = len(scenario.displacement_choices_m)
        self._num_choices = torch.tensor([len(scenario.spacing_choices_m), axis_choices, axis_choices, axis_choices])

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> RandomMemory:
        """The streams of these chases."""
        return RandomMemory(ChaseStreams.of(chase_keys(seed, num_chases, first_chase), "policy"))

    def decide(self, observation: Observation, memory: RandomMemory) -> tuple[Action, RandomMemory]:
        """A uniform action."""
        choice = (memory.streams.uniform(len(self._num_choices)) * self._num_choices).long()
        return action_from_choice(self._scenario, choice), memory
