"""The tables of docs/results.md from the summaries of ``reproduction``."""

from collections.abc import Iterator, Sequence
from typing import Any

from ..evaluation.paper_results import MOVEMENTS_P90, SAMPLING_HZ, SPATIAL_CORRELATION, TRACKING_TIME_S
from .intervals import shown_interval, shown_reached
from .text_table import TextTable

Summaries = Sequence[dict[str, Any]]


def report(summaries: Summaries) -> str:
    """All tables and the oracle's line, as a document."""
    return (
        "\n\n".join([*(table.markdown() for table in report_tables(summaries).values()), oracle_line(summaries)]) + "\n"
    )


def report_tables(summaries: Summaries) -> dict[str, TextTable]:
    """Every table by what it is of."""
    return {
        "movements": percentile_table(summaries),
        "A3C alone": a3c_table(summaries),
        "mean total tracking time": time_table(summaries),
    }


def percentile_table(summaries: Summaries) -> TextTable:
    """One line a setting: the 90th percentile, the mean and the most movements of ``paper``."""
    [oracle] = _of(summaries, "oracle")
    head = ("rho", "F (Hz)", "paper, 90th percentile", "ours, 90th percentile", "over the oracle", "mean", "most")
    rows = [
        (
            f"{correlation:g}",
            f"{sampling_hz:g}",
            str(MOVEMENTS_P90.get((sampling_hz, correlation), "-")),
            _percentile(row),
            f"{100 * (row['movements_p90'] / oracle['movements_p90'] - 1):+.0f} %",
            _mean(row),
            str(row["movements_max"]),
            shown_reached(row),
        )
        for sampling_hz, correlation, row in _twelve(summaries)
    ]
    return TextTable((*head, "reached"), tuple(rows), num_keys=2)


def a3c_table(summaries: Summaries) -> TextTable:
    """The settings for which a controller was trained by A3C alone."""
    head = ("rho", "F (Hz)", "paper", "`paper-a3c`", "`paper`", "mean, `paper-a3c`", "most", "reached", "chases")
    rows = []
    for row in _of(summaries, "paper-a3c"):
        setting = (row["sampling_hz"], row["spatial_correlation"])
        [best] = _of(summaries, "paper", *setting)
        rows.append(
            (
                f"{setting[1]:g}",
                f"{setting[0]:g}",
                str(MOVEMENTS_P90.get(setting, "-")),
                _percentile(row),
                _percentile(best),
                _mean(row),
                str(row["movements_max"]),
                shown_reached(row),
                f"{row['episodes']:,}",
            )
        )
    return TextTable(head, tuple(rows), num_keys=2)


def time_table(summaries: Summaries) -> TextTable:
    """Mean total tracking times at both speeds."""
    rows = [
        (
            f"{correlation:g}",
            f"{sampling_hz:g}",
            f"{TRACKING_TIME_S[sampling_hz, correlation]} s" if (sampling_hz, correlation) in TRACKING_TIME_S else "-",
            _time(row, "5"),
            _time(row, "2"),
        )
        for sampling_hz, correlation, row in _twelve(summaries)
    ]
    return TextTable(("rho", "F (Hz)", "paper", "ours at 5 m/s", "ours at 2 m/s"), tuple(rows), num_keys=2)


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
