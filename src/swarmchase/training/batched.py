"""The batched trainer: one process, many chases at a time on one device; the rollout and the losses of A3C.

Each scenario has ``num_agents`` agents, and all of them take turns. With one of each, ``a2c`` is A3C with one worker.

    swarmchase train batched --sampling-hz 100 --spatial-correlation 0.5 --preset counterfactual --folder runs/one
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import torch

from ..errors import InputError
from ..ranges import AT_LEAST_ONE, checked_number
from ..scenario import Scenario
from .in_turn import run_in_turn
from .run import TellStatus, TrainingResult, open_run
from .settings import TrainingSettings


def train_batched(
    scenarios: Sequence[Scenario],
    settings: TrainingSettings,
    folder: Path,
    resume: bool = False,
    progress: TellStatus | None = None,
    num_threads: int = 1,
    device: str = "cpu",
) -> TrainingResult:
    """Train the four networks for one scenario, or for several at once; everything it makes lies in ``folder``.

    Ctrl-C stops it cleanly: the run is saved and can be resumed, exactly on the same device with as many threads.

    Raises:
        InputError: no scenario, threads or device; the folder cannot be written, holds a run and ``resume`` is false,
            or holds no run and it is true.
    """
    if not scenarios:
        raise InputError("no scenario to train for: give at least one")
    checked_number("threads", num_threads, AT_LEAST_ONE)
    require_device(device)
    agents_of_all = dataclasses.replace(settings, num_agents=settings.num_agents * len(scenarios))
    with open_run(scenarios, agents_of_all, "batched", folder, resume, progress, device) as run:
        run_in_turn(run, num_threads, device)
        return run.result()


def require_device(device: str) -> None:
    """Refuse what PyTorch cannot compute on here.

    Raises:
        InputError: neither the CPU nor a GPU that it sees.
    """
    gpus = [f"cuda:{number}" for number in range(torch.cuda.device_count())]
    allowed = ["cpu", *(["cuda", *gpus] if gpus else [])]
    if device not in allowed:
        found = "" if gpus else "; PyTorch sees no GPU here"
        raise InputError(f"device = {device!r} is refused: allowed is {', '.join(allowed)}{found}")
