"""Both paths of a chase as seen from above: where north is, a scale, and how either path is drawn wherever it is."""

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from .flight_paths import FlightPaths
from .style import TARGET_COLOR

MARGIN_SHARE = 0.07
"""Of the view's width, left free around the paths."""
STRIP_SHARE = 0.13
"""Of the view's height, below the paths: for north and the scale, which so hide nothing."""
ROUND_NUMBERS = (1, 2, 5, 10)


@dataclass(frozen=True)
class PathStyle:
    """How a path looks: the two differ in line and marker as well as in colour."""

    label: str
    color: str
    line: str
    marker: str

    def handle(self) -> Line2D:
        """For a legend."""
        return Line2D([], [], color=self.color, ls=self.line, lw=1, marker=self.marker, ms=4, label=self.label)


CENTER_STYLE = PathStyle("centre of the swarm", "black", "-", "o")
TARGET_STYLE = PathStyle("target", TARGET_COLOR, "--", "D")


def set_view(axes: Axes, places_m: NDArray[np.float64], height_share: float) -> None:
    """Limits that hold these places [place, 2] with a metre as long on either axis; the view is ``height_share`` times
    as high as wide.
    """
    low_m, high_m = places_m.min(axis=0), places_m.max(axis=0)
    usable_share = height_share * (1 - STRIP_SHARE) - 2 * MARGIN_SHARE
    width_m = max((high_m[0] - low_m[0]) / (1 - 2 * MARGIN_SHARE), (high_m[1] - low_m[1]) / usable_share, 1.0)
    strip_m = STRIP_SHARE * height_share * width_m
    middle_east_m, middle_north_m = (low_m + high_m) / 2
    middle_north_m -= strip_m / 2
    half_m = np.array([width_m, height_share * width_m]) / 2
    axes.set_xlim(middle_east_m - half_m[0], middle_east_m + half_m[0])
    axes.set_ylim(middle_north_m - half_m[1], middle_north_m + half_m[1])
    axes.set_aspect("equal")
    axes.set(xlabel="east (m)", ylabel="north (m)")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    _draw_north(axes)
    _draw_scale(axes, width_m)


def plan_and_height(figure: Figure, paths: FlightPaths, margins: dict[str, float] | None = None) -> tuple[Axes, Axes]:
    """Empty axes for both paths from above and, below them, for their heights over time; fixed margins if given."""
    plan_axes, height_axes = figure.subplots(2, 1, height_ratios=(3.2, 1), gridspec_kw=margins)
    set_view(plan_axes, paths.from_above_m, height_share=0.95)
    plan_axes.legend(
        handles=[CENTER_STYLE.handle(), TARGET_STYLE.handle()],
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=2,
        frameon=False,
    )
    height_axes.set(xlabel=paths.clock_label, ylabel="height (m)")
    height_axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    return plan_axes, height_axes


def draw_path(axes: Axes, style: PathStyle, place_m: NDArray[np.float64]) -> Line2D:
    """The way through these places, [moment, 2] in the axes' metres."""
    (line,) = axes.plot(*place_m.T, color=style.color, linestyle=style.line, linewidth=1)
    return line


def draw_start(axes: Axes, style: PathStyle, place_m: NDArray[np.float64]) -> None:
    """Hollow."""
    axes.plot(*place_m[:1].T, ls="none", marker=style.marker, ms=6, mfc="white", mec=style.color, mew=1)


def draw_end(axes: Axes, style: PathStyle, place_m: NDArray[np.float64]) -> Line2D:
    """Filled, with a white rim: where both end at one place, both are seen."""
    size = 8 if style is CENTER_STYLE else 5
    (marker,) = axes.plot(*place_m[-1:].T, ls="none", marker=style.marker, ms=size, color=style.color, mec="white")
    return marker


def _draw_north(axes: Axes) -> None:
    """In the strip below the paths, on its left."""
    low, high = 0.25 * STRIP_SHARE, 0.95 * STRIP_SHARE
    arrow = {"arrowstyle": "-|>", "facecolor": "black", "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (0.05, high), (0.05, low), "axes fraction", "axes fraction", arrowprops=arrow)
    axes.text(0.075, (low + high) / 2, "N", transform=axes.transAxes, va="center", fontsize=7)


def _draw_scale(axes: Axes, width_m: float) -> None:
    """In the strip below the paths, on its right: a round length of about a quarter of the view."""
    longest_m = 0.3 * width_m
    power = 10.0 ** math.floor(math.log10(longest_m))
    scale_m = max(number * power for number in ROUND_NUMBERS if number * power <= longest_m)
    begin, end = 0.96 - scale_m / width_m, 0.96
    height = 0.35 * STRIP_SHARE
    axes.plot([begin, end], [height] * 2, "k|-", transform=axes.transAxes, lw=1, ms=5, scalex=False, scaley=False)
    axes.text((begin + end) / 2, height + 0.01, f"{scale_m:g} m", transform=axes.transAxes, ha="center", va="bottom")
