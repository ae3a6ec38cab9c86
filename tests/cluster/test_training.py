"""A3C on a real Ray cluster of two nodes: it is the laptop's, and it learns on through every fault."""

import contextlib
import dataclasses
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from ray_nodes import WAIT_S, Nodes, kill_one, listening_addresses, processes, processes_at, wait_until
from swarmchase.cluster.training import _Agent, _Supervisor, train_on_cluster
from swarmchase.scenario import paper_scenario
from swarmchase.training.a3c import train_a3c
from swarmchase.training.agent import LocalAgent
from swarmchase.training.losses import LossSettings
from swarmchase.training.run import TrainingResult, TrainingStatus
from swarmchase.training.run_folder import read_log
from swarmchase.training.settings import TrainingSettings

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc to know a node's processes")

WORLD = paper_scenario(start_distance_m=8.0, max_movements=20, rician_k=1e6, window_samples=4)
SETTINGS = TrainingSettings(
    num_agents=3,
    chases_per_agent=4,
    learning_rate=1e-3,
    losses=LossSettings(discount=0.5),
    max_updates=200,
    seed=5,
    evaluation_interval=200,
    evaluation_chases=4,
    checkpoint_interval=40,
)
LOCAL, GLOBAL = "LocalAgentActor", "GlobalAgentActor"


@pytest.fixture(scope="module")
def first(head: Nodes) -> Iterator[Any]:
    """A node with a CPU, beside the head."""
    with head.with_node(num_cpus=1) as node:
        yield node


def test_one_agent_on_the_cluster_is_the_deterministic_schedule_bit_for_bit(
    head: Nodes, first: Any, tmp_path: Path
) -> None:
    """Parameters, Adam, the agent's chases and random streams, the log and the best weights."""
    settings = dataclasses.replace(
        SETTINGS, num_agents=1, max_updates=20, evaluation_interval=20, checkpoint_interval=6, final_learning_rate=1e-4
    )
    results = [
        train_on_cluster(WORLD, settings, tmp_path / "cluster", head.address),
        train_a3c(WORLD, settings, tmp_path / "here", "deterministic"),
    ]
    assert results[0].best == results[1].best
    assert [result.environment_steps for result in results] == [results[1].environment_steps] * 2
    for file in ("resume.safetensors", "best.safetensors"):
        one, other = load_file(tmp_path / "cluster" / file), load_file(tmp_path / "here" / file)
        assert one.keys() == other.keys()
        assert [name for name in one if not torch.equal(one[name], other[name])] == []
    assert read_log(tmp_path / "cluster", "chase") == read_log(tmp_path / "here", "chase") != []
    gradients = read_log(tmp_path / "cluster", "gradient")
    assert [(line["update"], line["updates_behind"]) for line in gradients] == [(k, 0) for k in range(1, 21)]


