"""A3C's asynchronous schedule: each local agent and the auxiliary agent a process, looked after by the global agent.

Processes are spawned, never forked. One that dies ends the run with its traceback or its exit code. None can hold up
the others by its death: each has a pipe of its own, and flags are numbers in shared memory.
"""

import contextlib
import math
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing import connection
from pathlib import Path
from typing import Any

import torch

from ..batch.freed_memory import keep_freed_memory
from ..errors import WorkerDiedError
from ..processes.children import begin_child, start_helper, starting_children
from ..processes.shared_memory import share
from ..processes.stop_request import StopRequest
from ..scenario import Scenario
from .agent import AgentSnapshot, FinishedChase, LocalAgent
from .evaluator import AuxiliaryEvaluation, Evaluator
from .global_agent import SharedParameters
from .run import TrainingRun, next_evaluation, next_multiple
from .settings import TrainingSettings
from .worker import make_global_agent, work_once

POLL_S = 0.1
"""How often the global agent looks at its mail and at its agents' health."""
STOP_LIMIT_S = 60.0
"""An agent that has not stopped after this long is ended by force; only an evaluation may take so long."""


@dataclass(frozen=True)
class _Channels:
    """How the processes talk, beside the pipe from each to the global agent: one lock, and flags in shared memory."""

    lock: Any
    stop: torch.Tensor
    """Not 0: the agents are to leave."""
    checkpoints_asked: torch.Tensor
    environment_steps: torch.Tensor
    """Movements made by each local agent in this session."""
    evaluating: torch.Tensor
    """Chases that have ended of the evaluation under way, and all of them: 0 where none is."""

    def tell_evaluating(self, ended: int, chases: int) -> None:
        """The auxiliary agent's."""
        self.evaluating.copy_(torch.tensor([ended, chases]))


@dataclass(frozen=True)
class _EvaluationMail:
    evaluation: AuxiliaryEvaluation
    best: AuxiliaryEvaluation | None
    meets_criterion: bool


@dataclass(frozen=True)
class _SnapshotMail:
    index: int
    asked: int
    snapshot: AgentSnapshot


@dataclass(frozen=True)
class _StopMail:
    """A signal wants an agent to stop, which is meant for the whole run."""

    number: int


@dataclass(frozen=True)
class _ErrorMail:
    who: str
    text: str


def run_processes(run: TrainingRun) -> None:
    """Train until the run ends.

    Raises:
        InputError: no room for what the processes share.
        WorkerDiedError: an agent ended unexpectedly.
    """
    settings = run.settings
    run.shared.share()
    start_helper()
    context: Any = torch.multiprocessing.get_context("spawn")
    channels = _Channels(
        lock=context.Lock(),
        stop=_shared_zeros(1),
        checkpoints_asked=_shared_zeros(1),
        environment_steps=_shared_zeros(settings.num_agents),
        evaluating=_shared_zeros(2),
    )
    arguments = (run.scenarios, settings, run.shared, channels)
    first_evaluation = next_evaluation(int(run.shared.updates), settings)
    starts: list[AgentSnapshot | None] = list(run.point.agents) or [None] * settings.num_agents
    agents: dict[str, tuple[Any, tuple[Any, ...]]] = {
        f"local agent {index}": (_local_agent_process, (*arguments, index, starts[index]))
        for index in range(settings.num_agents)
    }
    last_arguments = (*arguments, run.folder.folder, run.best, first_evaluation)
    agents["auxiliary agent"] = (_auxiliary_agent_process, last_arguments)
    processes: dict[str, Any] = {}
    mailbox = _Mailbox()
    try:
        with starting_children():
            for who, (target, its_arguments) in agents.items():
                receiver, sender = context.Pipe(duplex=False)
                outbox = _Outbox(who, sender)
                processes[who] = context.Process(target=target, args=(outbox, *its_arguments), daemon=True)
                processes[who].start()
                sender.close()
                mailbox.receivers.append(receiver)
        _supervise(run, channels, mailbox, processes)
    finally:
        for process in processes.values():
            if process.is_alive():
                process.kill()  # it leaves other signals to this process
        for process in processes.values():
            if process.pid is not None:
                process.join()


