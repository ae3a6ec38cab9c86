"""Movements a second on one core: the batched environment, and what is left of it through Gymnasium.

A movement of one chase is one step, with its RSSI window of 6 trackers x 50 samples; no controller is involved. Actions
are drawn beforehand, at random. Through Gymnasium the time includes the checks of the actions, the information and
the chases that end and begin. The subjects take turns, and a rate is the median over the turns. Time is CPU time of
the process, so that other work on the machine disturbs little.
"""

import itertools
import platform
import statistics
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import torch

from ..batch.streams import chase_keys
from ..formation import action_from_choice
from ..gym import ChaseEnv, ChaseVectorEnv
from ..scenario import Scenario, paper_scenario
from ..world.environment import Environment

if TYPE_CHECKING:
    from rich.table import Table

Step = Callable[[], Any]
"""One movement of every chase of a batch."""

_SEED = 1
_NUM_PREPARED_ACTIONS = 64


def environment_step(scenario: Scenario, batch: int) -> Step:
    """``Environment.step`` alone: chases go on after their end."""
    environment = Environment(scenario)
    state = environment.reset(chase_keys(_SEED, batch))
    actions = itertools.cycle([action_from_choice(scenario, torch.from_numpy(one)) for one in _choices(batch)])

    def step() -> None:
        nonlocal state
        state, _ = environment.step(state, next(actions))

    return step


def chase_env_step(scenario: Scenario, batch: int) -> Step:
    """``ChaseEnv``, one after the other, reset where a chase ends."""
    envs = [ChaseEnv(scenario) for _ in range(batch)]
    for lane, env in enumerate(envs):
        env.reset(seed=_SEED + lane)
    choices = itertools.cycle(_choices(batch))

    def step() -> None:
        for env, choice in zip(envs, next(choices), strict=True):
            _, _, terminated, truncated, _ = env.step(choice)
            if terminated or truncated:
                env.reset()

    return step


def chase_vector_env_step(scenario: Scenario, batch: int) -> Step:
    """``ChaseVectorEnv``, one batch."""
    return _vector_step(ChaseVectorEnv(batch, scenario))


def sync_vector_env_step(scenario: Scenario, batch: int) -> Step:
    """Gymnasium's own loop over ``ChaseEnv``, which is what ``ChaseVectorEnv`` stands in for."""
    return _vector_step(gymnasium.vector.SyncVectorEnv([lambda: ChaseEnv(scenario)] * batch))


SUBJECTS: dict[str, Callable[[Scenario, int], Step]] = {
    "Environment": environment_step,
    "ChaseVectorEnv": chase_vector_env_step,
    "SyncVectorEnv": sync_vector_env_step,
    "ChaseEnv": chase_env_step,
}
_LARGEST_LOOP = 64
"""What loops over single environments gains nothing from more of them."""


def measure(turn_s: float = 0.2, repeats: int = 5, batch_sizes: tuple[int, ...] = (1, 64, 1024)) -> dict[str, Any]:
    """Movements a second of every subject at every batch size, each in ``repeats`` turns of ``turn_s`` of CPU time."""
    scenario = paper_scenario()
    cases = [
        (name, batch)
        for name in SUBJECTS
        for batch in batch_sizes
        if not (name == "ChaseEnv" and batch > 1) and not (name == "SyncVectorEnv" and batch > _LARGEST_LOOP)
    ]
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        steps = {case: SUBJECTS[case[0]](scenario, case[1]) for case in cases}
        turns: dict[tuple[str, int], list[float]] = {case: [] for case in cases}
        for step in steps.values():
            step()
        for _ in range(repeats):
            for case in cases:
                turns[case].append(_movements_per_s(steps[case], case[1], turn_s))
    finally:
        torch.set_num_threads(threads)
    rates: dict[str, dict[str, float]] = {name: {} for name, _ in cases}
    for (name, batch), found in turns.items():
        rates[name][str(batch)] = statistics.median(found)
    return {
        "benchmark": "environment",
        "processor": platform.processor() or platform.machine(),
        "threads": 1,
        "clock": "CPU time of the process",
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "torch": torch.__version__,
            "gymnasium": gymnasium.__version__,
        },
        "scenario": scenario.to_dict(),
        "repeats": repeats,
        "movements_per_s": rates,
    }


def table(result: dict[str, Any]) -> "Table":
    """What ``measure`` found, for people."""
    from rich.table import Table

    rates = result["movements_per_s"]
    batches = list(dict.fromkeys(batch for found in rates.values() for batch in found))
    shown = Table(title="Environment: movements per second on one core", caption="columns: chases in one batch")
    shown.add_column("")
    for batch in batches:
        shown.add_column(batch, justify="right")
    for name, found in rates.items():
        shown.add_row(name, *(f"{found[batch]:,.0f}" if batch in found else "" for batch in batches))
    return shown


def _movements_per_s(step: Step, batch: int, turn_s: float) -> float:
    num_movements = 0
    begin_s = time.process_time()
    while (elapsed_s := time.process_time() - begin_s) < turn_s:
        step()
        num_movements += batch
    return num_movements / elapsed_s


def _vector_step(env: Any) -> Step:
    env.reset(seed=_SEED)
    choices = itertools.cycle(_choices(env.num_envs))
    return lambda: env.step(next(choices))


def _choices(batch: int) -> list[Any]:
    """Actions for some movements, [chase, 4] each."""
    return list(np.random.default_rng(_SEED).integers(0, 5, size=(_NUM_PREPARED_ACTIONS, batch, 4)))
