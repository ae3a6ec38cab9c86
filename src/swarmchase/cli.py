"""The command line: ``swarmchase`` and the name of a command.

Each command is a dataclass whose fields are its options and whose ``run`` does the work; tyro makes the parser and
``--help`` of them. A command's module is imported when it is asked for, and what is slow to import by ``run``. Bad
input ends in one line on standard error and exit code 2.
"""

import importlib.metadata
import sys
from collections.abc import Sequence
from typing import NoReturn

from .commands.catalogue import COMMANDS, kind, members
from .commands.help import print_options
from .commands.overview import print_group, print_overview
from .commands.running import Command, exit_codes, parsed, run
from .errors import InputError
from .processes.stop_request import stopped_at_once
from .ranges import meant

HELP = ("--help", "-h")
WITHOUT_TORCH = {"keys", "tracker", "completion"}
"""First words of commands: a tracker's computer is small."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command and exit, with the codes of ``commands.running.exit_codes``."""
    with exit_codes():
        name, command = _parsed(list(sys.argv[1:] if arguments is None else arguments))
        with stopped_at_once():
            if name.split()[0] not in WITHOUT_TORCH:
                _use_one_thread()
            run(command)


def _parsed(words: list[str]) -> tuple[str, Command]:
    """The name of the command these words ask for, and the command.

    Raises:
        InputError: an unknown command or option, a value that cannot be read, or an option that is missing.
        SystemExit: ``--help``, which has been printed.
    """
    # ``train a3c`` and its like are two words to a person and one command to the parser.
    pair = " ".join(words[:2])
    name, *options = [pair, *words[2:]] if pair in COMMANDS else words or [""]
    if name not in COMMANDS:
        _answer_or_refuse(name, options)
    command, program = kind(name), f"swarmchase {name}"
    if any(word in HELP for word in options):
        print_options(program, command)
        sys.exit(0)
    return name, parsed(command, program, options)


def _answer_or_refuse(word: str, others: list[str]) -> NoReturn:
    """What is no command by itself: an overview, the version, or nothing that is known.

    Raises:
        InputError: it is nothing that is known.
        SystemExit: it was answered on standard output.
    """
    asks = not others or others[0] in HELP
    if word == "--version":
        print(f"swarmchase {importlib.metadata.version('swarmchase')}", flush=True)
    elif word in HELP:
        print_overview()
    elif members(word) and asks:
        print_group(word)
    elif members(word):
        known = [name.split()[1] for name in members(word)]
        raise InputError(
            f"no command {f'{word} {others[0]}'!r}{meant(others[0], known)}; see: swarmchase {word} --help"
        )
    elif not word:
        raise InputError("give a command; see: swarmchase --help")
    elif word.startswith("-"):
        raise InputError(f"no option {word!r} before a command; see: swarmchase --help")
    else:
        raise InputError(
            f"no command {word!r}{meant(word, {name.split()[0]: None for name in COMMANDS})}; see: swarmchase --help"
        )
    sys.exit(0)


def _use_one_thread() -> None:
    """The fastest for batches of this size; commands that use more cores start processes."""
    import torch

    torch.set_num_threads(1)
