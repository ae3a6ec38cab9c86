"""One pass of Algorithm 1's outer loop, the same under every schedule."""

from typing import Any, Protocol, runtime_checkable

import torch

from .agent import LocalAgent
from .global_agent import GlobalAgent, LearningRate, SharedParameters
from .parameters import FlatNetworks
from .settings import TrainingSettings


@runtime_checkable
class ParameterServer(Protocol):
    """What a local agent asks of the global one: here in shared memory, or at the other end of a network."""

    def synchronise(self, local: FlatNetworks) -> None:
        """Copy the global parameters to an agent's own."""

    def update(self, gradient: torch.Tensor) -> bool:
        """Apply a gradient; False where the last update had already been made."""


def make_global_agent(settings: TrainingSettings, shared: SharedParameters, lock: Any) -> GlobalAgent:
    """The global agent as any process sees it."""
    end = settings.learning_rate if settings.final_learning_rate is None else settings.final_learning_rate
    return GlobalAgent(
        shared, lock, LearningRate(settings.learning_rate, end, settings.max_updates), settings.max_updates
    )


def work_once(agent: LocalAgent, global_agent: ParameterServer) -> int:
    """One pass of Algorithm 1's outer loop: synchronise, play T movements, transfer the gradient; returns the
    movements made. PPO transfers several gradients of the same rollout, each at the parameters of its moment."""
    global_agent.synchronise(agent.local)
    rollout = agent.play()
    for passed in range(agent.passes_per_rollout):
        if passed > 0:
            global_agent.synchronise(agent.local)
        agent.compute_gradient(rollout)
        global_agent.update(agent.local.gradient)
    return int(rollout.valid.sum())
