"""The command line: ``swarmchase`` and the name of a command.

Each command is a dataclass whose fields are its options and whose ``run`` does the work; tyro makes the parser and
``--help`` of them. A command's module is imported when it is asked for, and what is slow to import by ``run``. Bad
input ends in one line on standard error and exit code 2.
"""

import contextlib
import importlib
import io
import re
import select
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Protocol, TextIO, runtime_checkable

import tyro

from .commands.terminal import CONSOLE, discard
from .errors import InputError, WorkerDiedError
from .processes.stop_request import Interrupted, stopped_at_once

DESCRIPTION = """Chase an unauthorised UAV with a swarm of six trackers that hear only its signal strength.

Begin with: swarmchase chase"""


@runtime_checkable
class Command(Protocol):
    """One parsed command."""

    def run(self) -> None:
        """Do the work."""


COMMANDS = {
    "chase": "chase.ChaseCommand",
    "evaluate": "evaluate.EvaluateCommand",
    "compare": "compare.CompareCommand",
    "reproduce": "reproduce.ReproduceCommand",
    "train a3c": "train.TrainA3CCommand",
    "train batched": "train.TrainBatchedCommand",
    "train windows": "train.TrainWindowsCommand",
    "benchmark channel": "benchmark.BenchmarkChannelCommand",
    "benchmark environment": "benchmark.BenchmarkEnvironmentCommand",
    "benchmark flight": "benchmark.BenchmarkFlightCommand",
    "benchmark training": "benchmark.BenchmarkTrainingCommand",
    "benchmark batched": "benchmark.BenchmarkBatchedCommand",
    "benchmark cluster": "benchmark.BenchmarkClusterCommand",
    "benchmark live": "benchmark.BenchmarkLiveCommand",
    "benchmark liars": "benchmark.BenchmarkLiarsCommand",
    "benchmark separation": "benchmark.BenchmarkSeparationCommand",
    "benchmark nearness": "benchmark.BenchmarkNearnessCommand",
    "benchmark recordings": "benchmark.BenchmarkRecordingsCommand",
    "benchmark soak": "benchmark.BenchmarkSoakCommand",
    "benchmark kills": "benchmark.BenchmarkKillsCommand",
    "keys": "keys.KeysCommand",
    "keys make": "keys.KeysCommand",
    "keys renew": "keys.KeysRenewCommand",
    "keys revoke": "keys.KeysRevokeCommand",
    "keys reset": "keys.KeysResetCommand",
    "live": "live.LiveCommand",
    "serve": "serve.ServeCommand",
    "replay": "replay.ReplayCommand",
    "tracker": "tracker.TrackerCommand",
}
"""What answers to a name: a module of ``commands``, and the class in it."""

WITHOUT_TORCH = {"keys", "keys make", "keys renew", "keys revoke", "keys reset", "tracker"}
"""A tracker's computer is small."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command and exit: 0 when it went well, 2 on bad input, 141 when nobody reads what it prints any more
    (``| head``), 1 on any other failure. Stopped by a signal, 0 where it has a result before its end (a live chase, a
    training), else 128 and the signal's number, as after a second Ctrl-C: 130 for SIGINT, 143 for SIGTERM, 129 for
    SIGHUP.
    """
    try:
        name, command = _parsed(list(sys.argv[1:] if arguments is None else arguments))
        with stopped_at_once():
            if name not in WITHOUT_TORCH:
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


def _parsed(words: list[str]) -> tuple[str, Command]:
    """The name of the command these words ask for, and the command.

    Raises:
        InputError: an unknown command or option, a value that cannot be read, or an option that is missing.
        SystemExit: ``--help``, which has been printed.
    """
    # ``train a3c`` and its like are two words to a person and one command to the parser.
    pair = " ".join(words[:2])
    name, *options = [pair, *words[2:]] if pair in COMMANDS else words or [""]
    if name not in COMMANDS and not name.startswith("-") and words:
        raise InputError(f"no command {name!r}; there are {', '.join(COMMANDS)}; see: swarmchase --help")
    refusal = io.StringIO()
    try:
        with contextlib.redirect_stderr(refusal):
            if name in COMMANDS:
                return name, tyro.cli(_kind(name), prog=f"swarmchase {name}", args=options)
            tyro.extras.subcommand_cli_from_dict(
                {one: _kind(one) for one in COMMANDS}, prog="swarmchase", description=DESCRIPTION, args=words
            )
    except SystemExit as error:
        if not error.code:
            print(end="", flush=True)  # now, since nobody catches what fails at the very end
            raise
        command = f"{name} " if name in COMMANDS else ""
        raise InputError(f"{_one_line(refusal.getvalue())}; see: swarmchase {command}--help") from None
    raise AssertionError("without a command there is nothing to parse")


def _kind(name: str) -> Callable[..., Command]:
    module, kind = COMMANDS[name].split(".")
    found: Callable[..., Command] = getattr(importlib.import_module(f".commands.{module}", __package__), kind)
    return found


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
