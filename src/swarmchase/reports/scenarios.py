"""Scenarios and behaviours side by side, each as some of its chases look, from their logs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from .flight_paths import flight_paths
from .plan_view import CENTER_STYLE, TARGET_STYLE, draw_end, draw_path, draw_start, set_view
from .style import PAGE_WIDTH_INCHES, STYLE, TRACKER_COLORS, TRACKER_NAMES, save_figure

Log = dict[str, Any]

BAND_COLOR = "#EFE3D3"
"""Where targets may be: at the start, and the altitudes at which they fly."""
VIEW_SHARE = 1.12
"""Half of the view's width over the farthest start."""
BEHAVIOUR_COLUMNS = 4
LISTENERS = (0, 1)
"""Trackers whose levels are drawn: those on the x axis."""


def draw_scenarios(logs: Mapping[str, Sequence[Log]], path: Path, title: str) -> None:
    """One column a scenario: some chases from above and from the south, and what the trackers hear in the first one.

    Args:
        logs: of the chases, by the scenario's name.
        title: what was chased, which the file keeps.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(PAGE_WIDTH_INCHES, 5.2), layout="constrained")
        panels = figure.subplots(3, len(logs), height_ratios=(2.2, 1, 1.3), squeeze=False)
        for column, (name, chases) in enumerate(logs.items()):
            plan_axes, side_axes, level_axes = panels[:, column]
            _draw_chases(plan_axes, side_axes, chases)
            _draw_levels(level_axes, chases[0])
            plan_axes.set_title(name)
        for axes, label in zip(panels[:, 0], ("north (m)", "altitude (m)", "level (dBm)"), strict=True):
            axes.set_ylabel(label)
        heard = [
            Line2D(
                [], [], ls="none", marker=".", color=TRACKER_COLORS[tracker], label=f"heard by {TRACKER_NAMES[tracker]}"
            )
            for tracker in LISTENERS
        ]
        band = Patch(facecolor=BAND_COLOR, label="where targets may start; altitudes at which they fly")
        figure.legend(
            handles=[CENTER_STYLE.handle(), TARGET_STYLE.handle(), *heard, band],
            loc="outside upper center",
            ncols=5,
            columnspacing=1.2,
            frameon=False,
        )
        save_figure(figure, path, title)


def draw_behaviours(logs: Mapping[str, Log], path: Path, title: str) -> None:
    """One chase of each behaviour, from above.

    Args:
        logs: by the behaviour's name.
        title: what was chased, which the file keeps.
    """
    with mpl.rc_context(STYLE):
        rows = -(-len(logs) // BEHAVIOUR_COLUMNS)
        figure = Figure(figsize=(PAGE_WIDTH_INCHES, 0.3 + 1.9 * rows), layout="constrained")
        panels = figure.subplots(rows, BEHAVIOUR_COLUMNS, squeeze=False)
        for axes, (name, log) in zip(panels.flat, logs.items(), strict=False):
            paths = flight_paths(log)
            set_view(axes, paths.from_above_m, height_share=0.95)
            axes.set(title=f"{name}: {log['capture_s']:.0f} s", xlabel="", ylabel="")
            axes.set_xticks([])
            axes.set_yticks([])
            for style, place_m in ((CENTER_STYLE, paths.center_m), (TARGET_STYLE, paths.target_m)):
                draw_path(axes, style, place_m[:, :2])
                draw_start(axes, style, place_m[:, :2])
                draw_end(axes, style, place_m[:, :2])
        for axes in panels.flat[len(logs) :]:
            axes.set_visible(False)
        figure.legend(
            handles=[CENTER_STYLE.handle(), TARGET_STYLE.handle()], loc="outside upper center", ncols=2, frameon=False
        )
        save_figure(figure, path, title)


def _draw_chases(plan_axes: Axes, side_axes: Axes, chases: Sequence[Log]) -> None:
    """The region of the starts is shaded; altitudes are over the ground."""
    scenario = chases[0]["scenario"]
    nearest_m = scenario["start_distance_m"]
    farthest_m = scenario.get("farthest_start_m", nearest_m)
    altitude_m = scenario.get("start_altitude_m", 50.0)
    half_m = VIEW_SHARE * farthest_m
    angle = np.linspace(0, 2 * np.pi, 200)
    circle = np.array([np.cos(angle), np.sin(angle)])
    plan_axes.fill(*(farthest_m * circle), color=BAND_COLOR)
    if farthest_m > nearest_m:
        plan_axes.fill(*(nearest_m * circle), color="white")
        low_m, high_m = scenario["lowest_altitude_m"], scenario["highest_altitude_m"]
        side_axes.axhspan(low_m, high_m, color=BAND_COLOR)
        side_axes.set_ylim(0, high_m * VIEW_SHARE)
    else:
        side_axes.fill(farthest_m * circle[0], altitude_m + farthest_m * circle[1], color=BAND_COLOR)
    for log in chases:
        paths = flight_paths(log)
        for style, place_m in ((CENTER_STYLE, paths.center_m), (TARGET_STYLE, paths.target_m)):
            above_m, side_m = place_m[:, :2], np.column_stack([place_m[:, 0], altitude_m + place_m[:, 2]])
            for axes, way_m in ((plan_axes, above_m), (side_axes, side_m)):
                draw_path(axes, style, way_m).set_linewidth(0.7)
                axes.plot(*way_m[0], marker=style.marker, markersize=3, color=style.color)
    plan_axes.set(xlim=(-half_m, half_m), ylim=(-half_m, half_m), aspect="equal")
    side_axes.set(xlim=(-half_m, half_m), xlabel="east (m)")
    for axis in (plan_axes.xaxis, plan_axes.yaxis, side_axes.xaxis):
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))


def _draw_levels(axes: Axes, log: Log) -> None:
    """Every sample of the trackers on the x axis; what is missing is not there."""
    level_dbm = np.concatenate([np.array(moment["rssi_dbm"], dtype=np.float64) for moment in log["moments"]])
    sample_s, label = _sample_times(log)
    for tracker in LISTENERS:
        axes.plot(sample_s, level_dbm[:, tracker], ".", markersize=2, markeredgewidth=0, color=TRACKER_COLORS[tracker])
    axes.set(xlabel=label, ylim=(-110, 0))


def _sample_times(log: Log) -> tuple[NDArray[np.float64], str]:
    """By the clock; of a chase that is measured by movements, in the order in which they were heard."""
    moments = log["moments"]
    if "sample_time_s" in moments[0]:
        return np.concatenate([np.array(moment["sample_time_s"]) for moment in moments]), "time (s)"
    samples = len(moments[0]["rssi_dbm"])
    return np.arange(len(moments) * samples) / samples - 0.5, "movement"
