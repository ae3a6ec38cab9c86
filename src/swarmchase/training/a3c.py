"""Asynchronous advantage actor-critic, Algorithm 1 of the paper.

One global agent (this process: shared parameters, Adam, checkpoints, log), N local agents and one auxiliary agent that
evaluates, each a process of its own. ``schedule = "deterministic"`` runs the same agents in turn in this
process, which is bit-reproducible.

    swarmchase train a3c --sampling-hz 10 --spatial-correlation 0.9 --preset paper --folder runs/paper
"""

import contextlib
import signal
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

import torch

from ..errors import InputError
from ..networks import SwarmNetworks, initialise
from ..scenario import Scenario
from .agent import AgentSnapshot, FinishedChase, LocalAgent
from .evaluator import Evaluation, Evaluator
from .global_agent import GlobalAgent, LearningRate, SharedParameters
from .parameters import FlatNetworks
from .run_folder import ResumePoint, RunFolder, TrainingLog
from .settings import A3CSettings, Schedule, training_seed

POLL_S = 0.1
"""How often the global agent looks at its mail and at its agents' health."""
STOP_LIMIT_S = 60.0
"""An agent that has not stopped after this long is ended by force; an evaluation in its last chases may take this long."""


class WorkerDied(RuntimeError):
    """A local or auxiliary agent ended unexpectedly; the message holds its traceback or its exit code."""


@dataclass(frozen=True)
class TrainingStatus:
    """What a progress display shows."""

    updates: int
    max_updates: int
    environment_steps: int
    seconds: float
    last_chase: FinishedChase | None
    last_evaluation: Evaluation | None


@dataclass(frozen=True)
class TrainingResult:
    """How a run ended."""

    updates: int
    environment_steps: int
    seconds: float
    best: Evaluation | None
    stopped: str
    """"finished", "criterion met" or "interrupted"."""
    weights: Path
    """The best weights by evaluation, or the last where none was made."""


class Progress(Protocol):
    """Is told how the run goes, several times a second."""

    def __call__(self, status: TrainingStatus) -> None: ...


def train_a3c(
    scenario: Scenario,
    settings: A3CSettings,
    folder: Path,
    schedule: Schedule = "processes",
    resume: bool = False,
    progress: Progress = lambda status: None,
) -> TrainingResult:
    """Train the four networks; everything it makes lies in ``folder``.

    Ctrl-C stops it cleanly: the run is saved and can be resumed.

    Raises:
        InputError: the folder cannot be written, holds a run and ``resume`` is false, or holds no run and it is true.
        WorkerDied: an agent ended unexpectedly.
    """
    run_folder = RunFolder(folder, scenario, settings)
    if run_folder.has_resume_point and not resume:
        raise InputError(f"folder {folder} holds a run already: resume it, or choose another folder")
    if resume and not run_folder.has_resume_point:
        raise InputError(f"folder {folder} holds no run to resume")
    point = run_folder.load() if resume else _start(settings)
    run = _Run(scenario, settings, run_folder, point, progress)
    with contextlib.closing(run), _interrupt(run.interrupt):
        if schedule == "deterministic":
            _run_in_turn(run)
        else:
            _run_processes(run)
        return run.result()


def _start(settings: A3CSettings) -> ResumePoint:
    generator = torch.Generator().manual_seed(training_seed(settings.seed))
    vector = FlatNetworks(SwarmNetworks(generator)).vector
    return ResumePoint(SharedParameters.start(vector), agents=[], best=None, environment_steps=0, seconds=0.0)


class _Run:
    """The global agent's books: log, checkpoints, evaluations and why the run ends."""

    def __init__(
        self, scenario: Scenario, settings: A3CSettings, folder: RunFolder, point: ResumePoint, progress: Progress
    ) -> None:
        self.scenario = scenario
        self.settings = settings
        self.folder = folder
        self.point = point
        self.shared = point.parameters.shared()
        self.best = point.best
        self.environment_steps = point.environment_steps
        self.stopped: str | None = None
        self._progress = progress
        self._began_s = time.monotonic() - point.seconds
        self._log = TrainingLog(folder.folder, int(self.shared.updates))
        self._last_chase: FinishedChase | None = None
        self._last_evaluation: Evaluation | None = None

    @property
    def seconds(self) -> float:
        return time.monotonic() - self._began_s

    def global_agent(self, lock: Any) -> GlobalAgent:
        return make_global_agent(self.settings, self.shared, lock)

    def interrupt(self) -> None:
        self.stopped = self.stopped or "interrupted"

    def chase_ended(self, chase: FinishedChase) -> None:
        self._last_chase = chase
        self._log.chase(chase)

    def evaluated(self, evaluation: Evaluation, best: Evaluation | None, meets_criterion: bool) -> None:
        self._last_evaluation, self.best = evaluation, best
        self._log.evaluation(evaluation, self.seconds, self.environment_steps)
        if meets_criterion:
            self.stopped = self.stopped or "criterion met"

    def checkpoint(self, parameters: SharedParameters, agents: list[AgentSnapshot]) -> None:
        self._log.flush()
        self.folder.save(ResumePoint(parameters, agents, self.best, self.environment_steps, self.seconds))

    def show(self) -> None:
        self._progress(
            TrainingStatus(
                int(self.shared.updates),
                self.settings.max_updates,
                self.environment_steps,
                self.seconds,
                self._last_chase,
                self._last_evaluation,
            )
        )

    def close(self) -> None:
        self._log.close()

    def result(self) -> TrainingResult:
        from .evaluator import BEST_WEIGHTS

        return TrainingResult(
            int(self.shared.updates),
            self.environment_steps,
            self.seconds,
            self.best,
            self.stopped or "finished",
            self.folder.folder / BEST_WEIGHTS,
        )


