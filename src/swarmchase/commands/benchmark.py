"""``swarmchase benchmark channel | environment | training``: measure this machine, side by side with the peers."""

from dataclasses import dataclass

from .terminal import CONSOLE, print_json


@dataclass(frozen=True, kw_only=True)
class BenchmarkChannelCommand:
    """Channel windows a second on one core, beside pyphysim and CommPy (extra: benchmark) in the same run."""

    json: bool = False
    """Print one JSON object on standard output."""

    def run(self) -> None:
        """Measure and report."""
        from ..benchmarks import channel

        result = channel.measure()
        if self.json:
            print_json(result)
        else:
            CONSOLE.print(channel.table(result))


@dataclass(frozen=True, kw_only=True)
class BenchmarkEnvironmentCommand:
    """Movements a second on one core, by batch size and through Gymnasium."""

    json: bool = False
    """Print one JSON object on standard output."""

    def run(self) -> None:
        """Measure and report."""
        from ..benchmarks import environment

        result = environment.measure()
        if self.json:
            print_json(result)
        else:
            CONSOLE.print(environment.table(result))


@dataclass(frozen=True, kw_only=True)
class BenchmarkTrainingCommand:
    """Environment steps a second of the A3C trainer, by number of local agents."""

    json: bool = False
    """Print one JSON object on standard output."""

    def run(self) -> None:
        """Measure and report."""
        from ..benchmarks import training

        result = training.measure()
        if self.json:
            print_json(result)
        else:
            CONSOLE.print(training.table(result))