def test_ctrl_c_stops_the_command_and_its_cluster_cleanly(tmp_path: Path) -> None:
    """As a terminal does, it reaches the whole process group; a cluster on this machine ends with the command, and no
    other machine can reach it.
    """
    WORLD.save_toml(tmp_path / "world.toml")
    options = {"cluster": "local", "preset": "fast", "agents": 1, "folder": tmp_path / "run"}
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    program = [str(Path(sys.executable).with_name("swarmchase")), "train", "a3c", *words]
    process = subprocess.Popen(
        [*program, "--scenario", str(tmp_path / "world.toml")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        log = tmp_path / "run" / "training.jsonl"
        wait_until(lambda: process.poll() is not None or (log.exists() and log.stat().st_size > 0), "gradients")
        addresses = listening_addresses(process.pid)
        os.killpg(process.pid, signal.SIGINT)
        standard_output, standard_error = process.communicate(timeout=WAIT_S)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 0, standard_error
    assert addresses == {"127.0.0.1"}
    assert "no token" not in standard_error
    assert "Training interrupted" in standard_error
    assert "Traceback" not in standard_error
    assert standard_output == ""
    wait_until(lambda: process.pid not in {parent for parent, _ in processes().values()}, "no orphans")
    updates = int(load_file(tmp_path / "run" / "resume.safetensors")["global.updates"])
    assert updates == len(read_log(tmp_path / "run", "gradient")) > 0
    assert (tmp_path / "run" / "staleness.png").stat().st_size > 10_000


class Faults:
    """What happens to a training, one thing after another: each at an update, or later, when its condition holds.

    While it waits for the condition no agent gets more to do, and hardly any updates go by: nothing here depends on how
    soon a machine starts processes.
    """

    def __init__(self, *script: tuple[int, Callable[[], bool], Callable[[], Any]]) -> None:
        self._script = list(script)
        self.happened_at: list[int] = []

    def __call__(self, status: TrainingStatus) -> None:
        if not self._script or status.updates < self._script[0][0]:
            return
        _, holds, happen = self._script[0]
        look_again_s = time.monotonic() + 5
        while not holds():
            if time.monotonic() > look_again_s:
                return
            time.sleep(0.1)
        happen()
        self._script.pop(0)
        self.happened_at.append(status.updates)


@dataclasses.dataclass(frozen=True)
class Ordeal:
    """A training with every fault in it."""

    interrupted: TrainingResult
    finished: TrainingResult
    folder: Path
    happened_at: list[int]


@pytest.fixture(scope="module")
def ordeal(head: Nodes, first: Any, tmp_path_factory: pytest.TempPathFactory) -> Ordeal:
    """Two nodes with a CPU each beside the head, and three agents: one of them waits for a third node."""
    folder = tmp_path_factory.mktemp("ordeal") / "run"
    second = head.add(num_cpus=1)
    third: list[Any] = []

    def kill_global_agent() -> None:
        kill_one(head.head, GLOBAL)

    faults = Faults(
        (20, lambda: len(processes_at(first, LOCAL)) == 1, lambda: kill_one(first, LOCAL)),
        (50, lambda: True, lambda: third.append(head.add(num_cpus=2))),
        (80, lambda: bool(processes_at(third[0], LOCAL)), lambda: head.remove(second)),
        (100, lambda: sum(len(processes_at(node, LOCAL)) for node in (first, *third)) == 3, kill_global_agent),
        (130, lambda: True, lambda: signal.raise_signal(signal.SIGINT)),
    )
    interrupted = train_on_cluster(WORLD, SETTINGS, folder, head.address, progress=faults)
    finished = train_on_cluster(WORLD, SETTINGS, folder, head.address, resume=True)
    head.remove(third[0])
    return Ordeal(interrupted, finished, folder, faults.happened_at)


@pytest.mark.parametrize(("never_started", "deaths"), [(True, 0), (False, 1)])
def test_an_actor_that_never_ran_has_not_died(never_started: bool, deaths: int) -> None:
    """Ray drops one now and then, most when the machine is busy; three of them are no reason to end a training."""
    from ray.core.generated.common_pb2 import ActorDiedErrorContext
    from ray.exceptions import ActorDiedError

    error = ActorDiedError(ActorDiedErrorContext(actor_id=b"1" * 16, never_started=never_started))
    supervisor = object.__new__(_Supervisor)
    supervisor._got_over = lambda _what: None  # type: ignore[method-assign]
    supervisor._ray = Mock()
    agent = _Agent(0, LocalAgent(WORLD, SETTINGS, 0).snapshot())
    supervisor._agent_died(agent, error)
    assert agent.deaths == deaths


def told(ordeal: Ordeal, words: str) -> list[dict[str, Any]]:
    return [line for line in read_log(ordeal.folder, "fault") if words in line["what"]]


def test_every_fault_happened_and_the_training_came_to_its_end(ordeal: Ordeal) -> None:
    assert len(ordeal.happened_at) == 5
    assert (ordeal.interrupted.stopped, ordeal.finished.stopped) == ("interrupted", "finished")
    assert ordeal.interrupted.updates >= 130
    assert ordeal.finished.updates == int(load_file(ordeal.folder / "resume.safetensors")["global.updates"]) == 200
    assert ordeal.finished.best is not None
    assert ordeal.finished.best.update == 200


def test_a_killed_agent_and_those_of_a_removed_node_come_back(ordeal: Ordeal) -> None:
    """On the node that was added: the script waited for one to start there, and for another in place of the lost."""
    assert len(told(ordeal, "local agent ")) >= 2
    assert len(told(ordeal, "has joined")) == 1
    assert len(told(ordeal, "node ")) >= 2
    assert next(line["update"] for line in told(ordeal, "local agent ")) >= 20
    gradients = read_log(ordeal.folder, "gradient")
    assert {line["agent"] for line in gradients if line["update"] > ordeal.happened_at[3]} == {0, 1, 2}


def test_with_the_global_agent_at_most_a_checkpoint_interval_is_lost(ordeal: Ordeal) -> None:
    lines = told(ordeal, "the global agent is gone")
    assert len(lines) == 1, lines
    (line,) = lines
    words = line["what"].split(":")[0].split()
    reached = int(words[words.index("update") + 1])
    assert 0 <= reached - line["update"] <= SETTINGS.checkpoint_interval
    assert line["update"] % SETTINGS.checkpoint_interval == 0


def test_every_gradient_is_in_the_log_once_and_none_is_fresher_than_it_can_be(ordeal: Ordeal) -> None:
    """What was lost with the global agent is made again, and the log with it."""
    gradients = read_log(ordeal.folder, "gradient")
    assert [line["update"] for line in gradients] == list(range(1, 201))
    last: dict[int, int] = {}
    for line in gradients[: ordeal.happened_at[3] - SETTINGS.checkpoint_interval]:
        # Its agent fetched the parameters with its last update, or later: at the start of its process.
        assert 0 <= line["updates_behind"] <= line["update"] - 1 - last.get(line["agent"], 0)
        last[line["agent"]] = line["update"]
    assert max(line["updates_behind"] for line in gradients) >= 1


def test_it_learns_through_all_of_them(ordeal: Ordeal) -> None:
    """The reward of a movement on the three axes, chase by chase, rises from the first fifth of the updates to the last
    by an effect of more than 0.8 standard deviations, which is called large; 2.0 was seen."""
    chases = read_log(ordeal.folder, "chase")
    update = np.array([line["update"] for line in chases])
    rate_m = np.array([sum(line["reward_m"][1:]) / line["movements"] for line in chases])
    first, last = rate_m[update <= 40], rate_m[update > 160]
    assert min(len(first), len(last)) >= 30
    assert (last.mean() - first.mean()) / np.sqrt((first.var() + last.var()) / 2) > 0.8
    movements = np.array([line["movements"] for line in chases])
    assert movements[update > 160].mean() < 0.7 * movements[update <= 40].mean()
