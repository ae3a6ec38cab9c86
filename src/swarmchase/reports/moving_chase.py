"""The picture of a chase that is measured by the clock, from its log on disk: as wide as a column of the journal."""

import math
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from .flight_paths import FlightPaths, flight_paths
from .plan_view import CENTER_STYLE, TARGET_STYLE, draw_end, draw_path, draw_start, set_view
from .style import (
    COLUMN_WIDTH_INCHES,
    STYLE,
    TARGET_COLOR,
    TRACKER_COLORS,
    TRACKER_MARKERS,
    TRACKER_NAMES,
    save_figure,
)

PLAN_HEIGHT_SHARE = 0.9
"""Of the plan's width."""
MARK_EVERY_S = (2, 10, 30, 60, 300, 600, 3600)
"""Paths are marked every so many seconds: the first that makes at most ``MOST_MARKS``."""
MOST_MARKS = 12
MARK_APART_SHARE = 0.06
"""Of the view's width: a mark nearer to another one goes without its number."""
MOST_MEANS = 42
"""A tracker's level is drawn as so many means; each has the marker of one tracker, since levels lie close together."""
BELIEF_COLOR = "#7B3294"
LEAST_SHOWN_M = 0.1
"""Of the belief: what is less does not matter to the eye."""
END_SHARE = 1.03
"""Of the chase's length, so that what ends it stands free of the edge."""


def draw_moving_chase(log: dict[str, Any], path: Path) -> None:
    """Both paths from above, and over time their heights, their distance, the controller's belief if it has one, and
    the six trackers' levels, from the log of a chase that is measured by the clock, as PNG or PDF.
    """
    paths = flight_paths(log)
    with mpl.rc_context(STYLE):
        beliefs = _beliefs(log)
        heights = (2.8, 0.8, 0.9, 0.9, 1.2) if beliefs else (2.8, 0.8, 0.9, 1.2)
        figure = Figure(figsize=(COLUMN_WIDTH_INCHES, 8.2 if beliefs else 7.2), layout="constrained")
        grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
        plan_axes = figure.add_subplot(grid[0])
        level_axes = figure.add_subplot(grid[len(heights) - 1])
        height_axes, distance_axes, *belief_axes = (
            figure.add_subplot(grid[row], sharex=level_axes) for row in range(1, len(heights) - 1)
        )
        _draw_plan(plan_axes, paths)
        _draw_height(height_axes, paths)
        _draw_distance(distance_axes, log, paths)
        for axes in belief_axes:
            _draw_belief(axes, beliefs)
        _draw_levels(level_axes, log)
        for axes in (height_axes, distance_axes, *belief_axes):
            axes.tick_params(labelbottom=False)
        level_axes.set(xlabel=paths.clock_label, xlim=(0, END_SHARE * paths.clock[-1]))
        figure.align_ylabels([plan_axes, height_axes, distance_axes, *belief_axes, level_axes])
        lines = _title_lines(log)
        figure.suptitle("\n".join(lines), fontsize=8)
        save_figure(figure, path, ", ".join(lines))


def _title_lines(log: dict[str, Any]) -> list[str]:
    scenario = log["scenario"]
    behaviour = Path(scenario.get("behaviour", "hover")).name
    target = f"{behaviour}, {scenario['target_speed_mps']:g} m/s" if "target_speed_mps" in scenario else behaviour
    ending = f"reached in {log['capture_s']:.1f} s" if log["reached"] else f"not reached in {log['capture_s']:.0f} s"
    return [
        f"Controller {Path(log['controller']).name}, target ({target}) {ending}",
        f"F = {scenario['sampling_hz']:g} Hz, ρ = {scenario['spatial_correlation']:g}, "
        f"seed {log['seed']}, chase {log['chase']}",
    ]


def _draw_plan(axes: Axes, paths: FlightPaths) -> None:
    set_view(axes, paths.from_above_m, PLAN_HEIGHT_SHARE)
    every_s = _mark_every_s(paths.clock[-1])
    mark_s = np.arange(every_s, paths.clock[-1], every_s)
    apart_m = MARK_APART_SHARE * (axes.get_xlim()[1] - axes.get_xlim()[0])
    ends_m = np.concatenate([place_m[[0, -1], :2] for place_m in (paths.center_m, paths.target_m)])
    taken_m = list(ends_m)
    for style, place_m, side in ((TARGET_STYLE, paths.target_m, -1), (CENTER_STYLE, paths.center_m, 1)):
        draw_path(axes, style, place_m[:, :2])
        marks_m = np.column_stack([np.interp(mark_s, paths.clock, place_m[:, axis]) for axis in (0, 1)])
        axes.plot(*marks_m.T, linestyle="none", marker=style.marker, markersize=3, color=style.color)
        for time_s, mark_m in zip(mark_s, marks_m, strict=True):
            if all(math.dist(mark_m, other_m) > apart_m for other_m in taken_m):
                taken_m.append(mark_m)
                _draw_number(axes, f"{time_s:g}", mark_m, side, style.color)
    for style, place_m in ((CENTER_STYLE, paths.center_m), (TARGET_STYLE, paths.target_m)):
        draw_start(axes, style, place_m[:, :2])
        draw_end(axes, style, place_m[:, :2])
    axes.legend(
        handles=[CENTER_STYLE.handle(), TARGET_STYLE.handle()],
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=2,
        frameon=False,
        title=f"hollow: start, filled: end, between them a mark every {every_s} s",
        title_fontsize=7,
    )


