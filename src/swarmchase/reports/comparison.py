"""The figures of a comparison from its results: distributions, percentiles against F, and worlds side by side.

Nothing here simulates. Every figure is written as PNG and as PDF.
"""

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..evaluation.paper_results import MOVEMENTS_P90
from .marks import (
    BANDS,
    BARS,
    FEW_MOVEMENT_TICKS,
    FORMATS,
    MOST_SHOWN,
    ORACLE_COLOR,
    ROUND_MOVEMENT_TICKS,
    STATED,
    draw_cdf,
    draw_with_bars,
    label_plainly,
    mark_stated,
    movement_axis,
    sampling_axis,
    star_last,
)
from .style import CONTROLLER_STYLES, PAGE_WIDTH_INCHES, STYLE, save_figure

STATED_COLOR = "#7A7A7A"
MOST_PANELS = 12
PANELS_A_ROW = 4
LONGEST_NAME = 46
"""Characters of a world's name on one line."""
APART = 1.012
"""Between the marks of two controllers at one F: none hides another."""

Row = dict[str, Any]
PlaceOfPanel = tuple[float, float, str]
"""F, rho and world."""
MovementsByPlace = Mapping[tuple[str, float, float, str], Sequence[float | int]]
"""Movements of every chase, or another measure of it, by (controller, F, rho, world)."""


def draw_comparison(
    folder: Path,
    movements: MovementsByPlace,
    rows: Sequence[Row],
    following_s: MovementsByPlace,
    belief_error_m: MovementsByPlace,
) -> list[Path]:
    """Draw what the results have: distributions, and percentiles against F (of a single F controller by controller) or,
    in several worlds, means by world.
    Where chases are measured by the clock, the distributions of the seconds until the capture. Of what there is, also
    the distributions of the longest time near the target and of the belief's median error.

    ``rows`` are the summaries of the same results. Returns the PNG files.
    """
    figures: dict[str, Callable[[], Figure]]
    if "capture_s_mean" in rows[0]:
        figures = {"capture": lambda: capture_figure(movements)}
    else:
        figures = {"movements": lambda: distribution_figure(movements)}
        if len({row["world"] for row in rows}) > 1:
            figures["worlds"] = lambda: world_figure(rows)
        elif len({row["sampling_hz"] for row in rows}) == 1:
            figures["percentile"] = lambda: controller_figure(rows)
        else:
            figures["percentile"] = lambda: percentile_figure(rows)
    if following_s:
        figures["following"] = lambda: following_figure(following_s)
    if belief_error_m:
        figures["belief"] = lambda: belief_figure(belief_error_m)
    return _drawn(folder, figures)


def _drawn(folder: Path, figures: Mapping[str, Callable[[], Figure]]) -> list[Path]:
    for name, make in figures.items():
        with mpl.rc_context(STYLE):
            figure = make()
            for suffix in FORMATS:
                save_figure(figure, folder / f"{name}{suffix}", name)
    return [folder / f"{name}.png" for name in figures]


def distribution_figure(movements: MovementsByPlace) -> Figure:
    """Distribution of the number of movements, one panel a setting and world, the first ``MOST_PANELS`` of them."""
    least = min(map(min, movements.values()))

    def finish(axes: Axes, place: PlaceOfPanel) -> None:
        stated = MOVEMENTS_P90.get(place[:2])
        if stated is not None:
            mark_stated(axes, stated, 0.9, STATED_COLOR)
        movement_axis(axes, "x", (least, stated or least, MOST_SHOWN), FEW_MOVEMENT_TICKS)

    return _distributions(movements, "movements", MOST_SHOWN, finish)


def capture_figure(capture_s: MovementsByPlace) -> Figure:
    """Distribution of the seconds until the capture, panels as above; a chase without one counts as long as it lasted,
    where the panels end.
    """
    # Just before the end, where the step of those without a capture would look like captures.
    end_s = 0.999 * max(map(max, capture_s.values()))
    return _distributions(capture_s, "seconds until the capture", end_s, lambda axes, _: axes.set_xlim(0, end_s))


def following_figure(following_s: MovementsByPlace) -> Figure:
    """Distribution of each chase's longest time near the target, panels as above."""
    return _distributions(following_s, "longest time within 10 m (s)", math.inf, lambda _axes, _: None)


def belief_figure(error_m: MovementsByPlace) -> Figure:
    """Distribution of the median error of each chase's belief, panels as above."""
    label = "belief: median error of a chase (m)"

    def finish(axes: Axes, _: PlaceOfPanel) -> None:
        axes.set_xscale("log")
        label_plainly(axes.xaxis)

    return _distributions(error_m, label, math.inf, finish)


