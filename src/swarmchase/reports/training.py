"""The learning curves of a training, from its log."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .style import PAGE_WIDTH_INCHES, STYLE, save_figure

REWARD_CHASES = 100
"""Chases that a point of the training's reward curve averages, as in Fig. 4 of the paper."""
NETWORK_COLORS = ("#000000", "#0072B2", "#D55E00", "#00694E")


def draw_training(chases: Sequence[dict[str, Any]], evaluations: Sequence[dict[str, Any]], path: Path) -> None:
    """How a training went, from its log: reward per movement of the four networks, and the evaluations' movements.

    Rewards are averaged over ``REWARD_CHASES`` chases, as in Fig. 4 of the paper, or over all where there are less.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(PAGE_WIDTH_INCHES, 2.6), layout="constrained")
        reward_axes, movement_axes = figure.subplots(1, 2)
        draw_rewards(reward_axes, chases)
        update = [evaluation["update"] for evaluation in evaluations]
        movement_axes.plot(
            update,
            [one["movements_p90"] for one in evaluations],
            color="black",
            marker="o",
            markersize=3,
            label="90th percentile",
        )
        movement_axes.plot(
            update,
            [one["movements_mean"] for one in evaluations],
            color="#0072B2",
            linestyle="--",
            marker="s",
            markersize=3,
            label="mean",
        )
        movement_axes.set(xlabel="updates of the global networks", ylabel="movements", ylim=(0, None))
        movement_axes.legend(frameon=False)
        save_figure(figure, path, "training")


def draw_rewards(axes: Axes, chases: Sequence[dict[str, Any]]) -> None:
    """Reward per movement of the four networks, from the chases of a training's log."""
    averaged = min(REWARD_CHASES, len(chases))
    update = [chase["update"] for chase in chases[averaged - 1 :]]
    for network, (name, color, line) in enumerate(zip("dxyz", NETWORK_COLORS, ("-", "--", "-.", ":"), strict=True)):
        won_m = np.cumsum([0.0] + [chase["reward_m"][network] for chase in chases])
        made = np.cumsum([0.0] + [chase["movements"] for chase in chases])
        mean_m = (won_m[averaged:] - won_m[:-averaged]) / (made[averaged:] - made[:-averaged])
        axes.plot(update, mean_m, color=color, linestyle=line, label=f"θ$^{name}$")
    axes.set(xlabel="updates of the global networks", ylabel=f"reward per movement (m),\nmean of {averaged} chases")
    axes.legend(frameon=False, ncols=2)