@dataclass
class _Mailbox:
    """The global agent's ends of the agents' pipes; that of an agent which has ended goes."""

    receivers: list[Any] = field(default_factory=list)

    def read(self) -> Iterator[Any]:
        """All that has come."""
        while ready := connection.wait(self.receivers, 0):
            for receiver in ready:
                assert isinstance(receiver, connection.Connection)
                try:
                    mail = receiver.recv()
                except (EOFError, OSError):
                    self.receivers.remove(receiver)
                else:
                    yield mail


@dataclass
class _Outbox:
    """An agent's end of its pipe."""

    who: str
    sender: Any
    has_passed_on: bool = False

    def put(self, mail: Any) -> None:
        """Send it. No tensors: a process that shares memory for them leaves files behind when it is killed."""
        self.sender.send(mail)

    def pass_on(self, request: StopRequest) -> None:
        """Once, if it is made."""
        if request.made and not self.has_passed_on:
            self.has_passed_on = True
            self.put(_StopMail(request.number))


@dataclass(frozen=True)
class _WatchedLock:
    """The lock as the global agent takes it: an agent killed while it held it must not hold up the run for ever."""

    lock: Any
    processes: dict[str, Any]

    def __enter__(self) -> None:
        while not self.lock.acquire(timeout=POLL_S):
            _require_health(self.processes)

    def __exit__(self, *_: object) -> None:
        self.lock.release()


def _supervise(run: TrainingRun, channels: _Channels, mailbox: _Mailbox, processes: dict[str, Any]) -> None:
    """Read the mail, look after the agents, take checkpoints, and bring the run to its end."""
    global_agent = make_global_agent(run.settings, run.shared, _WatchedLock(channels.lock, processes))
    steps_before = run.environment_steps
    snapshots: dict[int, AgentSnapshot] = {}
    next_checkpoint = next_multiple(global_agent.updates, run.settings.checkpoint_interval)
    stopping = leave_is_saved = False
    stop_by_s = math.inf
    while any(process.is_alive() for process in processes.values()) or mailbox.receivers:
        # Before the mail: an agent that died of an error has written it by then, and its traceback says more.
        casualty = _casualty(processes)
        _read_mail(run, channels, mailbox, snapshots)
        if casualty is not None:
            raise WorkerDiedError(casualty)
        run.environment_steps = steps_before + int(channels.environment_steps.sum())
        if len(snapshots) == run.settings.num_agents and not leave_is_saved:
            run.checkpoint(global_agent.snapshot(), [snapshots[index] for index in range(run.settings.num_agents)])
            leave_is_saved = stopping
            snapshots = snapshots if stopping else {}
        if global_agent.updates >= next_checkpoint and not stopping:
            next_checkpoint = next_multiple(global_agent.updates, run.settings.checkpoint_interval)
            snapshots = {}
            channels.checkpoints_asked.add_(1)
        if not stopping and (run.stopped is not None or global_agent.finished):
            # The agents' last snapshots come with their leave, under a number of their own.
            snapshots = {}
            channels.checkpoints_asked.add_(1)
            channels.stop.fill_(1)
            stopping = True
        if run.stopped is not None:
            # A run that has made all of its updates waits for its last evaluation, unless it is interrupted.
            stop_by_s = min(stop_by_s, time.monotonic() + STOP_LIMIT_S)
        if time.monotonic() > stop_by_s:
            break
        ended, chases = channels.evaluating.tolist()
        if chases > 0:
            run.evaluating(ended, chases)
        else:
            run.show()
        time.sleep(POLL_S)
    _require_health(processes)
    if len(snapshots) == run.settings.num_agents:
        run.checkpoint(global_agent.snapshot(), [snapshots[index] for index in range(run.settings.num_agents)])
    run.show()


