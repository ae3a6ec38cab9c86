"""The command line: ``swarmchase`` and the name of a command.

Each command is a dataclass whose fields are its options and whose ``run`` does the work; tyro makes the parser and
``--help`` of them. What is slow to import is imported by ``run``. Bad input ends in one line on standard error and exit
code 2.
"""

import contextlib
import io
import re
import select
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TextIO, runtime_checkable

import tyro

from .commands.benchmark import (
    BenchmarkBatchedCommand,
    BenchmarkChannelCommand,
    BenchmarkClusterCommand,
    BenchmarkEnvironmentCommand,
    BenchmarkKillsCommand,
    BenchmarkLiarsCommand,
    BenchmarkLiveCommand,
    BenchmarkNearnessCommand,
    BenchmarkRecordingsCommand,
    BenchmarkSeparationCommand,
    BenchmarkSoakCommand,
    BenchmarkTrainingCommand,
)
from .commands.chase import ChaseCommand
from .commands.compare import CompareCommand
from .commands.evaluate import EvaluateCommand
from .commands.keys import KeysCommand, KeysRenewCommand, KeysResetCommand, KeysRevokeCommand
from .commands.live import LiveCommand
from .commands.replay import ReplayCommand
from .commands.reproduce import ReproduceCommand
from .commands.serve import ServeCommand
from .commands.terminal import CONSOLE, discard
from .commands.tracker import TrackerCommand
from .commands.train import TrainA3CCommand, TrainBatchedCommand
from .errors import InputError, WorkerDiedError
from .processes.stop_request import Interrupted, stopped_at_once

DESCRIPTION = """Chase an unauthorised UAV with a swarm of six trackers that hear only its signal strength.

Begin with: swarmchase chase"""


@runtime_checkable
class Command(Protocol):
    """One parsed command."""

    def run(self) -> None:
        """Do the work."""


COMMANDS: dict[str, Callable[..., Command]] = {
    "chase": ChaseCommand,
    "evaluate": EvaluateCommand,
    "compare": CompareCommand,
    "reproduce": ReproduceCommand,
    "train a3c": TrainA3CCommand,
    "train batched": TrainBatchedCommand,
    "benchmark channel": BenchmarkChannelCommand,
    "benchmark environment": BenchmarkEnvironmentCommand,
    "benchmark training": BenchmarkTrainingCommand,
    "benchmark batched": BenchmarkBatchedCommand,
    "benchmark cluster": BenchmarkClusterCommand,
    "benchmark live": BenchmarkLiveCommand,
    "benchmark liars": BenchmarkLiarsCommand,
    "benchmark separation": BenchmarkSeparationCommand,
    "benchmark nearness": BenchmarkNearnessCommand,
    "benchmark recordings": BenchmarkRecordingsCommand,
    "benchmark soak": BenchmarkSoakCommand,
    "benchmark kills": BenchmarkKillsCommand,
    "keys": KeysCommand,
    "keys make": KeysCommand,
    "keys renew": KeysRenewCommand,
    "keys revoke": KeysRevokeCommand,
    "keys reset": KeysResetCommand,
    "live": LiveCommand,
    "serve": ServeCommand,
    "replay": ReplayCommand,
    "tracker": TrackerCommand,
}

WITHOUT_TORCH = (KeysCommand, KeysRenewCommand, KeysRevokeCommand, KeysResetCommand, TrackerCommand)
"""A tracker's computer is small."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command and exit: 0 when it went well, 2 on bad input, 141 when nobody reads what it prints any more
    (``| head``), 1 on any other failure. Stopped by a signal, 0 where it has a result before its end (a live chase, a
    training), else 128 and the signal's number, as after a second Ctrl-C: 130 for SIGINT, 143 for SIGTERM, 129 for
    SIGHUP.
    """
    try:
        command = _parsed(list(sys.argv[1:] if arguments is None else arguments))
        with stopped_at_once():
            if not isinstance(command, WITHOUT_TORCH):
                _use_one_thread()
            command.run()
    except BrokenPipeError:
        if not _has_lost_its_reader(sys.stdout):
            raise
        discard(sys.stdout)
        sys.exit(128 + signal.SIGPIPE)
    except InputError as error:
        line = " ".join(str(error).splitlines())
        CONSOLE.print(f"swarmchase: {line}", style="bold red", markup=False, soft_wrap=True)
        sys.exit(2)
    except WorkerDiedError as error:
        CONSOLE.print(f"swarmchase: {error}", style="bold red", markup=False, soft_wrap=True)
        sys.exit(1)
    except KeyboardInterrupt as error:
        number, done = (error.number, error.done) if isinstance(error, Interrupted) else (signal.SIGINT, "")
        CONSOLE.print(f"swarmchase: interrupted {done}".rstrip(), markup=False, soft_wrap=True)
        sys.exit(128 + number)


def _parsed(words: list[str]) -> Command:
    """The command these words ask for.

    Raises:
        InputError: an unknown command or option, a value that cannot be read, or an option that is missing.
        SystemExit: ``--help``, which has been printed.
    """
    # ``train a3c`` and its like are two words to a person and one command to the parser.
    pair = " ".join(words[:2])
    words = [pair, *words[2:]] if pair in COMMANDS else words
    if words and not words[0].startswith("-") and words[0] not in COMMANDS:
        raise InputError(f"no command {words[0]!r}; there are {', '.join(COMMANDS)}; see: swarmchase --help")
    refusal = io.StringIO()
    try:
        with contextlib.redirect_stderr(refusal):
            parsed: Any = tyro.extras.subcommand_cli_from_dict(
                COMMANDS, prog="swarmchase", description=DESCRIPTION, args=words
            )
    except SystemExit as error:
        if not error.code:
            print(end="", flush=True)  # now, since nobody catches what fails at the very end
            raise
        command = f"{words[0]} " if words and words[0] in COMMANDS else ""
        raise InputError(f"{_one_line(refusal.getvalue())}; see: swarmchase {command}--help") from None
    command_object: Command = parsed
    return command_object


def _one_line(refusal: str) -> str:
    """What tyro refuses and why: it prints a title, this, and where to find help, in a box and between ruled lines."""
    plain = re.sub(r"\x1b\[[0-9;]*m", "", refusal)
    sections = re.split(r"^[│ ]*(?:[╭╰].*|[-─]{3,})[│ ]*$", plain, flags=re.MULTILINE)
    statement = sections[1 if len(sections) > 1 else 0].replace("│", " ").split("Got errors:")[0]
    return " ".join(statement.split()).rstrip(".:;")


def _has_lost_its_reader(stream: TextIO) -> bool:
    """Whether it is a pipe or socket whose other end is closed: any other broken pipe is a failure."""
    poll = select.poll()
    poll.register(stream, 0)
    return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))


def _use_one_thread() -> None:
    """The fastest for batches of this size; commands that use more cores start processes."""
    import torch

    torch.set_num_threads(1)
