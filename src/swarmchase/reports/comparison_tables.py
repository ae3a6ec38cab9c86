"""The tables of a comparison, as Markdown, from its summaries."""

from collections.abc import Callable, Sequence
from typing import Any

from .intervals import shown_errors, shown_interval, shown_share

Row = dict[str, Any]


def comparison_tables(rows: Sequence[Row]) -> dict[str, str]:
    """Every table by its name: movements, differences from the first controller, and decision times if measured.
    Where chases are measured by the clock, capture times come first.
    """
    tables = {
        **(_by_the_clock(rows) if "capture_s_mean" in rows[0] else {}),
        **(_of_following(rows) if "following_s_mean" in rows[0] else {}),
        "90th percentile of movements": _by_place(rows, _percentile),
        "mean movements": _by_place(rows, _mean),
        "reached": _by_place(rows, lambda row: f"{100 * row['success_rate']:.2f} %"),
    }
    believing = [row for row in rows if "belief_coverage_95" in row]
    if believing:
        tables |= _of_belief(believing)
    first = rows[0]["controller"]
    others = [row for row in rows if row["controller"] != first]
    if others:
        tables[f"difference of the 90th percentile from {first}"] = _by_place(others, _percentile_difference)
        tables[f"difference of the mean from {first}"] = _by_place(others, _mean_difference)
    timed = [row for row in rows if row["decision_ms_p99"] is not None and row["world"] == rows[0]["world"]]
    if timed:
        tables["milliseconds a decision: median, 99th percentile"] = _by_place(timed, _decision)
    return tables


def _by_the_clock(rows: Sequence[Row]) -> dict[str, str]:
    return {
        "seconds until the capture, mean": _by_place(rows, lambda row: _seconds(row, "mean")),
        "seconds until the capture, 90th percentile": _by_place(rows, lambda row: _seconds(row, "p90")),
        **{
            f"captured within {limit} s": _by_place(rows, lambda row, limit=limit: _captured(row, limit))  # type: ignore[misc]
            for limit in rows[0]["captured_within_s"]
        },
    }


def _of_following(rows: Sequence[Row]) -> dict[str, str]:
    return {
        "longest time within 10 m, mean seconds": _by_place(
            rows, lambda row: f"{row['following_s_mean']:.1f}" + shown_interval(row["following_s_mean_ci95"], 1)
        ),
        "within 10 m for 30 s": _by_place(
            rows, lambda row: shown_share(row["followed_30_s"], row["followed_30_s_ci95"])
        ),
    }


def _of_belief(rows: Sequence[Row]) -> dict[str, str]:
    """Coverage never stands without the radius and the error: a belief that knows nothing covers everything."""
    return {
        "belief: target in its 95 % region": _by_place(
            rows, lambda row: shown_share(row["belief_coverage_95"], row["belief_coverage_95_ci95"])
        ),
        "belief: radius of the region, median in m": _by_place(rows, lambda row: f"{row['belief_radius_m_p50']:.1f}"),
        "belief: error, median in m": _by_place(rows, lambda row: f"{row['belief_error_m_p50']:.1f}"),
        "belief: median error after 10, 20, 40, 80 " + ("s" if "capture_s_mean" in rows[0] else "movements"): _by_place(
            rows, lambda row: shown_errors(row["belief_error_m_p50_after"], "capture_s_mean" in row)
        ),
    }


def _seconds(row: Row, which: str) -> str:
    return f"{row[f'capture_s_{which}']:.1f}" + shown_interval(row[f"capture_s_{which}_ci95"], 1)


def _captured(row: Row, limit: str) -> str:
    return shown_share(row["captured_within_s"][limit], row["captured_within_s_ci95"][limit])


def _by_place(rows: Sequence[Row], shown: Callable[[Row], str]) -> str:
    """One line a setting or world, one column a controller."""
    controllers = list(dict.fromkeys(row["controller"] for row in rows))
    settings = list(dict.fromkeys(_setting(row) for row in rows))
    worlds = list(dict.fromkeys(row["world"] for row in rows))
    head = ["rho", "F (Hz)", *(["world"] if len(worlds) > 1 else []), *(f"`{name}`" for name in controllers)]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for setting in settings:
        for world in worlds:
            here = {row["controller"]: row for row in rows if (_setting(row), row["world"]) == (setting, world)}
            if here:
                cells = [shown(here[name]) if name in here else "-" for name in controllers]
                place = [f"{setting[1]:g}", f"{setting[0]:g}", *([world] if len(worlds) > 1 else [])]
                lines.append(f"| {' | '.join([*place, *cells])} |")
    return "\n".join(lines)


def _setting(row: Row) -> tuple[float, float]:
    return row["sampling_hz"], row["spatial_correlation"]


def _percentile(row: Row) -> str:
    return f"{row['movements_p90']:g}" + shown_interval(row["movements_p90_ci95"], 0)


def _mean(row: Row) -> str:
    return f"{row['movements_mean']:.2f}" + shown_interval(row["movements_mean_ci95"], 2)


def _percentile_difference(row: Row) -> str:
    return f"{row['movements_p90_difference']:+g}" + shown_interval(row["movements_p90_difference_ci95"], 0)


def _mean_difference(row: Row) -> str:
    return f"{row['movements_mean_difference']:+.2f}" + shown_interval(row["movements_mean_difference_ci95"], 2)


def _decision(row: Row) -> str:
    return f"{row['decision_ms_p50']:.1f}, {row['decision_ms_p99']:.1f}"
