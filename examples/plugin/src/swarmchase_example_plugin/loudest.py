"""A controller: on each axis it goes towards the tracker that hears more."""

from typing import Any

import torch

from swarmchase import Action, Observation, Scenario
from swarmchase.observation import mean_power_dbm

DEADBAND_DB = 0.5
"""Differences below this are not worth a movement."""


class LoudestController:
    """It remembers nothing: its memory is a number a chase, which nobody reads."""

    name = "loudest"

    def __init__(self, scenario: Scenario) -> None:
        self._spacing_m = max(scenario.spacing_choices_m)
        self._step_m = max(scenario.displacement_choices_m)

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> torch.Tensor:
        """The memory of so many chases."""
        return torch.zeros(num_chases)

    def decide(self, observation: Observation, memory: Any) -> tuple[Action, Any]:
        """Towards the louder side: trackers are at +x, -x, +y, -y, +z, -z."""
        level_dbm = mean_power_dbm(observation.rssi_dbm).nan_to_num(-200.0)
        ahead_db = level_dbm[:, 0::2] - level_dbm[:, 1::2]
        is_plain = ahead_db.abs() > DEADBAND_DB
        displacement_m = torch.where(is_plain, self._step_m * ahead_db.sign(), 0.0).double()
        return Action(torch.full((len(level_dbm),), self._spacing_m, dtype=torch.float64), displacement_m), memory
