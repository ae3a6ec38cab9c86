"""Environment steps a second of training on two cores: the batched trainer, our A3C, and Stable-Baselines3's A2C.

All train the four networks of the paper with T = 5. A3C has two workers with a chase each, a core each; the batched
trainer has 64 chases and two threads; Stable-Baselines3 has the same four networks before its heads, 64 of our
Gymnasium environments and two threads. Each runs in a process of its own, ours with
``batch.freed_memory.keep_freed_memory`` as in training; Stable-Baselines3 as it comes, and once more with that. They
take turns; a ratio is the median over the turns of two rates measured one right after the other. Time is wall time:
leave the machine to it."""

import contextlib
import dataclasses
import functools
import multiprocessing
import platform
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import TYPE_CHECKING, Any

import torch

from ..batch.freed_memory import keep_freed_memory
from ..networks.actor_critic import NETWORK_NAMES, ActorCritic, SwarmNetworks
from ..networks.forms import new_networks
from ..processes.children import end_with_parent
from ..scenario import paper_scenario
from ..training.agent import LocalAgent
from ..training.global_agent import SharedParameters
from ..training.parameters import FlatNetworks
from ..training.settings import PRESETS, Precision
from ..training.worker import make_global_agent, work_once
from .training import steps_per_s as a3c_steps_per_s

if TYPE_CHECKING:
    from rich.table import Table

CORES = 2
CHASES = 64
A3C, SB3 = "A3C, two workers", "Stable-Baselines3 A2C"
SB3_KEEPING = "Stable-Baselines3 A2C, freed memory kept"
OURS = {"bfloat16": "batched, bfloat16", "float32": "batched, float32"}


def measure(rollouts: int = 12, repeats: int = 3) -> dict[str, Any]:
    """Steps a second of each trainer, ``rollouts`` of 64 chases a turn; a rate is the median over ``repeats`` turns."""
    a3c_updates = rollouts * CHASES // 8
    subjects: dict[str, Callable[[], float]] = {
        OURS["bfloat16"]: lambda: _in_a_process(batched_steps_per_s, "bfloat16", rollouts),
        A3C: lambda: a3c_steps_per_s(CORES, a3c_updates),
        OURS["float32"]: lambda: _in_a_process(batched_steps_per_s, "float32", rollouts),
    }
    not_measured = {}
    try:
        import stable_baselines3

        for name, keeps_memory in ((SB3, False), (SB3_KEEPING, True)):
            subjects[name] = functools.partial(
                _in_a_process, stable_baselines3_steps_per_s, max(1, rollouts // 3), keeps_memory
            )
        sb3_version = stable_baselines3.__version__
    except ModuleNotFoundError as error:
        not_measured[SB3], sb3_version = str(error), None
    rates: dict[str, list[float]] = {name: [] for name in subjects}
    for _ in range(repeats):
        for name, subject in subjects.items():
            rates[name].append(subject())
    ours = rates[OURS["bfloat16"]]
    return {
        "benchmark": "batched",
        "processor": platform.processor() or platform.machine(),
        "versions": {
            "python": platform.python_version(),
            "torch": torch.__version__,
            "stable_baselines3": sb3_version,
        },
        "environment_steps_per_s": {name: statistics.median(turns) for name, turns in rates.items()},
        "all_turns": rates,
        "ratio_of_batched_bfloat16": {
            name: statistics.median(our / their for our, their in zip(ours, turns, strict=True))
            for name, turns in rates.items()
        },
        "not_measured": not_measured,
    }


def table(result: dict[str, Any]) -> "Table":
    """The result as people read it."""
    from rich.table import Table

    shown = Table(title=f"Training on {CORES} cores, environment steps a second (T = 5, four networks)")
    for heading in ("trainer", "steps/s", "batched, bfloat16, is faster by"):
        shown.add_column(heading, justify="right")
    for name, rate in result["environment_steps_per_s"].items():
        shown.add_row(name, f"{rate:.1f}", f"{result['ratio_of_batched_bfloat16'][name]:.2f}")
    for name, reason in result["not_measured"].items():
        shown.add_row(name, "-", reason)
    return shown


def _in_a_process(rate: Callable[..., float], *arguments: Any) -> float:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context, initializer=end_with_parent) as pool:
        return pool.submit(rate, *arguments).result()


def batched_steps_per_s(precision: Precision, rollouts: int) -> float:
    """Of the preset ``a2c`` in this precision; the first rollout is not timed."""
    settings = dataclasses.replace(PRESETS["a2c"], chases_per_agent=CHASES, precision=precision)
    networks = new_networks(settings, torch.Generator().manual_seed(0))
    shared = SharedParameters.start(FlatNetworks(networks).vector)
    torch.set_num_threads(CORES)
    keep_freed_memory()
    global_agent = make_global_agent(settings, shared, contextlib.nullcontext())
    agent = LocalAgent(paper_scenario(), settings, 0)
    work_once(agent, global_agent)
    began_s, steps = time.perf_counter(), 0
    for _ in range(rollouts):
        steps += work_once(agent, global_agent)
        agent.finished_chases(global_agent.updates)
    return steps / (time.perf_counter() - began_s)


def stable_baselines3_steps_per_s(rollouts: int, keeps_memory: bool) -> float:
    """Of its A2C on 64 ``ChaseEnv``; the first rollout is not timed."""
    from stable_baselines3 import A2C
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from stable_baselines3.common.vec_env import DummyVecEnv

    from ..gym import ChaseEnv

    class FourNetworks(BaseFeaturesExtractor):
        """The paper's four networks up to their heads."""

        def __init__(self, observation_space: Any) -> None:
            super().__init__(observation_space, features_dim=128 * len(NETWORK_NAMES))
            self.networks = SwarmNetworks(torch.Generator().manual_seed(0)).by_name

        def forward(self, rssi_dbm: torch.Tensor) -> torch.Tensor:
            networks = [network for network in self.networks.values() if isinstance(network, ActorCritic)]
            return torch.cat([network.features(network.scaled(rssi_dbm)) for network in networks], dim=1)

    torch.set_num_threads(CORES)
    if keeps_memory:
        keep_freed_memory()
    model = A2C(
        "MlpPolicy",
        DummyVecEnv([ChaseEnv for _ in range(CHASES)]),
        n_steps=5,
        device="cpu",
        policy_kwargs={"features_extractor_class": FourNetworks, "net_arch": []},
    )
    model.learn(5 * CHASES)
    began_s = time.perf_counter()
    model.learn(5 * CHASES * rollouts)
    return 5 * CHASES * rollouts / (time.perf_counter() - began_s)
