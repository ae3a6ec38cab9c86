"""``swarmchase --help`` and ``swarmchase train --help``: which commands there are, and what each is for."""

import inspect

from rich.padding import Padding
from rich.table import Table

from .catalogue import EXAMPLES, SECTIONS, kind, members
from .terminal import Page

DESCRIPTION = "Chase an unauthorised UAV with a swarm of six trackers that hear only its signal strength."


def print_overview() -> None:
    """Of all commands, on standard output."""
    page = Page()
    page.print("usage: swarmchase COMMAND [OPTIONS]\n")
    page.print(f"{DESCRIPTION}\n")
    for title, commands in SECTIONS.items():
        page.print(f"[bold]{title}[/bold]")
        page.print(_summaries([name for name in commands if not members(name)]))
    page.print("[bold]Begin with[/bold]")
    for example in EXAMPLES:
        page.print(Padding(example, (0, 0, 0, 2)), soft_wrap=True)
    page.print("\nOptions of a command: swarmchase COMMAND --help. Which version this is: swarmchase --version.")


def print_group(group: str) -> None:
    """Of the commands of two words of which this is the first, on standard output."""
    page = Page()
    page.print(f"usage: swarmchase {group} COMMAND [OPTIONS]\n")
    page.print(_summaries(members(group)))
    page.print(f"\nOptions of one: swarmchase {group} COMMAND --help.")


def _summaries(names: list[str]) -> Padding:
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column()
    for name in names:
        words = " ".join((inspect.getdoc(kind(name)) or "").split())
        table.add_row(name, words.partition(". ")[0].removesuffix("."))
    return Padding(table, (0, 0, 1, 2))
