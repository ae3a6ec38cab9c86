"""One pass of Algorithm 1's outer loop, the same under every schedule."""

from typing import Any

from ..scenario import Scenario
from .agent import LocalAgent
from .global_agent import GlobalAgent, LearningRate, SharedParameters
from .settings import A3CSettings, training_seed


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
    """One pass of Algorithm 1's outer loop: synchronise, play T movements, transfer the gradient; returns T."""
    global_agent.synchronise(agent.local)
    movements = agent.compute_gradient()
    global_agent.update(agent.local.gradient)
    return movements
