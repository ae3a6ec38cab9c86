"""``compare``: the same chases for all, differences chase by chase, tables and figures from what lies on disk."""

import contextlib
import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
import scipy.stats
from matplotlib.figure import Figure

from swarmchase.cli import main
from swarmchase.controllers import load_controller
from swarmchase.errors import InputError
from swarmchase.evaluation import blocks, comparison
from swarmchase.evaluation.chases import ChaseResult, run_chases
from swarmchase.evaluation.comparison import (
    AS_TOLD,
    RESAMPLES,
    TABLE_FILE,
    Place,
    Result,
    compare,
    comparison_jobs,
    paired_difference,
    places,
    read_results,
    resampled_differences_p90,
    save_results,
    summaries,
    timed_decisions_ms,
)
from swarmchase.evaluation.paper_results import SAMPLING_HZ, SPATIAL_CORRELATION
from swarmchase.evaluation.statistics import nearest_rank_percentile, share_interval
from swarmchase.evaluation.table import Evaluation, evaluate
from swarmchase.reports.comparison import belief_figure, distribution_figure, percentile_figure, world_figure
from swarmchase.reports.comparison_tables import comparison_tables
from swarmchase.scenario import Scenario, paper_scenario
from swarmchase.world.departures import DEPARTURES, departed

NEAR = paper_scenario(start_distance_m=10.0, max_movements=15)
LOUD = dataclasses.replace(NEAR, transmit_power_dbm=29.0)


