"""A run of the training of ``training.windows``: its loop, and its folder with a resume file and the weights.

swarmchase train windows --folder runs/windows --device cuda
"""

import contextlib
import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ..batch.tensor_files import load_tensors, save_tensors
from ..channel.fading_worlds import WorldsFading
from ..errors import InputError
from ..files import require_writable_folder
from ..locks import LockFile
from ..networks.actor_critic import PAPER_WINDOW_SAMPLES
from ..networks.weights import save_weights
from ..networks.windows import WindowsNetwork
from ..processes.stop_request import stop_request
from ..scenario import NUM_TRACKERS
from .batched import require_device
from .resumption import require_same_run
from .run_folder import LOCK_FILE, RESUME_FILE
from .windows import WindowsSettings, drawn_worlds, reported_db, windows_loss

WEIGHTS_FILE = "best.safetensors"
CHECKPOINT_INTERVAL = 500
"""Updates between two."""
TOLD_INTERVAL = 20
"""Updates between two readings of the loss: each waits for a GPU."""
SMOOTHING = 0.02
"""How far the loss that is told follows each reading."""
MOST_RESUME_BYTES = 64 * 2**20
FORMAT = "swarmchase-windows-resume-1"


@dataclass(frozen=True)
class WindowsResult:
    """How a run ended."""

    updates: int
    loss_nats: float | None
    """- log density of a window, smoothed; None where too few updates were made to say."""
    weights: Path
    stopped: str
    """finished or interrupted."""


def train_windows(
    settings: WindowsSettings,
    folder: Path,
    resume: bool = False,
    device: str = "cpu",
    progress: Callable[[int, float], None] | None = None,
) -> WindowsResult:
    """Train, and write the weights to ``folder``. Ctrl-C stops it cleanly: the run can be resumed, exactly.

    Args:
        progress: is told the number of updates and the loss.

    Raises:
        InputError: no such device; the folder cannot be written, is in use, holds a run and ``resume`` is false, holds
            none and it is true, or one of other settings.
    """
    require_device(device)
    require_writable_folder(folder)
    in_use = f"folder {folder} is in use by another training: wait for it, or choose another folder"
    with contextlib.closing(LockFile(folder / LOCK_FILE, in_use)), stop_request() as request:
        run = _Run(settings, folder, device)
        run.begin(resume)
        while run.update < settings.max_updates and not request.made:
            run.make_update()
            if progress is not None and run.update % TOLD_INTERVAL == 0:
                progress(run.update, run.loss_nats)
            if run.update % CHECKPOINT_INTERVAL == 0:
                run.save()
        run.save()
        stopped = "finished" if run.update == settings.max_updates else "interrupted"
        loss_nats = None if math.isnan(run.loss_nats) else run.loss_nats
        return WindowsResult(run.update, loss_nats, run.write_weights(), stopped)


class _Run:
    """Where a training stands."""

    def __init__(self, settings: WindowsSettings, folder: Path, device: str) -> None:
        self._settings = settings
        self._folder = folder
        self._device = device
        self._generator = torch.Generator(device)
        self._generator.manual_seed(settings.seed)
        self._network = WindowsNetwork(torch.Generator().manual_seed(settings.seed)).to(device)
        self._optimizer = torch.optim.Adam(self._network.parameters(), lr=settings.learning_rate)
        self._fading = WorldsFading(PAPER_WINDOW_SAMPLES, device)
        self.update = 0
        self.loss_nats = math.nan

    def begin(self, resume: bool) -> None:
        path = self._folder / RESUME_FILE
        if path.exists() and not resume:
            raise InputError(f"folder {self._folder} holds a run: give --resume to go on with it, or another folder")
        if resume and not path.exists():
            raise InputError(f"folder {self._folder} holds no run to resume")
        if resume:
            self._restore(path)

    def make_update(self) -> None:
        """One step of Adam on chases that nobody has seen."""
        settings, generator, device = self._settings, self._generator, self._device
        for group in self._optimizer.param_groups:
            group["lr"] = settings.learning_rate * (1 - 0.999 * self.update / settings.max_updates)
        num_chases = settings.worlds * settings.chases_per_world
        worlds = drawn_worlds(settings.worlds, generator, device)
        fading_db = self._fading.drawn_db(worlds, settings.chases_per_world * settings.windows, generator)
        shape = (num_chases, settings.windows, PAPER_WINDOW_SAMPLES, NUM_TRACKERS)
        heard_db = reported_db(fading_db.transpose(2, 3).reshape(shape), generator)
        # Few windows as often as many: what is decided early in a chase is decided on few.
        number = (settings.windows + 0.99) ** torch.rand(num_chases, generator=generator, device=device)
        loss = windows_loss(self._network, heard_db, number.long())
        self._optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self._network.parameters(), settings.max_gradient_norm)
        self._optimizer.step()
        self.update += 1
        if self.update % TOLD_INTERVAL == 0:
            nats = float(loss.detach())
            share = 1.0 if math.isnan(self.loss_nats) else SMOOTHING
            self.loss_nats = nats if share == 1.0 else (1 - share) * self.loss_nats + share * nats

    def save(self) -> None:
        """Write the resume file."""
        tensors = {f"network.{name}": value.detach().cpu() for name, value in self._network.state_dict().items()}
        for number, state in self._optimizer.state_dict()["state"].items():
            tensors |= {f"adam.{number}.{name}": value.cpu() for name, value in state.items()}
        document = {
            **self._identity,
            "update": self.update,
            "loss_nats": None if math.isnan(self.loss_nats) else self.loss_nats,
            "generator": self._generator.get_state().tolist(),
        }
        save_tensors(self._folder / RESUME_FILE, tensors, document)

    def write_weights(self) -> Path:
        """Write the network in float16, and return its file."""
        path = self._folder / WEIGHTS_FILE
        configuration = {"settings": dataclasses.asdict(self._settings), "schedule": "windows", "update": self.update}
        save_weights(path, self._network.cpu(), configuration, torch.float16)
        return path

    @property
    def _identity(self) -> dict[str, Any]:
        return {"format": FORMAT, "settings": dataclasses.asdict(self._settings), "device": self._device.split(":")[0]}

    def _restore(self, path: Path) -> None:
        tensors, document = load_tensors(path, "resume file", MOST_RESUME_BYTES)
        require_same_run(path, document, self._identity)
        try:
            network = {name[8:]: value for name, value in tensors.items() if name.startswith("network.")}
            self._network.load_state_dict(network)
            state: dict[int, dict[str, torch.Tensor]] = {}
            for name, value in tensors.items():
                if name.startswith("adam."):
                    _, number, part = name.split(".")
                    state.setdefault(int(number), {})[part] = value
            self._optimizer.load_state_dict({**self._optimizer.state_dict(), "state": state})
            self._generator.set_state(torch.tensor(document["generator"], dtype=torch.uint8))
            self.update = int(document["update"])
            self.loss_nats = math.nan if document["loss_nats"] is None else float(document["loss_nats"])
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise InputError(f"resume file {path} is incomplete: {error}") from error