def make_global_agent(settings: A3CSettings, shared: SharedParameters, lock: Any) -> GlobalAgent:
    """The global agent as any process sees it."""
    end = settings.learning_rate if settings.final_learning_rate is None else settings.final_learning_rate
    return GlobalAgent(
        shared, lock, LearningRate(settings.learning_rate, end, settings.max_updates), settings.max_updates
    )


def make_local_agent(scenario: Scenario, settings: A3CSettings, index: int) -> LocalAgent:
    """Local agent ``index`` at the beginning of its first chase."""
    return LocalAgent(
        index, settings.num_agents, training_seed(settings.seed), scenario, settings.losses, settings.update_interval
    )


def work_once(agent: LocalAgent, global_agent: GlobalAgent) -> int:
    """One pass of Algorithm 1's outer loop: synchronise, play T movements, transfer the gradient. Returns the movements."""
    global_agent.synchronise(agent.local)
    movements = agent.compute_gradient()
    global_agent.update(agent.local.gradient)
    return movements


def _run_in_turn(run: _Run) -> None:
    """The deterministic schedule: the agents take turns, the auxiliary agent evaluates between them."""
    settings = run.settings
    global_agent = run.global_agent(contextlib.nullcontext())
    agents = [make_local_agent(run.scenario, settings, index) for index in range(settings.num_agents)]
    for agent, snapshot in zip(agents, run.point.agents, strict=False):
        agent.restore(snapshot)
    evaluator = Evaluator(run.scenario, settings, run.folder.folder, run.best)
    with _one_thread():
        while not global_agent.finished and run.stopped is None:
            agent = agents[global_agent.updates % settings.num_agents]
            run.environment_steps += work_once(agent, global_agent)
            finished = agent.finished_chase(global_agent.updates)
            if finished is not None:
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

    def handle(number: int, frame: FrameType | None) -> None:
        stop()

    before = signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


# ---------------------------------------------------------------------------------------------------------------
# Processes
# ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Channels:
    """How the processes talk: one lock, one mailbox to the global agent, and flags in shared memory."""

    lock: Any
    mailbox: Any
    stop: Any
    checkpoints_asked: torch.Tensor
    environment_steps: torch.Tensor
    """Movements made by each local agent in this session."""


@dataclass(frozen=True)
class _EvaluationMail:
    evaluation: Evaluation
    best: Evaluation | None
    meets_criterion: bool


@dataclass(frozen=True)
class _SnapshotMail:
    index: int
    asked: int
    snapshot: AgentSnapshot


@dataclass(frozen=True)
class _ErrorMail:
    who: str
    text: str


def _run_processes(run: _Run) -> None:
    settings = run.settings
    context: Any = torch.multiprocessing.get_context("spawn")
    channels = _Channels(
        lock=context.Lock(),
        mailbox=context.SimpleQueue(),
        stop=context.Event(),
        checkpoints_asked=torch.zeros(1, dtype=torch.int64).share_memory_(),
        environment_steps=torch.zeros(settings.num_agents, dtype=torch.int64).share_memory_(),
    )
    arguments = (run.scenario, settings, run.shared, channels)
    starts = list(run.point.agents) or [None] * settings.num_agents
    processes = {
        f"local agent {index}": context.Process(
            target=_local_agent_process, args=(*arguments, index, starts[index]), daemon=True
        )
        for index in range(settings.num_agents)
    }
    processes["auxiliary agent"] = context.Process(
        target=_auxiliary_agent_process, args=(*arguments, run.folder.folder, run.best), daemon=True
    )
    for process in processes.values():
        process.start()
    try:
        _supervise(run, channels, processes)
    finally:
        for process in processes.values():
            if process.is_alive():
                process.terminate()
        for process in processes.values():
            process.join()


