"""The tables of a comparison from its summaries."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from .intervals import shown_errors, shown_interval, shown_reached, shown_share
from .text_table import TextTable

Row = dict[str, Any]
Place = tuple[float, float, str]
"""rho, F and world."""


@dataclass(frozen=True)
class Measure:
    """One figure of each row that has it, as words."""

    rows: Sequence[Row]
    shown: Callable[[Row], str]


def comparison_tables(rows: Sequence[Row]) -> dict[str, TextTable]:
    """One table a measure, by its name: one line a setting or world, one column a controller."""
    return {name: by_place(measure) for name, measure in measures(rows).items()}


def report(rows: Sequence[Row]) -> str:
    """All tables, as a document."""
    return "\n\n".join(f"## {name}\n\n{table.markdown()}" for name, table in comparison_tables(rows).items()) + "\n"


def measures(rows: Sequence[Row]) -> dict[str, Measure]:
    """Movements, differences from the first controller, and decision times if measured. Where chases are measured by
    the clock, capture times come first.
    """
    found = {
        **(_by_the_clock(rows) if "capture_s_mean" in rows[0] else {}),
        **(_of_following(rows) if "following_s_mean" in rows[0] else {}),
        "90th percentile of movements": Measure(rows, _percentile),
        "mean movements": Measure(rows, _mean),
        "reached": Measure(rows, shown_reached),
    }
    believing = [row for row in rows if "belief_coverage_95" in row]
    if believing:
        found |= _of_belief(believing)
    first = rows[0]["controller"]
    others = [row for row in rows if row["controller"] != first]
    if others:
        found[f"difference of the 90th percentile from {first}"] = Measure(others, _percentile_difference)
        found[f"difference of the mean from {first}"] = Measure(others, _mean_difference)
    timed = [row for row in rows if row["decision_ms_p99"] is not None and row["world"] == rows[0]["world"]]
    if timed:
        found["milliseconds a decision: median, 99th percentile"] = Measure(timed, _decision)
    return found


def by_place(measure: Measure) -> TextTable:
    """One line a setting or world, one column a controller."""
    controllers, places = _controllers(measure.rows), _places(measure.rows)
    worlds = len({world for _, _, world in places}) > 1
    rows = [
        (f"{rho:g}", f"{hertz:g}", *([world] if worlds else []), *_cells(measure, controllers, [(rho, hertz, world)]))
        for rho, hertz, world in places
    ]
    head = ("rho", "F (Hz)", *(["world"] if worlds else []), *(f"`{name}`" for name in controllers))
    return TextTable(head, tuple(rows), num_keys=2 + worlds)


def by_controller(measure: Measure) -> TextTable:
    """The same with one line a controller, one column a setting or world."""
    controllers, places = _controllers(measure.rows), _places(measure.rows)
    rows = [(name, *_cells(measure, [name], places)) for name in controllers]
    return TextTable(("controller", *map(_place_name, places)), tuple(rows))


def in_one_place(rows: Sequence[Row]) -> TextTable:
    """All measures of one setting and world, one line a controller."""
    found, [place] = measures(rows), _places(rows)
    lines = [
        (name, *(cell for measure in found.values() for cell in _cells(measure, [name], [place])))
        for name in _controllers(rows)
    ]
    return TextTable(("controller", *found), tuple(lines))


def place_name(row: Row) -> str:
    """The setting and world that a row is of."""
    return _place_name(_place(row))


def num_places(rows: Sequence[Row]) -> int:
    """Settings and worlds that these rows are of."""
    return len(_places(rows))


def _cells(measure: Measure, controllers: Sequence[str], places: Sequence[Place]) -> list[str]:
    """Every controller in every place; a dash where it has not been."""
    known = {(row["controller"], _place(row)): row for row in measure.rows}
    keys = [(name, place) for name in controllers for place in places]
    return [measure.shown(known[key]) if key in known else "-" for key in keys]


def _controllers(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(row["controller"] for row in rows))


def _places(rows: Sequence[Row]) -> list[Place]:
    """Setting by setting, in each of them its worlds."""
    worlds = list(dict.fromkeys(row["world"] for row in rows))
    found = dict.fromkeys(map(_place, rows))
    settings = list(dict.fromkeys(place[:2] for place in found))
    return sorted(found, key=lambda place: (settings.index(place[:2]), worlds.index(place[2])))


def _place_name(place: Place) -> str:
    rho, hertz, world = place
    return f"F = {hertz:g} Hz, rho = {rho:g}, {world}"


def _place(row: Row) -> Place:
    return row["spatial_correlation"], row["sampling_hz"], row["world"]


def _seconds(row: Row, which: str) -> str:
    return f"{row[f'capture_s_{which}']:.1f}" + shown_interval(row[f"capture_s_{which}_ci95"], 1)


def _captured(row: Row, limit: str) -> str:
    return shown_share(row["captured_within_s"][limit], row["captured_within_s_ci95"][limit])


def _by_the_clock(rows: Sequence[Row]) -> dict[str, Measure]:
    return {
        "seconds until the capture, mean": Measure(rows, lambda row: _seconds(row, "mean")),
        "seconds until the capture, 90th percentile": Measure(rows, lambda row: _seconds(row, "p90")),
        **{
            f"captured within {limit} s": Measure(rows, functools.partial(_captured, limit=limit))
            for limit in rows[0]["captured_within_s"]
        },
    }


def _of_following(rows: Sequence[Row]) -> dict[str, Measure]:
    return {
        "longest time within 10 m, mean seconds": Measure(
            rows, lambda row: f"{row['following_s_mean']:.1f}" + shown_interval(row["following_s_mean_ci95"], 1)
        ),
        "within 10 m for 30 s": Measure(rows, lambda row: shown_share(row["followed_30_s"], row["followed_30_s_ci95"])),
    }


def _of_belief(rows: Sequence[Row]) -> dict[str, Measure]:
    """Coverage never stands without the radius and the error: a belief that knows nothing covers everything."""
    return {
        "belief: target in its 95 % region": Measure(
            rows, lambda row: shown_share(row["belief_coverage_95"], row["belief_coverage_95_ci95"])
        ),
        "belief: radius of the region, median in m": Measure(rows, lambda row: f"{row['belief_radius_m_p50']:.1f}"),
        "belief: error, median in m": Measure(rows, lambda row: f"{row['belief_error_m_p50']:.1f}"),
        "belief: median error after 10, 20, 40, 80 " + ("s" if "capture_s_mean" in rows[0] else "movements"): Measure(
            rows, lambda row: shown_errors(row["belief_error_m_p50_after"], "capture_s_mean" in row)
        ),
    }


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
