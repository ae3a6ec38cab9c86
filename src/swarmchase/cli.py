"""The command line: ``swarmchase`` and the name of a command.

Each command is a dataclass whose fields are its options and whose ``run`` does the work; tyro makes the parser and
``--help`` of them. A command's module is imported when it is asked for, and what is slow to import by ``run``. Bad
input ends in one line on standard error and exit code 2.
"""

import contextlib
import importlib.metadata
import io
import re
import select
import signal
import sys
from collections.abc import Sequence
from typing import NoReturn, TextIO

import tyro

from .commands.catalogue import COMMANDS, Command, kind, members
from .commands.configuration import configuration_path, print_configuration, with_configuration
from .commands.overview import print_group, print_overview
from .commands.terminal import CONSOLE, discard
from .errors import InputError, WorkerDiedError
from .processes.stop_request import Interrupted, stopped_at_once
from .ranges import meant

HELP = ("--help", "-h")
WITHOUT_TORCH = {"keys", "tracker", "completion"}
"""First words of commands: a tracker's computer is small."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command and exit: 0 when it went well, 2 on bad input, 141 when nobody reads what it prints any more
    (``| head``), 1 on any other failure. Stopped by a signal, 0 where it has a result before its end (a live chase, a
    training), else 128 and the signal's number, as after a second Ctrl-C: 130 for SIGINT, 143 for SIGTERM, 129 for
    SIGHUP.
    """
    try:
        name, command = _parsed(list(sys.argv[1:] if arguments is None else arguments))
        with stopped_at_once():
            if name.split()[0] not in WITHOUT_TORCH:
                _use_one_thread()
            if getattr(command, "print_config", False):
                print_configuration(command)
            else:
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
    if name not in COMMANDS:
        _answer_or_refuse(name, options)
    command, refusal = kind(name), io.StringIO()
    try:
        with contextlib.redirect_stderr(refusal):
            return name, tyro.cli(command, prog=f"swarmchase {name}", args=with_configuration(command, options))
    except SystemExit as error:
        if not error.code:
            print(end="", flush=True)  # now, since nobody catches what fails at the very end
            raise
        path = configuration_path(command, options)
        where = "" if path is None else f"; the configuration is {path}"
        raise InputError(f"{_one_line(refusal.getvalue())}{where}; see: swarmchase {name} --help") from None


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


def _one_line(refusal: str) -> str:
    """What tyro refuses and why: it prints a title, this, what may have been meant, and where to find help, in a box
    and between ruled lines.
    """
    plain = re.sub(r"\x1b\[[0-9;]*m", "", refusal)
    sections = re.split(r"^[│ ]*(?:[╭╰].*|[-─]{3,})[│ ]*$", plain, flags=re.MULTILINE)
    statement = sections[1 if len(sections) > 1 else 0].replace("│", " ").split("Got errors:")[0]
    meant = dict.fromkeys(
        option
        for section in sections
        if "Perhaps you meant:" in section
        for option in re.findall(r"^[│ ]*(--[\w-]+)", section, flags=re.MULTILINE)
    )
    line = " ".join(statement.split()).rstrip(".:;")
    return f"{line} (did you mean {' or '.join(meant)}?)" if meant else line


def _has_lost_its_reader(stream: TextIO) -> bool:
    """Whether it is a pipe or socket whose other end is closed: any other broken pipe is a failure."""
    poll = select.poll()
    poll.register(stream, 0)
    return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))


def _use_one_thread() -> None:
    """The fastest for batches of this size; commands that use more cores start processes."""
    import torch

    torch.set_num_threads(1)