def _distributions(
    values: MovementsByPlace, label: str, most_shown: float | int, finish: Callable[[Axes, PlaceOfPanel], object]
) -> Figure:
    """Curves end at ``most_shown``; ``finish`` does what a panel needs besides."""
    span = min(map(min, values.values())), most_shown
    places = list(dict.fromkeys(key[1:] for key in values))[:MOST_PANELS]
    columns = min(PANELS_A_ROW, len(places))
    lines = -(-len(places) // columns)
    width = PAGE_WIDTH_INCHES if columns > 1 else 0.6 * PAGE_WIDTH_INCHES
    figure = Figure(figsize=(width, 0.6 + 1.9 * lines), layout="constrained")
    panels = figure.subplots(lines, columns, sharey=True, sharex=True, squeeze=False)
    styles = _styles(key[0] for key in values)
    for axes, place in zip(panels.flat, places, strict=False):
        for controller, (color, _, line) in styles.items():
            if (controller, *place) in values:
                draw_cdf(axes, values[controller, *place], span, color, line, controller)
        axes.axhline(0.9, color="black", linewidth=0.4)
        axes.set_title(_place_title(place))
        axes.set_ylim(0, 1.02)
        finish(axes, place)
    for axes in panels.flat[len(places) :]:
        axes.set_visible(False)
    for axes in panels[:, 0]:
        axes.set_ylabel("share of chases")
    for number, axes in enumerate(panels.flat[: len(places)]):
        if number + columns >= len(places):
            axes.set_xlabel(label)
            axes.tick_params(labelbottom=True)
    _legend_below(figure, list(panels.flat[: len(places)]), BANDS)
    return figure


def percentile_figure(rows: Sequence[Row]) -> Figure:
    """90th percentile of movements against F, one panel a correlation, with 95 % intervals and the paper's points."""
    correlations = sorted({row["spatial_correlation"] for row in rows})
    width = PAGE_WIDTH_INCHES * (1.0 if len(correlations) > 1 else 0.6)
    figure = Figure(figsize=(width, 3.0), layout="constrained")
    panels = figure.subplots(1, len(correlations), sharey=True, squeeze=False)[0]
    styles = _styles(row["controller"] for row in rows)
    for axes, correlation in zip(panels, correlations, strict=True):
        here = [row for row in rows if row["spatial_correlation"] == correlation]
        for number, (controller, (color, marker, line)) in enumerate(styles.items()):
            its = sorted((row for row in here if row["controller"] == controller), key=lambda row: row["sampling_hz"])
            percentiles = [row["movements_p90"] for row in its]
            intervals = [row["movements_p90_ci95"] for row in its]
            beside = APART ** (number - (len(styles) - 1) / 2)
            draw_with_bars(axes, its, percentiles, intervals, color, marker, line, color, controller, beside)
        _mark_stated(axes, here)
        sampling_axis(axes, sorted({row["sampling_hz"] for row in rows}))
        axes.set_title(f"ρ = {correlation:g}")
        movement_axis(axes, "y", _shown_percentiles(rows))
    panels[0].set_ylabel("90th percentile of movements")
    _legend_below(figure, list(panels), BARS)
    return figure


def controller_figure(rows: Sequence[Row]) -> Figure:
    """90th percentile of movements at one F, one line a controller and one panel a correlation, with 95 % intervals and
    the paper's points.
    """
    correlations = sorted({row["spatial_correlation"] for row in rows})
    controllers = list(dict.fromkeys(row["controller"] for row in rows))
    width = PAGE_WIDTH_INCHES * (1.0 if len(correlations) > 1 else 0.6)
    figure = Figure(figsize=(width, 1.2 + 0.22 * len(controllers)), layout="constrained")
    panels = figure.subplots(1, len(correlations), sharey=True, squeeze=False)[0]
    styles = _styles(controllers)
    for axes, correlation in zip(panels, correlations, strict=True):
        here = [row for row in rows if row["spatial_correlation"] == correlation]
        for row in here:
            color, marker, _ = styles[row["controller"]]
            value, height = row["movements_p90"], controllers.index(row["controller"])
            _draw_across(axes, [value], [row["movements_p90_ci95"]], [height], color, marker, None)
        stated = MOVEMENTS_P90.get((rows[0]["sampling_hz"], correlation))
        if stated is not None:
            axes.axvline(stated, color=STATED_COLOR, linewidth=0.8, linestyle=":", label=STATED)
        movement_axis(axes, "x", _shown_percentiles(rows), FEW_MOVEMENT_TICKS)
        axes.set_title(f"F = {rows[0]['sampling_hz']:g} Hz, ρ = {correlation:g}")
        axes.set_xlabel("90th percentile of movements")
    panels[0].set_yticks(range(len(controllers)), controllers)
    panels[0].set_ylim(len(controllers) - 0.5, -0.5)
    _legend_below(figure, list(panels), BARS)
    return figure


def world_figure(rows: Sequence[Row]) -> Figure:
    """Mean movements with 95 % intervals in each world, one panel a setting; a failed chase counts as 501."""
    settings = list(dict.fromkeys((row["sampling_hz"], row["spatial_correlation"]) for row in rows))
    worlds = list(dict.fromkeys(row["world"] for row in rows))
    lines, columns = -(-len(settings) // PANELS_A_ROW), min(PANELS_A_ROW, len(settings))
    height = 0.8 + lines * (0.3 + 0.24 * len(worlds))
    figure = Figure(figsize=(PAGE_WIDTH_INCHES, height), layout="constrained")
    panels = figure.subplots(lines, columns, sharey=True, squeeze=False)
    styles = _styles(row["controller"] for row in rows)
    bounds = [bound for row in rows for bound in row["movements_mean_ci95"] or [row["movements_mean"]]]
    for axes, setting in zip(panels.flat, settings, strict=False):
        for number, (controller, (color, marker, _)) in enumerate(styles.items()):
            its = [
                row
                for row in rows
                if (row["sampling_hz"], row["spatial_correlation"], row["controller"]) == (*setting, controller)
            ]
            shift = 0.6 * ((number + 0.5) / len(styles) - 0.5)
            heights = [worlds.index(row["world"]) + shift for row in its]
            means, intervals = ([row[f"movements_mean{what}"] for row in its] for what in ("", "_ci95"))
            _draw_across(axes, means, intervals, heights, color, marker, controller)
        movement_axis(axes, "x", bounds, ROUND_MOVEMENT_TICKS)
        axes.set(xlabel="mean movements", title=f"told F = {setting[0]:g} Hz, ρ = {setting[1]:g}")
    for axes in panels.flat[len(settings) :]:
        axes.set_visible(False)
    panels[0, 0].set_yticks(range(len(worlds)), [textwrap.fill(world, LONGEST_NAME) for world in worlds])
    panels[0, 0].set_ylim(len(worlds) - 0.5, -0.5)
    _legend_below(figure, list(panels.flat[: len(settings)]), BARS)
    return figure


def _draw_across(
    axes: Axes,
    values: Sequence[float | int],
    intervals: Sequence[Sequence[float] | None],
    heights: Sequence[float | int],
    color: str,
    marker: str,
    label: str | None,
) -> None:
    """Values with their intervals along the x axis."""
    bounds = [interval or (value, value) for value, interval in zip(values, intervals, strict=True)]
    below = [value - low for value, (low, _) in zip(values, bounds, strict=True)]
    above = [high - value for value, (_, high) in zip(values, bounds, strict=True)]
    axes.errorbar(
        values,
        heights,
        xerr=[below, above],
        color=color,
        marker=marker,
        markersize=3.5,
        linestyle="none",
        linewidth=0.8,
        label=label,
    )


def _mark_stated(axes: Axes, rows: Sequence[Row]) -> None:
    """What the paper states of the settings of these rows."""
    for setting in dict.fromkeys((row["sampling_hz"], row["spatial_correlation"]) for row in rows):
        if setting in MOVEMENTS_P90:
            mark_stated(axes, setting[0], MOVEMENTS_P90[setting], STATED_COLOR)


def _shown_percentiles(rows: Sequence[Row]) -> list[float | int]:
    """Of these rows, with the bounds of their intervals, and what the paper states of their settings."""
    settings = {(row["sampling_hz"], row["spatial_correlation"]) for row in rows}
    stated: list[float | int] = [value for setting, value in MOVEMENTS_P90.items() if setting in settings]
    return stated + [bound for row in rows for bound in row["movements_p90_ci95"] or [row["movements_p90"]]]


def _styles(controllers: Any) -> dict[str, tuple[str, str, Any]]:
    """Colour, marker and line of each controller; the oracle, which is no controller one could fly, is grey."""
    names = list(dict.fromkeys(controllers))
    flown = [name for name in names if name != "oracle"]
    styles: dict[str, tuple[str, str, Any]] = {
        name: CONTROLLER_STYLES[number % len(CONTROLLER_STYLES)] for number, name in enumerate(flown)
    }
    return styles | ({"oracle": (ORACLE_COLOR, "_", "-")} if "oracle" in names else {})


def _place_title(place: PlaceOfPanel) -> str:
    sampling_hz, correlation, world = place
    setting = f"F = {sampling_hz:g} Hz, ρ = {correlation:g}"
    return setting if world == "as told" else f"{setting}\n{world}"


def _legend_below(figure: Figure, panels: Sequence[Axes], title: str) -> None:
    """One legend for all panels: what any of them shows; the title names what lines and marks do not."""
    shown: dict[str, Any] = {}
    for axes in panels:
        handles, labels = star_last(axes)
        shown |= {label: handle for handle, label in zip(handles, labels, strict=True) if label not in shown}
    columns = 5 if len(panels) > 1 else 3
    figure.legend(
        shown.values(),
        shown.keys(),
        loc="outside lower center",
        ncols=columns,
        frameon=False,
        title=title,
        title_fontsize=7,
    )