@pytest.fixture
def few_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten decisions are timed in each setting, not three hundred, which one test looks at."""
    monkeypatch.setattr(comparison, "TIMED_DECISIONS", 10)


def result(controller: str, movements: list[int], sampling_hz: float = 10.0, world_name: str = AS_TOLD) -> Result:
    """Chases 0, 1, ... with these movements."""
    told = paper_scenario(sampling_hz=sampling_hz, spatial_correlation=0.5)
    world = departed(told, world_name)
    chases = [
        ChaseResult(7, number, 0.0, 0.0, 0.0, count, count <= 500, 5.0 * count)
        for number, count in enumerate(movements)
    ]
    return Result(Place(told, world_name, world), Evaluation(told, controller, None, 7, chases, world))


def test_every_controller_chases_the_same_targets_in_the_world_that_it_is_not_told(tmp_path: Path) -> None:
    jobs = comparison_jobs(["particle", "oracle"], [Place(NEAR, "louder", LOUD)], 6)
    found = compare(tmp_path, jobs, 3, 1)
    for one in found:
        # The oracle knows the world; the other is told what is not so.
        told = LOUD if one.evaluation.controller == "oracle" else NEAR
        alone = sorted(
            run_chases(LOUD, load_controller(one.evaluation.controller, told), 3, range(6)), key=lambda row: row.chase
        )
        assert list(one.evaluation.chases) == alone
    misled, told_so = found[0].evaluation.chases, evaluate(LOUD, "particle", 6, 3).chases
    assert [chase.target_x_m for chase in misled] == [chase.target_x_m for chase in told_so]
    assert [chase.movements for chase in misled] != [chase.movements for chase in told_so]


def test_places() -> None:
    told = [paper_scenario(spatial_correlation=0.9), paper_scenario(spatial_correlation=0.3)]
    assert [place.world for place in places(told, departures=False)] == told
    every = places(told, departures=True)
    # "rho = 0.9" is no other world where 0.9 is told.
    assert [place.world_name for place in every] == [name for name in DEPARTURES if name != "rho = 0.9"] + [*DEPARTURES]
    assert len({place.name for place in every}) == len(every)
    assert all(place.told in told for place in every)


def test_differences_by_hand() -> None:
    # Movements 20..29 against the same and one more, but for the last, which failed: 24 and 501.
    first = np.array([20, 21, 22, 23, 24, 25, 26, 27, 28, 24])
    other = first + 1
    other[9] = 501
    found = paired_difference(first, other)
    assert found["movements_mean_difference"] == pytest.approx((9 * 1 + 477) / 10)
    # Of ten the ninth: 27 (20 to 24, 24, 25, 26, 27, 28) and 29.
    assert found["movements_p90_difference"] == 29 - 27
    differences = other - first
    half = 1.959964 * differences.std(ddof=1) / np.sqrt(10)
    assert found["movements_mean_difference_ci95"] == pytest.approx(
        [differences.mean() - half, differences.mean() + half]
    )


def test_a_pair_says_more_than_two_tables() -> None:
    """Two controllers that differ by one in every chase: sure, however much the chases differ."""
    generator = np.random.default_rng(1)
    first = generator.integers(20, 60, 500)
    found = paired_difference(first, first + 1)
    assert found["movements_mean_difference_ci95"] == [1, 1]
    assert found["movements_p90_difference_ci95"] == [1, 1]


def test_the_bootstrap_is_scipys() -> None:
    generator = np.random.default_rng(2)
    first = generator.geometric(0.05, 400) + 20
    other = np.maximum(20, first + generator.integers(-15, 5, 400))

    def difference(mine: Any, theirs: Any) -> float:
        return nearest_rank_percentile(theirs, 90) - nearest_rank_percentile(mine, 90)

    theirs = scipy.stats.bootstrap(
        (first, other), difference, paired=True, vectorized=False, n_resamples=2000, method="percentile", rng=3
    )
    ours = resampled_differences_p90(first, other)
    assert len(ours) == RESAMPLES
    assert ours.std() == pytest.approx(theirs.standard_error, rel=0.1)
    assert ours.mean() == pytest.approx(theirs.bootstrap_distribution.mean(), abs=0.5)


@pytest.mark.parametrize(
    ("controllers", "message"),
    [
        ([], "no controllers to compare"),
        (["oracle", "random", "oracle"], "controller 'oracle' is given twice"),
        (["oracle", "nobody"], "no controller 'nobody'; there are particle"),
    ],
)
def test_controllers_that_cannot_be_compared_are_refused(tmp_path: Path, controllers: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        compare(tmp_path / "out", comparison_jobs(controllers, places([NEAR], False), 3), 0, 1)
    assert not (tmp_path / "out").exists()


def test_interrupted_it_goes_on_and_the_table_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "BLOCK_CHASES", 2)
    jobs = comparison_jobs(["oracle", "random"], [Place(NEAR, AS_TOLD, NEAR), Place(NEAR, "louder", LOUD)], 5)
    save_results(tmp_path / "whole", compare(tmp_path / "whole", jobs, 3, 1))
    evaluated: list[tuple[str, float, int]] = []

    def counted(told: Scenario, controller: str, *arguments: Any, **options: Any) -> Evaluation:
        if len(evaluated) == 7:
            raise KeyboardInterrupt
        evaluated.append((controller, options["world"].transmit_power_dbm, options["first_chase"]))
        return evaluate(told, controller, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(blocks, "evaluate", counted)
        with pytest.raises(KeyboardInterrupt):
            compare(tmp_path / "parts", jobs, 3, 1)
        evaluated.clear()
        patch.setattr(blocks, "evaluate", lambda *a, **o: counted(*a, **o) if len(evaluated) < 7 else None)
        save_results(tmp_path / "parts", compare(tmp_path / "parts", jobs, 3, 1))
    # Twelve blocks in all, seven of them were there.
    assert evaluated == [("oracle", 29, 2), ("oracle", 29, 4), *(("random", 29, first) for first in (0, 2, 4))]
    assert (tmp_path / "parts" / TABLE_FILE).read_bytes() == (tmp_path / "whole" / TABLE_FILE).read_bytes()


def test_what_is_written_is_read(tmp_path: Path) -> None:
    jobs = comparison_jobs(["oracle", "random"], [Place(NEAR, "louder", LOUD)], 4)
    written = compare(tmp_path, jobs, 3, 1)
    save_results(tmp_path, written)
    read = read_results(tmp_path / TABLE_FILE)
    assert [one.place for one in read] == [one.place for one in written]
    for mine, theirs in zip(summaries(read), summaries(written), strict=True):
        times = ("tracking_time_mean_s", "tracking_time_mean_s_ci95")  # path lengths are float32 on disk
        assert {key: mine[key] for key in mine if key not in times} == {
            key: theirs[key] for key in theirs if key not in times
        }
        assert mine[times[0]] == pytest.approx(theirs[times[0]], rel=1e-6)
    (tmp_path / "none.parquet").write_bytes(b"no table")
    for name in ("none.parquet", "missing.parquet"):
        with pytest.raises(InputError, match=name):
            read_results(tmp_path / name)


def invented() -> list[Result]:
    """Two settings, two controllers: 20..29 and 30..39 movements, ten times as many chases each."""
    return [
        result(controller, [start + hertz // 50 + number % 10 for number in range(100)], sampling_hz=float(hertz))
        for hertz in (10, 100)
        for start, controller in ((20, "recurrent"), (30, "particle"))
    ]


def markdown(rows: list[dict[str, Any]]) -> dict[str, str]:
    return {name: table.markdown() for name, table in comparison_tables(rows).items()}


def test_the_tables_by_hand() -> None:
    tables = markdown(summaries(invented(), {("particle", "F10-rho0.5"): (1.25, 2.5)}))
    assert tables["90th percentile of movements"].splitlines() == [
        "| rho | F (Hz) | `recurrent` | `particle` |",
        "|---|---|---|---|",
        # Of 20..29, ten of each, the 90th is 28.
        "| 0.5 | 10 | 28 [28, 29] | 38 [38, 39] |",
        "| 0.5 | 100 | 30 [30, 31] | 40 [40, 41] |",
    ]
    assert tables["difference of the 90th percentile from recurrent"].splitlines()[2] == "| 0.5 | 10 | +10 [10, 10] |"
    assert tables["difference of the mean from recurrent"].splitlines()[3] == "| 0.5 | 100 | +10.00 [10.00, 10.00] |"
    assert tables["milliseconds a decision: median, 99th percentile"].splitlines()[2:] == ["| 0.5 | 10 | 1.2, 2.5 |"]
    assert tables["reached"].splitlines()[2] == "| 0.5 | 10 | 100.00 % [96.38, 100.00] | 100.00 % [96.38, 100.00] |"


@pytest.mark.usefixtures("few_timed")
def test_where_the_clock_measures_the_seconds_come_first(tmp_path: Path) -> None:
    """The real command: ten flights of two who know where the target is, and one who does not."""
    words = "compare --controllers oracle-intercept oracle random --scenario flight --behaviour waypoints --json"
    told = "--target-speed-mps 5 --max-movements 119 --follow-s 2 --episodes 10 --processes 1 --folder"
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        main([*words.split(), *told.split(), str(tmp_path)])
    intercept, pursuit, blind = json.loads(output.getvalue())
    assert intercept["capture_s_mean"] < pursuit["capture_s_mean"] < blind["capture_s_mean"] == 60
    assert blind["captured_within_s"] == {"60": 0, "120": 0, "300": 0}
    assert pursuit["captured_within_s_ci95"]["60"] == pytest.approx(share_interval(10, 10))
    tables = markdown([intercept, pursuit, blind])
    assert next(iter(tables)) == "seconds until the capture, mean"
    assert tables["captured within 60 s"].splitlines()[2].endswith("| 0.0 % [0.0, 30.8] |")
    assert sorted(path.name for path in tmp_path.glob("*.p*")) == [
        "capture.pdf", "capture.png", "comparison.parquet", "following.pdf", "following.png",
    ]  # fmt: skip
    assert [chase.capture_s for chase in read_results(tmp_path / TABLE_FILE)[2].evaluation.chases] == [60] * 10
    # Who flies past at 10 m/s is there for 1.6 s at least.
    assert pursuit["following_s_mean"] > 1.6 > blind["following_s_mean"] == blind["followed_30_s"] == 0
    assert tables["within 10 m for 30 s"].splitlines()[2].endswith("| 0.0 % [0.0, 30.8] |")


def test_a_belief_stands_in_table_document_and_figure_of_those_that_have_one(tmp_path: Path) -> None:
    """Half of the decisions right; a belief 4 m wide and 3 m off, 5 m after ten movements."""
    told = paper_scenario()
    place = Place(told, AS_TOLD, told)
    measures = {"belief_decisions": 20, "belief_held": 10, "belief_radius_m": 4.0, "belief_error_m": 3.0}
    believing = [
        dataclasses.replace(chase, **measures, belief_error_10_m=5.0)
        for chase in result("particle", [20, 20]).evaluation.chases
    ]
    results = [
        Result(place, Evaluation(told, "particle", None, 7, believing, told)),
        Result(place, result("oracle", [18, 19]).evaluation),
    ]
    save_results(tmp_path, results)
    back = read_results(tmp_path / TABLE_FILE)
    rows = summaries(back)
    assert back[0].evaluation.chases[1].belief_error_10_m == 5.0
    assert back[1].evaluation.chases[1].belief_decisions is None
    assert "belief_coverage_95" not in rows[1]
    assert rows[0]["belief_coverage_95_ci95"] == [0.5, 0.5]
    tables = {name: table.splitlines()[0::2] for name, table in markdown(rows).items() if "belief" in name}
    head = "| rho | F (Hz) | `particle` |"
    assert tables == {
        "belief: target in its 95 % region": [head, "| 0.9 | 10 | 50.0 % [50.0, 50.0] |"],
        "belief: radius of the region, median in m": [head, "| 0.9 | 10 | 4.0 |"],
        "belief: error, median in m": [head, "| 0.9 | 10 | 3.0 |"],
        "belief: median error after 10, 20, 40, 80 movements": [head, "| 0.9 | 10 | 10: 5.0 m |"],
    }
    figure = belief_figure({("particle", 10.0, 0.9, AS_TOLD): [3.0, 5.0]})
    (line,) = [line for line in figure.axes[0].lines if line.get_label() == "particle"]
    assert np.asarray(line.get_xydata()).tolist() == [[3.0, 0.0], [3.0, 0.5], [5.0, 1.0]]
    figure.draw_without_rendering()
    assert {"3", "4"} < {label.get_text() for label in figure.axes[0].get_xticklabels(which="both")}


def test_worlds_stand_in_the_table_where_there_are_several() -> None:
    rows = summaries([result("particle", [30, 40]), result("particle", [50, 501], world_name="6 dB weaker")])
    lines = markdown(rows)["reached"].splitlines()
    assert lines[0] == "| rho | F (Hz) | world | `particle` |"
    assert lines[2:] == [
        "| 0.5 | 10 | as told | 100.00 % [15.81, 100.00] |",
        "| 0.5 | 10 | 6 dB weaker | 50.00 % [1.26, 98.74] |",
    ]


def movements_of(results: list[Result]) -> dict[tuple[str, float, float, str], list[int]]:
    return {
        (one.evaluation.controller, one.place.told.sampling_hz, one.place.told.spatial_correlation, AS_TOLD): [
            chase.movements for chase in one.evaluation.chases
        ]
        for one in results
    }


def labels(figure: Figure) -> set[str]:
    return {text.get_text() for text in figure.legends[0].get_texts()}


def test_the_figures_show_every_controller_and_the_papers_points() -> None:
    rows = summaries(invented())
    figure = percentile_figure(rows)
    assert labels(figure) == {"recurrent", "particle", "stated in the paper"}
    stars = [line for line in figure.axes[0].get_lines() if line.get_marker() == "*"]
    drawn = {(float(np.asarray(s.get_xdata())[0]), float(np.asarray(s.get_ydata())[0])) for s in stars}
    assert drawn == {(10.0, 44.0), (100.0, 160.0)}
    figure = distribution_figure(movements_of(invented()))
    assert [axes.get_title() for axes in figure.axes] == ["F = 10 Hz, ρ = 0.5", "F = 100 Hz, ρ = 0.5"]
    curve = next(line for line in figure.axes[1].get_lines() if line.get_label() == "particle")
    assert np.asarray(curve.get_xdata())[1:].tolist() == sorted([32 + number % 10 for number in range(100)])
    weaker = summaries([result("particle", [30, 40]), result("particle", [50, 501], world_name="6 dB weaker")])
    axes = world_figure(weaker).axes[0]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["as told", "6 dB weaker"]


def test_decisions_are_timed_in_whole_chases() -> None:
    p50_ms, p99_ms = timed_decisions_ms("oracle", NEAR)
    assert 0 < p50_ms <= p99_ms


@pytest.mark.parametrize("departures", [False, True])
@pytest.mark.usefixtures("few_timed")
def test_the_command_leaves_table_report_figures_and_one_json_list(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], departures: bool
) -> None:
    NEAR.save_toml(tmp_path / "near.toml")
    folder = tmp_path / "out"
    several = [] if departures else ["20"]
    words = ["compare", "--controllers", "gradient", "random", "--sampling-hz", *several, "100", "--episodes", "2"]
    words += ["--spatial-correlation", "0.5", "--scenario", str(tmp_path / "near.toml"), "--processes", "1"]
    words += ["--seed", "4", "--folder", str(folder), "--json", *(["--departures"] if departures else [])]
    main(words)
    output = capsys.readouterr()
    rows = json.loads(output.out)
    worlds = len(DEPARTURES) - 1 if departures else 1
    assert len(rows) == 2 * (len(several) + 1) * worlds
    alone = evaluate(dataclasses.replace(NEAR, sampling_hz=100.0, spatial_correlation=0.5), "random", 2, 4).summary()
    [same] = [row for row in rows if (row["controller"], row["sampling_hz"], row["world"]) == ("random", 100, AS_TOLD)]
    assert alone.items() <= same.items()
    names = {path.name for path in folder.iterdir()}
    second = "worlds" if departures else "percentile"
    assert names == {
        "blocks",
        TABLE_FILE,
        "comparison.md",
        *(f"{name}.{kind}" for name in ("movements", second) for kind in ("png", "pdf")),
    }
    assert matplotlib.image.imread(folder / f"{second}.png").std() > 0.01
    report = (folder / "comparison.md").read_text()
    read = markdown(summaries(read_results(folder / TABLE_FILE)))
    assert all(table in report for table in read.values())


@pytest.mark.usefixtures("few_timed")
def test_the_paper_settings_are_twelve(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("swarmchase.reports.comparison.draw_comparison", lambda *_: [])  # the test above looks at them
    words = ["compare", "--controllers", "oracle", "--episodes", "1", "--processes", "1", "--paper-settings"]
    main([*words, "--folder", str(tmp_path / "out"), "--json"])
    rows = json.loads(capsys.readouterr().out)
    assert {(row["sampling_hz"], row["spatial_correlation"]) for row in rows} == {
        (sampling_hz, rho) for sampling_hz in SAMPLING_HZ for rho in SPATIAL_CORRELATION
    }
    with pytest.raises(SystemExit) as ended:
        main([*words, "--sampling-hz", "10", "--folder", str(tmp_path / "other")])
    assert ended.value.code == 2
    assert "--paper-settings are twelve" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()
