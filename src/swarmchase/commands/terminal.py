"""What people see: everything but a command's JSON goes to standard error."""

import json
import sys
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

CONSOLE = Console(stderr=True, highlight=False)


def print_json(document: Any) -> None:
    """Print exactly one JSON value on standard output."""
    sys.stdout.write(json.dumps(document) + "\n")


def progress_bar(unit: str) -> Progress:
    """A bar with a count, the rate in ``unit`` and the time left."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]} " + unit),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[news]}"),
        console=CONSOLE,
    )
