"""Agents that take turns in one process: bit-reproducible. A3C's deterministic schedule, and the batched trainer."""

import contextlib
import warnings
from collections.abc import Iterator

import torch

from ..batch.freed_memory import keep_freed_memory
from ..networks.forms import new_networks
from .agent import LocalAgent
from .evaluator import Evaluator
from .parameters import FlatNetworks
from .run import TrainingRun
from .worker import make_global_agent, work_once


def run_in_turn(run: TrainingRun, num_threads: int = 1, device: torch.device | str = "cpu") -> None:
    """Train until the run ends; the auxiliary agent evaluates between the others' turns."""
    keep_freed_memory()
    settings = run.settings
    global_agent = make_global_agent(settings, run.shared, contextlib.nullcontext())
    local = FlatNetworks(new_networks(settings).to(device))  # one for all: each fills it anew at its turn
    agents = [
        LocalAgent(run.scenarios[index % len(run.scenarios)], settings, index, local)
        for index in range(settings.num_agents)
    ]
    for agent, snapshot in zip(agents, run.point.agents, strict=False):
        agent.restore(snapshot)
    evaluator = Evaluator(run.scenarios, settings, run.schedule, run.folder.folder, run.best)
    with _threads(num_threads), _in_the_order_of_the_vector():
        while not global_agent.finished and run.stopped is None:
            before = global_agent.updates
            agent = agents[before // settings.passes_per_rollout % settings.num_agents]
            run.environment_steps += work_once(agent, global_agent)
            for finished in agent.finished_chases(global_agent.updates):
                run.chase_ended(finished)
            if _has_passed(settings.evaluation_interval, before, global_agent.updates) or global_agent.finished:
                evaluation = evaluator.evaluate(global_agent.snapshot(), run.evaluating)
                run.evaluated(evaluation, evaluator.best, evaluator.meets_criterion(evaluation))
            if _has_passed(settings.checkpoint_interval, before, global_agent.updates):
                run.checkpoint(global_agent.snapshot(), [agent.snapshot() for agent in agents])
            run.show()
    run.checkpoint(global_agent.snapshot(), [agent.snapshot() for agent in agents])


def _has_passed(interval: int, before: int, after: int) -> bool:
    return before // interval != after // interval


@contextlib.contextmanager
def _in_the_order_of_the_vector() -> Iterator[None]:
    """On a GPU a recurrent network's weights are copied at every call, since ``FlatNetworks`` holds them in its own
    order: some megabytes, which PyTorch need not warn of.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="RNN module weights are not part of single contiguous chunk")
        yield


@contextlib.contextmanager
def _threads(number: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)
