"""Asynchronous advantage actor-critic, Algorithm 1 of the paper.

One global agent (shared parameters, Adam, checkpoints, log), N local agents and one auxiliary agent that evaluates.
``schedule = "processes"`` makes each a process of its own; ``"deterministic"`` runs the same agents in turn in this
process, which is bit-reproducible.

    swarmchase train a3c --sampling-hz 10 --spatial-correlation 0.9 --preset paper --folder runs/paper
"""

import contextlib
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

import torch

from ..errors import InputError
from ..networks import SwarmNetworks
from ..scenario import Scenario
from .agent import LocalAgent
from .evaluator import Evaluator
from .global_agent import SharedParameters
from .parameters import FlatNetworks
from .processes import run_processes
from .run import Progress, TrainingResult, TrainingRun
from .run_folder import ResumePoint, RunFolder
from .settings import A3CSettings, Schedule, training_seed
from .worker import make_global_agent, work_once


def train_a3c(
    scenario: Scenario,
    settings: A3CSettings,
    folder: Path,
    schedule: Schedule = "processes",
    resume: bool = False,
    progress: Progress | None = None,
) -> TrainingResult:
    """Train the four networks; everything it makes lies in ``folder``.

    Ctrl-C stops it cleanly: the run is saved and can be resumed.

    Raises:
        InputError: the folder cannot be written, holds a run and ``resume`` is false, or holds no run and it is true.
        WorkerDiedError: an agent ended unexpectedly.
    """
    run_folder = RunFolder(folder, scenario, settings)
    if run_folder.has_resume_point and not resume:
        raise InputError(f"folder {folder} holds a run already: resume it, or choose another folder")
    if resume and not run_folder.has_resume_point:
        raise InputError(f"folder {folder} holds no run to resume")
    point = run_folder.load() if resume else _start(settings)
    run = TrainingRun(scenario, settings, run_folder, point, progress)
    with contextlib.closing(run), _interrupt(run.interrupt):
        if schedule == "deterministic":
            _run_in_turn(run)
        else:
            run_processes(run)
        return run.result()


def _start(settings: A3CSettings) -> ResumePoint:
    generator = torch.Generator().manual_seed(training_seed(settings.seed))
    vector = FlatNetworks(SwarmNetworks(generator)).vector
    return ResumePoint(SharedParameters.start(vector), agents=[], best=None, environment_steps=0, seconds=0.0)


def _run_in_turn(run: TrainingRun) -> None:
    """The deterministic schedule: the agents take turns, the auxiliary agent evaluates between them."""
    settings = run.settings
    global_agent = make_global_agent(settings, run.shared, contextlib.nullcontext())
    agents = [LocalAgent(run.scenario, settings, index) for index in range(settings.num_agents)]
    for agent, snapshot in zip(agents, run.point.agents, strict=False):
        agent.restore(snapshot)
    evaluator = Evaluator(run.scenario, settings, run.folder.folder, run.best)
    with _one_thread():
        while not global_agent.finished and run.stopped is None:
            agent = agents[global_agent.updates % settings.num_agents]
            run.environment_steps += work_once(agent, global_agent)
            for finished in agent.finished_chases(global_agent.updates):
                run.chase_ended(finished)
            if global_agent.updates % settings.evaluation_interval == 0:
                evaluation = evaluator.evaluate(global_agent.snapshot())
                run.evaluated(evaluation, evaluator.best, evaluator.meets_criterion(evaluation))
            if global_agent.updates % settings.checkpoint_interval == 0:
                run.checkpoint(global_agent.snapshot(), [agent.snapshot() for agent in agents])
            run.show()
    run.checkpoint(global_agent.snapshot(), [agent.snapshot() for agent in agents])


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextlib.contextmanager
def _interrupt(stop: Callable[[], None]) -> Iterator[None]:
    """Ctrl-C asks the run to stop instead of tearing it down."""

    def handle(_number: int, _frame: FrameType | None) -> None:
        stop()

    before = signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
