"""How a command runs, whichever program it belongs to: parsed by tyro, ended by one line and a code."""

import contextlib
import io
import re
import select
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol, TextIO, TypeVar, runtime_checkable

import tyro

from ..errors import InputError, WorkerDiedError
from ..processes.stop_request import Interrupted
from .configuration import configuration_path, print_configuration, with_configuration
from .terminal import CONSOLE, discard


@runtime_checkable
class Command(Protocol):
    """One parsed command."""

    def run(self) -> None:
        """Do the work."""


Kind = TypeVar("Kind", bound=Command)


@contextlib.contextmanager
def exit_codes() -> Iterator[None]:
    """Exit as a command does: 0 when it went well, 2 on bad input, 141 when nobody reads what it prints any more
    (``| head``), 1 on any other failure. Stopped by a signal, 0 where it has a result before its end (a live chase, a
    training), else 128 and the signal's number, as after a second Ctrl-C: 130 for SIGINT, 143 for SIGTERM, 129 for
    SIGHUP.
    """
    try:
        yield
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


def parsed(kind: Callable[..., Kind], program: str, options: Sequence[str]) -> Kind:
    """The command that these words of a command line describe, after ``program``.

    Raises:
        InputError: an unknown option, a value that cannot be read, or an option that is missing.
        SystemExit: ``--help``, which has been printed.
    """
    refusal = io.StringIO()
    try:
        with contextlib.redirect_stderr(refusal):
            return tyro.cli(kind, prog=program, args=with_configuration(kind, options))
    except SystemExit as error:
        if not error.code:
            print(end="", flush=True)  # now, since nobody catches what fails at the very end
            raise
        path = configuration_path(kind, options)
        where = "" if path is None else f"; the configuration is {path}"
        raise InputError(f"{_one_line(refusal.getvalue())}{where}; see: {program} --help") from None


def run(command: Command) -> None:
    """Do what a parsed command says, or print its configuration."""
    if getattr(command, "print_config", False):
        print_configuration(command)
    else:
        command.run()


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
    missing = re.findall(r"^ +(--.*)", statement, flags=re.MULTILINE) if "Missing from" in statement else []
    if missing:
        statement = f"{statement.split(missing[0])[0]} {', '.join(option.strip() for option in missing)}"
    line = " ".join(statement.split()).rstrip(".:;")
    return f"{line} (did you mean {' or '.join(meant)}?)" if meant else line


def _has_lost_its_reader(stream: TextIO) -> bool:
    """Whether it is a pipe or socket whose other end is closed: any other broken pipe is a failure."""
    poll = select.poll()
    poll.register(stream, 0)
    return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))
