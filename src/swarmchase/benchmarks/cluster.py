"""Updates and movements a second of A3C on a cluster, against the number of agents; a model of the cost; more agents.

Two nodes on this machine: the global agent on one, the agents on the other, so that every gradient and all parameters
go from node to node as they do on a rack, though not through a network. What an agent costs is fitted to the runs with
one agent, what the shared processes cost to all of them; the runs with several agents then say how good the model is.
Leave the machine to it.

    swarmchase benchmark cluster --figure cluster.png
"""

import dataclasses
import os
import platform
import statistics
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from ..cluster.connection import LOCAL_OBJECT_STORE_BYTES, Cluster, at_node, connected, ray_module
from ..cluster.global_actor import GlobalAgentActor
from ..cluster.local_actor import AgentReport, LocalAgentActor
from ..networks.forms import new_networks
from ..scenario import paper_scenario
from ..training.global_agent import SharedParameters
from ..training.parameters import FlatNetworks
from ..training.settings import MOST_UPDATES, TrainingSettings
from .cluster_model import UpdateCost, fitted_line, on_few_cores, predicted, saturating_agents

if TYPE_CHECKING:
    from rich.table import Table

WARM_UP_S = 3.0
LIMIT_S = 300.0
"""For agents to start, and beyond its time for each measurement."""
NETWORK_BITS_PER_S = 10e9
PLANNED_AGENTS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
SHOWN_AGENTS = (10, 100, 1000)
"""Of these, in the table."""
PLANNED_SETTINGS = ((1, 5), (8, 5), (8, 20), (64, 20))
"""Chases of an agent and T."""


def measure(
    seconds: float = 10.0, agents: Sequence[int] = (1, 2, 4), chases_per_agent: Sequence[int] = (1, 8, 32)
) -> dict[str, Any]:
    """Rates with each number of agents, each with so many chases; T = 5.

    Raises:
        InputError: Ray is not installed.
    """
    rows: list[dict[str, Any]] = []
    with _two_nodes(max(agents)) as (address, raylet):
        for chases in chases_per_agent:
            for number in agents:
                settings = TrainingSettings(num_agents=number, chases_per_agent=chases, max_updates=MOST_UPDATES)
                with connected(address, 1) as cluster:
                    rows.append(_measured(cluster, settings, seconds, raylet))
    cost = fitted_cost(rows)
    cores = os.cpu_count() or 1
    return {
        "benchmark": "cluster",
        "processor": platform.processor() or platform.machine(),
        "cores": cores,
        "versions": {"python": platform.python_version(), "torch": torch.__version__, "ray": ray_module().__version__},
        "seconds": seconds,
        "measured": [{**row, "predicted_updates_per_s": _predicted(cost, row, cores)} for row in rows],
        "cost": dataclasses.asdict(cost),
        "network_bits_per_s": NETWORK_BITS_PER_S,
        "planned": [
            dataclasses.asdict(predicted(cost, number, chases, interval, NETWORK_BITS_PER_S))
            for chases, interval in PLANNED_SETTINGS
            for number in PLANNED_AGENTS
        ],
        "saturating_agents": [
            {
                "chases_per_agent": chases,
                "update_interval": interval,
                "agents": saturating_agents(cost, chases, interval, NETWORK_BITS_PER_S),
            }
            for chases, interval in PLANNED_SETTINGS
        ],
    }


def _predicted(cost: UpdateCost, row: dict[str, Any], cores: int) -> float:
    return on_few_cores(cost, row["agents"], row["chases_per_agent"], row["update_interval"], cores)


def fitted_cost(rows: Sequence[dict[str, Any]]) -> UpdateCost:
    """The model's numbers. Processes that agents share also cost something while nothing happens, which is not theirs:
    what an update costs is the slope of their load against the rate."""
    fewest = min(row["agents"] for row in rows)
    alone = [row for row in rows if row["agents"] == fewest]
    fixed_s, step_s = fitted_line(
        [row["chases_per_agent"] * row["update_interval"] for row in alone], [row["agent_cpu_s"] for row in alone]
    )
    rates = [row["updates_per_s"] for row in rows]
    global_agent_s, raylet_s = (
        fitted_line(rates, [row[name] * row["updates_per_s"] for row in rows])[1]
        for name in ("global_agent_cpu_s", "raylet_cpu_s")
    )
    delay_s = max(0.0, statistics.median(row["exchange_s"] for row in alone) - global_agent_s - raylet_s)
    return UpdateCost(fixed_s, step_s, global_agent_s, raylet_s, delay_s, int(rows[0]["message_bytes"]))


@contextmanager
def _two_nodes(num_cpus: int) -> Iterator[tuple[str, int]]:
    """A head without CPUs and a node with so many; gives the head's address and the process of its raylet."""
    ray_module()
    from ray.cluster_utils import Cluster as Nodes

    common = {"object_store_memory": LOCAL_OBJECT_STORE_BYTES, "include_dashboard": False}
    nodes = Nodes(initialize_head=True, shutdown_at_exit=True, head_node_args={"num_cpus": 0, **common})
    try:
        nodes.add_node(num_cpus=num_cpus, **common)
        yield nodes.address, nodes.head_node.all_processes["raylet"][0].process.pid
    finally:
        nodes.shutdown()


