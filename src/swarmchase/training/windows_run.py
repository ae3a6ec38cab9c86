"""A run of the training of ``training.windows``.

swarmchase train windows --folder runs/windows --device cuda
"""

from collections.abc import Callable
from pathlib import Path

import torch

from ..channel.fading_worlds import WorldsFading
from ..networks.actor_critic import PAPER_WINDOW_SAMPLES
from ..networks.windows import WindowsNetwork
from ..scenario import NUM_TRACKERS
from .batched import require_device
from .learner import Learner, LearnerResult, train_learner
from .windows import WindowsSettings, drawn_worlds, reported_db, windows_loss


def train_windows(
    settings: WindowsSettings,
    folder: Path,
    resume: bool = False,
    device: str = "cpu",
    progress: Callable[[int, float], None] | None = None,
) -> LearnerResult:
    """As ``train_learner``. The loss is - log density of a window in nats.

    Raises:
        InputError: as ``train_learner``, or no such device.
    """
    require_device(device)
    return train_learner(_WindowsLearner(settings, device), folder, resume, progress)


class _WindowsLearner(Learner):
    schedule = "windows"
    network: WindowsNetwork
    settings: WindowsSettings

    def __init__(self, settings: WindowsSettings, device: str) -> None:
        super().__init__(settings, WindowsNetwork(torch.Generator().manual_seed(settings.seed)), device)
        self._fading = WorldsFading(PAPER_WINDOW_SAMPLES, device)

    def learning_rate(self) -> float:
        return self.settings.learning_rate * (1 - 0.999 * self.update / self.settings.max_updates)

    def computed_loss(self) -> torch.Tensor:
        """Of chases that nobody has seen."""
        settings, generator, device = self.settings, self._generator, self._device
        num_chases = settings.worlds * settings.chases_per_world
        worlds = drawn_worlds(settings.worlds, generator, device)
        fading_db = self._fading.drawn_db(worlds, settings.chases_per_world * settings.windows, generator)
        shape = (num_chases, settings.windows, PAPER_WINDOW_SAMPLES, NUM_TRACKERS)
        heard_db = reported_db(fading_db.transpose(2, 3).reshape(shape), generator)
        # Few windows as often as many: what is decided early in a chase is decided on few.
        number = (settings.windows + 0.99) ** torch.rand(num_chases, generator=generator, device=device)
        return windows_loss(self.network, heard_db, number.long())
