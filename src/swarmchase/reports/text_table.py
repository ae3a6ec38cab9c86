"""A table of words, as Markdown holds it and a terminal shows it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TextTable:
    """Rows of cells under a head."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    num_keys: int = 1
    """The first columns, which say what a row is of: they come again where a table is shown in parts."""

    def markdown(self) -> str:
        """As a document holds it."""
        return "\n".join([_line(self.head), "|" + "---|" * len(self.head), *map(_line, self.rows)])


def _line(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"
