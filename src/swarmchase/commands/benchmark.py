"""``swarmchase benchmark NAME``: measure this machine, side by side with the peers."""

import importlib
import itertools
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from ..errors import InputError
from ..scenario import Scenario
from .options import DEFAULT_CONTROLLER, ScenarioOptions
from .progress import progress_bar
from .tables import print_table
from .terminal import print_json

STOPPING_CONTROLLER = "recurrent"
"""Live chases in the paper's pace were measured with it, and are compared with what is published of them."""


@dataclass(frozen=True, kw_only=True)
class _BenchmarkCommand:
    json: bool = False
    """Print one JSON object on standard output."""

    def report(self, name: str, **options: Any) -> dict[str, Any]:
        """Run ``swarmchase.benchmarks.<name>``, show what it measured and return it."""
        benchmark = importlib.import_module(f"..benchmarks.{name}", __package__)
        result: dict[str, Any] = benchmark.measure(**options)
        if self.json:
            print_json(result)
        else:
            print_table(benchmark.table(result))
        return result


@dataclass(frozen=True, kw_only=True)
class BenchmarkChannelCommand(_BenchmarkCommand):
    """Channel windows a second on one core, beside pyphysim and CommPy (extra: benchmark) in the same run."""

    def run(self) -> None:
        """Measure and report."""
        self.report("channel")


@dataclass(frozen=True, kw_only=True)
class BenchmarkEnvironmentCommand(_BenchmarkCommand):
    """Movements a second on one core, by batch size and through Gymnasium."""

    def run(self) -> None:
        """Measure and report."""
        self.report("environment")


@dataclass(frozen=True, kw_only=True)
class BenchmarkFlightCommand(_BenchmarkCommand):
    """Seconds of chases in flight on one core, beside the same world in numpy, and flights of particle, in one run."""

    def run(self) -> None:
        """Measure and report."""
        self.report("flight")


@dataclass(frozen=True, kw_only=True)
class BenchmarkBatchedCommand(_BenchmarkCommand):
    """Environment steps a second of the batched trainer, beside our A3C and Stable-Baselines3's A2C in the same run."""

    def run(self) -> None:
        """Measure and report."""
        self.report("batched")


@dataclass(frozen=True, kw_only=True)
class BenchmarkTrainingCommand(_BenchmarkCommand):
    """Environment steps a second of the A3C trainer with one and two workers, a core each."""

    def run(self) -> None:
        """Measure and report."""
        self.report("training")


@dataclass(frozen=True, kw_only=True)
class _LiveOptions(ScenarioOptions):
    controller: Annotated[
        str | None,
        arg(
            help=f"As for swarmchase live; default is {DEFAULT_CONTROLLER} where trackers listen in flight, "
            f"{STOPPING_CONTROLLER} where they stop to listen."
        ),
    ] = None

    def controller_in(self, scenario: Scenario) -> str:
        """The one asked for, or the default in the pace of this scenario."""
        default = STOPPING_CONTROLLER if scenario.pace == "stop_and_listen" else DEFAULT_CONTROLLER
        return default if self.controller is None else self.controller


@dataclass(frozen=True, kw_only=True)
class _LiveChasesCommand(_LiveOptions):
    episodes: Annotated[int, arg(aliases=["--chases"])] = 100
    """Chases in each setting; --chases is what it was called."""
    seed: int = 0
    """Of the run they belong to."""
    processes: int = 1
    """One a core."""
    json: bool = False
    """Print one JSON object on standard output."""

    def report_chases(self, name: str) -> None:
        """Run ``swarmchase.benchmarks.<name>`` and show what it measured.

        Raises:
            InputError: too few chases, or numbers that cannot be.
        """
        if self.episodes < 2 or self.seed < 0 or self.processes < 1:
            raise InputError("episodes must be at least 2, seed at least 0, processes at least 1")
        with progress_bar("live chases", self.episodes, "chases/s") as show:
            began_s = time.monotonic()

            def finished(chases: int) -> None:
                show(chases, f"{chases / (time.monotonic() - began_s):.2f}", "")

            benchmark = importlib.import_module(f"..benchmarks.{name}", __package__)
            scenario = self.world()
            controller = self.controller_in(scenario)
            result = benchmark.measure(scenario, controller, self.episodes, self.seed, self.processes, finished)
        if self.json:
            print_json(result)
        else:
            print_table(benchmark.table(result))


@dataclass(frozen=True, kw_only=True)
class BenchmarkLiveCommand(_LiveChasesCommand):
    """Simulated live chases over a link that fails, faster than real time: success, movements, decision time."""

    def run(self) -> None:
        """Measure and report."""
        self.report_chases("live")


@dataclass(frozen=True, kw_only=True)
class BenchmarkLiarsCommand(_LiveChasesCommand):
    """Simulated live chases with trackers that lie or fail, faster than real time: success, movements, who is named,
    separation."""

    def run(self) -> None:
        """Measure and report."""
        self.report_chases("liars")


@dataclass(frozen=True, kw_only=True)
class BenchmarkTransmittersCommand(_LiveChasesCommand):
    """Simulated live flights with another transmitter 80, 150 or 300 m from the target, and without: which one is
    called reached."""

    def run(self) -> None:
        """Measure and report."""
        self.report_chases("transmitters")


