"""The picture of one chase, from its log on disk."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .flight_paths import is_told_in_seconds
from .moving_chase import draw_moving_chase
from .style import (
    PAGE_WIDTH_INCHES,
    STYLE,
    TARGET_COLOR,
    TRACKER_COLORS,
    TRACKER_MARKERS,
    TRACKER_NAMES,
    save_figure,
)

START_COLOR = "#0072B2"
SHADOW_COLOR = "#B0B0B0"
MOST_MARKERS = 25


def draw_chase(log: dict[str, Any], path: Path) -> None:
    """The path in 3-D, the six RSSI traces, distance and spacing, from a chase's log, as PNG or PDF.

    A chase that is measured by the clock has a picture of its own: ``moving_chase``.
    """
    if is_told_in_seconds(log):
        draw_moving_chase(log, path)
        return
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(PAGE_WIDTH_INCHES, 4.2), layout="constrained")
        grid = figure.add_gridspec(3, 2, width_ratios=(1, 1.15), height_ratios=(2.1, 1.3, 0.8))
        _draw_path(figure.add_subplot(grid[:, 0], projection="3d"), log)
        rssi_axes = figure.add_subplot(grid[0, 1])
        distance_axes = figure.add_subplot(grid[1, 1], sharex=rssi_axes)
        spacing_axes = figure.add_subplot(grid[2, 1], sharex=rssi_axes)
        _draw_rssi(rssi_axes, log)
        _draw_distance(distance_axes, log)
        _draw_spacing(spacing_axes, log)
        for axes in (rssi_axes, distance_axes):
            axes.tick_params(labelbottom=False)
        figure.align_ylabels([rssi_axes, distance_axes, spacing_axes])
        title = _title(log)
        figure.suptitle(title, fontsize=8)
        save_figure(figure, path, title)


def _title(log: dict[str, Any]) -> str:
    scenario = log["scenario"]
    ending = f"{'reached' if log['reached'] else 'not reached'} in {log['movements']} movements"
    return (
        f"Controller {Path(log['controller']).name}, F = {scenario['sampling_hz']:g} Hz, "
        f"ρ = {scenario['spatial_correlation']:g}, seed {log['seed']}, chase {log['chase']}: {ending}"
    )


def _draw_path(axes: Any, log: dict[str, Any]) -> None:
    """The way of the centre, and its shadow on the floor of the box."""
    x, y, z = zip(*(moment["center_m"] for moment in log["moments"]), strict=True)
    target = log["target_position_m"]
    _make_cube(axes, [[*coordinates, goal] for coordinates, goal in zip((x, y, z), target, strict=True)])
    floor = axes.get_zlim()[0]
    axes.plot(x, y, [floor] * len(z), color=SHADOW_COLOR, linewidth=0.8)
    axes.plot(*([value] * 2 for value in target[:2]), [floor, target[2]], color=SHADOW_COLOR, linewidth=0.8, ls=":")
    axes.plot(x, y, z, color="black", linewidth=1, marker="o", markersize=2, label="centre of the swarm")
    start, goal = ([value] for value in (x[0], y[0], z[0])), ([value] for value in target)
    axes.scatter(*start, color=START_COLOR, marker="s", s=28, depthshade=False, label="start")
    axes.scatter(
        *goal, color=TARGET_COLOR, edgecolor="black", linewidth=0.5, marker="*", s=110, depthshade=False, label="target"
    )
    axes.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.03), ncols=3, frameon=False, handletextpad=0.4)


def _make_cube(axes: Any, coordinates: Sequence[Sequence[float]]) -> None:
    """A metre is as long on every axis, and the box is the same for every chase."""
    half = 0.54 * max(max(values) - min(values) for values in coordinates)
    for axis, set_limits, values in zip(
        (axes.xaxis, axes.yaxis, axes.zaxis), (axes.set_xlim, axes.set_ylim, axes.set_zlim), coordinates, strict=True
    ):
        center = (max(values) + min(values)) / 2
        set_limits(center - half, center + half)
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axis.labelpad = 0
    axes.tick_params(pad=0)
    axes.set_box_aspect((1, 1, 1), zoom=0.95)


def _draw_rssi(axes: Axes, log: dict[str, Any]) -> None:
    """The windows one after another, each around its movement, and the mean of each."""
    moments = log["moments"]
    samples = len(moments[0]["rssi_dbm"])
    gap = float("nan")
    place = [moment["movement"] + sample / samples - 0.5 for moment in moments for sample in range(samples + 1)]
    trackers = zip(TRACKER_NAMES, TRACKER_COLORS, TRACKER_MARKERS, strict=True)
    for tracker, (name, color, marker) in enumerate(trackers):
        traces = [[sample[tracker] for sample in moment["rssi_dbm"]] for moment in moments]
        axes.plot(place, [value for trace in traces for value in (*trace, gap)], color=color, linewidth=0.4, alpha=0.45)
        axes.plot(
            [moment["movement"] for moment in moments],
            [sum(trace) / samples for trace in traces],
            color=color,
            linewidth=0.8,
            marker=marker,
            markersize=3,
            markerfacecolor=color if name.startswith("+") else "white",
            markeredgewidth=0.7,
            markevery=max(1, len(moments) // MOST_MARKERS),
            label=name,
        )
    axes.set_ylabel("RSSI (dBm)")
    axes.legend(
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=6,
        frameon=False,
        handlelength=1.6,
        columnspacing=1.2,
        title="tracker: samples (thin) and the mean of each window",
        title_fontsize=7,
    )


def _draw_distance(axes: Axes, log: dict[str, Any]) -> None:
    moments = log["moments"]
    axes.plot(
        [moment["movement"] for moment in moments],
        [moment["distance_m"] for moment in moments],
        color="black",
        linewidth=1,
        marker="o",
        markersize=2,
        markevery=max(1, len(moments) // MOST_MARKERS),
    )
    radius_m = log["scenario"]["success_radius_m"]
    axes.axhline(radius_m, color=TARGET_COLOR, linestyle=":", linewidth=1)
    axes.set_title(f"dotted: success within {radius_m:g} m", fontsize=7, loc="right", pad=2)
    # Somewhat below nothing, so that the radius and the end stand free of the axis.
    highest_m = max(radius_m, *(moment["distance_m"] for moment in moments))
    axes.set(ylabel="distance (m)", ylim=(-0.05 * highest_m, 1.05 * highest_m))


def _draw_spacing(axes: Axes, log: dict[str, Any]) -> None:
    moments = log["moments"]
    first, last = moments[0]["movement"] - 0.5, moments[-1]["movement"] + 0.5
    axes.step(
        [first, *(moment["movement"] + 0.5 for moment in moments)],
        [moments[0]["spacing_m"], *(moment["spacing_m"] for moment in moments)],
        where="pre",
        color="#009E73",
        linewidth=1,
    )
    choices_m = log["scenario"]["spacing_choices_m"]
    axes.set(
        xlabel="movement", ylabel="spacing (m)", ylim=(0, 1.15 * max(*choices_m, log["scenario"]["initial_spacing_m"]))
    )
    axes.set_xlim(first, last)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
