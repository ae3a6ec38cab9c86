"""A network that one process trains by Adam, and the folder of its run: a resume file and the weights."""

import contextlib
import copy
import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch

from ..batch.tensor_files import load_tensors, save_tensors
from ..errors import InputError
from ..files import require_writable_folder
from ..locks import LockFile
from ..networks.protocol import HearingNetworks
from ..networks.weights import save_weights
from ..processes.stop_request import stop_request
from .resumption import require_same_run
from .run_folder import LOCK_FILE, MOST_RESUME_BYTES, RESUME_FILE

WEIGHTS_FILE = "best.safetensors"
CHECKPOINT_INTERVAL = 500
"""Updates between two."""
TOLD_INTERVAL = 20
"""Updates between two readings of the loss: each waits for a GPU."""
SMOOTHING = 0.02
"""How far the loss that is told follows each reading."""
RESUME_VERSION = 2


@dataclass(frozen=True)
class LearnerResult:
    """How a run ended."""

    updates: int
    loss: float | None
    """Smoothed; None where too few updates were made to say."""
    weights: Path
    stopped: str
    """finished or interrupted."""


class Learner(ABC):
    """Where a training stands."""

    schedule: ClassVar[str]
    """In its weights files, and in its resume files."""

    def __init__(self, settings: Any, network: HearingNetworks, device: str) -> None:
        """``settings`` is a dataclass with ``seed``, ``learning_rate``, ``max_gradient_norm`` and ``max_updates``."""
        self.settings = settings
        self.network = network.to(device)
        self.update = 0
        self.loss = math.nan
        self._device = device
        self._generator = torch.Generator(device)
        self._generator.manual_seed(settings.seed)
        self._optimizer = torch.optim.Adam(self.network.parameters(), lr=settings.learning_rate)

    @abstractmethod
    def computed_loss(self) -> torch.Tensor:
        """Of the next update."""

    @abstractmethod
    def learning_rate(self) -> float:
        """Of the next update."""

    def pack(self) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        """What else a run goes on with, as ``batch.selection.pack`` gives it."""
        return {}, {}

    def unpack(self, tensors: dict[str, torch.Tensor], document: dict[str, Any]) -> None:  # noqa: B027 - most have none
        """Go on with what ``pack`` gave.

        Raises:
            InputError, LookupError, TypeError, ValueError: it is not that.
        """

    def make_update(self) -> None:
        """One step of Adam."""
        for group in self._optimizer.param_groups:
            group["lr"] = self.learning_rate()
        loss = self.computed_loss()
        self._optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.settings.max_gradient_norm)
        self._optimizer.step()
        self.update += 1
        if self.update % TOLD_INTERVAL == 0:
            read = float(loss.detach())
            self.loss = read if math.isnan(self.loss) else (1 - SMOOTHING) * self.loss + SMOOTHING * read

    def save(self, path: Path) -> None:
        """Write the resume file."""
        tensors = {f"network.{name}": value.detach().cpu() for name, value in self.network.state_dict().items()}
        for number, state in self._optimizer.state_dict()["state"].items():
            tensors |= {f"adam.{number}.{name}": value.cpu() for name, value in state.items()}
        own_tensors, own_document = self.pack()
        tensors |= {f"own.{name}": value.cpu() for name, value in own_tensors.items()}
        document = {
            **self._identity,
            "update": self.update,
            "loss": None if math.isnan(self.loss) else self.loss,
            "generator": self._generator.get_state().tolist(),
            "own": own_document,
        }
        save_tensors(path, tensors, document)

    def restore(self, path: Path) -> None:
        """Go on where the resume file was written.

        Raises:
            InputError: it cannot be read, is incomplete, or of a run with other settings.
        """
        tensors, document = load_tensors(path, "resume file", MOST_RESUME_BYTES)
        require_same_run(path, document, self._identity)
        try:
            self.network.load_state_dict(_below(tensors, "network."))
            state: dict[int, dict[str, torch.Tensor]] = {}
            for name, value in _below(tensors, "adam.").items():
                number, part = name.split(".")
                state.setdefault(int(number), {})[part] = value
            self._optimizer.load_state_dict({**self._optimizer.state_dict(), "state": state})
            self._generator.set_state(torch.tensor(document["generator"], dtype=torch.uint8))
            self.update = int(document["update"])
            self.loss = math.nan if document["loss"] is None else float(document["loss"])
            self.unpack(_below(tensors, "own."), document["own"])
        except (LookupError, TypeError, ValueError, RuntimeError) as error:
            raise InputError(f"resume file {path} is incomplete: {error}") from error

    def write_weights(self, path: Path) -> Path:
        """Write the network in float16, and return its file."""
        configuration = {
            "settings": dataclasses.asdict(self.settings),
            "schedule": self.schedule,
            "update": self.update,
        }
        save_weights(path, copy.deepcopy(self.network).cpu(), configuration, torch.float16)
        return path

    @property
    def _identity(self) -> dict[str, Any]:
        return {
            "format": f"swarmchase-{self.schedule}-resume-{RESUME_VERSION}",
            "settings": _jsonable(dataclasses.asdict(self.settings)),
            "device": self._device.split(":")[0],
        }


def train_learner(
    learner: Learner, folder: Path, resume: bool = False, progress: Callable[[int, float], None] | None = None
) -> LearnerResult:
    """Train, and write the weights to ``folder``. Ctrl-C stops it cleanly: the run can be resumed, exactly.

    Args:
        progress: is told the number of updates and the loss.

    Raises:
        InputError: the folder cannot be written, is in use, holds a run and ``resume`` is false, holds none and it is
            true, or one of other settings.
    """
    require_writable_folder(folder)
    in_use = f"folder {folder} is in use by another training: wait for it, or choose another folder"
    path = folder / RESUME_FILE
    with contextlib.closing(LockFile(folder / LOCK_FILE, in_use)), stop_request() as request:
        if path.exists() and not resume:
            raise InputError(f"folder {folder} holds a run: give --resume to go on with it, or another folder")
        if resume and not path.exists():
            raise InputError(f"folder {folder} holds no run to resume")
        if resume:
            learner.restore(path)
        while learner.update < learner.settings.max_updates and not request.made:
            learner.make_update()
            if progress is not None and learner.update % TOLD_INTERVAL == 0:
                progress(learner.update, learner.loss)
            if learner.update % CHECKPOINT_INTERVAL == 0:
                learner.save(path)
        learner.save(path)
        stopped = "finished" if learner.update == learner.settings.max_updates else "interrupted"
        loss = None if math.isnan(learner.loss) else learner.loss
        return LearnerResult(learner.update, loss, learner.write_weights(folder / WEIGHTS_FILE), stopped)


def _below(tensors: dict[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def _jsonable(settings: dict[str, Any]) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in settings.items()}
