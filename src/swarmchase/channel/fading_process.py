"""Which ``Fading`` a scenario has."""

from typing import Any

import torch

from ..batch.array_types import Float, Tensor
from ..batch.streams import ChaseKey
from ..scenario import Scenario
from .drawn_windows import DrawnWindows, DrawnWindowsState
from .fading import Fading, window_time_s
from .in_flight import InFlight, InFlightState
from .running_process import RunningProcess, RunningProcessState

FadingState = DrawnWindowsState | RunningProcessState | InFlightState
"""Of whichever it is."""


def fading_process(scenario: Scenario, device: torch.device | str = "cpu") -> Fading[Any]:
    """The fading that the scenario's ``continuity`` names."""
    if scenario.continuity == "independent":
        return DrawnWindows(scenario, device)
    if scenario.continuity == "continuous":
        return RunningProcess(scenario, device)
    return InFlight(scenario, device)


def first_window(scenario: Scenario, keys: list[ChaseKey]) -> Float[Tensor, "chase tracker 2 sample"]:
    """The fading of the first window of these chases, for a swarm that hovers."""
    process = fading_process(scenario)
    window, _ = process.gain(process.begin(keys), window_time_s(scenario, torch.zeros(len(keys), dtype=torch.float64)))
    return window
