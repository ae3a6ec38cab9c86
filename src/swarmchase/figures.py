"""Figures: each a function of what lies on disk. Nothing here simulates."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .files import atomic_path

TRACKER_NAMES = ("+x", "-x", "+y", "-y", "+z", "-z")
TRACKER_COLORS = ("#0072B2", "#56B4E9", "#D55E00", "#E69F00", "#009E73", "#CC79A7")
"""Okabe and Ito's colours, distinguishable without colour vision; opposite trackers share a hue's family."""
STYLE: Any = {
    "font.size": 8,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def draw_chase(log: dict[str, Any], path: Path) -> None:
    """The path in 3-D, the six RSSI traces and the distance to the target, from a chase's log, as PNG or PDF."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10, 5), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(1.1, 1))
        _draw_path(figure.add_subplot(grid[:, 0], projection="3d"), log)
        rssi_axes = figure.add_subplot(grid[0, 1])
        _draw_rssi(rssi_axes, log)
        _draw_distance(figure.add_subplot(grid[1, 1], sharex=rssi_axes), log)
        ending = f"{'reached' if log['reached'] else 'not reached'} in {log['movements']} movements"
        scenario = log["scenario"]
        figure.suptitle(
            f"Controller {log['controller']}, F = {scenario['sampling_hz']:g} Hz, "
            f"ρ = {scenario['spatial_correlation']:g}, seed {log['seed']}, chase {log['chase']}: {ending}"
        )
        with atomic_path(path) as temporary:
            figure.savefig(temporary, format=path.suffix.lstrip("."), dpi=150)


def _draw_path(axes: Any, log: dict[str, Any]) -> None:
    x, y, z = zip(*(moment["center_m"] for moment in log["moments"]), strict=True)
    axes.plot(x, y, z, color="black", linewidth=1, marker="o", markersize=2.5, label="centre of the swarm")
    axes.scatter(*([value] for value in (x[0], y[0], z[0])), color="#0072B2", s=40, label="start")
    axes.scatter(*([value] for value in log["target_position_m"]), color="#D55E00", marker="*", s=140, label="target")
    axes.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
    axes.set_aspect("equal")
    axes.legend(loc="upper left", frameon=False)


def _draw_rssi(axes: Axes, log: dict[str, Any]) -> None:
    """The windows one after another; each movement's samples fill the unit before it."""
    moments = log["moments"]
    samples = len(moments[0]["rssi_dbm"])
    movement = [moment["movement"] + sample / samples for moment in moments for sample in range(samples)]
    for tracker, (name, color) in enumerate(zip(TRACKER_NAMES, TRACKER_COLORS, strict=True)):
        rssi_dbm = [sample[tracker] for moment in moments for sample in moment["rssi_dbm"]]
        axes.plot(movement, rssi_dbm, color=color, linewidth=0.6, label=name)
    axes.set_ylabel("RSSI (dBm)")
    axes.legend(
        title="tracker", ncols=6, loc="lower right", handlelength=1.2, columnspacing=1, title_fontsize=7, fontsize=7
    )


def _draw_distance(axes: Axes, log: dict[str, Any]) -> None:
    movement = [moment["movement"] for moment in log["moments"]]
    axes.plot(
        movement, [moment["distance_m"] for moment in log["moments"]], color="black", label="distance to the target"
    )
    axes.step(
        movement,
        [moment["spacing_m"] for moment in log["moments"]],
        where="post",
        color="#009E73",
        linestyle="--",
        label="spacing",
    )
    axes.axhline(log["scenario"]["success_radius_m"], color="#D55E00", linestyle=":", label="success radius")
    axes.set(xlabel="movement", ylabel="m", ylim=(0, None))
    axes.legend(loc="upper right", frameon=False)
