"""Live chases with trackers that lie or fail, in the simulated site: does one of six steer the swarm?

The chases are whole, as in ``benchmarks.live``, and the settings share them, so that differences are those of the liar.
Which tracker lies goes round with the chases. Separations are between true places, 40 times a second.
"""

import platform
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from ..controllers import load_controller, require_controller
from ..evaluation.statistics import share_interval
from ..live.service.chase_state import Snapshot
from ..live.service.safety import SafetyLimits
from ..scenario import NUM_TRACKERS, Scenario
from ..simulation.fault_plan import fault_plan
from ..simulation.virtual_chase import VirtualChase, VirtualResult
from .live import Finished, LiveWork, flown, rows, summary

if TYPE_CHECKING:
    from rich.table import Table

NOBODY = "nobody"
SETTINGS: dict[str, str] = {
    NOBODY: "",
    "29.9 m off in place": "offset={0}@0",
    "-200 dBm": "deaf={0}@0",
    "+20 dBm": "loud={0}@0",
    "never moves": "stays={0}@0",
    "origin wrong by 1 km": "origin={0}@0",
    "a fence that drops destinations": "fence={0}@0",
}
"""What is wrong, in the words of ``fault_plan``; {0} is the liar."""


@dataclass(frozen=True)
class LiarsResult:
    """How one chase with liars went."""

    chase: VirtualResult
    liars: tuple[int, ...]
    left_out: dict[int, str]
    """Who was left out at any time, or had all samples dropped, and why first."""
    honest_separation_m: float
    """The least between two that do not lie, at any time;"""
    liar_separation_m: float | None
    """and between one that does and another; None without liars."""


def measure(
    scenario: Scenario, controller: str, chases: int, seed: int, processes: int, finished: Finished
) -> dict[str, Any]:
    """Chases 0, 1, ... of the seed in every setting."""
    require_controller(controller, scenario)
    work = [LiveWork(scenario, controller, seed, chase) for chase in range(chases)]
    by_setting: dict[str, list[LiarsResult]] = {name: [] for name in SETTINGS}
    for number, results in enumerate(flown(work, _in_every_setting, processes), start=1):
        for name, result in results.items():
            by_setting[name].append(result)
        finished(number)
    return report(scenario, controller, seed, by_setting)


def report(scenario: Scenario, controller: str, seed: int, by_setting: dict[str, list[LiarsResult]]) -> dict[str, Any]:
    """What ``measure`` returns of these results."""
    return {
        "controller": controller,
        "sampling_hz": scenario.sampling_hz,
        "spatial_correlation": scenario.spatial_correlation,
        "chases": len(by_setting[NOBODY]),
        "seed": seed,
        "processor": platform.processor() or platform.machine(),
        "minimum_separation_m": SafetyLimits().minimum_separation_m,
        "settings": {name: _summary(scenario, results) for name, results in by_setting.items()},
    }


def table(result: dict[str, Any]) -> "Table":
    """What people see."""
    from rich.table import Table

    shown = Table(
        "Who lies",
        "Reached",
        "False alarms",
        "Movements, mean",
        "90th percentile",
        "Seconds, mean",
        "Liars named",
        "Honest left out",
        "Least separation of honest ones (m)",
        title=f"{result['chases']} live chases each, {result['controller']}, F = {result['sampling_hz']:g} Hz, "
        f"rho = {result['spatial_correlation']:g}",
    )
    for row in liar_rows(result):
        shown.add_row(*row)
    return shown


def liar_rows(result: dict[str, Any]) -> list[list[str]]:
    """As the terminal and docs/live.md show it: a row a setting."""
    return [
        [
            *row,
            "-"
            if one["liars_named"] is None
            else "{:.0%} [{:.0%}, {:.0%}]".format(one["liars_named"], *one["liars_named_ci95"]),
            f"{one['honest_left_out']}",
            f"{one['honest_separation_m']:.2f}",
        ]
        for row, one in zip(rows(result), result["settings"].values(), strict=True)
    ]


def fly(work: LiveWork, faults: str) -> LiarsResult:
    """One chase with these faults, in which {0} is the first liar, {1} another one."""
    plan = fault_plan(faults.format(*_order(work.chase)))
    liars = tuple(sorted({fault.tracker for fault in plan.trackers}))
    left_out: dict[int, str] = {}

    def watch(snapshot: Snapshot) -> None:
        for tracker, one in enumerate(snapshot.trackers):
            reason = one.left_out or ", ".join(one.dropped if one.is_silent else ())
            if reason:
                left_out.setdefault(tracker, reason)

    controller = load_controller(work.controller, work.scenario)
    chase = VirtualChase(work.scenario, controller, work.seed, work.chase, plan, watch=watch)
    honest_m = liar_m = np.inf
    honest = np.array([tracker not in liars for tracker in range(NUM_TRACKERS)])
    one, other = np.array(list(combinations(range(NUM_TRACKERS), 2))).T
    are_honest = honest[one] & honest[other]

    def look() -> None:
        nonlocal honest_m, liar_m
        place_m = np.array(chase.site.positions_m())
        apart_m = np.linalg.norm(place_m[one] - place_m[other], axis=1)
        honest_m = min(honest_m, float(apart_m[are_honest].min()))
        liar_m = min(liar_m, float(apart_m[~are_honest].min(initial=np.inf)))

    result = chase.run(look)
    return LiarsResult(result, liars, left_out, honest_m, liar_m if liars else None)


def _order(chase: int) -> list[int]:
    """The trackers, beginning with another one in each chase, and going on with another one in every six."""
    first, step = chase % NUM_TRACKERS, chase // NUM_TRACKERS % (NUM_TRACKERS - 1)
    others = [tracker for tracker in range(NUM_TRACKERS) if tracker != first]
    return [first, *others[step:], *others[:step]]


def _in_every_setting(work: LiveWork) -> dict[str, LiarsResult]:
    return {name: fly(work, faults) for name, faults in SETTINGS.items()}


def _summary(scenario: Scenario, results: list[LiarsResult]) -> dict[str, Any]:
    liars = [tracker in one.left_out for one in results for tracker in one.liars]
    to_liar_m = [one.liar_separation_m for one in results if one.liar_separation_m is not None]
    return {
        **summary(scenario, [one.chase for one in results]),
        "ended_under_way": sum(one.chase.state not in {"reached", "lost"} for one in results),
        "liars_named": sum(liars) / len(liars) if liars else None,
        "liars_named_ci95": share_interval(sum(liars), len(liars)) if liars else None,
        "honest_left_out": sum(tracker not in one.liars for one in results for tracker in one.left_out),
        "honest_separation_m": round(min(one.honest_separation_m for one in results), 3),
        "liar_separation_m": round(min(to_liar_m), 3) if to_liar_m else None,
    }
