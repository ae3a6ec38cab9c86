"""``paper``, ``robust`` and every other controller whose decisions come from trained networks.

Networks of the paper's form decide from the current window alone; the gated one remembers. Missing samples (NaN)
are filled by the networks, each in its way (``networks.actor_critic.filled_window_dbm``, ``networks.gated``); in a
window without any sample the controller holds still and remembers nothing of it.
"""

from dataclasses import dataclass
from typing import Literal

import torch

from ..batch.array_types import Float, Int, Tensor
from ..batch.streams import ChaseStreams, chase_keys
from ..errors import InputError
from ..formation import Action, action_from_choice
from ..networks.actor_critic import NETWORK_NAMES, NUM_CHOICES, greedy_choice, sampled_choice
from ..networks.protocol import DecidingNetworks
from ..observation import Observation, checked_observation, mean_position_m
from ..scenario import NUM_TRACKERS, Scenario
from .condition import Condition
from .described import Described
from .explanation import Explanation

ActionChoice = Literal["sampled", "greedy"]


@dataclass(frozen=True)
class LearnedMemory:
    """What each chase carries from movement to movement."""

    network_memory: Float[Tensor, "chase memory"]
    """What the networks remember; nothing for those of the paper's form."""
    logits: Float[Tensor, "chase 4 5"]
    """Of the last decision's policies, for people to look at."""
    condition: Int[Tensor, "chase"]
    """A ``Condition``."""
    streams: ChaseStreams
    """Each chase's own random numbers for sampling actions."""


def require_action_sets(scenario: Scenario, name: str) -> None:
    """Refuse a scenario that a learned controller of this name cannot decide in.

    Raises:
        InputError: action sets that are not of five choices each.
    """
    if {len(scenario.spacing_choices_m), len(scenario.displacement_choices_m)} != {NUM_CHOICES}:
        raise InputError(
            f"{name} decides between {NUM_CHOICES} spacings and displacements; the scenario has other action sets"
        )


class LearnedController(Described):
    """Samples from its policies ("stochastically determine", Section II.A), or takes their most likely action.

    Raises:
        InputError: action sets that are not of five choices each.
    """

    def __init__(
        self,
        scenario: Scenario,
        networks: DecidingNetworks,
        name: str,
        action_choice: ActionChoice = "sampled",
    ) -> None:
        require_action_sets(scenario, name)
        self.name = name
        self._scenario = scenario
        self._networks = networks.eval()
        self._action_choice = action_choice
        choices_m = torch.tensor(scenario.displacement_choices_m)
        self._still = int(choices_m.abs().argmin())

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> LearnedMemory:
        """Nothing heard yet."""
        return LearnedMemory(
            self._networks.begin(self._scenario, num_chases),
            torch.zeros(num_chases, len(NETWORK_NAMES), NUM_CHOICES),
            torch.zeros(num_chases, dtype=torch.int64),
            ChaseStreams.of(chase_keys(seed, num_chases, first_chase), "policy"),
        )

    def decide(self, observation: Observation, memory: LearnedMemory) -> tuple[Action, LearnedMemory]:
        """Four choices for every chase from its window and its memory.

        Raises:
            InputError: a window of the wrong size.
        """
        observation = checked_observation(observation, self._scenario)
        logits, following = self._through(observation, memory.network_memory)
        if self._action_choice == "greedy":
            choice = greedy_choice(logits)
        else:
            choice = sampled_choice(logits, memory.streams.uniform(len(NETWORK_NAMES)).to(logits.device))
        deaf = ~observation.rssi_dbm.isfinite().any(dim=2).any(dim=1)
        choice[:, 1:] = torch.where(deaf[:, None], self._still, choice[:, 1:])
        following = torch.where(deaf[:, None], memory.network_memory, following)
        condition = torch.where(deaf, int(Condition.DEAF), int(Condition.TRACKING))
        return action_from_choice(self._scenario, choice), LearnedMemory(following, logits, condition, memory.streams)

    def explain(self, observation: Observation, memory: LearnedMemory) -> Explanation:
        """The policies' probabilities."""
        return Explanation(memory.logits[0].double().softmax(dim=1), None)

    def policy_logits(self, observation: Observation) -> Float[Tensor, "chase 4 5"]:
        """Logits of the four policies for a first window.

        Raises:
            InputError: a window of the wrong size.
        """
        return self._through(observation, self._networks.begin(self._scenario, len(observation.rssi_dbm)))[0]

    def _through(
        self, observation: Observation, memory: Float[Tensor, "chase memory"]
    ) -> tuple[Float[Tensor, "chase 4 5"], Float[Tensor, "chase memory"]]:
        window_dbm = observation.rssi_dbm.float()
        if window_dbm.shape[1:] != (self._scenario.samples_a_decision, NUM_TRACKERS):
            raise InputError(
                f"a window of {tuple(window_dbm.shape[1:])} is refused: "
                f"{self.name} needs {self._scenario.samples_a_decision} samples of {NUM_TRACKERS} trackers"
            )
        num_chases = len(window_dbm)
        inputs = [window_dbm, mean_position_m(observation).float(), memory]
        missing = -num_chases % self._networks.batch_multiple
        if missing > 0:
            inputs = [torch.cat([part, part[:1].expand(missing, *part.shape[1:])]) for part in inputs]
        with torch.inference_mode():
            logits, following = self._networks.decide(*inputs)
        return logits[:num_chases].clone(), following[:num_chases].clone()
