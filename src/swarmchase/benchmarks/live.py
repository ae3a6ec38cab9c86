"""Live chases over a link that fails: how many reach the target, in how many movements, in the simulated site.

Every chase is whole: the real service, agents, link and signatures, on a clock that is made (``VirtualChase``). The
settings share their chases, so that differences are those of the link. A tracker that gets lost does so half way
through the same chase without faults. A flood is ten forged datagrams for each one that trackers send.

A setting succeeds in a chase where the service says that the target is reached and the swarm's centre is within the
success radius. Where the target flies, that is so if it was there in the second that is judged, give or take
``MARGIN_M`` for receivers of positions; anything else that is called reached is a false alarm. The same chases are
evaluated, too, and said to be reached is compared with reached there.
"""

import math
import multiprocessing
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import torch

from ..batch.freed_memory import keep_freed_memory
from ..controllers import load_controller, require_controller
from ..evaluation.play import play
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
IN_FLIGHT = ("no loss", "15 % loss in bursts")
"""The settings in which targets that fly are chased."""
MARGIN_M = 1.0

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
    flies = scenario.pace == "listen_in_flight"
    by_setting: dict[str, list[VirtualResult]] = {name: [] for name in (IN_FLIGHT if flies else SETTINGS)}
    evaluated_s = []
    for number, (results, capture_s) in enumerate(flown(work, _in_every_setting, processes), start=1):
        for name, result in results.items():
            by_setting[name].append(result)
        evaluated_s.append(capture_s)
        finished(number)
    told = {"behaviour": scenario.behaviour, "evaluation": _evaluation(scenario, evaluated_s)} if flies else {}
    return told | {
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

    if "evaluation" in result:
        return _table_in_flight(result)
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


def _table_in_flight(result: dict[str, Any]) -> "Table":
    from rich.table import Table

    shown = Table(
        "Link",
        "Captured and said",
        "False alarms",
        "Reached (s)",
        "Said (s)",
        "Said / evaluation",
        "Least separation (m)",
        "Decision p50, p99 (ms)",
        title=f"{result['chases']} flights each, {result['controller']}, {result['behaviour']}; evaluation "
        f"{result['evaluation']['capture_s_mean']:.1f} s",
    )
    for row, one in zip(rows_in_flight(result), result["settings"].values(), strict=True):
        shown.add_row(*row, f"{one['decision_latency_p50_ms']:.1f}, {one['decision_latency_p99_ms']:.1f}")
    return shown


def rows_in_flight(result: dict[str, Any]) -> list[list[str]]:
    """What is the same on any machine, of targets that fly: a row a setting."""
    return [
        [
            name,
            "{:.0%} [{:.0%}, {:.0%}]".format(one["success_rate"], *one["success_rate_ci95"]),
            f"{one['false_alarms']}",
            "{:.1f} [{:.1f}, {:.1f}]".format(one["capture_s_mean"], *one["capture_s_mean_ci95"]),
            "{:.1f} [{:.1f}, {:.1f}]".format(one["said_s_mean"], *one["said_s_mean_ci95"]),
            f"{one['said_s_mean'] / result['evaluation']['capture_s_mean']:.2f}",
            f"{one['least_separation_m']:.2f}",
        ]
        for name, one in result["settings"].items()
    ]


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


def _in_every_setting(work: LiveWork) -> tuple[dict[str, VirtualResult], float]:
    """The chase in each of them, and when it is reached in the evaluation, of a target that flies."""
    flies = work.scenario.pace == "listen_in_flight"
    results: dict[str, VirtualResult] = {}
    for name in IN_FLIGHT if flies else SETTINGS:
        faults = SETTINGS[name]
        half_way_s = results["no loss"].seconds / 2 if results else 0.0
        plan = fault_plan(faults.format(tracker=work.chase % NUM_TRACKERS, half_way_s=half_way_s))
        controller = load_controller(work.controller, work.scenario)
        results[name] = VirtualChase(work.scenario, controller, work.seed, work.chase, plan).run()
    return results, _evaluated_s(work) if flies else math.inf


def _evaluated_s(work: LiveWork) -> float:
    """When the same chase is reached in the evaluation; infinite where it is not."""
    controller, chase = load_controller(work.controller, work.scenario), range(work.chase, work.chase + 1)
    *_, last = play(work.scenario, controller, work.seed, chase, batch_size=1)
    return float(last.after.reached_s[0])


def _evaluation(scenario: Scenario, capture_s: list[float]) -> dict[str, Any]:
    limited_s = np.minimum(capture_s, _limit_s(scenario))
    return {
        "success_rate": float(np.isfinite(capture_s).mean()),
        "capture_s_mean": float(limited_s.mean()),
        "capture_s_mean_ci95": mean_interval(limited_s),
    }


def _limit_s(scenario: Scenario) -> float:
    return (scenario.max_movements + 1) * scenario.decision_s


def is_reached(scenario: Scenario, result: VirtualResult) -> bool:
    """Whether the service says so and is right."""
    if scenario.pace == "stop_and_listen":
        return result.reached
    return result.state == "reached" and result.said_distance_m <= scenario.success_radius_m + MARGIN_M


def _in_flight(scenario: Scenario, results: list[VirtualResult]) -> dict[str, Any]:
    """When targets that fly were first reached, and when the service said so; what was not counts as the limit."""
    limit_s = _limit_s(scenario)
    capture_s = np.array([min(result.capture_s or limit_s, limit_s) for result in results])
    said_s = [result.flown_s or limit_s if is_reached(scenario, result) else limit_s for result in results]
    return {
        "capture_s_mean": float(capture_s.mean()),
        "capture_s_mean_ci95": mean_interval(capture_s),
        "said_s_mean": float(np.minimum(said_s, limit_s).mean()),
        "said_s_mean_ci95": mean_interval(np.minimum(said_s, limit_s)),
        "said_distance_m": [round(result.said_distance_m, 2) for result in results if result.state == "reached"],
        "least_separation_m": min(result.least_separation_m for result in results),
    }


def summary(scenario: Scenario, results: list[VirtualResult]) -> dict[str, Any]:
    """Of the chases of one setting."""
    reached = np.array([is_reached(scenario, result) for result in results])
    lost = scenario.max_movements + 1
    # As in the evaluation: what is not reached counts as more movements than there are, and is never dropped.
    movements = np.where(reached, [result.movements for result in results], lost)
    latency_s = [latency for result in results for latency in result.decision_latency_s]
    return (_in_flight(scenario, results) if scenario.pace == "listen_in_flight" else {}) | {
        "success_rate": float(reached.mean()),
        "success_rate_ci95": share_interval(int(reached.sum()), len(reached)),
        "movements_mean": float(movements.mean()),
        "movements_mean_ci95": mean_interval(movements),
        "movements_p90": nearest_rank_percentile(movements, 90),
        "movements_p90_ci95": percentile_interval(movements, 90),
        "seconds_mean": float(np.mean([result.seconds for result in results])),
        "false_alarms": sum(result.state == "reached" for result in results) - int(reached.sum()),
        "decision_latency_p50_ms": percentile_ms(latency_s, 50),
        "decision_latency_p99_ms": percentile_ms(latency_s, 99),
        "rejected": sum(sum(result.rejected.values()) for result in results),
    }
