"""What people see: everything but a command's JSON goes to standard error."""

import contextlib
import json
import os
import queue
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TextIO, cast

from rich.console import Console

from ..errors import InputError

STANDARD_ERROR = 2
LAST_LINES_S = 1.0


def discard(stream: TextIO) -> None:
    """What is written from now on, and what is still to be flushed at the end, goes nowhere."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class _StandardError:
    """Where it cannot be written any more, since the terminal has gone, the work still goes on to its end."""

    def write(self, text: str) -> int:
        try:
            return sys.stderr.write(text)
        except OSError:
            discard(sys.stderr)
            return len(text)

    def flush(self) -> None:
        try:
            sys.stderr.flush()
        except OSError:
            discard(sys.stderr)

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.stderr, name)


CONSOLE = Console(file=cast(TextIO, _StandardError()), highlight=False)


class Page(Console):
    """What is printed on standard output for people. A reader that has gone (``| head``) is an error here as anywhere,
    for ``running.exit_codes``; a console of rich ends the process with an exit code of its own.
    """

    def __init__(self, width: int | None = None) -> None:
        super().__init__(file=sys.stdout, highlight=False, width=width)

    def on_broken_pipe(self) -> None:
        """It is being handled."""
        raise  # noqa: PLE0704


def print_json(document: Any) -> None:
    """Print exactly one JSON value on standard output.

    Raises:
        InputError: standard output cannot be written (a full disk, a closed pipe).
    """
    try:
        sys.stdout.write(json.dumps(document) + "\n")
        sys.stdout.flush()
    except OSError as error:
        raise InputError(f"cannot write to standard output: {error.strerror or error}") from error


def warn(line: str) -> None:
    """Tell people what they should know, and go on."""
    CONSOLE.print(line, style="yellow", markup=False, soft_wrap=True)


def tell_replaced(paths: Iterable[Path]) -> None:
    """Of results in a folder that a command works in: those of the run before go, and people are told."""
    there = [str(path) for path in paths if path.exists()]
    if there:
        CONSOLE.print(f"Replaced: {', '.join(there)}", markup=False, soft_wrap=True)


@contextlib.contextmanager
def refusals_held_back() -> Iterator[Callable[[InputError], None]]:
    """Gives a function that takes why something could not be written: what is found out is not to be lost with it. The
    first is raised when the block has ended.

    Raises:
        InputError: what was held back.
    """
    held: list[InputError] = []
    yield held.append
    if held:
        raise held[0]


@contextlib.contextmanager
def line_printer() -> Iterator[Callable[[str], None]]:
    """Gives a function that prints a line on standard error and never waits: a terminal that is stopped (Ctrl-S) or
    gone must not stop what flies. Lines that it does not take are lost; the block's end waits a moment for the rest.
    """
    lines: queue.Queue[str | None] = queue.Queue(maxsize=1000)

    def print_all() -> None:
        while (line := lines.get()) is not None:
            rest = f"{line}\n".encode(errors="replace")
            # Not through sys.stderr: its lock, held while this thread waits, would keep the process from ending.
            with contextlib.suppress(OSError):
                while rest:
                    rest = rest[os.write(STANDARD_ERROR, rest) :]

    def tell(line: str) -> None:
        with contextlib.suppress(queue.Full):
            lines.put_nowait(line)

    thread = threading.Thread(target=print_all, name="line printer", daemon=True)
    thread.start()
    try:
        yield tell
    finally:
        with contextlib.suppress(queue.Full):
            lines.put_nowait(None)
        thread.join(LAST_LINES_S)