def _draw_number(axes: Axes, number: str, place_m: NDArray[np.float64], side: int, color: str) -> None:
    """On the right of the place (1) or on its left (-1)."""
    axes.annotate(
        number,
        place_m.tolist(),
        (4 * side, 0),
        textcoords="offset points",
        fontsize=6,
        color=color,
        ha="left" if side > 0 else "right",
        va="center",
    )


def _mark_every_s(duration_s: float) -> int:
    return next((every_s for every_s in MARK_EVERY_S if duration_s / every_s <= MOST_MARKS), MARK_EVERY_S[-1])


def _draw_height(axes: Axes, paths: FlightPaths) -> None:
    for style, place_m in ((CENTER_STYLE, paths.center_m), (TARGET_STYLE, paths.target_m)):
        draw_path(axes, style, np.column_stack([paths.clock, place_m[:, 2]]))
    axes.set_ylabel("height (m)")
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))


def _draw_distance(axes: Axes, log: dict[str, Any], paths: FlightPaths) -> None:
    """The target is reached between two decisions; there the line ends, or the chase goes on."""
    radius_m = log["scenario"]["success_radius_m"]
    time_s, distance_m = paths.clock.copy(), paths.distance_m
    note = f"dotted: success within {radius_m:g} m"
    if log["reached"]:
        capture, after = (log["capture_s"], radius_m), int(np.searchsorted(time_s, log["capture_s"]))
        if after >= len(time_s) - 1:
            time_s[-1], distance_m[-1] = capture
        else:
            time_s, distance_m = np.insert(time_s, after, capture[0]), np.insert(distance_m, after, capture[1])
        axes.plot(*capture, marker="*", ms=9, color=TARGET_COLOR, mec="black", mew=0.5, zorder=5)
        note += ", star: reached"
    axes.plot(time_s, distance_m, color="black", linewidth=1)
    axes.axhline(radius_m, color=TARGET_COLOR, linestyle=":", linewidth=1)
    axes.set_title(note, fontsize=7, loc="right", pad=2)
    # Somewhat below nothing, so that the radius and the star stand free of the axis.
    highest_m = max(distance_m.max(), radius_m)
    axes.set(ylabel="distance (m)", ylim=(-0.08 * highest_m, 1.05 * highest_m))


def _beliefs(log: dict[str, Any]) -> list[tuple[float, dict[str, Any]]]:
    """What the controller believed, and when."""
    moments = log["moments"]
    times_s = [moment["time_s"] for moment in moments]
    # Of the moment before; logs of earlier versions have none.
    beliefs = [moment.get("belief") for moment in moments[1:]]
    return [(time_s, belief) for time_s, belief in zip(times_s, beliefs, strict=False) if belief is not None]


def _draw_belief(axes: Axes, beliefs: list[tuple[float, dict[str, Any]]]) -> None:
    """How far off it was, and how far it said that it might be."""
    time_s = np.array([time_s for time_s, _ in beliefs])
    radius_m, error_m = (np.array([belief[what] for _, belief in beliefs]) for what in ("radius_m", "error_m"))
    is_missed = ~np.array([belief["is_held"] for _, belief in beliefs])
    axes.plot(time_s, radius_m, color=BELIEF_COLOR, linewidth=1, linestyle="--", label="95 % region")
    axes.plot(time_s, error_m, color="black", linewidth=1, label="error")
    axes.plot(time_s[is_missed], error_m[is_missed], linestyle="none", marker="x", color=TARGET_COLOR, markersize=3)
    least_m = max(min(radius_m.min(), error_m.min()), LEAST_SHOWN_M)
    axes.set(ylabel="belief (m)", yscale="log")
    axes.set_ylim(0.6 * least_m, 2 * max(radius_m.max(), error_m.max(), least_m))
    axes.legend(
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=2,
        frameon=False,
        title="cross: target outside the 95 % region" if is_missed.any() else None,
        title_fontsize=7,
    )


def _draw_levels(axes: Axes, log: dict[str, Any]) -> None:
    """Every sample, thin, and means of as many windows each as make ``MOST_MEANS`` of them."""
    moments = log["moments"]
    sample_s = np.array([moment["sample_time_s"] for moment in moments])
    level_dbm = np.array([moment["rssi_dbm"] for moment in moments], dtype=np.float64)
    windows = math.ceil(len(moments) / MOST_MEANS)
    trackers = zip(TRACKER_NAMES, TRACKER_COLORS, TRACKER_MARKERS, strict=True)
    for tracker, (name, color, marker) in enumerate(trackers):
        axes.plot(sample_s.ravel(), level_dbm[:, :, tracker].ravel(), color=color, linewidth=0.3, alpha=0.35)
        axes.plot(
            _means(sample_s, windows),
            _means(level_dbm[:, :, tracker], windows),
            color=color,
            linestyle="-" if name.startswith("+") else "--",
            linewidth=0.8,
            marker=marker,
            markersize=3,
            markerfacecolor=color if name.startswith("+") else "white",
            markeredgewidth=0.7,
            markevery=(tracker, len(TRACKER_NAMES)),
            label=name,
        )
    axes.set_ylabel("level (dBm)")
    axes.legend(
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=6,
        frameon=False,
        handlelength=1.4,
        columnspacing=0.8,
        handletextpad=0.4,
        title=f"tracker: samples (thin) and means of {windows} window{'s' if windows > 1 else ''}",
        title_fontsize=7,
    )


def _means(values: NDArray[np.float64], windows: int) -> NDArray[np.float64]:
    """[window, sample] to a mean of every so many windows, the last of fewer; NaN where nothing was heard."""
    cuts = range(0, len(values), windows)
    means = [np.ma.masked_invalid(values[cut : cut + windows]).mean() for cut in cuts]
    return np.array([np.nan if mean is np.ma.masked else mean for mean in means])