@dataclass(frozen=True, kw_only=True)
class BenchmarkSeparationCommand:
    """How near vehicles truly come in situations drawn for it: pilots, dead agents, cut links, wind, wrong places."""

    situations: int = 10_000
    """How many."""
    seed: int = 0
    """Of the first; the others follow."""
    processes: int = 1
    """One a core."""
    checkpoint: Path = Path("separation.jsonl")
    """A line a situation; what is in it is not flown again."""
    json: bool = False
    """Print one JSON object on standard output."""

    def run(self) -> None:
        """Measure and report.

        Raises:
            InputError: a number that cannot be, or a checkpoint that cannot be written.
        """
        from ..benchmarks import separation

        if self.situations < 1 or self.seed < 0 or self.processes < 1:
            raise InputError("situations must be at least 1, seed at least 0, processes at least 1")
        with progress_bar("situations", self.situations, "") as show:
            result = separation.measure(
                self.situations, self.seed, self.processes, self.checkpoint, lambda flown: show(flown, "", "")
            )
        if self.json:
            print_json(result)
        else:
            print_table(separation.table(result))


@dataclass(frozen=True, kw_only=True)
class BenchmarkSoakCommand(_LiveOptions):
    """A live chase in real processes that does not end, with page and log: memory over time, decision time; of a target
    that flies also how well it is followed."""

    seconds: float = 3600.0
    """How long."""
    faults: str = ""
    """As for swarmchase live."""
    json: bool = False
    """Print one JSON object on standard output."""

    def run(self) -> None:
        """Measure and report.

        Raises:
            InputError: too short, or nothing that a live chase plays.
        """
        from ..benchmarks import soak
        from ..controllers import load_controller
        from ..live.service.service import require_judged
        from ..live.service.settings import ServiceSettings
        from ..simulation.fault_plan import fault_plan
        from ..simulation.site import require_played, require_site

        scenario = self.world()
        require_site(scenario)
        require_played(scenario, fault_plan(self.faults))
        flies = scenario.pace == "listen_in_flight"
        controller = self.controller_in(scenario)
        require_judged(scenario, load_controller(controller, scenario), ServiceSettings(follow=flies))
        soak.require_seconds(self.seconds)
        with progress_bar("soak", int(self.seconds), "") as show:
            result = soak.measure(
                scenario, controller, self.seconds, self.faults, lambda passed_s: show(passed_s, "", "")
            )
        if self.json:
            print_json(result)
        else:
            print_table(soak.table(result))


@dataclass(frozen=True, kw_only=True)
class BenchmarkNearnessCommand(_BenchmarkCommand):
    """Over a real radio map: at how many places, near an emitter and far from it, a live chase ends as "reached"."""

    map: Path
    """A folder with sensors.csv and radio_map.csv."""

    def run(self) -> None:
        """Measure and report."""
        self.report("nearness", folder=self.map)


@dataclass(frozen=True, kw_only=True)
class BenchmarkRecordingsCommand(_BenchmarkCommand):
    """A controller on what real receivers heard: which way it goes, whether its belief is true, chases over a map."""

    controller: str = "adaptive"
    """As for swarmchase evaluate."""
    map: Path | None = None
    """A folder with sensors.csv and radio_map.csv: chases, and ways that do not depend on the controller."""
    paths: Path | None = None
    """A folder with tables of one receiver's levels and places, and the emitter's places."""
    draws: int = 3
    """Draws of windows of the map; paths are repeated with as many random numbers."""
    first_draw: int = 0
    """The others follow."""
    guessed: bool = False
    """Controllers are told what somebody guesses, not what fits the recordings best."""

    def run(self) -> None:
        """Measure and report.

        Raises:
            InputError: nothing to measure, or numbers that cannot be.
        """
        if self.draws < 1 or self.first_draw < 0:
            raise InputError("draws must be at least 1, first-draw at least 0")
        finished = itertools.count(1)
        with progress_bar("draws of the map", self.draws, "") as show:
            self.report(
                "recordings",
                controller=self.controller,
                radio_map=self.map,
                paths=self.paths,
                draws=list(range(self.first_draw, self.first_draw + self.draws)),
                guessed=self.guessed,
                finished=lambda: show(next(finished), "", ""),
            )


class BenchmarkKillsCommand(_BenchmarkCommand):
    """Live chases, trainings and evaluations killed at random moments: what hangs, stays or cannot be read."""

    kills: int = 100
    """One after another, about 20 s each."""
    seed: int = 0
    """Of what is killed, how and when."""

    def run(self) -> None:
        """Measure and report."""
        with progress_bar("kills", self.kills, "") as show:
            self.report("kills", kills=self.kills, seed=self.seed, finished=lambda number: show(number, "", ""))


@dataclass(frozen=True, kw_only=True)
class BenchmarkClusterCommand(_BenchmarkCommand):
    """Updates a second of A3C on a Ray cluster by number of agents, and what a model of the cost says for more."""

    seconds: float = 10.0
    """Of each of nine measurements."""
    figure: Path | None = None
    """Draw it as PNG or PDF."""
    overwrite: bool = False
    """Replace the figure if it is there already."""

    def run(self) -> None:
        """Measure, report and draw.

        Raises:
            InputError: no time to measure, or a figure that cannot be written.
        """
        from ..files import require_writable_file
        from ..reports.cluster import draw_scaling

        if not 0 < self.seconds < math.inf:
            raise InputError(f"seconds = {self.seconds} is refused: allowed is greater than 0")
        if self.figure is not None:
            if self.figure.suffix not in (".png", ".pdf"):
                raise InputError(f"figure {self.figure} is refused: allowed is .png or .pdf")
            require_writable_file(self.figure, replaces=self.overwrite)
        result = self.report("cluster", seconds=self.seconds)
        if self.figure is not None:
            draw_scaling(result, self.figure)
