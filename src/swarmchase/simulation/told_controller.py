"""A controller in a simulated site: one that knows the target is told where the site has it."""

from typing import Any

import torch

from ..controllers.protocol import Controller, KnowsTarget
from ..formation import Action
from ..live.link.messages import Metres
from ..observation import Observation


def told_where(controller: Controller, target_m: Metres) -> Controller:
    """The controller, told of this target in the chase's own frame if it is one that ``KnowsTarget``."""
    return _Told(controller, target_m) if isinstance(controller, KnowsTarget) else controller


class _Told:
    """Told when a chase begins: the live service, which knows no target, drives it like any other."""

    def __init__(self, controller: KnowsTarget, target_m: Metres) -> None:
        self.name = controller.name
        self._controller = controller
        self._target_m = torch.tensor([target_m], dtype=torch.float64)

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> Any:
        memory = self._controller.begin(num_chases, seed, first_chase)
        return self._controller.told(memory, self._target_m.expand(num_chases, -1))

    def decide(self, observation: Observation, memory: Any) -> tuple[Action, Any]:
        return self._controller.decide(observation, memory)
