"""``swarmchase benchmark NAME``: measure this machine, side by side with the peers."""

import importlib
from dataclasses import dataclass

from .terminal import CONSOLE, print_json


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
