"""The figures of a comparison from its results: distributions, percentiles against F, and worlds side by side.

Nothing here simulates. Every figure is written as PNG and as PDF.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, NullLocator

from ..evaluation.paper_results import MOVEMENTS_P90
from .marks import (
    FORMATS,
    MOST_SHOWN,
    ORACLE_COLOR,
    draw_cdf,
    draw_with_bars,
    mark_stated,
    sampling_axis,
    star_last,
)
from .style import CONTROLLER_STYLES, PAGE_WIDTH_INCHES, STYLE, save_figure

STATED_COLOR = "#7A7A7A"
MOST_PANELS = 12
PANELS_A_ROW = 4

Row = dict[str, Any]
MovementsByPlace = Mapping[tuple[str, float, float, str], Sequence[float | int]]
"""Movements of every chase, or another measure of it, by (controller, F, rho, world)."""


def draw_comparison(
    folder: Path,
    movements: MovementsByPlace,
    rows: Sequence[Row],
    following_s: MovementsByPlace,
    belief_error_m: MovementsByPlace,
) -> list[Path]:
    """Draw what the results have: distributions, and percentiles against F or, in several worlds, means by world.
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
        else:
            figures["percentile"] = lambda: percentile_figure(rows)
    if following_s:
        figures["following"] = lambda: _distributions(following_s, "longest time within 10 m (s)")[0]
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
    figure, panels = _distributions(movements, "movements")
    for axes, place in panels:
        stated = MOVEMENTS_P90.get(place[:2])
        if stated is not None:
            mark_stated(axes, stated, 0.9, STATED_COLOR)
        axes.set(xscale="log", xlim=(13, MOST_SHOWN))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xticks([15, 30, 60, 120], ["15", "30", "60", "120"])
    return figure


def capture_figure(capture_s: MovementsByPlace) -> Figure:
    """Distribution of the seconds until the capture, panels as above; a chase without one counts as long as it lasted,
    where the panels end.
    """
    figure, panels = _distributions(capture_s, "seconds until the capture")
    for axes, _ in panels:
        # Just before the end, where the step of those without a capture would look like captures.
        axes.set_xlim(0, 0.999 * max(max(seconds) for seconds in capture_s.values()))
    return figure


def belief_figure(error_m: MovementsByPlace) -> Figure:
    """Distribution of the median error of each chase's belief, panels as above."""
    figure, panels = _distributions(error_m, "belief: median error of a chase (m)")
    for axes, _ in panels:
        axes.set_xscale("log")
    return figure


