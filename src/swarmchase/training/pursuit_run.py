"""A run of the training of ``training.pursuit``.

swarmchase train pursuit --folder runs/pursuit --lessons flight:flee:8:20 --device cuda
"""

import dataclasses
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from ..errors import InputError
from ..networks.pursuit import PursuitNetwork
from ..networks.weights import load_weights, read_weights
from .batched import require_device
from .learner import Learner, LearnerResult, train_learner
from .pursuit import Lesson, PursuitSettings, exploration_at, is_reinforced, learning_rate_at, lesson_scenario
from .settings import training_seed


def train_pursuit(
    settings: PursuitSettings,
    folder: Path,
    start: Path | None = None,
    resume: bool = False,
    device: str = "cpu",
    progress: Callable[[int, float], None] | None = None,
) -> LearnerResult:
    """As ``train_learner``.

    Args:
        start: a weights file of this form to begin with.

    Raises:
        InputError: as ``train_learner``, no such device, or ``start`` is no such file.
    """
    require_device(device)
    network = PursuitNetwork(torch.Generator().manual_seed(settings.seed))
    if start is not None:
        loaded, _ = load_weights(start)
        if not isinstance(loaded, PursuitNetwork):
            raise InputError(f"weights file {start} holds networks of the form {loaded.form}; needed is pursuit")
        network.load_state_dict(loaded.state_dict())
        settings = dataclasses.replace(settings, start_sha256=hashlib.sha256(read_weights(start)).hexdigest())
    return train_learner(_PursuitLearner(settings, network, device), folder, resume, progress)


class _PursuitLearner(Learner):
    schedule = "pursuit"
    settings: PursuitSettings

    def __init__(self, settings: PursuitSettings, network: PursuitNetwork, device: str) -> None:
        super().__init__(settings, network, device)
        each = settings.flights // len(settings.lessons)
        self._lessons = [
            Lesson(lesson_scenario(lesson), each, network, training_seed(settings.seed), number, device)
            for number, lesson in enumerate(settings.lessons)
        ]

    def learning_rate(self) -> float:
        return learning_rate_at(self.settings, self.update)

    def computed_loss(self) -> torch.Tensor:
        settings, update = self.settings, self.update
        slow = update < settings.slow_share * settings.max_updates
        reinforced, exploration = is_reinforced(settings, update), exploration_at(settings, update)
        losses = [
            lesson.turn_loss(settings.intervals, exploration, reinforced, slow, self._generator)
            for lesson in self._lessons
        ]
        return torch.stack(losses).mean()

    def pack(self) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        tensors: dict[str, torch.Tensor] = {}
        documents: list[dict[str, Any]] = []
        for number, lesson in enumerate(self._lessons):
            own, document = lesson.pack(f"lesson{number}")
            tensors |= own
            documents.append(document)
        return tensors, {"lessons": documents}

    def unpack(self, tensors: dict[str, torch.Tensor], document: dict[str, Any]) -> None:
        for number, (lesson, own) in enumerate(zip(self._lessons, document["lessons"], strict=True)):
            lesson.unpack(f"lesson{number}", tensors, own)
