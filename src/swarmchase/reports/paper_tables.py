"""The tables of docs/results.md, as Markdown, from the summaries of ``reproduction``."""

from collections.abc import Iterator, Sequence
from typing import Any

from ..evaluation.paper_results import MOVEMENTS_P90, SAMPLING_HZ, SPATIAL_CORRELATION, TRACKING_TIME_S
from .intervals import shown_interval

Summaries = Sequence[dict[str, Any]]


def report_tables(summaries: Summaries) -> dict[str, str]:
    """Every table by its name."""
    return {
        "percentiles": percentile_table(summaries),
        "a3c": a3c_table(summaries),
        "times": time_table(summaries),
        "oracle": oracle_line(summaries),
    }


def percentile_table(summaries: Summaries) -> str:
    """One line a setting: the 90th percentile, the mean and the most movements of ``paper``."""
    [oracle] = _of(summaries, "oracle")
    lines = [
        "| rho | F (Hz) | paper, 90th percentile | ours, 90th percentile | over the oracle | mean | most | reached |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for sampling_hz, correlation, row in _twelve(summaries):
        excess = row["movements_p90"] / oracle["movements_p90"] - 1
        lines.append(
            f"| {correlation:g} | {sampling_hz:g} | {MOVEMENTS_P90.get((sampling_hz, correlation), '-')} | "
            f"{_percentile(row)} | {100 * excess:+.0f} % | {_mean(row)} | {row['movements_max']} | "
            f"{100 * row['success_rate']:.2f} % |"
        )
    return "\n".join(lines)


def a3c_table(summaries: Summaries) -> str:
    """The settings for which a controller was trained by A3C alone."""
    lines = [
        "| rho | F (Hz) | paper | `paper-a3c` | `paper` | mean, `paper-a3c` | most | reached | chases |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in _of(summaries, "paper-a3c"):
        setting = (row["sampling_hz"], row["spatial_correlation"])
        [best] = _of(summaries, "paper", *setting)
        lines.append(
            f"| {setting[1]:g} | {setting[0]:g} | {MOVEMENTS_P90.get(setting, '-')} | {_percentile(row)} | "
            f"{_percentile(best)} | {_mean(row)} | {row['movements_max']} | {100 * row['success_rate']:.2f} % | "
            f"{row['episodes']:,} |"
        )
    return "\n".join(lines)


def time_table(summaries: Summaries) -> str:
    """Mean total tracking times at both speeds."""
    lines = ["| rho | F (Hz) | paper | ours at 5 m/s | ours at 2 m/s |", "|---|---|---|---|---|"]
    for sampling_hz, correlation, row in _twelve(summaries):
        stated = TRACKING_TIME_S.get((sampling_hz, correlation))
        lines.append(
            f"| {correlation:g} | {sampling_hz:g} | {'-' if stated is None else f'{stated} s'} | "
            f"{_time(row, '5')} | {_time(row, '2')} |"
        )
    return "\n".join(lines)


def _twelve(summaries: Summaries) -> Iterator[tuple[float, float, dict[str, Any]]]:
    """F, rho and the row of ``paper`` in each of the paper's settings, the easy ones first."""
    for correlation in reversed(SPATIAL_CORRELATION):
        for sampling_hz in SAMPLING_HZ:
            for row in _of(summaries, "paper", sampling_hz, correlation):
                yield sampling_hz, correlation, row


def oracle_line(summaries: Summaries) -> str:
    """What no controller with these actions can beat."""
    [row] = _of(summaries, "oracle")
    return (
        f"The oracle, which knows the target: 90th percentile {_percentile(row)}, mean {_mean(row)}, "
        f"most {row['movements_max']}."
    )


def _of(
    summaries: Summaries, controller: str, sampling_hz: float | None = None, correlation: float | None = None
) -> list[dict[str, Any]]:
    return [
        row
        for row in summaries
        if row["controller"] == controller
        and sampling_hz in (None, row["sampling_hz"])
        and correlation in (None, row["spatial_correlation"])
    ]


def _percentile(row: dict[str, Any]) -> str:
    low, high = row["movements_p90_ci95"]
    return f"{row['movements_p90']:g} [{low:g}, {high:g}]"


def _mean(row: dict[str, Any]) -> str:
    return f"{row['movements_mean']:.2f}" + shown_interval(row["movements_mean_ci95"], 2)


def _time(row: dict[str, Any], speed: str) -> str:
    return f"{row['tracking_time_mean_s'][speed]:.1f} s" + shown_interval(row["tracking_time_mean_s_ci95"][speed], 1)
