"""Tables as a terminal or a pipe shows them: no cell is ever cut or wrapped. What is too wide comes in parts."""

import textwrap
from collections.abc import Iterator, Sequence

from rich.table import Table
from rich.text import Text

from ..reports.text_table import TextTable
from .terminal import CONSOLE

GAP = 3
"""Between two columns, for the line and the blanks around it."""


def print_table(table: TextTable | Table, title: str = "") -> None:
    """Whole where it fits, else in parts that each have the first columns."""
    parts = [*_parts(table if isinstance(table, TextTable) else _words(table))]
    if len(parts) == 1 and isinstance(table, Table):
        CONSOLE.print(table)
        return
    heading = title or (str(table.title or "") if isinstance(table, Table) else "")
    if heading:
        CONSOLE.print(heading, style="bold", markup=False, soft_wrap=True)
    for part in parts:
        CONSOLE.print(part, crop=False)
    caption = table.caption if isinstance(table, Table) else None
    if caption:
        CONSOLE.print(str(caption), style="dim", markup=False)


def fits(table: TextTable) -> bool:
    """Whether it can be shown whole."""
    return sum(_widths(table)) + GAP * len(table.head) + 1 <= CONSOLE.width


def _parts(table: TextTable) -> Iterator[Table]:
    keys = range(table.num_keys)
    widths = _widths(table)
    chosen: list[int] = []
    for column in range(table.num_keys, len(table.head)):
        needed = sum(widths[one] + GAP for one in (*keys, *chosen, column)) + 1
        if chosen and needed > CONSOLE.width:
            yield _part(table, [*keys, *chosen], widths)
            chosen = []
        chosen.append(column)
    yield _part(table, [*keys, *chosen], widths)


def _part(table: TextTable, columns: Sequence[int], widths: Sequence[int]) -> Table:
    part = Table()
    for column in columns:
        name = table.head[column].replace("`", "")
        head = "\n".join(textwrap.wrap(name, widths[column], break_on_hyphens=False))
        part.add_column(Text(head), width=widths[column], no_wrap=True, overflow="ignore")
    for row in table.rows:
        part.add_row(*(Text(row[column]) for column in columns))
    return part


def _widths(table: TextTable) -> list[int]:
    """Of each column: of its widest cell, or of the longest word in its head."""
    return [
        max(
            [len(word) for word in head.split()]
            + [len(line) for row in table.rows for line in row[column].splitlines()]
            + [1]
        )
        for column, head in enumerate(table.head)
    ]


def _words(table: Table) -> TextTable:
    """What a table of rich says."""
    columns = [[str(cell) for cell in column.cells] for column in table.columns]
    return TextTable(tuple(str(column.header) for column in table.columns), tuple(zip(*columns, strict=True)))
