"""The command line: ``swarmchase chase | evaluate | train a3c | benchmark ...``.

Each command is a dataclass whose fields are its options and whose ``run`` does the work; tyro makes the parser and
``--help`` of them. Bad input ends in one line on standard error and exit code 2.
"""

import sys
from collections.abc import Callable, Sequence
from typing import Protocol

import torch
import tyro

from .commands.benchmark import BenchmarkChannelCommand, BenchmarkEnvironmentCommand, BenchmarkTrainingCommand
from .commands.chase import ChaseCommand
from .commands.evaluate import EvaluateCommand
from .commands.terminal import CONSOLE
from .commands.train import TrainA3CCommand
from .errors import InputError

DESCRIPTION = """Chase an unauthorised UAV with a swarm of six trackers that hear only its signal strength.

Begin with: swarmchase chase"""


class Command(Protocol):
    """One parsed command."""

    def run(self) -> None:
        """Do the work."""


COMMANDS: dict[str, Callable[..., Command]] = {
    "chase": ChaseCommand,
    "evaluate": EvaluateCommand,
    "train a3c": TrainA3CCommand,
    "benchmark channel": BenchmarkChannelCommand,
    "benchmark environment": BenchmarkEnvironmentCommand,
    "benchmark training": BenchmarkTrainingCommand,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command and exit: 0 when it went well, 2 on bad input, 130 on Ctrl-C, 1 on any other failure."""
    words = _joined(list(sys.argv[1:] if arguments is None else arguments))
    command = tyro.extras.subcommand_cli_from_dict(COMMANDS, prog="swarmchase", description=DESCRIPTION, args=words)
    # One thread a process is the fastest for batches of this size; commands that use more cores start processes.
    torch.set_num_threads(1)
    try:
        command.run()
    except InputError as error:
        CONSOLE.print(f"swarmchase: {error}", style="bold red", markup=False, soft_wrap=True)
        sys.exit(2)
    except KeyboardInterrupt:
        CONSOLE.print("swarmchase: interrupted")
        sys.exit(130)


def _joined(words: list[str]) -> list[str]:
    """``train a3c`` and its like are two words to a person and one command to the parser."""
    pair = " ".join(words[:2])
    return [pair, *words[2:]] if pair in COMMANDS else words
