"""Which ``Fading`` a scenario has."""

from collections.abc import Callable
from typing import Any

import torch

from ..batch.array_types import Float, Tensor
from ..batch.streams import ChaseKey
from ..plug_ins import made_by_plug_in
from ..scenario import Scenario
from .drawn_windows import DrawnWindows
from .fading import Fading, window_time_s
from .in_flight import InFlight
from .running_process import RunningProcess

FadingState = Any
"""Of whichever it is: a batch of chases (``batch.selection``)."""

_OWN: dict[str, Callable[[Scenario, torch.device | str], Fading[Any]]] = {
    "independent": DrawnWindows,
    "continuous": RunningProcess,
    "in_flight": InFlight,
}


def fading_process(scenario: Scenario, device: torch.device | str = "cpu") -> Fading[Any]:
    """The fading that the scenario's ``continuity`` names, this package's or another one's.

    Raises:
        InputError: another package's cannot be loaded.
    """
    if scenario.continuity in _OWN:
        return _OWN[scenario.continuity](scenario, device)
    made: Fading[Any] = made_by_plug_in("fading", scenario.continuity, Fading, scenario, device)
    return made


def first_window(scenario: Scenario, keys: list[ChaseKey]) -> Float[Tensor, "chase tracker 2 sample"]:
    """The fading of the first window of these chases, for a swarm that hovers."""
    process = fading_process(scenario)
    window, _ = process.gain(process.begin(keys), window_time_s(scenario, torch.zeros(len(keys), dtype=torch.float64)))
    return window