def _measured(cluster: Cluster, settings: TrainingSettings, seconds: float, raylet: int) -> dict[str, Any]:
    ray = cluster.ray
    parameters = SharedParameters.start(FlatNetworks(new_networks(settings, torch.Generator().manual_seed(0))).vector)
    settings = dataclasses.replace(settings, checkpoint_interval=MOST_UPDATES)
    here = at_node(cluster.home)
    global_agent = (
        ray.remote(num_cpus=0)(GlobalAgentActor).options(scheduling_strategy=here).remote(settings, parameters)
    )
    agent_type = ray.remote(num_cpus=1)(LocalAgentActor)
    agents = [agent_type.remote(paper_scenario(), settings, index) for index in range(settings.num_agents)]
    ray.get([agent.ready.remote() for agent in agents], timeout=LIMIT_S)

    def work(for_s: float) -> list[AgentReport]:
        pieces = [agent.work.remote(global_agent, 0, for_s, None) for agent in agents]
        reports: list[AgentReport] = ray.get(pieces, timeout=LIMIT_S + for_s)
        return reports

    work(WARM_UP_S)
    before, raylet_before_s = ray.get(global_agent.news.remote(), timeout=LIMIT_S), _cpu_s(raylet)
    reports = work(seconds)
    after, raylet_after_s = ray.get(global_agent.news.remote(), timeout=LIMIT_S), _cpu_s(raylet)
    made = [sum(arrival.agent == index for arrival in after.arrivals) for index in range(settings.num_agents)]
    updates = sum(made)
    return {
        "agents": settings.num_agents,
        "chases_per_agent": settings.chases_per_agent,
        "update_interval": settings.update_interval,
        "updates_per_s": sum(number / report.seconds for number, report in zip(made, reports, strict=True)),
        "steps_per_s": sum(report.environment_steps / report.seconds for report in reports),
        "agent_cpu_s": sum(report.cpu_s for report in reports) / updates,
        "exchange_s": sum(report.exchange_s for report in reports) / updates,
        "global_agent_cpu_s": (after.cpu_s - before.cpu_s) / updates,
        "raylet_cpu_s": (raylet_after_s - raylet_before_s) / updates,
        "updates_behind": statistics.fmean(arrival.updates_behind for arrival in after.arrivals),
        "message_bytes": 4 * len(parameters.vector),
    }


def _cpu_s(process: int) -> float:
    """CPU time of a process so far, all of its threads."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def table(result: dict[str, Any]) -> "Table":
    """The result as people read it."""
    from rich.table import Table

    shown = Table(title=f"A3C on a cluster of two nodes on one machine of {result['cores']} cores, and the model of it")
    for heading in ("agents", "chases each", "T", "updates/s", "model", "steps/s", "updates behind"):
        shown.add_column(heading, justify="right")
    for row in result["measured"]:
        shown.add_row(
            str(row["agents"]),
            str(row["chases_per_agent"]),
            str(row["update_interval"]),
            f"{row['updates_per_s']:.1f}",
            f"{row['predicted_updates_per_s']:.1f}",
            f"{row['steps_per_s']:.0f}",
            f"{row['updates_behind']:.1f}",
        )
    shown.add_section()
    for row in (one for one in result["planned"] if one["agents"] in SHOWN_AGENTS):
        shown.add_row(
            str(row["agents"]),
            str(row["chases_per_agent"]),
            str(row["update_interval"]),
            "-",
            f"{row['updates_per_s']:.1f}",
            f"{row['steps_per_s']:.0f}",
            f"{row['updates_behind']:.0f}",
        )
    shown.caption = (
        f"below the line: by the model, on a rack with {result['network_bits_per_s'] / 1e9:g} Gb/s and a core an agent"
    )
    return shown


def markdown(result: dict[str, Any]) -> str:
    """The tables of docs/cluster.md: what was measured, what an update costs, what the model says of a rack."""
    cost = UpdateCost(**result["cost"])
    network_s = cost.network_s(result["network_bits_per_s"])
    saturating = {
        (one["chases_per_agent"], one["update_interval"]): one["agents"] for one in result["saturating_agents"]
    }
    settings = list(saturating)
    planned = {(one["chases_per_agent"], one["update_interval"], one["agents"]): one for one in result["planned"]}
    measured = [
        f"| {row['agents']} | {row['chases_per_agent']} | {row['updates_per_s']:.1f} | "
        f"{row['predicted_updates_per_s']:.1f} | {row['steps_per_s']:.0f} | {row['updates_behind']:.1f} |"
        for row in result["measured"]
    ]
    costs = [
        ("agent, fixed", cost.agent_fixed_s),
        ("agent, each movement of each chase", cost.agent_step_s),
        ("global agent's process", cost.global_agent_s),
        ("raylet of its node", cost.raylet_s),
        ("network, each direction", network_s),
        ("delay beyond these", cost.delay_s),
    ]
    rack = [
        f"| {chases} | {interval} | "
        + " | ".join(_shown_rates(planned[chases, interval, agents]) for agents in SHOWN_AGENTS)
        + f" | {saturating[chases, interval]:.0f} |"
        for chases, interval in settings
    ]
    heads = " | ".join(f"{agents} agents" for agents in SHOWN_AGENTS)
    return "\n".join(
        [
            "| agents | chases each | updates/s | model | movements/s | updates behind |",
            "|---|---|---|---|---|---|",
            *measured,
            "",
            "| cost of an update | ms |",
            "|---|---|",
            *(f"| {name} | {1e3 * seconds:.1f} |" for name, seconds in costs),
            "",
            f"| chases each | T | {heads} | saturates at agents |",
            "|---|---|---|---|---|---|",
            *rack,
        ]
    )


def _shown_rates(prediction: dict[str, Any]) -> str:
    return f"{prediction['updates_per_s']:.0f} / {prediction['steps_per_s']:,.0f}"