def _distributions(values: MovementsByPlace, label: str) -> tuple[Figure, list[tuple[Axes, tuple[float, float, str]]]]:
    """The panels and what each is of."""
    places = list(dict.fromkeys(key[1:] for key in values))[:MOST_PANELS]
    columns = min(PANELS_A_ROW, len(places))
    lines = -(-len(places) // columns)
    width = PAGE_WIDTH_INCHES if columns > 1 else 0.6 * PAGE_WIDTH_INCHES
    figure = Figure(figsize=(width, 0.5 + 1.9 * lines), layout="constrained")
    panels = figure.subplots(lines, columns, sharey=True, sharex=True, squeeze=False)
    styles = _styles(key[0] for key in values)
    for axes, place in zip(panels.flat, places, strict=False):
        for controller, (color, _, line) in styles.items():
            if (controller, *place) in values:
                draw_cdf(axes, values[controller, *place], color, line, controller)
        axes.axhline(0.9, color="black", linewidth=0.4)
        axes.set_title(_place_title(place))
        axes.set_ylim(0, 1.02)
    for axes in panels.flat[len(places) :]:
        axes.set_visible(False)
    for axes in panels[:, 0]:
        axes.set_ylabel("share of chases")
    for number, axes in enumerate(panels.flat[: len(places)]):
        if number + columns >= len(places):
            axes.set_xlabel(label)
            axes.tick_params(labelbottom=True)
    _legend_below(figure, list(panels.flat[: len(places)]))
    return figure, list(zip(panels.flat, places, strict=False))


def percentile_figure(rows: Sequence[Row]) -> Figure:
    """90th percentile of movements against F, one panel a correlation, with 95 % intervals and the paper's points."""
    correlations = sorted({row["spatial_correlation"] for row in rows})
    width = PAGE_WIDTH_INCHES * (1.0 if len(correlations) > 1 else 0.6)
    figure = Figure(figsize=(width, 3.0), layout="constrained")
    panels = figure.subplots(1, len(correlations), sharey=True, squeeze=False)[0]
    styles = _styles(row["controller"] for row in rows)
    for axes, correlation in zip(panels, correlations, strict=True):
        here = [row for row in rows if row["spatial_correlation"] == correlation]
        for controller, (color, marker, line) in styles.items():
            its = sorted((row for row in here if row["controller"] == controller), key=lambda row: row["sampling_hz"])
            percentiles = [row["movements_p90"] for row in its]
            intervals = [row["movements_p90_ci95"] for row in its]
            draw_with_bars(axes, its, percentiles, intervals, color, marker, line, color, controller)
        for (sampling_hz, stated_correlation), stated in MOVEMENTS_P90.items():
            if stated_correlation == correlation:
                mark_stated(axes, sampling_hz, stated, STATED_COLOR)
        sampling_axis(axes)
        axes.set(yscale="log", title=f"ρ = {correlation:g}")
        axes.yaxis.set_minor_locator(NullLocator())
        ticks = [20, 30, 40, 60, 80, 120, 160, 240]
        axes.set_yticks(ticks, [f"{tick}" for tick in ticks])
    panels[0].set_ylim(20, 1.2 * max([row["movements_p90"] for row in rows] + list(MOVEMENTS_P90.values())))
    panels[0].set_ylabel("90th percentile of movements")
    _legend_below(figure, list(panels))
    return figure


def world_figure(rows: Sequence[Row]) -> Figure:
    """Mean movements with 95 % intervals in each world, one panel a setting; a failed chase counts as 501."""
    settings = list(dict.fromkeys((row["sampling_hz"], row["spatial_correlation"]) for row in rows))
    worlds = list(dict.fromkeys(row["world"] for row in rows))
    figure = Figure(figsize=(PAGE_WIDTH_INCHES, 0.8 + 0.24 * len(worlds)), layout="constrained")
    panels = figure.subplots(1, len(settings), sharey=True, squeeze=False)[0]
    styles = _styles(row["controller"] for row in rows)
    for axes, setting in zip(panels, settings, strict=True):
        for number, (controller, (color, marker, _)) in enumerate(styles.items()):
            its = [
                row
                for row in rows
                if (row["sampling_hz"], row["spatial_correlation"], row["controller"]) == (*setting, controller)
            ]
            shift = 0.6 * ((number + 0.5) / len(styles) - 0.5)
            height = [worlds.index(row["world"]) + shift for row in its]
            mean = [row["movements_mean"] for row in its]
            bounds = [row["movements_mean_ci95"] or (row["movements_mean"],) * 2 for row in its]
            axes.errorbar(
                mean,
                height,
                xerr=[
                    [value - low for value, (low, _) in zip(mean, bounds, strict=True)],
                    [high - value for value, (_, high) in zip(mean, bounds, strict=True)],
                ],
                color=color,
                marker=marker,
                markersize=3.5,
                linestyle="none",
                linewidth=0.8,
                label=controller,
            )
        axes.set(xscale="log", xlabel="mean movements", title=f"told F = {setting[0]:g} Hz, ρ = {setting[1]:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xticks([20, 30, 50, 100, 200, 500], ["20", "30", "50", "100", "200", "500"])
    panels[0].set_yticks(range(len(worlds)), worlds)
    panels[0].set_ylim(len(worlds) - 0.5, -0.5)
    _legend_below(figure, list(panels))
    return figure


def _styles(controllers: Any) -> dict[str, tuple[str, str, Any]]:
    """Colour, marker and line of each controller; the oracle, which is no controller one could fly, is grey."""
    names = list(dict.fromkeys(controllers))
    flown = [name for name in names if name != "oracle"]
    styles: dict[str, tuple[str, str, Any]] = {
        name: CONTROLLER_STYLES[number % len(CONTROLLER_STYLES)] for number, name in enumerate(flown)
    }
    return styles | ({"oracle": (ORACLE_COLOR, "_", "-")} if "oracle" in names else {})


def _place_title(place: tuple[float, float, str]) -> str:
    sampling_hz, correlation, world = place
    setting = f"F = {sampling_hz:g} Hz, ρ = {correlation:g}"
    return setting if world == "as told" else f"{setting}\n{world}"


def _legend_below(figure: Figure, panels: Sequence[Axes]) -> None:
    """One legend for all panels: what any of them shows."""
    shown: dict[str, Any] = {}
    for axes in panels:
        handles, labels = star_last(axes)
        shown |= {label: handle for handle, label in zip(handles, labels, strict=True) if label not in shown}
    columns = 5 if len(panels) > 1 else 3
    figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=columns, frameon=False)
