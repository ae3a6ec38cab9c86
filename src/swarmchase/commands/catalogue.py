"""The commands by name, in the order in which help shows them."""

import importlib
from collections.abc import Callable, Mapping

from .running import Command

SECTIONS: Mapping[str, Mapping[str, str]] = {
    "Simulate": {
        "chase": "chase.ChaseCommand",
        "evaluate": "evaluate.EvaluateCommand",
        "compare": "compare.CompareCommand",
        "reproduce": "reproduce.ReproduceCommand",
    },
    "Learn": {
        "train a3c": "train.TrainA3CCommand",
        "train batched": "train.TrainBatchedCommand",
        "train windows": "train.TrainWindowsCommand",
        "train pursuit": "train.TrainPursuitCommand",
    },
    "Fly": {
        "live": "live.LiveCommand",
        "serve": "serve.ServeCommand",
        "tracker": "tracker.TrackerCommand",
        "replay": "replay.ReplayCommand",
        "keys": "keys.KeysCommand",
        "keys make": "keys.KeysCommand",
        "keys renew": "keys.KeysRenewCommand",
        "keys revoke": "keys.KeysRevokeCommand",
        "keys reset": "keys.KeysResetCommand",
    },
    "Take along": {
        "export": "export.ExportCommand",
    },
    "Measure": {
        "benchmark channel": "benchmark.BenchmarkChannelCommand",
        "benchmark environment": "benchmark.BenchmarkEnvironmentCommand",
        "benchmark flight": "benchmark.BenchmarkFlightCommand",
        "benchmark training": "benchmark.BenchmarkTrainingCommand",
        "benchmark batched": "benchmark.BenchmarkBatchedCommand",
        "benchmark cluster": "benchmark.BenchmarkClusterCommand",
        "benchmark live": "benchmark.BenchmarkLiveCommand",
        "benchmark liars": "benchmark.BenchmarkLiarsCommand",
        "benchmark transmitters": "benchmark.BenchmarkTransmittersCommand",
        "benchmark separation": "benchmark.BenchmarkSeparationCommand",
        "benchmark nearness": "benchmark.BenchmarkNearnessCommand",
        "benchmark recordings": "benchmark.BenchmarkRecordingsCommand",
        "benchmark soak": "benchmark.BenchmarkSoakCommand",
        "benchmark kills": "benchmark.BenchmarkKillsCommand",
    },
    "Set up": {
        "completion": "completion.CompletionCommand",
    },
}
"""What answers to a name, by what it is for: a module beside this one, and the class in it."""

COMMANDS: Mapping[str, str] = {name: home for section in SECTIONS.values() for name, home in section.items()}

EXAMPLES = (
    "swarmchase chase",
    "swarmchase evaluate --scenario flight --behaviour waypoints --episodes 100",
    "swarmchase live --scenario flight --behaviour waypoints",
)


def kind(name: str) -> Callable[..., Command]:
    """The class of a command; its module is imported now."""
    module, name_there = COMMANDS[name].split(".")
    found: Callable[..., Command] = getattr(importlib.import_module(f".{module}", __package__), name_there)
    return found


def members(group: str) -> list[str]:
    """The commands of two words of which this is the first."""
    return [name for name in COMMANDS if name.startswith(f"{group} ")]
