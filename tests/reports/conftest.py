"""What tests of figures share."""

from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Those that are saved."""
    saved: list[Figure] = []
    save = Figure.savefig

    def remember(figure: Figure, *arguments: Any, **options: Any) -> None:
        saved.append(figure)
        save(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", remember)
    return saved


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Those that are saved, which are not painted: their files are empty."""
    kept: list[Figure] = []

    def remember(figure: Figure, path: Path, **options: Any) -> None:
        kept.append(figure)
        path.touch()

    monkeypatch.setattr(Figure, "savefig", remember)
    return kept
