"""What every figure keeps: nothing lies outside its panel or the page, no panel is empty, no band is without a name."""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import Collection, PathCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

Points = NDArray[np.float64]


def require_tidy(figure: Figure) -> None:
    """Every panel shows something, nothing of it lies outside its panel, and no text outside the figure."""
    figure.draw_without_rendering()
    panels = [axes for axes in figure.axes if axes.get_visible() and axes.axison and axes.name != "3d"]
    assert panels
    for axes in panels:
        frame, name = axes.get_window_extent(), f"{axes.get_title()} {axes.get_ylabel()}"
        drawn = list(places_dots(axes))
        assert drawn, f"{name} is empty"
        for place_dots, reach in drawn:
            (x, y) = place_dots.T
            assert frame.x0 - 1 <= x.min(), name
            assert x.max() + reach <= frame.x1 + 1, name
            assert frame.y0 - 1 <= y.min() - reach, name
            assert y.max() + reach <= frame.y1 + 1, name
        for text in axes.texts:
            box = text.get_window_extent()
            assert frame.x0 - 1 <= box.x0 <= box.x1 <= frame.x1 + 1, text.get_text()
            assert frame.y0 - 1 <= box.y0 <= box.y1 <= frame.y1 + 1, text.get_text()
    box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert -0.01 <= box.x0 <= box.x1 <= width + 0.01
    assert -0.01 <= box.y0 <= box.y1 <= height + 0.01


def places_dots(axes: Axes) -> Iterator[tuple[Points, float]]:
    """Where each line, bar and band of a panel is, [point, 2], and how far its markers reach beyond; both in dots. A
    line of one point that has no marker is not seen.
    """
    for line in axes.lines:
        place = line.get_transform().transform(np.asarray(line.get_xydata(), dtype=np.float64).reshape(-1, 2))
        place = place[np.isfinite(place).all(axis=1)]
        has_marker = line.get_marker() not in (None, "None", "", " ", "|", "_")
        if len(place) > 1 or (len(place) == 1 and line.get_marker() not in (None, "None", "", " ")):
            yield place, line.get_markersize() / 2 * axes.get_figure(root=True).dpi / 72 if has_marker else 0.0
    for artist in (*axes.collections, *axes.patches):
        yield from _outlines(artist)


def _outlines(artist: Collection | Patch) -> Iterator[tuple[Points, float]]:
    if isinstance(artist, PathCollection):
        return
    paths = artist.get_paths() if isinstance(artist, Collection) else [artist.get_path()]
    for path in paths:
        place = np.asarray(artist.get_transform().transform(path.vertices), dtype=np.float64)
        place = place[np.isfinite(place).all(axis=1)]
        if len(place):
            yield place, 0.0
