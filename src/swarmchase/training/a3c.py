"""Asynchronous advantage actor-critic, Algorithm 1 of the paper.

One global agent (shared parameters, Adam, checkpoints, log), N local agents and one auxiliary agent that evaluates.
``schedule = "processes"`` makes each a process of its own; ``"deterministic"`` runs the same agents in turn in this
process, which is bit-reproducible.

    swarmchase train a3c --sampling-hz 10 --spatial-correlation 0.9 --preset paper --folder runs/paper
"""

from pathlib import Path
from typing import get_args

from ..errors import InputError
from ..scenario import Scenario
from .in_turn import run_in_turn
from .processes import run_processes
from .run import TellStatus, TrainingResult, open_run
from .settings import A3CSchedule, TrainingSettings


def train_a3c(
    scenario: Scenario,
    settings: TrainingSettings,
    folder: Path,
    schedule: A3CSchedule = "processes",
    resume: bool = False,
    progress: TellStatus | None = None,
) -> TrainingResult:
    """Train the four networks; everything it makes lies in ``folder``.

    Ctrl-C stops it cleanly: the run is saved and can be resumed.

    Raises:
        InputError: the folder cannot be written, holds a run and ``resume`` is false, or holds no run and it is true.
        WorkerDiedError: an agent ended unexpectedly.
    """
    if schedule not in get_args(A3CSchedule):
        raise InputError(f"schedule = {schedule!r} is refused: allowed is {' or '.join(get_args(A3CSchedule))}")
    with open_run([scenario], settings, schedule, folder, resume, progress) as run:
        if schedule == "deterministic":
            run_in_turn(run)
        else:
            run_processes(run)
        return run.result()
