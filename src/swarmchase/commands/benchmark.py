"""``swarmchase benchmark NAME``: measure this machine, side by side with the peers."""

import dataclasses
import importlib
import time
from dataclasses import dataclass

from ..errors import InputError
from .options import ScenarioOptions
from .terminal import CONSOLE, print_json, progress_bar


@dataclass(frozen=True, kw_only=True)
class _BenchmarkCommand:
    json: bool = False
    """Print one JSON object on standard output."""

    def report(self, name: str) -> None:
        """Run ``swarmchase.benchmarks.<name>`` and show what it measured."""
        benchmark = importlib.import_module(f"..benchmarks.{name}", __package__)
        result = benchmark.measure()
        if self.json:
            print_json(result)
        else:
            CONSOLE.print(benchmark.table(result))


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
class BenchmarkLiveCommand(ScenarioOptions):
    """Simulated live chases over a link that fails, faster than real time: success, movements, decision time."""

    controller: str = "recurrent"
    """As for swarmchase live."""
    chases: int = 100
    """In each setting."""
    seed: int = 0
    """Of the run they belong to."""
    processes: int = 1
    """One a core."""
    json: bool = False
    """Print one JSON object on standard output."""

    def run(self) -> None:
        """Measure and report."""
        from ..benchmarks import live

        if self.chases < 2 or self.seed < 0 or self.processes < 1:
            raise InputError("chases must be at least 2, seed at least 0, processes at least 1")
        with progress_bar("live chases", self.chases, "chases/s") as show:
            began_s = time.monotonic()

            def finished(chases: int) -> None:
                show(chases, f"{chases / (time.monotonic() - began_s):.2f}", "")

            result = live.measure(self.scenario(), self.controller, self.chases, self.seed, self.processes, finished)
        if self.json:
            print_json(result)
        else:
            CONSOLE.print(live.table(result))


@dataclass(frozen=True, kw_only=True)
class BenchmarkSoakCommand(ScenarioOptions):
    """A live chase in real processes that does not end, with page and log: memory over time, decision time."""

    controller: str = "recurrent"
    """As for swarmchase live."""
    seconds: float = 3600.0
    """How long."""
    faults: str = ""
    """As for swarmchase live."""
    json: bool = False
    """Print one JSON object on standard output."""

    def run(self) -> None:
        """Measure and report."""
        from ..benchmarks import soak

        scenario = dataclasses.replace(self.scenario(), max_movements=1_000_000)
        with progress_bar("soak", int(self.seconds), "") as show:
            result = soak.measure(
                scenario, self.controller, self.seconds, self.faults, lambda passed_s: show(passed_s, "", "")
            )
        if self.json:
            print_json(result)
        else:
            CONSOLE.print(soak.table(result))
