"""Live chases over a link that fails: how many reach the target, in how many movements, in the simulated site.

Every chase is whole: the real service, agents, link and signatures, on a clock that is made (``VirtualChase``). The
settings share their chases, so that differences are those of the link. A tracker that gets lost does so half way
through the same chase without faults. A flood is ten forged datagrams for each one that trackers send.

A setting succeeds in a chase where the service says that the target is reached and the swarm's centre is within the
success radius.
"""

import multiprocessing
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import torch

from ..batch.freed_memory import keep_freed_memory
from ..controllers import load_controller, require_controller
from ..evaluation.statistics import mean_interval, nearest_rank_percentile, percentile_interval, share_interval
from ..live.service.loop import percentile_ms
from ..live.tracker.agent import AgentSettings
from ..processes.children import end_with_parent
from ..scenario import NUM_TRACKERS, Scenario
from ..simulation.fault_plan import fault_plan
from ..simulation.virtual_chase import VirtualChase, VirtualResult

if TYPE_CHECKING:
    from rich.table import Table

_DATAGRAMS_HZ = NUM_TRACKERS * sum((AgentSettings.window_hz, AgentSettings.position_hz, AgentSettings.heartbeat_hz))
HALF_WAY = "one tracker lost half way"
SETTINGS: dict[str, str] = {
    "no loss": "",
    "5 % loss": "loss=0.05",
    "15 % loss": "loss=0.15",
    "30 % loss": "loss=0.3",
    "15 % loss in bursts": "burst=0.15",
    HALF_WAY: "kill={tracker}@{half_way_s}",
    "10 times flood": f"forge={10 * _DATAGRAMS_HZ:g}",
}
"""What goes wrong, in the words of ``fault_plan``."""

Finished = Callable[[int], None]
"""Is told how many chases have ended."""
Flown = TypeVar("Flown")


@dataclass(frozen=True)
class LiveWork:
    """One chase to be flown in every setting."""

    scenario: Scenario
    controller: str
    seed: int
    chase: int


def measure(
    scenario: Scenario, controller: str, chases: int, seed: int, processes: int, finished: Finished
) -> dict[str, Any]:
    """Chases 0, 1, ... of the seed in every setting."""
    require_controller(controller, scenario)
    work = [LiveWork(scenario, controller, seed, chase) for chase in range(chases)]
    by_setting: dict[str, list[VirtualResult]] = {name: [] for name in SETTINGS}
    for number, results in enumerate(flown(work, _in_every_setting, processes), start=1):
        for name, result in results.items():
            by_setting[name].append(result)
        finished(number)
    return {
        "controller": controller,
        "sampling_hz": scenario.sampling_hz,
        "spatial_correlation": scenario.spatial_correlation,
        "chases": chases,
        "seed": seed,
        "processor": platform.processor() or platform.machine(),
        "settings": {name: summary(scenario, results) for name, results in by_setting.items()},
    }


def table(result: dict[str, Any]) -> "Table":
    """What people see."""
    from rich.table import Table

    shown = Table(
        "Link",
        "Reached",
        "False alarms",
        "Movements, mean",
        "90th percentile",
        "Seconds, mean",
        "Decision p50, p99 (ms)",
        title=f"{result['chases']} live chases each, {result['controller']}, F = {result['sampling_hz']:g} Hz, "
        f"rho = {result['spatial_correlation']:g}",
    )
    for row, one in zip(rows(result), result["settings"].values(), strict=True):
        shown.add_row(*row, f"{one['decision_latency_p50_ms']:.1f}, {one['decision_latency_p99_ms']:.1f}")
    return shown


def rows(result: dict[str, Any]) -> list[list[str]]:
    """What is the same on any machine, as the terminal and docs/live.md show it: a row a setting."""
    return [
        [
            name,
            "{:.0%} [{:.0%}, {:.0%}]".format(one["success_rate"], *one["success_rate_ci95"]),
            f"{one['false_alarms']}",
            "{:.1f} [{:.1f}, {:.1f}]".format(one["movements_mean"], *one["movements_mean_ci95"]),
            "{:.0f} [{:.0f}, {:.0f}]".format(one["movements_p90"], *one["movements_p90_ci95"]),
            f"{one['seconds_mean']:.0f}",
        ]
        for name, one in result["settings"].items()
    ]


def flown(work: list[LiveWork], fly: Callable[[LiveWork], Flown], processes: int) -> Iterator[Flown]:
    """What comes of each work, in their order."""
    if processes == 1:
        yield from map(fly, work)
        return
    with multiprocessing.get_context("spawn").Pool(processes, initializer=_begin_process) as pool:
        yield from pool.imap(fly, work)


def _begin_process() -> None:
    end_with_parent()
    torch.set_num_threads(1)
    keep_freed_memory()


def _in_every_setting(work: LiveWork) -> dict[str, VirtualResult]:
    results: dict[str, VirtualResult] = {}
    for name, faults in SETTINGS.items():
        half_way_s = results["no loss"].seconds / 2 if results else 0.0
        plan = fault_plan(faults.format(tracker=work.chase % NUM_TRACKERS, half_way_s=half_way_s))
        controller = load_controller(work.controller, work.scenario)
        results[name] = VirtualChase(work.scenario, controller, work.seed, work.chase, plan).run()
    return results


def _in_flight(scenario: Scenario, results: list[VirtualResult]) -> dict[str, Any]:
    """When targets that fly were first reached, whenever the service said so; what was not counts as the limit."""
    limit_s = (scenario.max_movements + 1) * scenario.decision_s
    capture_s = np.array([min(result.capture_s or limit_s, limit_s) for result in results])
    said_s = np.array([result.movements * scenario.decision_s if result.reached else limit_s for result in results])
    return {
        "capture_s_mean": float(capture_s.mean()),
        "capture_s_mean_ci95": mean_interval(capture_s),
        "said_s_mean": float(said_s.mean()),
        "said_s_mean_ci95": mean_interval(said_s),
        "least_separation_m": min(result.least_separation_m for result in results),
    }


def summary(scenario: Scenario, results: list[VirtualResult]) -> dict[str, Any]:
    """Of the chases of one setting."""
    reached = np.array([result.reached for result in results])
    lost = scenario.max_movements + 1
    # As in the evaluation: what is not reached counts as more movements than there are, and is never dropped.
    movements = np.array([result.movements if result.reached else lost for result in results])
    latency_s = [latency for result in results for latency in result.decision_latency_s]
    return (_in_flight(scenario, results) if scenario.pace == "listen_in_flight" else {}) | {
        "success_rate": float(reached.mean()),
        "success_rate_ci95": share_interval(int(reached.sum()), len(reached)),
        "movements_mean": float(movements.mean()),
        "movements_mean_ci95": mean_interval(movements),
        "movements_p90": nearest_rank_percentile(movements, 90),
        "movements_p90_ci95": percentile_interval(movements, 90),
        "seconds_mean": float(np.mean([result.seconds for result in results])),
        "false_alarms": sum(result.state == "reached" and not result.reached for result in results),
        "decision_latency_p50_ms": percentile_ms(latency_s, 50),
        "decision_latency_p99_ms": percentile_ms(latency_s, 99),
        "rejected": sum(sum(result.rejected.values()) for result in results),
    }
