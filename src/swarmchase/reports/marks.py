"""What figures of movements are drawn with: distributions, values with their intervals, the paper's own values."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from ..evaluation.paper_results import SAMPLING_HZ
from ..evaluation.statistics import CONFIDENCE

ORACLE_COLOR = "#808080"
STATED = "stated in the paper"
MOST_SHOWN = 220
FORMATS = (".png", ".pdf")


def draw_cdf(axes: Axes, values: Sequence[float | int], color: str, line: str, label: str) -> None:
    """Share of the chases that needed at most so many movements, or so long, with its 95 % band."""
    ordered = np.sort(np.asarray(values))
    share = np.arange(1, len(ordered) + 1) / len(ordered)
    band = math.sqrt(math.log(2 / (1 - CONFIDENCE)) / (2 * len(ordered)))
    axes.step(ordered, share, where="post", color=color, linestyle=line, linewidth=1, label=label)
    axes.fill_between(
        ordered,
        np.clip(share - band, 0, 1),
        np.clip(share + band, 0, 1),
        step="post",
        color=color,
        alpha=0.15,
        linewidth=0,
    )


def draw_with_bars(
    axes: Axes,
    rows: Sequence[dict[str, Any]],
    values: Sequence[float],
    intervals: Sequence[Sequence[float] | None],
    color: str,
    marker: str,
    line: str,
    face: str,
    label: str,
) -> None:
    """One value for each row against its F, with its interval."""
    if not rows:
        return
    bounds = [interval or (value, value) for value, interval in zip(values, intervals, strict=True)]
    below = [value - low for value, (low, _) in zip(values, bounds, strict=True)]
    above = [high - value for value, (_, high) in zip(values, bounds, strict=True)]
    axes.errorbar(
        [row["sampling_hz"] for row in rows],
        values,
        [below, above],
        color=color,
        marker=marker,
        markersize=4,
        markerfacecolor=face,
        linestyle=line,
        linewidth=1,
        capsize=2,
        label=label,
    )


def sampling_axis(axes: Axes) -> None:
    """F on a logarithmic axis with the paper's four values."""
    axes.set(xscale="log", xlabel="sampling frequency F (Hz)")
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticks(SAMPLING_HZ, [f"{sampling_hz:g}" for sampling_hz in SAMPLING_HZ])


def star_last(axes: Axes) -> tuple[list[Any], list[Any]]:
    """Handles and labels of a legend."""
    handles, labels = axes.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda number: labels[number].startswith(STATED))
    return [handles[number] for number in order], [labels[number] for number in order]


def mark_stated(axes: Axes, x: float | int, y: float | int, color: str, label: str = STATED) -> None:
    """A star where the paper states a value; named once in the legend."""
    named = any(line.get_label() == label for line in axes.get_lines())
    axes.plot(
        [x],
        [y],
        marker="*",
        markersize=9,
        color=color,
        markeredgecolor="white",
        markeredgewidth=0.5,
        linestyle="none",
        label=None if named else label,
        zorder=5,
    )
