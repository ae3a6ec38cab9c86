"""The global agent as an actor of the cluster, and what a local agent sees of it.

Gradients come and parameters go as one flat float32 array each. The reply to a gradient is the fresh parameters, so
that an update costs one message each way.
"""

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..training.global_agent import SharedParameters
from ..training.parameters import FlatNetworks
from ..training.settings import TrainingSettings
from ..training.worker import make_global_agent

EXCHANGE_LIMIT_S = 60.0
"""A local agent whose gradient is not answered for so long takes the global agent for lost."""
HELD_S = 0.02
"""A local agent that is told to wait for a checkpoint asks again after so long."""


class GlobalAgentLostError(Exception):
    """The global agent is gone or does not answer."""


@dataclass(frozen=True)
class Arrival:
    """A gradient that was applied."""

    update: int
    """Its number, counted from 1."""
    agent: int
    updates_behind: int
    """Staleness: updates made by others since its agent had last fetched the parameters."""


@dataclass(frozen=True)
class Reply:
    """The global parameters after a gradient, or word to wait."""

    parameters: NDArray[np.float32] | None
    """Flat; None while the gradient has to wait for a checkpoint."""
    updates: int
    applied: bool
    """False where the last update had been made before."""
    finished: bool


@dataclass(frozen=True)
class GlobalNews:
    """What has happened since the last news."""

    updates: int
    arrivals: Sequence[Arrival] = field(repr=False)
    cpu_s: float
    """CPU time of the global agent's process in all."""


class GlobalAgentActor:
    """Parameters and Adam of the training; it holds gradients back rather than be more than a checkpoint ahead."""

    def __init__(self, settings: TrainingSettings, parameters: SharedParameters) -> None:
        torch.set_num_threads(1)
        self._shared = parameters
        self._global_agent = make_global_agent(settings, parameters, contextlib.nullcontext())
        self._gradient = torch.zeros_like(parameters.vector)
        self._interval = settings.checkpoint_interval
        self._kept = int(parameters.updates)
        self._arrivals: list[Arrival] = []

    def parameters(self) -> Reply:
        """The parameters as they are."""
        agent = self._global_agent
        return Reply(self._shared.vector.numpy(), agent.updates, False, agent.finished)

    def exchange(self, agent: int, gradient: NDArray[np.float32], fetched_at: int) -> Reply:
        """Apply a gradient that was made of the parameters after update ``fetched_at``, and give the fresh ones."""
        updates = self._global_agent.updates
        if updates - self._kept >= self._interval and not self._global_agent.finished:
            return Reply(None, updates, applied=False, finished=False)
        self._gradient.numpy()[:] = gradient
        applied = self._global_agent.update(self._gradient)
        if applied:
            self._arrivals.append(Arrival(updates + 1, agent, updates - fetched_at))
        return Reply(self._shared.vector.numpy(), self._global_agent.updates, applied, self._global_agent.finished)

    def snapshot(self) -> SharedParameters:
        """A copy of everything, for a checkpoint or an evaluation."""
        return self._global_agent.snapshot()

    def kept(self, update: int) -> None:
        """A checkpoint of the state after this update is on disk."""
        self._kept = update

    def news(self) -> GlobalNews:
        """What has happened since this was last asked."""
        arrivals, self._arrivals = self._arrivals, []
        return GlobalNews(self._global_agent.updates, arrivals, time.process_time())


class RemoteGlobalAgent:
    """The global agent at the other end of the network, as ``work_once`` uses it."""

    def __init__(self, ray: Any, actor: Any, agent: int) -> None:
        """``agent`` is the number of the local agent that it is for.

        Raises:
            GlobalAgentLostError: it is gone or does not answer.
        """
        self._ray = ray
        self._actor = actor
        self._agent = agent
        self.exchange_s = 0.0
        """Time spent waiting for replies in all."""
        self._reply = self._answered(actor.parameters.remote())

    @property
    def updates(self) -> int:
        """Updates made so far by all agents, as of the last reply."""
        return self._reply.updates

    @property
    def finished(self) -> bool:
        """Whether the last update has been made."""
        return self._reply.finished

    def synchronise(self, local: FlatNetworks) -> None:
        """Copy the global parameters, as of the last reply, to the agent's own."""
        local.vector.numpy()[:] = self._reply.parameters

    def update(self, gradient: torch.Tensor) -> bool:
        """Hand in a gradient, wait for the fresh parameters; False where the last update had been made before.

        Raises:
            GlobalAgentLostError: it is gone or does not answer.
        """
        sent = self._ray.put(gradient.numpy())
        give_up_s = time.monotonic() + EXCHANGE_LIMIT_S
        while True:
            reply = self._answered(self._actor.exchange.remote(self._agent, sent, self._reply.updates))
            if reply.parameters is not None:
                self._reply = reply
                return reply.applied
            if time.monotonic() > give_up_s:
                raise GlobalAgentLostError(f"held back for {EXCHANGE_LIMIT_S:g} s: no checkpoint is being written")
            time.sleep(HELD_S)

    def _answered(self, asked: Any) -> Reply:
        began_s = time.perf_counter()
        try:
            reply: Reply = self._ray.get(asked, timeout=EXCHANGE_LIMIT_S)
        except self._ray.exceptions.RayTaskError:
            raise  # an error of ours, to be seen
        except self._ray.exceptions.RayError as error:
            raise GlobalAgentLostError(str(error)) from error
        self.exchange_s += time.perf_counter() - began_s
        return reply
