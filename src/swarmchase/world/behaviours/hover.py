"""``hover``: stands still in the air, as the paper's target does."""

from collections.abc import Sequence

import torch

from ...batch.array_types import Float, Tensor
from ...batch.streams import ChaseKey
from ...scenario import Scenario
from .protocol import Swarm, Target


class Hover:
    """A ``Behaviour`` that has no speed."""

    is_still = True

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._device = torch.device(device)

    def begin(self, keys: Sequence[ChaseKey], start_m: Float[Tensor, "chase 3"]) -> Target:
        """Where they start."""
        return Target.at_rest(start_m.to(self._device))

    def fly(self, target: Target, seconds: Float[Tensor, "chase"], swarm: Swarm) -> Target:
        """Where they are."""
        return target