def _supervise(run: _Run, channels: _Channels, processes: dict[str, Any]) -> None:
    """Read the mail, look after the agents, take checkpoints, and bring the run to its end."""
    global_agent = run.global_agent(channels.lock)
    steps_before = run.environment_steps
    snapshots: dict[int, AgentSnapshot] = {}
    next_checkpoint = _next_multiple(global_agent.updates, run.settings.checkpoint_interval)
    stop_by_s: float | None = None
    while any(process.is_alive() for process in processes.values()) or not channels.mailbox.empty():
        while not channels.mailbox.empty():
            mail = channels.mailbox.get()
            if isinstance(mail, FinishedChase):
                run.chase_ended(mail)
            elif isinstance(mail, _EvaluationMail):
                run.evaluated(mail.evaluation, mail.best, mail.meets_criterion)
            elif isinstance(mail, _SnapshotMail):
                if mail.asked == int(channels.checkpoints_asked):
                    snapshots[mail.index] = mail.snapshot
            else:
                raise WorkerDied(f"{mail.who} ended with an error:\n{mail.text}")
        _require_health(processes)
        run.environment_steps = steps_before + int(channels.environment_steps.sum())
        if len(snapshots) == run.settings.num_agents:
            run.checkpoint(global_agent.snapshot(), [snapshots[index] for index in range(run.settings.num_agents)])
            snapshots = {}
        if global_agent.updates >= next_checkpoint and stop_by_s is None:
            next_checkpoint = _next_multiple(global_agent.updates, run.settings.checkpoint_interval)
            snapshots = {}
            channels.checkpoints_asked.add_(1)
        if stop_by_s is None and (run.stopped is not None or global_agent.finished):
            # The agents' last snapshots come with their leave, under a number of their own.
            snapshots = {}
            channels.checkpoints_asked.add_(1)
            channels.stop.set()
            stop_by_s = time.monotonic() + STOP_LIMIT_S
        if stop_by_s is not None and time.monotonic() > stop_by_s:
            break
        run.show()
        time.sleep(POLL_S)
    if len(snapshots) == run.settings.num_agents:
        run.checkpoint(global_agent.snapshot(), [snapshots[index] for index in range(run.settings.num_agents)])
    run.show()


def _require_health(processes: dict[str, Any]) -> None:
    for who, process in processes.items():
        if process.exitcode not in (None, 0):
            raise WorkerDied(
                f"{who} ended with exit code {process.exitcode}" + (" (killed)" if process.exitcode < 0 else "")
            )


def _next_multiple(updates: int, interval: int) -> int:
    return (updates // interval + 1) * interval


@contextlib.contextmanager
def _worker(channels: _Channels, who: str) -> Iterator[None]:
    """One thread, Ctrl-C left to the global agent, and no silent death."""
    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    except BaseException:
        channels.mailbox.put(_ErrorMail(who, traceback.format_exc()))
        raise


def _local_agent_process(
    scenario: Scenario,
    settings: A3CSettings,
    shared: SharedParameters,
    channels: _Channels,
    index: int,
    start: AgentSnapshot | None,
) -> None:
    with _worker(channels, f"local agent {index}"):
        global_agent = make_global_agent(settings, shared, channels.lock)
        agent = make_local_agent(scenario, settings, index)
        if start is not None:
            agent.restore(start)
        answered = 0
        while not channels.stop.is_set():
            if global_agent.finished:
                channels.stop.wait()
                break
            channels.environment_steps[index].add_(work_once(agent, global_agent))
            finished = agent.finished_chase(global_agent.updates)
            if finished is not None:
                channels.mailbox.put(finished)
            asked = int(channels.checkpoints_asked)
            if asked > answered and not channels.stop.is_set():
                answered = asked
                channels.mailbox.put(_SnapshotMail(index, asked, agent.snapshot()))
        channels.mailbox.put(_SnapshotMail(index, int(channels.checkpoints_asked), agent.snapshot()))


def _auxiliary_agent_process(
    scenario: Scenario,
    settings: A3CSettings,
    shared: SharedParameters,
    channels: _Channels,
    folder: Path,
    best: Evaluation | None,
) -> None:
    with _worker(channels, "auxiliary agent"):
        global_agent = make_global_agent(settings, shared, channels.lock)
        evaluator = Evaluator(scenario, settings, folder, best)
        next_evaluation = _next_multiple(global_agent.updates, settings.evaluation_interval)
        while not channels.stop.is_set():
            if global_agent.updates < next_evaluation:
                channels.stop.wait(POLL_S)
                continue
            next_evaluation = _next_multiple(global_agent.updates, settings.evaluation_interval)
            evaluation = evaluator.evaluate(global_agent.snapshot())
            channels.mailbox.put(_EvaluationMail(evaluation, evaluator.best, evaluator.meets_criterion(evaluation)))
