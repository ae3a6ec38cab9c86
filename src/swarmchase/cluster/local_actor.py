"""A local agent as an actor of the cluster: the worker step of every other schedule, in pieces that report."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from ..batch.freed_memory import keep_freed_memory
from ..scenario import Scenario
from ..training.agent import AgentSnapshot, FinishedChase, LocalAgent
from ..training.settings import TrainingSettings
from ..training.worker import work_once
from .connection import ray_module
from .global_actor import GlobalAgentLostError, RemoteGlobalAgent


@dataclass(frozen=True)
class AgentReport:
    """What an agent did in one piece of work."""

    incarnation: int
    """Of the global agent that it worked with."""
    environment_steps: int
    finished: Sequence[FinishedChase]
    snapshot: AgentSnapshot = field(repr=False)
    """Where it stands."""
    lost: str | None
    """Why it takes the global agent for lost, if it does."""
    seconds: float
    exchange_s: float
    """Of these, waiting for the global agent."""
    cpu_s: float
    """CPU time of the agent's process."""


def owned(snapshot: AgentSnapshot) -> AgentSnapshot:
    """The same as a message brought it, in memory of its own: what Ray hands over must not be written to."""
    return AgentSnapshot({name: array.copy() for name, array in snapshot.arrays.items()}, snapshot.streams)


class LocalAgentActor:
    """One of N agents, with its chases, on some node."""

    def __init__(self, scenario: Scenario, settings: TrainingSettings, index: int) -> None:
        torch.set_num_threads(1)
        keep_freed_memory()
        self._ray = ray_module()
        self._index = index
        self._agent = LocalAgent(scenario, settings, index)
        self._global_agent: RemoteGlobalAgent | None = None
        self._incarnation = -1

    def ready(self) -> None:
        """Is answered when the process is there."""

    def work(self, global_agent: Any, incarnation: int, seconds: float, start: AgentSnapshot | None) -> AgentReport:
        """Work with a global agent for about so long, for one update at least unless the last has been made.

        It goes on where ``start`` was taken, or where it stands itself.
        """
        if start is not None:
            self._agent.restore(owned(start))
        began_s, cpu_before_s = time.monotonic(), time.process_time()
        steps, finished, lost = 0, [], None
        waited_before_s = 0.0
        try:
            if self._global_agent is None or incarnation != self._incarnation:
                self._global_agent = RemoteGlobalAgent(self._ray, global_agent, self._index)
                self._incarnation = incarnation
            else:
                waited_before_s = self._global_agent.exchange_s
            while not self._global_agent.finished:
                steps += work_once(self._agent, self._global_agent)
                finished += self._agent.finished_chases(self._global_agent.updates)
                if time.monotonic() >= began_s + seconds:
                    break
        except GlobalAgentLostError as error:
            lost = str(error)
        return AgentReport(
            incarnation,
            steps,
            finished,
            self._agent.snapshot(),
            lost,
            time.monotonic() - began_s,
            0.0 if self._global_agent is None else self._global_agent.exchange_s - waited_before_s,
            time.process_time() - cpu_before_s,
        )
