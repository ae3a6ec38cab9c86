"""``paper`` and every other controller whose decisions come from the paper's four networks.

It decides from the current window alone and remembers nothing. A window with missing samples (NaN) is refused: the
networks were never shown one.
"""

from dataclasses import dataclass
from typing import Literal

import torch

from ..errors import InputError
from ..formation import Action, action_from_choice
from ..networks import NETWORK_NAMES, NUM_CHOICES, SwarmNetworks, greedy_choice, sampled_choice
from ..observation import Observation
from ..scenario import NUM_TRACKERS, Scenario
from ..streams import ChaseStreams, chase_keys

ActionChoice = Literal["sampled", "greedy"]

SMALLEST_BATCH = 8
"""Fewer chases are padded to this many: from there on a row's result does not depend on the batch, bit for bit."""


@dataclass(frozen=True)
class LearnedMemory:
    """Each chase's stream for sampling actions."""

    streams: ChaseStreams


class LearnedController:
    """Samples from its policies ("stochastically determine", Section II.A), or takes their most likely action.

    Raises:
        InputError: action sets that are not of five choices each.
    """

    def __init__(
        self, scenario: Scenario, networks: SwarmNetworks, name: str, action_choice: ActionChoice = "sampled"
    ) -> None:
        if {len(scenario.spacing_choices_m), len(scenario.displacement_choices_m)} != {NUM_CHOICES}:
            raise InputError(
                f"{name} decides between {NUM_CHOICES} spacings and displacements; the scenario has other action sets"
            )
        self.name = name
        self._scenario = scenario
        self._networks = networks.eval()
        self._action_choice = action_choice

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> LearnedMemory:
        """The streams of these chases."""
        return LearnedMemory(ChaseStreams.of(chase_keys(seed, num_chases, first_chase), "policy"))

    def decide(self, observation: Observation, memory: LearnedMemory) -> tuple[Action, LearnedMemory]:
        """Four choices for every chase from its window.

        Raises:
            InputError: a window of the wrong size, or with missing samples.
        """
        logits = self.policy_logits(observation)
        if self._action_choice == "greedy":
            choice = greedy_choice(logits)
        else:
            choice = sampled_choice(logits, memory.streams.uniform(len(NETWORK_NAMES)).to(logits.device))
        return action_from_choice(self._scenario, choice), memory

    def policy_logits(self, observation: Observation) -> torch.Tensor:
        """Logits of the four policies, [chase, 4, 5].

        Raises:
            InputError: a window of the wrong size, or with missing samples.
        """
        window_dbm = observation.rssi_dbm.float()
        if window_dbm.shape[1:] != (self._scenario.window_samples, NUM_TRACKERS):
            raise InputError(
                f"a window of {tuple(window_dbm.shape[1:])} is refused: "
                f"{self.name} needs {self._scenario.window_samples} samples of {NUM_TRACKERS} trackers"
            )
        if not window_dbm.isfinite().all():
            missing = int((~window_dbm.isfinite()).sum())
            raise InputError(
                f"rssi_dbm has {missing} missing samples (NaN or infinite): {self.name} needs complete windows"
            )
        num_chases = len(window_dbm)
        if num_chases < SMALLEST_BATCH:
            window_dbm = torch.cat([window_dbm, window_dbm[:1].expand(SMALLEST_BATCH - num_chases, -1, -1)])
        with torch.inference_mode():
            logits = self._networks.policy_logits(window_dbm.contiguous())
        return logits[:num_chases].clone()
