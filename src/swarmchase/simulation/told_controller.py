"""A controller in a simulated site: one that knows the target is told where the site has it."""

from collections.abc import Callable
from typing import Any

import torch

from ..controllers.protocol import Controller, KnowsTarget
from ..formation import Action
from ..live.link.messages import Metres
from ..observation import Observation


def told_where(controller: Controller, target: Callable[[], tuple[Metres, Metres]]) -> Controller:
    """The controller, told in the chase's own frame where this target is and how fast it flies, if it is one that
    ``KnowsTarget``.
    """
    return _Told(controller, target) if isinstance(controller, KnowsTarget) else controller


class _Told:
    """Told before every decision: the live service, which knows no target, drives it like any other."""

    def __init__(self, controller: KnowsTarget, target: Callable[[], tuple[Metres, Metres]]) -> None:
        self.name = controller.name
        self._controller, self._target = controller, target

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> Any:
        return self._told(self._controller.begin(num_chases, seed, first_chase))

    def decide(self, observation: Observation, memory: Any) -> tuple[Action, Any]:
        return self._controller.decide(observation, self._told(memory))

    def _told(self, memory: Any) -> Any:
        position_m, velocity_mps = (torch.tensor([one], dtype=torch.float64) for one in self._target())
        return self._controller.told(memory, position_m, velocity_mps)
