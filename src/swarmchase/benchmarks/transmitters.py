"""Live flights with another transmitter at the target's frequency, so far from where that starts, and the same flights
without: how often the service calls the wrong one reached, and how often it takes one for two.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..controllers import load_controller, require_controller
from ..errors import InputError
from ..evaluation.statistics import share_interval
from ..live.service.capture import LEAST_SHARE
from ..live.service.chase_state import NOT_ONE_TRANSMITTER, Snapshot
from ..scenario import Scenario
from ..simulation.fault_plan import fault_plan
from ..simulation.virtual_chase import VirtualChase, VirtualResult
from .live import Finished, LiveWork, flown, is_reached

if TYPE_CHECKING:
    from rich.table import Table

REFUSED_S = 10.0
"""So long a swarm may be where the target could be and the service not say so, because it hears two: then the flight is
ended. While it looks a second time it is not there."""
LEFT_S = 3.0
"""Who has not been there for so long has left: a swarm turns round more quickly where it has passed a target."""
APART_M = (80, 150, 300)
SETTINGS: dict[str, str] = {
    "one transmitter": "",
    **{f"another one {apart_m} m away": f"second={apart_m}" for apart_m in APART_M},
}
"""In the words of ``fault_plan``."""


@dataclass(frozen=True)
class TransmittersResult:
    """How one flight went."""

    chase: VirtualResult
    hears_two: bool
    """Whether the service has ever said that what is heard does not fit one transmitter."""
    is_long: bool
    """Whether it has said so for ``REFUSED_S`` beside one."""

    @property
    def is_refused(self) -> bool:
        """Whether the service has called neither reached for it, then or when the movements were spent."""
        return self.is_long or NOT_ONE_TRANSMITTER in self.chase.reason


def measure(
    scenario: Scenario, controller: str, chases: int, seed: int, processes: int, finished: Finished
) -> dict[str, Any]:
    """Chases 0, 1, ... of the seed in every setting.

    Raises:
        InputError: the target does not fly.
    """
    require_controller(controller, scenario)
    if scenario.pace == "stop_and_listen":
        raise InputError("transmitters are told apart in flight: say --scenario flight")
    work = [LiveWork(scenario, controller, seed, chase) for chase in range(chases)]
    by_setting: dict[str, list[TransmittersResult]] = {name: [] for name in SETTINGS}
    for number, results in enumerate(flown(work, _in_every_setting, processes), start=1):
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
    refusal = Refusal()

    def end_refused() -> None:
        if refusal.is_long:
            chase.service.abort()

    controller = load_controller(work.controller, work.scenario)
    chase = VirtualChase(work.scenario, controller, work.seed, work.chase, fault_plan(faults), watch=refusal.take)
    result = chase.run(end_refused)
    return TransmittersResult(result, refusal.hears_two, refusal.is_long)


class Refusal:
    """Told every snapshot of a flight, it says whether the service has refused to say that the target is reached."""

    def __init__(self) -> None:
        self.hears_two = False
        """Whether it has ever told of two."""
        self.is_long = False
        """Whether, for ``REFUSED_S``, it has told of two while the swarm was where the target could be."""
        self._beside_since_ns: int | None = None
        self._beside_ns = -math.inf
        """When the swarm was there last."""

    def take(self, snapshot: Snapshot) -> None:
        """The service as it is now."""
        self.hears_two |= snapshot.hears_two
        if (snapshot.share_within or 0.0) >= LEAST_SHARE:
            self._beside_ns = snapshot.time_ns
        if not snapshot.hears_two or snapshot.time_ns - self._beside_ns >= LEFT_S * 1e9:
            self._beside_since_ns = None
        elif self._beside_since_ns is None:
            self._beside_since_ns = snapshot.time_ns
        elif snapshot.time_ns - self._beside_since_ns >= REFUSED_S * 1e9:
            self.is_long = True


def _in_every_setting(work: LiveWork) -> dict[str, TransmittersResult]:
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
