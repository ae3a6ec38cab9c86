"""Figs. 3 to 7 of the paper from the tables of ``reproduction``, with what the paper states marked by a star.

Nothing here simulates. Every figure is written as PNG and as PDF.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..evaluation.paper_results import MOVEMENTS_P90, SAMPLING_HZ, SPATIAL_CORRELATION, TRACKING_TIME_S
from .marks import (
    BANDS,
    BARS,
    FEW_MOVEMENT_TICKS,
    FORMATS,
    MOST_SHOWN,
    ORACLE_COLOR,
    draw_cdf,
    draw_with_bars,
    end_at_a_tick,
    mark_stated,
    movement_axis,
    sampling_axis,
    star_last,
)
from .style import PAGE_WIDTH_INCHES, STYLE, TRACKER_COLORS, TRACKER_MARKERS, TRACKER_NAMES, save_figure
from .training import draw_rewards

SAMPLING_STYLE = dict(
    zip(SAMPLING_HZ, (("#000000", "-"), ("#0072B2", "--"), ("#D55E00", "-."), ("#00694E", ":")), strict=True)
)
CORRELATION_STYLE = dict(zip(SPATIAL_CORRELATION, (("#0072B2", "s"), ("#D55E00", "^"), ("#000000", "o")), strict=True))
STATED_TIME = "stated in the paper (its speed is inferred)"

MovementsBySetting = Mapping[tuple[str, float, float], Sequence[int]]
"""Movements of every chase by (controller, F, rho)."""


def draw_all(
    folder: Path,
    fading: Sequence[dict[str, Any]],
    training_chases: Sequence[dict[str, Any]],
    movements: MovementsBySetting,
    summaries: Sequence[dict[str, Any]],
) -> list[Path]:
    """Draw the five figures into ``folder`` and return their PNG files.

    ``summaries`` are of the same evaluations as ``movements``.
    """
    figures: dict[str, Callable[[], Figure]] = {
        "fig3-fading": lambda: fading_figure(fading),
        "fig4-training-reward": lambda: reward_figure(training_chases),
        "fig5-movements": lambda: movement_figure(movements),
        "fig6-percentile": lambda: percentile_figure(summaries),
        "fig7-tracking-time": lambda: tracking_time_figure(summaries),
    }
    for name, make in figures.items():
        with mpl.rc_context(STYLE):
            figure = make()
            for suffix in FORMATS:
                save_figure(figure, folder / f"{name}{suffix}", name)
    return [folder / f"{name}.png" for name in figures]


def fading_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """Fig. 3: fading of the six trackers through one window, by setting."""
    settings = list(dict.fromkeys((row["sampling_hz"], row["spatial_correlation"]) for row in rows))
    figure = Figure(figsize=(PAGE_WIDTH_INCHES, 2.4), layout="constrained")
    panels = figure.subplots(1, len(settings), sharey=True, squeeze=False)[0]
    for axes, setting in zip(panels, settings, strict=True):
        for tracker, color in enumerate(TRACKER_COLORS):
            trace = [
                row
                for row in rows
                if (row["sampling_hz"], row["spatial_correlation"]) == setting and row["tracker"] == tracker
            ]
            axes.plot(
                [row["time_s"] for row in trace],
                [row["fading_db"] for row in trace],
                color=color,
                linewidth=0.9,
                marker=TRACKER_MARKERS[tracker],
                markersize=2.5,
                markerfacecolor=color if tracker % 2 == 0 else "white",
                markeredgewidth=0.6,
                markevery=3,
                label=TRACKER_NAMES[tracker],
            )
        axes.set(xlabel="time (s)", title=f"F = {setting[0]:g} Hz, ρ = {setting[1]:g}")
    panels[0].set_ylabel("fading (dB)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
    return figure


def reward_figure(chases: Sequence[dict[str, Any]]) -> Figure:
    """Fig. 4: reward of the four networks while they are trained by A3C."""
    figure = Figure(figsize=(PAGE_WIDTH_INCHES / 2, 2.4), layout="constrained")
    draw_rewards(figure.subplots(), chases)
    return figure


def movement_figure(movements: MovementsBySetting) -> Figure:
    """Fig. 5: distribution of the number of movements, with 95 % bands (Dvoretzky, Kiefer and Wolfowitz)."""
    figure = Figure(figsize=(PAGE_WIDTH_INCHES, 2.6), layout="constrained")
    panels = figure.subplots(1, len(SPATIAL_CORRELATION), sharey=True)
    span = min(map(min, movements.values())), MOST_SHOWN
    [oracle] = [values for (controller, _, _), values in movements.items() if controller == "oracle"]
    for axes, correlation in zip(panels, SPATIAL_CORRELATION, strict=True):
        draw_cdf(axes, oracle, span, ORACLE_COLOR, "-", "oracle")
        for sampling_hz, (color, line) in SAMPLING_STYLE.items():
            values = movements["paper", sampling_hz, correlation]
            draw_cdf(axes, values, span, color, line, f"F = {sampling_hz:g} Hz")
            stated = MOVEMENTS_P90.get((sampling_hz, correlation))
            if stated is not None:
                mark_stated(axes, stated, 0.9, color)
        axes.axhline(0.9, color="black", linewidth=0.4)
        axes.set(xlabel="movements", title=f"ρ = {correlation:g}", ylim=(0, 1.02))
        movement_axis(axes, "x", span, FEW_MOVEMENT_TICKS)
    panels[0].set_ylabel("share of chases")
    figure.legend(
        *star_last(panels[-1]),
        loc="outside lower center",
        ncols=6,
        frameon=False,
        title=BANDS,
        title_fontsize=7,
    )
    return figure


def percentile_figure(summaries: Sequence[dict[str, Any]]) -> Figure:
    """Fig. 6: 90th percentile of movements against F, with 95 % intervals."""
    figure = Figure(figsize=(PAGE_WIDTH_INCHES / 2, 3.4), layout="constrained")
    axes = figure.subplots()
    for correlation, (color, marker) in CORRELATION_STYLE.items():
        for controller, line, face in (("paper", "-", color), ("paper-a3c", ":", "white")):
            rows = _rows(summaries, controller, correlation)
            draw_with_bars(
                axes,
                rows,
                [row["movements_p90"] for row in rows],
                [row["movements_p90_ci95"] for row in rows],
                color,
                marker,
                line,
                face,
                f"ρ = {correlation:g}" + ("" if controller == "paper" else ", A3C"),
            )
    for (sampling_hz, correlation), stated in MOVEMENTS_P90.items():
        mark_stated(axes, sampling_hz, stated, CORRELATION_STYLE[correlation][0])
    [oracle] = [row for row in summaries if row["controller"] == "oracle"]
    axes.axhline(oracle["movements_p90"], color=ORACLE_COLOR, linewidth=1.2, label="oracle")
    sampling_axis(axes)
    axes.set_ylabel("90th percentile of movements")
    bounds = [bound for row in summaries for bound in row["movements_p90_ci95"] or [row["movements_p90"]]]
    movement_axis(axes, "y", [*bounds, *MOVEMENTS_P90.values()])
    figure.legend(*star_last(axes), loc="outside lower center", ncols=3, frameon=False, title=BARS, title_fontsize=7)
    return figure


def tracking_time_figure(summaries: Sequence[dict[str, Any]]) -> Figure:
    """Fig. 7: mean total tracking time against F for two speeds, with 95 % intervals."""
    speeds = list(summaries[0]["tracking_time_mean_s"])
    figure = Figure(figsize=(PAGE_WIDTH_INCHES, 2.6), layout="constrained")
    panels = figure.subplots(1, len(speeds), sharey=True)
    for axes, speed in zip(panels, speeds, strict=True):
        for correlation, (color, marker) in CORRELATION_STYLE.items():
            rows = _rows(summaries, "paper", correlation)
            draw_with_bars(
                axes,
                rows,
                [row["tracking_time_mean_s"][speed] for row in rows],
                [row["tracking_time_mean_s_ci95"][speed] for row in rows],
                color,
                marker,
                "-",
                color,
                f"ρ = {correlation:g}",
            )
            if speed == "5":
                for (sampling_hz, stated_correlation), stated in TRACKING_TIME_S.items():
                    if stated_correlation == correlation:
                        mark_stated(axes, sampling_hz, stated, color, STATED_TIME)
        _draw_oracle_time(axes, summaries, float(speed))
        sampling_axis(axes)
        axes.set_title(f"v = {speed} m/s")
    end_at_a_tick(panels[0])  # they share it
    panels[0].set_ylabel("mean total tracking time (s)")
    figure.legend(
        *star_last(panels[-1]), loc="outside lower center", ncols=5, frameon=False, title=BARS, title_fontsize=7
    )
    return figure


def _draw_oracle_time(axes: Axes, summaries: Sequence[dict[str, Any]], speed_mps: float) -> None:
    """tau(M, F) of the oracle's mean M: it hears nothing, so F changes its listening time alone."""
    [oracle] = [row for row in summaries if row["controller"] == "oracle"]
    listening_s = oracle["movements_mean"] * oracle["window_s"]
    flying_s = oracle["tracking_time_mean_s"][f"{speed_mps:g}"] - listening_s
    times_s = [flying_s + listening_s * oracle["sampling_hz"] / sampling_hz for sampling_hz in SAMPLING_HZ]
    axes.plot(SAMPLING_HZ, times_s, color=ORACLE_COLOR, linewidth=1.2, label="oracle")


def _rows(summaries: Sequence[dict[str, Any]], controller: str, correlation: float) -> list[dict[str, Any]]:
    rows = [row for row in summaries if (row["controller"], row["spatial_correlation"]) == (controller, correlation)]
    return sorted(rows, key=lambda row: float(row["sampling_hz"]))
