"""The learning curves of a training, from its log, and of several beside each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from ..evaluation.paper_results import MOVEMENTS_P90
from .marks import STATED, end_at_a_tick
from .style import CONTROLLER_STYLES, PAGE_WIDTH_INCHES, STYLE, save_figure

REWARD_CHASES = 100
"""Chases that a point of the training's reward curve averages, as in Fig. 4 of the paper."""
NETWORK_COLORS = ("#000000", "#0072B2", "#D55E00", "#00694E")


def draw_training(chases: Sequence[dict[str, Any]], evaluations: Sequence[dict[str, Any]], path: Path) -> None:
    """How a training went, from its log: reward per movement of the four networks, and the evaluations' movements.

    Rewards are averaged over ``REWARD_CHASES`` chases, as in Fig. 4 of the paper, or over all where there are less.
    What there is nothing of has no panel.
    """
    with mpl.rc_context(STYLE):
        panels = [
            (draw, rows) for draw, rows in ((draw_rewards, chases), (_draw_movements, evaluations)) if len(rows) > 0
        ]
        figure = Figure(figsize=(PAGE_WIDTH_INCHES * len(panels) / 2, 2.6), layout="constrained")
        for axes, (draw, rows) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            draw(axes, rows)
        save_figure(figure, path, "training")


def draw_rewards(axes: Axes, chases: Sequence[dict[str, Any]]) -> None:
    """Reward per movement of the four networks, from the chases of a training's log; at least one."""
    averaged = min(REWARD_CHASES, len(chases))
    update = [chase["update"] for chase in chases[averaged - 1 :]]
    for network, (name, color, line) in enumerate(zip("dxyz", NETWORK_COLORS, ("-", "--", "-.", ":"), strict=True)):
        won_m = np.cumsum([0.0] + [chase["reward_m"][network] for chase in chases])
        made = np.cumsum([0.0] + [chase["movements"] for chase in chases])
        mean_m = (won_m[averaged:] - won_m[:-averaged]) / (made[averaged:] - made[:-averaged])
        # A line needs two points.
        axes.plot(
            update, mean_m, color=color, linestyle=line, marker="" if len(update) > 1 else "o", label=f"θ$^{name}$"
        )
    of = "1 chase" if averaged == 1 else f"mean of {averaged} chases"
    axes.set(xlabel="updates of the global networks", ylabel=f"reward per movement (m),\n{of}")
    axes.legend(frameon=False, ncols=2)


def _draw_movements(axes: Axes, evaluations: Sequence[dict[str, Any]]) -> None:
    """Large hollow marks around small filled ones: where the two are equal, as of chases that all fail, both are
    seen.
    """
    update = [evaluation["update"] for evaluation in evaluations]
    percentile: dict[str, Any] = {"label": "90th percentile", "color": "black", "marker": "o", "ms": 6, "mfc": "none"}
    mean: dict[str, Any] = {"label": "mean", "color": "#0072B2", "linestyle": "--", "marker": "s", "ms": 2.5}
    for measure, look in (("movements_p90", percentile), ("movements_mean", mean)):
        axes.plot(update, [evaluation[measure] for evaluation in evaluations], **look)
    axes.set(xlabel="updates of the global networks", ylabel="movements")
    end_at_a_tick(axes)
    axes.legend(frameon=False)


@dataclass(frozen=True)
class LearningPoint:
    """An evaluation in a training, beside others of other settings."""

    sampling_hz: float
    spatial_correlation: float
    variant: str
    """What of the training is not as in Table I; nothing where all is."""
    action_choice: str
    """"sampled" or "greedy" on fixed chases; "training": sampled, the chases of the training that ended since the point
    before."""
    update: int
    """Of the global networks; the evaluation is of the networks after it."""
    environment_steps: int
    """Movements made for these updates."""
    hours: float | None
    """Wall time when the evaluation was there, or of greedy ones when the networks were written; None where no log
    says it."""
    movements_mean: float
    movements_p90: float
    reached: float
    """Share of the chases."""

    @property
    def setting(self) -> tuple[float, float]:
        """(F, rho)."""
        return self.sampling_hz, self.spatial_correlation


_MEASURES = {"movements_p90": "90th percentile of movements", "movements_mean": "mean movements"}
_CLOCKS = {"update": "updates of the global networks", "environment_steps": "environment steps", "hours": "hours"}


def draw_learning_curves(points: Sequence[LearningPoint], path: Path) -> None:
    """90th percentile and mean against updates, steps and hours: for each setting and variant the
    evaluations with sampled actions, hollow marks for those with greedy ones, a thin line for the training's own
    chases, and what the paper states."""
    curves = list(dict.fromkeys((point.setting, point.variant) for point in points))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(PAGE_WIDTH_INCHES, 4.6), layout="constrained")
        panels = figure.subplots(len(_MEASURES), len(_CLOCKS), sharex="col", sharey=True)
        for row, (measure, measure_name) in zip(panels, _MEASURES.items(), strict=True):
            for axes, clock in zip(row, _CLOCKS, strict=True):
                for curve, (color, marker, line) in zip(curves, CONTROLLER_STYLES, strict=False):
                    of_curve = [point for point in points if (point.setting, point.variant) == curve]
                    _draw_curve(axes, of_curve, clock, measure, color, marker, line)
                    if measure == "movements_p90" and curve[0] in MOVEMENTS_P90 and not curve[1]:
                        axes.axhline(MOVEMENTS_P90[curve[0]], color=color, linewidth=0.6, linestyle=(0, (1, 3)))
                axes.set(xscale="log", yscale="log")
            row[0].set_ylabel(measure_name)
        for axes, name in zip(panels[-1], _CLOCKS.values(), strict=True):
            axes.set_xlabel(name)
        panels[0, 0].set_yticks([25, 50, 100, 200, 500], ["25", "50", "100", "200", "500"], minor=False)
        panels[0, 0].yaxis.set_minor_locator(NullLocator())
        panels[0, 0].plot(
            [], [], color="black", marker="o", markersize=4, markerfacecolor="none", linestyle="none", label="greedy"
        )
        panels[0, 0].plot([], [], color="black", linewidth=0.5, alpha=0.6, label="chases of the training")
        panels[0, 0].plot([], [], color="black", linewidth=0.6, linestyle=(0, (1, 3)), label=STATED)
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
        save_figure(figure, path, "learning curves of the paper's own training")


def _draw_curve(
    axes: Axes, points: Sequence[LearningPoint], clock: str, measure: str, color: str, marker: str, line: Any
) -> None:
    """One setting and variant."""
    name = f"F = {points[0].sampling_hz:g} Hz, rho = {points[0].spatial_correlation:g}"
    name += f", {points[0].variant}" * bool(points[0].variant)
    for choice, look in (
        ("training", {"linewidth": 0.5, "alpha": 0.6}),
        ("sampled", {"marker": marker, "markersize": 2.5, "linestyle": line, "linewidth": 0.8, "label": name}),
        ("greedy", {"marker": "o", "markersize": 4, "markerfacecolor": "none", "linestyle": "none"}),
    ):
        shown = [point for point in points if point.action_choice == choice and getattr(point, clock) is not None]
        axes.plot(
            [getattr(point, clock) for point in shown],
            [getattr(point, measure) for point in shown],
            color=color,
            markeredgewidth=0.6,
            **look,
        )
