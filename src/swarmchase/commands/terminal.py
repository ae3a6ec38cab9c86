"""What people see: everything but a command's JSON goes to standard error."""

import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from typing import Any

from rich.console import Console

from ..errors import InputError
from ..scenario import Scenario

CONSOLE = Console(stderr=True, highlight=False)


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


def explain_choice(controller: str, scenario: Scenario) -> None:
    """Say which trained controller is used, and why, where the scenario's F and rho are not its own."""
    from ..controllers import chosen_weights

    chosen = chosen_weights(controller, scenario)
    explanation = None if chosen is None else chosen.explanation(scenario)
    if explanation is not None:
        CONSOLE.print(explanation, soft_wrap=True)


@contextlib.contextmanager
def progress_bar(task: str, total: int, unit: str) -> Iterator[Callable[[int, str, str], None]]:
    """A bar with a count, the rate in ``unit``, the time left and news.

    Gives a function to be told the count, the rate and the news. The bar appears when it is first called: not before
    the work has begun.
    """
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    bar = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]} " + unit),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[news]}"),
        console=CONSOLE,
    )
    number = bar.add_task(task, total=total, start=False, rate="-", news="")

    def show(completed: int, rate: str, news: str) -> None:
        if not bar.live.is_started:
            bar.start()
            bar.start_task(number)
        bar.update(number, completed=completed, rate=rate, news=news)

    try:
        yield show
    finally:
        if bar.live.is_started:
            bar.stop()
