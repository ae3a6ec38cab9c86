"""What figures of movements are drawn with: distributions, values with their intervals, the paper's own values."""

import bisect
import math
from collections.abc import Iterable, Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import LogFormatter, NullLocator

from ..evaluation.paper_results import SAMPLING_HZ
from ..evaluation.statistics import CONFIDENCE

ORACLE_COLOR = "#808080"
STATED = "stated in the paper"
BARS = "bars: 95 % confidence intervals"
BANDS = "shaded: 95 % confidence bands"
MOST_SHOWN = 240
"""Movements: chases beyond, failed ones among them, are what a curve lacks of 1 there."""
MOVEMENT_TICKS = (1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 60, 80, 120, 160, 240, 320, 500, 700, 1000, 2000, 5000, 10_000)
FEW_MOVEMENT_TICKS = (1, 2, 4, 8, 15, 30, 60, 120, 240, 500, 1000, 2000, 5000, 10_000)
EDGE = 1.04
"""By which an axis goes on behind its first and last tick: a marker there is whole."""
ROUND_MOVEMENT_TICKS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000)
FORMATS = (".png", ".pdf")


def draw_cdf(
    axes: Axes,
    values: Sequence[float | int],
    span: tuple[float | int, float | int],
    color: str,
    line: Any,
    label: str,
) -> None:
    """Share of the chases that needed at most so many movements, or so long, with its 95 % band.

    It rises with the first chase, and ends with the last or, where some needed more than the ``span`` that is shown,
    with that. Where all did, it is none from the one end to the other.
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    share = np.arange(1, len(ordered) + 1) / len(ordered)
    band = math.sqrt(math.log(2 / (1 - CONFIDENCE)) / (2 * len(ordered)))
    begin, end = span
    is_shown = ordered <= end
    first = ordered[0] if is_shown[0] else begin
    place, share = np.append(first, ordered[is_shown]), np.append(0.0, share[is_shown])
    if not is_shown[-1]:
        place, share = np.append(place, end), np.append(share, share[-1])
    axes.step(place, share, where="post", color=color, linestyle=line, linewidth=1, label=label)
    axes.fill_between(
        place,
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
    beside: float = 1.0,
) -> None:
    """One value for each row against its F times ``beside``, with its interval."""
    if not rows:
        return
    bounds = [interval or (value, value) for value, interval in zip(values, intervals, strict=True)]
    below = [value - low for value, (low, _) in zip(values, bounds, strict=True)]
    above = [high - value for value, (_, high) in zip(values, bounds, strict=True)]
    axes.errorbar(
        [beside * row["sampling_hz"] for row in rows],
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


def sampling_axis(axes: Axes, frequencies_hz: Sequence[float] = SAMPLING_HZ) -> None:
    """F on a logarithmic axis with these values, the paper's four unless others are given."""
    axes.set(xscale="log", xlabel="sampling frequency F (Hz)")
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticks(frequencies_hz, [f"{sampling_hz:g}" for sampling_hz in frequencies_hz])


def movement_axis(
    axes: Axes, which: Literal["x", "y"], values: Iterable[float | int], ticks: Sequence[int] = MOVEMENT_TICKS
) -> None:
    """Movements on a logarithmic axis that begins and ends at a tick, with all values between the two."""
    known = list(values)
    first = max(bisect.bisect_right(ticks, min(known)) - 1, 0)
    last = min(max(bisect.bisect_left(ticks, max(known)), first + 1), len(ticks) - 1)
    shown = ticks[first : last + 1]
    axes.set(**{f"{which}scale": "log", f"{which}lim": (shown[0] / EDGE, shown[-1] * EDGE)})
    axis = axes.xaxis if which == "x" else axes.yaxis
    axis.set_minor_locator(NullLocator())
    axis.set_ticks(shown, [f"{tick}" for tick in shown])


class PlainLogFormatter(LogFormatter):
    """Labels where matplotlib has them on a logarithmic axis, as 4 and 10 instead of powers of ten."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """The label of a tick, empty where it has none."""
        return f"{x:g}" if super().__call__(x, pos) else ""


def label_plainly(axis: Axis) -> None:
    """Numbers on a logarithmic axis as they stand in text and tables."""
    axis.set_major_formatter(PlainLogFormatter())
    axis.set_minor_formatter(PlainLogFormatter())


def end_at_a_tick(axes: Axes) -> None:
    """The y axis from nothing to just over the first tick above all that is drawn."""
    highest = axes.dataLim.y1 if axes.dataLim.y1 > 0 else 1.0
    ticks = np.asarray(axes.yaxis.get_major_locator().tick_values(0, highest))
    axes.set_ylim(0, EDGE * ticks[ticks >= highest][0])


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
