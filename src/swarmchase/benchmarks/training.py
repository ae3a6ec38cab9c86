"""Environment steps a second of the A3C trainer: one process, then two, each on a core of its own.

A process runs the local agent's own work: synchronise, T movements, gradient, shared Adam under the lock.
"""

import platform
import statistics
import time
from typing import TYPE_CHECKING, Any

import torch

from ..batch.freed_memory import keep_freed_memory
from ..networks.actor_critic import SwarmNetworks
from ..processes.children import end_with_parent
from ..scenario import Scenario, paper_scenario
from ..training.agent import LocalAgent
from ..training.global_agent import SharedParameters
from ..training.parameters import FlatNetworks
from ..training.settings import TrainingSettings
from ..training.worker import make_global_agent, work_once

if TYPE_CHECKING:
    from rich.table import Table

WARM_UP_UPDATES = 5


def measure(updates: int = 100, repeats: int = 3, workers: tuple[int, ...] = (1, 2)) -> dict[str, Any]:
    """Steps a second with each number of workers, in turns; a rate is the median over ``repeats`` turns."""
    rates: dict[int, list[float]] = {number: [] for number in workers}
    for _ in range(repeats):
        for number in workers:
            rates[number].append(steps_per_s(number, updates))
    medians = {str(number): statistics.median(turns) for number, turns in rates.items()}
    alone = medians[str(workers[0])] / workers[0]
    return {
        "benchmark": "training",
        "processor": platform.processor() or platform.machine(),
        "versions": {"python": platform.python_version(), "torch": torch.__version__},
        "scenario": paper_scenario().to_dict(),
        "updates_per_worker": updates,
        "environment_steps_per_s": medians,
        "all_turns": {str(number): turns for number, turns in rates.items()},
        "steps_per_s_per_worker": {number: rate / int(number) for number, rate in medians.items()},
        "scaling": {number: rate / alone / int(number) for number, rate in medians.items()},
    }


def table(result: dict[str, Any]) -> "Table":
    """The result as people read it."""
    from rich.table import Table

    shown = Table(title="A3C, environment steps a second (one worker a core, T = 5, four networks)")
    for heading in ("workers", "steps/s", "steps/s a worker", "of linear scaling"):
        shown.add_column(heading, justify="right")
    for number, rate in result["environment_steps_per_s"].items():
        each, scaling = result["steps_per_s_per_worker"][number], result["scaling"][number]
        shown.add_row(number, f"{rate:.1f}", f"{each:.1f}", f"{100 * scaling:.0f} %")
    return shown


def steps_per_s(num_workers: int, updates: int) -> float:
    """Of this many workers together, ``updates`` each."""
    context: Any = torch.multiprocessing.get_context("spawn")
    settings = TrainingSettings(num_agents=num_workers)
    shared = SharedParameters.start(FlatNetworks(SwarmNetworks(torch.Generator().manual_seed(0))).vector)
    lock, ready, mailbox = context.Lock(), context.Barrier(num_workers), context.SimpleQueue()
    processes = [
        context.Process(target=_worker, args=(paper_scenario(), settings, shared, lock, ready, mailbox, index, updates))
        for index in range(num_workers)
    ]
    for process in processes:
        process.start()
    rates = [mailbox.get() for _ in processes]
    for process in processes:
        process.join()
    return float(sum(rates))


def _worker(
    scenario: Scenario,
    settings: TrainingSettings,
    shared: SharedParameters,
    lock: Any,
    ready: Any,
    mailbox: Any,
    index: int,
    updates: int,
) -> None:
    end_with_parent()
    torch.set_num_threads(1)
    keep_freed_memory()
    global_agent = make_global_agent(settings, shared, lock)
    agent = LocalAgent(scenario, settings, index)
    for _ in range(WARM_UP_UPDATES):
        work_once(agent, global_agent)
    ready.wait()
    began_s = time.perf_counter()
    steps = 0
    for _ in range(updates):
        steps += work_once(agent, global_agent)
        agent.finished_chases(global_agent.updates)
    mailbox.put(steps / (time.perf_counter() - began_s))
