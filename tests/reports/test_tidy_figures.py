"""Every figure of a report, of much data, of little and of the awkward: nothing outside its panel, no panel empty."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from figure_checks import require_tidy
from swarmchase.commands.compare import draw_results
from swarmchase.controllers import load_controller
from swarmchase.evaluation.chase_log import chase_log, run_chase, save_chase_log
from swarmchase.evaluation.comparison import AS_TOLD, Place, Result, summaries
from swarmchase.evaluation.reproduction import training_log
from swarmchase.evaluation.table import evaluate
from swarmchase.reports.chase import draw_chase
from swarmchase.reports.cluster import draw_scaling, draw_staleness
from swarmchase.reports.marks import BANDS, BARS, FEW_MOVEMENT_TICKS, MOVEMENT_TICKS, movement_axis
from swarmchase.reports.scenarios import draw_behaviours, draw_scenarios
from swarmchase.reports.training import draw_training
from swarmchase.scenario import Scenario, load_scenario, paper_scenario
from swarmchase.world.departures import departed

CLUSTER = Path(__file__).parent.parent.parent / "benchmarks" / "cluster.json"
NEAR = paper_scenario(start_distance_m=20.0, max_movements=40)
FLIGHT = dataclasses.replace(load_scenario("flight"), start_distance_m=12.0, farthest_start_m=16.0, max_movements=40)


def result(world: Scenario, controller: str, world_name: str = AS_TOLD, **changes: Any) -> Result:
    """Eight chases."""
    told = dataclasses.replace(world, **changes)
    where = departed(told, world_name)
    found = evaluate(told, controller, 8, 1, world=where)
    return Result(Place(told, world_name, where), found)


def at_each_hz(*controllers: str) -> list[Result]:
    return [result(NEAR, name, sampling_hz=hertz) for hertz in (10.0, 100.0) for name in controllers]


COMPARISONS: dict[str, tuple[Callable[[], list[Result]], set[str]]] = {
    # Situation: its results, and the figures that there are of them.
    "two frequencies": (lambda: at_each_hz("multilateration", "gradient", "oracle"), {"movements", "percentile"}),
    "one frequency": (lambda: [result(NEAR, name) for name in ("gradient", "oracle")], {"movements", "percentile"}),
    "one controller": (lambda: [result(NEAR, "oracle")], {"movements", "percentile"}),
    # 501 movements: beyond the last that is shown.
    "none reached": (lambda: [result(paper_scenario(), "random")], {"movements", "percentile"}),
    "near": (lambda: [result(NEAR, name, start_distance_m=5.0) for name in ("gradient", "oracle")], {"percentile"}),
    "worlds": (
        lambda: [result(NEAR, "multilateration", name) for name in (AS_TOLD, "6 dB weaker")],
        {"movements", "worlds"},
    ),
    "by the clock": (lambda: [result(FLIGHT, name) for name in ("oracle", "random")], {"capture"}),
    "followed": (lambda: [result(FLIGHT, "adaptive", follow_s=2.0)], {"capture", "following", "belief"}),
}


@pytest.mark.parametrize("situation", COMPARISONS)
def test_comparisons(situation: str, tmp_path: Path, kept: list[Figure]) -> None:
    make, kinds = COMPARISONS[situation]
    results = make()
    draw_results(tmp_path, results, summaries(results))
    assert kinds <= {path.stem for path in tmp_path.glob("*.png")}
    for figure in kept:
        require_tidy(figure)
        assert figure.legends[0].get_title().get_text() in (BANDS, BARS)  # what is shaded or barred has a name


def test_controllers_at_one_frequency_lie_beside_one_another(tmp_path: Path, kept: list[Figure]) -> None:
    results = [result(NEAR, name) for name in ("gradient", "oracle", "random")]
    rows = summaries(results)
    draw_results(tmp_path, results, rows)
    [axes] = next(figure for figure in kept if "90th percentile" in figure.axes[0].get_xlabel()).axes
    drawn = {label.get_text(): tick for label, tick in zip(axes.get_yticklabels(), axes.get_yticks(), strict=True)}
    places = {tuple(np.asarray(line.get_xydata())[0]) for line in axes.lines if line.get_marker() in ("o", "s", "_")}
    assert places == {(row["movements_p90"], drawn[row["controller"]]) for row in rows}


CHASES = training_log()
EVALUATIONS = [
    # As long as all fail, mean and percentile are the same.
    {"update": update, "movements_p90": p90, "movements_mean": mean}
    for update, p90, mean in ((100, 501.0, 501.0), (200, 501.0, 501.0), (300, 180.0, 90.0))
]


@pytest.mark.parametrize(
    ("num_chases", "num_evaluations"), [(0, 1), (0, 3), (1, 0), (1, 1), (2, 1), (250, 0), (250, 3)]
)
def test_trainings(num_chases: int, num_evaluations: int, tmp_path: Path, kept: list[Figure]) -> None:
    draw_training(CHASES[:num_chases], EVALUATIONS[:num_evaluations], tmp_path / "training.png")
    require_tidy(kept[0])
    assert len(kept[0].axes) == (num_chases > 0) + (num_evaluations > 0)


def test_a_percentile_that_equals_the_mean_is_seen_around_it(tmp_path: Path, kept: list[Figure]) -> None:
    draw_training([], EVALUATIONS, tmp_path / "training.png")
    percentile, mean = kept[0].axes[0].lines
    assert percentile.get_markersize() > 2 * mean.get_markersize()
    assert percentile.get_markerfacecolor() == "none"
    assert mean.get_linestyle() == "--"  # over a line without gaps


def test_clusters(tmp_path: Path, kept: list[Figure]) -> None:
    draw_scaling(json.loads(CLUSTER.read_text()), tmp_path / "scaling.png")
    for behind in ([0], [0, 0, 3, 7, 7, 7, 1]):
        gradients = [{"update": update, "updates_behind": updates} for update, updates in enumerate(behind)]
        draw_staleness(gradients, tmp_path / "staleness.png")
    for figure in kept:
        require_tidy(figure)


def test_a_chase_has_as_many_movements_as_it_says(tmp_path: Path, kept: list[Figure]) -> None:
    """Windows lie around their movement: the last one must not look like one movement more."""
    oracle = load_controller("oracle", NEAR)
    save_chase_log(tmp_path / "chase.json", chase_log(NEAR, oracle, 1, 2, list(run_chase(NEAR, oracle, 1, 2))))
    log = json.loads((tmp_path / "chase.json").read_text())
    draw_chase(log, tmp_path / "chase.png")
    require_tidy(kept[0])
    _path, levels, distance, spacing = kept[0].axes
    for axes in (levels, distance, spacing):
        low, high = axes.get_xlim()
        assert (low, high) == (-0.5, log["movements"] + 0.5)
        assert max(tick for tick in axes.get_xticks() if low <= tick <= high) <= log["movements"]


def test_scenarios_and_behaviours(tmp_path: Path, kept: list[Figure]) -> None:
    logs = {}
    for name, world in (("paper", NEAR), ("flight", FLIGHT)):
        oracle = load_controller("oracle", world)
        logs[name] = [chase_log(world, oracle, 0, chase, list(run_chase(world, oracle, 0, chase))) for chase in (0, 1)]
    draw_scenarios(logs, tmp_path / "scenarios.png", "title")
    draw_behaviours({"hover": logs["flight"][0]}, tmp_path / "behaviours.png", "title")
    for figure in kept:
        require_tidy(figure)
    named = {text.get_text() for text in kept[0].legends[0].get_texts()}
    assert {"heard by +x", "heard by -x", "where targets may start; altitudes at which they fly"} < named


@pytest.mark.parametrize("ticks", [MOVEMENT_TICKS, FEW_MOVEMENT_TICKS])
@pytest.mark.parametrize("values", [(1.0,), (20.0,), (14.9, 241.0), (501.0, 501.0), (2.0, 9_000.0)])
def test_an_axis_of_movements_ends_at_ticks(values: tuple[float, ...], ticks: tuple[int, ...]) -> None:
    axes = Figure().subplots()
    movement_axis(axes, "y", values, ticks)
    shown, (low, high) = axes.get_yticks(), axes.get_ylim()
    assert low < shown[0] <= min(values) <= max(values) <= shown[-1] < high
