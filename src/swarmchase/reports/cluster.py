"""The figures of a cluster from what lies on disk: how it scales, and how stale its gradients are."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .marks import end_at_a_tick
from .style import CONTROLLER_STYLES, PAGE_WIDTH_INCHES, STYLE, save_figure

STALENESS_UPDATES = 100
"""Updates that a point of the staleness curve averages."""


def draw_scaling(result: dict[str, Any], path: Path) -> None:
    """Updates a second as measured on one machine with the model's, and the model's movements a second on a rack.

    ``result`` is what ``benchmarks.cluster.measure`` gives.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(PAGE_WIDTH_INCHES, 2.8), layout="constrained")
        measured_axes, planned_axes = figure.subplots(1, 2)
        _draw_measured(measured_axes, result["measured"])
        _draw_planned(planned_axes, result["planned"])
        measured_axes.set_title(f"measured on {result['cores']} cores (points), model (lines)")
        planned_axes.set_title(f"model: {result['network_bits_per_s'] / 1e9:g} Gb/s, a core an agent")
        save_figure(figure, path, "Scaling of A3C on a cluster")


def draw_staleness(gradients: Sequence[dict[str, Any]], path: Path) -> None:
    """Updates behind of every gradient, from a run's log: against the update, and how often each."""
    updates_behind = np.array([line["updates_behind"] for line in gradients])
    update = np.array([line["update"] for line in gradients])
    averaged = min(STALENESS_UPDATES, len(update))
    mean = np.convolve(updates_behind, np.full(averaged, 1 / averaged), mode="valid")
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(PAGE_WIDTH_INCHES, 2.6), layout="constrained")
        curve_axes, count_axes = figure.subplots(1, 2)
        curve_axes.plot(update, updates_behind, color="#B0B0B0", linestyle="", marker=".", markersize=2, label="each")
        curve_axes.plot(update[averaged - 1 :], mean, color="black", label=f"mean of {averaged}")
        curve_axes.set(xlabel="updates of the global networks", ylabel="updates behind")
        curve_axes.legend(frameon=False)
        count_axes.bar(*np.unique(updates_behind, return_counts=True), color="#0072B2")
        count_axes.set(xlabel="updates behind", ylabel="gradients")
        for axis in (curve_axes.yaxis, count_axes.xaxis):
            axis.set_major_locator(MaxNLocator(integer=True))
        for axes in (curve_axes, count_axes):
            end_at_a_tick(axes)
        # Somewhat below nothing, so that marks there are whole.
        curve_axes.set_ylim(bottom=-0.03 * curve_axes.get_ylim()[1])
        save_figure(figure, path, "Staleness of the gradients")


def _draw_measured(axes: Axes, rows: Sequence[dict[str, Any]]) -> None:
    for (chases, interval), its, (color, marker, line) in _by_setting(rows):
        agents = [row["agents"] for row in its]
        axes.plot(agents, [row["updates_per_s"] for row in its], color=color, marker=marker, linestyle="", markersize=4)
        predicted = [row["predicted_updates_per_s"] for row in its]
        axes.plot(agents, predicted, color=color, linestyle=line, label=_setting(chases, interval))
    axes.set(xlabel="agents", ylabel="updates a second")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    end_at_a_tick(axes)
    axes.legend(frameon=False)


def _draw_planned(axes: Axes, rows: Sequence[dict[str, Any]]) -> None:
    for (chases, interval), its, (color, _marker, line) in _by_setting(rows):
        agents = [row["agents"] for row in its]
        steps_per_s = [row["steps_per_s"] for row in its]
        axes.plot(agents, steps_per_s, color=color, linestyle=line, label=_setting(chases, interval))
    axes.set(xlabel="agents", ylabel="movements a second", xscale="log", yscale="log")
    axes.legend(frameon=False)


def _by_setting(rows: Sequence[dict[str, Any]]) -> list[tuple[tuple[int, int], list[dict[str, Any]], Any]]:
    settings = list(dict.fromkeys((row["chases_per_agent"], row["update_interval"]) for row in rows))
    return [
        (setting, [row for row in rows if (row["chases_per_agent"], row["update_interval"]) == setting], style)
        for setting, style in zip(settings, CONTROLLER_STYLES, strict=False)
    ]


def _setting(chases: int, interval: int) -> str:
    return f"{chases} chase{'s' if chases > 1 else ''} an agent, T = {interval}"
