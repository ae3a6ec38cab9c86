"""What all figures have in common: size, fonts, colours and how they are saved.

Sizes and fonts are those of a two-column page of the paper's journal; colours differ in lightness and lines in marker
or dash as well as in hue, so that nothing is lost without colour vision or in grey.
"""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ..files import atomic_path

PAGE_WIDTH_INCHES = 7.16
COLUMN_WIDTH_INCHES = 3.5
TRACKER_NAMES = ("+x", "-x", "+y", "-y", "+z", "-z")
TRACKER_COLORS = ("#0072B2", "#56B4E9", "#D55E00", "#E69F00", "#00694E", "#CC79A7")
"""Okabe and Ito's colours (+z darkened), distinguishable without colour vision; + is darker than its opposite."""
TRACKER_MARKERS = ("o", "o", "s", "s", "^", "^")
"""One shape an axis: filled on its positive side, hollow on the other."""
TARGET_COLOR = "#D55E00"
CONTROLLER_STYLES = (
    ("#000000", "o", "-"),
    ("#0072B2", "s", "--"),
    ("#D55E00", "^", "-."),
    ("#00694E", "v", ":"),
    ("#CC79A7", "D", (0, (5, 1))),
    ("#E69F00", "P", (0, (3, 1, 1, 1))),
    ("#56B4E9", "X", (0, (1, 1))),
    ("#7B3294", "<", (0, (7, 2))),
    ("#8C510A", ">", (0, (2, 2))),
)
"""Colour (Okabe and Ito, and two more), marker and line of the controllers in their order; they repeat after the
last."""
STYLE: Any = {
    "font.size": 8,
    "axes.titlesize": 8,
    "legend.fontsize": 7,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.5,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "pdf.fonttype": 42,
}


def save_figure(figure: Figure, path: Path, title: str) -> None:
    """Write PNG or PDF, whole or not at all; the same figure is the same file."""
    dates = {"CreationDate": None} if path.suffix == ".pdf" else {}
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format=path.suffix.lstrip("."), dpi=200, metadata={"Title": title, **dates})