def _read_mail(run: TrainingRun, channels: _Channels, mailbox: _Mailbox, snapshots: dict[int, AgentSnapshot]) -> None:
    """Enter all that has come into the run's books; answers to the present call for a checkpoint into ``snapshots``."""
    for mail in mailbox.read():
        if isinstance(mail, FinishedChase):
            run.chase_ended(mail)
        elif isinstance(mail, _EvaluationMail):
            run.evaluated(mail.evaluation, mail.best, mail.meets_criterion)
        elif isinstance(mail, _SnapshotMail):
            if mail.asked == int(channels.checkpoints_asked):
                snapshots[mail.index] = mail.snapshot
        elif isinstance(mail, _StopMail):
            run.request.note(mail.number)
        else:
            raise WorkerDiedError(f"{mail.who} ended with an error:\n{mail.text}")


def _require_health(processes: dict[str, Any]) -> None:
    casualty = _casualty(processes)
    if casualty is not None:
        raise WorkerDiedError(casualty)


def _casualty(processes: dict[str, Any]) -> str | None:
    for who, process in processes.items():
        if process.exitcode not in (None, 0):
            return f"{who} ended with exit code {process.exitcode}" + (" (killed)" if process.exitcode < 0 else "")
    return None


def _shared_zeros(length: int) -> torch.Tensor:
    zeros = torch.zeros(length, dtype=torch.int64)
    return share(zeros)


@contextlib.contextmanager
def _worker(outbox: _Outbox) -> Iterator[StopRequest]:
    """One thread, no silent death, and none left behind when the global agent is killed."""
    request = begin_child()
    torch.set_num_threads(1)
    keep_freed_memory()
    try:
        yield request
    except BaseException:
        outbox.put(_ErrorMail(outbox.who, traceback.format_exc()))
        raise


def _local_agent_process(
    outbox: _Outbox,
    scenarios: Sequence[Scenario],
    settings: TrainingSettings,
    shared: SharedParameters,
    channels: _Channels,
    index: int,
    start: AgentSnapshot | None,
) -> None:
    with _worker(outbox) as request:
        global_agent = make_global_agent(settings, shared, channels.lock)
        agent = LocalAgent(scenarios[index % len(scenarios)], settings, index)
        if start is not None:
            agent.restore(start)
        answered = 0
        while not channels.stop:
            outbox.pass_on(request)
            if global_agent.finished:
                time.sleep(POLL_S)
                continue
            channels.environment_steps[index].add_(work_once(agent, global_agent))
            for finished in agent.finished_chases(global_agent.updates):
                outbox.put(finished)
            asked = int(channels.checkpoints_asked)
            if asked > answered and not channels.stop:
                answered = asked
                outbox.put(_SnapshotMail(index, asked, agent.snapshot()))
        outbox.put(_SnapshotMail(index, int(channels.checkpoints_asked), agent.snapshot()))


def _auxiliary_agent_process(
    outbox: _Outbox,
    scenarios: Sequence[Scenario],
    settings: TrainingSettings,
    shared: SharedParameters,
    channels: _Channels,
    folder: Path,
    best: AuxiliaryEvaluation | None,
    next_update: int,
) -> None:
    with _worker(outbox) as request:
        global_agent = make_global_agent(settings, shared, channels.lock)
        evaluator = Evaluator(scenarios, settings, "processes", folder, best)
        while True:
            outbox.pass_on(request)
            if global_agent.updates < next_update:
                # Asked again: the last update may have come while it waited, and is still to be evaluated.
                if channels.stop and global_agent.updates < next_update:
                    break
                time.sleep(POLL_S)
                continue
            if channels.stop and not global_agent.finished:
                break
            next_update = next_evaluation(global_agent.updates, settings)
            evaluation = evaluator.evaluate(global_agent.snapshot(), channels.tell_evaluating)
            channels.tell_evaluating(0, 0)
            outbox.put(_EvaluationMail(evaluation, evaluator.best, evaluator.meets_criterion(evaluation)))
