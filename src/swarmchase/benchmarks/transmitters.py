"""Live flights with another transmitter at the target's frequency, 150 m from where that starts, and the same flights
without: how often the service calls the wrong one reached, and how often it takes one for two.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..controllers import load_controller, require_controller
from ..errors import InputError
from ..evaluation.statistics import share_interval
from ..live.service.capture import LEAST_SHARE
from ..live.service.chase_state import Snapshot
from ..scenario import Scenario
from ..simulation.fault_plan import fault_plan
from ..simulation.virtual_chase import VirtualChase, VirtualResult
from .live import Finished, LiveWork, flown, is_reached

if TYPE_CHECKING:
    from rich.table import Table

REFUSED_S = 10.0
"""So long a swarm may be where the target could be and the service not say so, because it hears two: then the flight is
ended."""
SETTINGS: dict[str, str] = {"one transmitter": "", "another one 150 m away": "second=150"}
"""In the words of ``fault_plan``."""


@dataclass(frozen=True)
class TransmittersResult:
    """How one flight went."""

    chase: VirtualResult
    hears_two: bool
    """Whether the service has ever said that what is heard does not fit one transmitter."""
    is_refused: bool
    """Whether it has said so for ``REFUSED_S`` beside one."""


def measure(
    scenario: Scenario, controller: str, chases: int, seed: int, processes: int, finished: Finished
) -> dict[str, Any]:
    """Chases 0, 1, ... of the seed in both settings.

    Raises:
        InputError: the target does not fly.
    """
    require_controller(controller, scenario)
    if scenario.pace == "stop_and_listen":
        raise InputError("transmitters are told apart in flight: say --scenario flight")
    work = [LiveWork(scenario, controller, seed, chase) for chase in range(chases)]
    by_setting: dict[str, list[TransmittersResult]] = {name: [] for name in SETTINGS}
    for number, results in enumerate(flown(work, _in_both_settings, processes), start=1):
        for name, result in results.items():
            by_setting[name].append(result)
        finished(number)
    return report(scenario, controller, seed, by_setting)


def report(
    scenario: Scenario, controller: str, seed: int, by_setting: dict[str, list[TransmittersResult]]
) -> dict[str, Any]:
    """What ``measure`` returns of these results."""
    return {
        "controller": controller,
        "behaviour": scenario.behaviour,
        "sampling_hz": scenario.sampling_hz,
        "spatial_correlation": scenario.spatial_correlation,
        "chases": len(next(iter(by_setting.values()))),
        "seed": seed,
        "settings": {name: _summary(scenario, results) for name, results in by_setting.items()},
    }


def table(result: dict[str, Any]) -> "Table":
    """What people see."""
    from rich.table import Table

    shown = Table(
        "Behaviour",
        "There is",
        "Reached, and said so",
        "Another place called reached",
        "Neither called reached",
        "Told of two",
        title=f"{result['chases']} flights each, {result['controller']}, F = {result['sampling_hz']:g} Hz, "
        f"rho = {result['spatial_correlation']:g}",
    )
    for row in transmitter_rows(result):
        shown.add_row(*row)
    return shown


def transmitter_rows(result: dict[str, Any]) -> list[list[str]]:
    """As the terminal and docs/live.md show it: a row a setting."""
    return [
        [
            result["behaviour"],
            name,
            f"{one['reached']}",
            "{} [{:.0%}, {:.0%}]".format(one["wrongly_reached"], *one["wrongly_reached_ci95"]),
            f"{one['refused']}",
            "{} [{:.0%}, {:.0%}]".format(one["told_of_two"], *one["told_of_two_ci95"]),
        ]
        for name, one in result["settings"].items()
    ]


def fly(work: LiveWork, faults: str) -> TransmittersResult:
    """One flight with these faults."""
    hears_two, is_refused = False, False
    beside_since_ns: int | None = None

    def watch(snapshot: Snapshot) -> None:
        nonlocal hears_two, beside_since_ns
        hears_two |= snapshot.hears_two
        if not snapshot.hears_two:
            beside_since_ns = None
        elif beside_since_ns is None and (snapshot.share_within or 0.0) >= LEAST_SHARE:
            beside_since_ns = snapshot.time_ns

    def end_refused() -> None:
        nonlocal is_refused
        if beside_since_ns is not None and chase.clock.now_ns() - beside_since_ns >= REFUSED_S * 1e9:
            is_refused = True
            chase.service.abort()

    controller = load_controller(work.controller, work.scenario)
    chase = VirtualChase(work.scenario, controller, work.seed, work.chase, fault_plan(faults), watch=watch)
    result = chase.run(end_refused)
    return TransmittersResult(result, hears_two, is_refused)


def _in_both_settings(work: LiveWork) -> dict[str, TransmittersResult]:
    return {name: fly(work, faults) for name, faults in SETTINGS.items()}


def _summary(scenario: Scenario, results: list[TransmittersResult]) -> dict[str, Any]:
    flights = len(results)
    reached = sum(is_reached(scenario, one.chase) for one in results)
    wrongly = sum(one.chase.state == "reached" for one in results) - reached
    told = sum(one.hears_two for one in results)
    return {
        "reached": reached,
        "wrongly_reached": wrongly,
        "wrongly_reached_ci95": share_interval(wrongly, flights),
        "refused": sum(one.is_refused for one in results),
        "told_of_two": told,
        "told_of_two_ci95": share_interval(told, flights),
    }
