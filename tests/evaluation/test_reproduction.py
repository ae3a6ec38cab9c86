"""``reproduce``: what it evaluates and keeps, that it goes on where it was, its tables and figures, its command."""

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure

from swarmchase.channel.fading import fading_db
from swarmchase.channel.fading_process import first_window
from swarmchase.cli import main
from swarmchase.errors import InputError
from swarmchase.evaluation import blocks, reproduction
from swarmchase.evaluation.chases import ChaseResult
from swarmchase.evaluation.paper_results import MOVEMENTS_P90, SAMPLING_HZ, SPATIAL_CORRELATION, TRACKING_TIME_S
from swarmchase.evaluation.reproduction import (
    FADING_FILE,
    TABLE_FILE,
    Cell,
    cells,
    fading_table,
    read_evaluations,
    reproduce,
    save_evaluations,
)
from swarmchase.evaluation.table import Evaluation, evaluate
from swarmchase.reports.paper import movement_figure, percentile_figure, tracking_time_figure
from swarmchase.reports.paper_tables import oracle_line, report_tables
from swarmchase.scenario import paper_scenario

TWELVE = {(sampling_hz, rho) for sampling_hz in SAMPLING_HZ for rho in SPATIAL_CORRELATION}


def invented(controller: str, sampling_hz: float, rho: float, movements: list[int]) -> Evaluation:
    """Chases 0, 1, ... with these movements, 5 m of flight each movement."""
    chases = [
        ChaseResult(7, number, 0.0, 0.0, 0.0, count, count <= 500, 5.0 * count)
        for number, count in enumerate(movements)
    ]
    return Evaluation(Cell(controller, sampling_hz, rho).scenario, controller, None, 7, chases)


def all_invented() -> list[Evaluation]:
    """The oracle, twelve settings that need more movements the faster and the less correlated, and one of A3C."""
    twelve = [
        invented("paper", sampling_hz, rho, [int(20 + sampling_hz / 5 + 10 * (1 - rho)) + k % 10 for k in range(40)])
        for rho in SPATIAL_CORRELATION
        for sampling_hz in SAMPLING_HZ
    ]
    return [
        invented("oracle", 10.0, 0.9, [20 + k % 5 for k in range(40)]),
        *twelve,
        invented("paper-a3c", 100.0, 0.5, [100 + k for k in range(40)]),
    ]


@pytest.fixture
def few_cells(monkeypatch: pytest.MonkeyPatch) -> list[Cell]:
    """Two cells that need no network, in blocks of three chases."""
    two = [Cell("oracle", 10.0, 0.9), Cell("random", 100.0, 0.1)]
    monkeypatch.setattr(reproduction, "cells", lambda: two)
    monkeypatch.setattr(blocks, "BLOCK_CHASES", 3)
    monkeypatch.setattr(Cell, "scenario", property(lambda cell: near(cell.sampling_hz, cell.spatial_correlation)))
    return two


def near(sampling_hz: float, rho: float) -> Any:
    changes = {"start_distance_m": 8.0, "max_movements": 15, "window_samples": 2}
    return paper_scenario(sampling_hz=sampling_hz, spatial_correlation=rho, **changes)


def test_it_evaluates_the_papers_twelve_settings_and_the_oracle() -> None:
    found = cells()
    for controller, settings in (("paper", TWELVE), ("oracle", {(10.0, 0.9)})):
        assert {(one.sampling_hz, one.spatial_correlation) for one in found if one.controller == controller} == settings
    assert set(MOVEMENTS_P90) | set(TRACKING_TIME_S) <= TWELVE
    assert len({one.name for one in found}) == len(found)
    assert {one.episodes(10_000) for one in found if one.controller == "paper-a3c"} == {2_000}
    assert {one.episodes(10_000) for one in found if one.controller != "paper-a3c"} == {10_000}
    assert {one.episodes(3) for one in found} == {1, 3}


def test_the_table_holds_the_very_chases_of_evaluate(few_cells: list[Cell], tmp_path: Path) -> None:
    evaluations = reproduce(tmp_path, 7, 3, 1)
    save_evaluations(tmp_path, evaluations)
    for cell, one in zip(few_cells, evaluations, strict=True):
        assert list(one.chases) == list(evaluate(cell.scenario, cell.controller, 7, 3).chases)
    kept = read_evaluations(tmp_path / TABLE_FILE)
    assert [one.controller for one in kept] == ["oracle", "random"]
    for one, whole in zip(kept, evaluations, strict=True):
        for mine, theirs in zip(one.chases, whole.chases, strict=True):
            assert dataclasses.replace(mine, target_x_m=0.0, target_y_m=0.0, target_z_m=0.0) == dataclasses.replace(
                theirs, target_x_m=0.0, target_y_m=0.0, target_z_m=0.0
            )
    metadata = json.loads(pq.read_schema(tmp_path / TABLE_FILE).metadata[b"swarmchase"])
    assert metadata["command"] == "swarmchase reproduce --episodes 7 --seed 3"
    assert set(metadata) == {"version", "command", "weights_sha256", "scenario", "differs_by_row"}
    assert set(metadata["weights_sha256"]) == {"oracle-F10-rho0.9", "random-F100-rho0.1"}


def test_interrupted_it_goes_on_behind_the_last_block(
    few_cells: list[Cell], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = reproduce(tmp_path / "whole", 7, 3, 1)
    save_evaluations(tmp_path / "whole", whole)
    evaluated: list[tuple[str, int, int]] = []

    def counted(
        scenario: Any, controller: str, episodes: int, *arguments: Any, first_chase: int, **options: Any
    ) -> Any:
        if len(evaluated) == 4:
            evaluated.clear()
            raise KeyboardInterrupt
        evaluated.append((controller, first_chase, episodes))
        return evaluate(scenario, controller, episodes, *arguments, first_chase=first_chase, **options)

    monkeypatch.setattr(blocks, "evaluate", counted)
    with pytest.raises(KeyboardInterrupt):
        reproduce(tmp_path / "parts", 7, 3, 1)
    told: list[tuple[int, int]] = []
    assert reproduce(tmp_path / "parts", 7, 3, 1, lambda *news: told.append(news[:2])) == whole
    assert evaluated == [("random", 3, 3), ("random", 6, 1)]
    assert told == sorted(told)
    assert told[-1] == (14, 10)  # of all chases ten were found on disk
    save_evaluations(tmp_path / "parts", whole)
    assert (tmp_path / "parts" / TABLE_FILE).read_bytes() == (tmp_path / "whole" / TABLE_FILE).read_bytes()


@pytest.mark.parametrize("change", ["nothing", "version", "weights", "damage"])
def test_a_block_of_another_run_is_made_anew(
    few_cells: list[Cell], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: str
) -> None:
    first = reproduce(tmp_path, 3, 3, 1)
    if change == "version":
        monkeypatch.setattr(blocks, "__version__", "another")
    if change == "weights":
        monkeypatch.setattr(blocks, "weights_sha256", lambda *_: "another")
    if change == "damage":
        for block in (tmp_path / "blocks").iterdir():
            block.write_bytes(block.read_bytes()[:-20])
    evaluated: list[str] = []

    def counted(scenario: Any, controller: str, *arguments: Any, **options: Any) -> Any:
        evaluated.append(controller)
        return evaluate(scenario, controller, *arguments, **options)

    monkeypatch.setattr(blocks, "evaluate", counted)
    assert reproduce(tmp_path, 3, 3, 1) == first
    assert evaluated == ([] if change == "nothing" else ["oracle", "random"])


def test_a_folder_with_another_runs_table_is_refused_and_left_as_it_is(few_cells: list[Cell], tmp_path: Path) -> None:
    save_evaluations(tmp_path, reproduce(tmp_path, 3, 3, 1))
    before = (tmp_path / TABLE_FILE).read_bytes()
    for episodes, seed in ((2, 3), (3, 4)):
        with pytest.raises(InputError, match="choose another folder"):
            reproduce(tmp_path, episodes, seed, 1)
    assert (tmp_path / TABLE_FILE).read_bytes() == before


def test_a_table_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / TABLE_FILE).write_bytes(b"no table")
    for path in (tmp_path / TABLE_FILE, tmp_path / "missing.parquet"):
        with pytest.raises(InputError, match=path.name):
            read_evaluations(path)
    with pytest.raises(InputError, match="episodes = 0"):
        reproduce(tmp_path / "new", 0, 0, 1)


def test_the_fading_examples_are_the_channels_own() -> None:
    rows = fading_table(5).to_pylist()
    assert len(rows) == 2 * 6 * 50
    scenario = paper_scenario(sampling_hz=20, spatial_correlation=0.1)
    expected = fading_db(first_window(scenario, [(5, 0)]))[0]
    trace = [row for row in rows if row["sampling_hz"] == 20 and row["tracker"] == 3]
    assert [row["fading_db"] for row in trace] == pytest.approx(expected[3].tolist())
    assert [row["time_s"] for row in trace] == pytest.approx([k / 20 for k in range(50)])
    assert {(row["sampling_hz"], row["spatial_correlation"]) for row in rows} == {(20.0, 0.1), (10.0, 0.9)}


def test_the_report_by_hand() -> None:
    summaries = [one.summary() for one in all_invented()]
    tables = {name: table.markdown() for name, table in report_tables(summaries).items()}
    # Movements 20..24, eight of each: the 36th of 40 is 24, the 32nd 23; mean 22.
    assert oracle_line(summaries).startswith(
        "The oracle, which knows the target: 90th percentile 24 [23, 24], mean 22.00 ["
    )
    rows = tables["movements"].splitlines()
    assert len(rows) == 2 + 12
    # F = 100, rho = 0.5: 45..54, the 36th is 53; 53 / 24 = 2.21. The paper says 160.
    [row] = [row for row in rows if row.startswith("| 0.5 | 100 |")]
    assert row.startswith("| 0.5 | 100 | 160 | 53 [")
    assert "| +121 % | 49.50 [" in row
    assert row.endswith("| 54 | 100.00 % [91.19, 100.00] |")
    [row] = [row for row in tables["A3C alone"].splitlines() if row.startswith("| 0.5 ")]
    # 100..139: the 36th is 135.
    assert row.startswith("| 0.5 | 100 | 160 | 135 [")
    assert "| 53 [" in row
    # F = 10, rho = 0.9: 23..32, mean 27.5; 27.5 (5 s + 5 m at 5 m/s) = 165 s, at 2 m/s 206.25 s.
    [row] = [row for row in tables["mean total tracking time"].splitlines() if row.startswith("| 0.9 | 10 |")]
    assert row.startswith("| 0.9 | 10 | 139 s | 165.0 s [")
    assert "| 206.2 s [" in row


def labels(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_the_figures_show_every_setting_and_what_the_paper_states() -> None:
    evaluations = all_invented()
    summaries = [one.summary() for one in evaluations]
    movements = {
        (one.controller, one.scenario.sampling_hz, one.scenario.spatial_correlation): [
            chase.movements for chase in one.chases
        ]
        for one in evaluations
    }
    figure = movement_figure(movements)
    assert labels(figure) == ["oracle", *(f"F = {hertz:g} Hz" for hertz in SAMPLING_HZ), "stated in the paper"]
    stars = [line for axes in figure.axes for line in axes.get_lines() if line.get_marker() == "*"]
    assert sorted(float(np.asarray(star.get_xdata())[0]) for star in stars) == [26, 44, 49, 160]
    curve = next(line for line in figure.axes[0].get_lines() if line.get_label() == "F = 10 Hz")
    # rho = 0.1, F = 10: 31 to 40, four chases each.
    assert np.asarray(curve.get_xdata())[1:].tolist() == sorted([31 + k % 10 for k in range(40)])
    assert np.asarray(curve.get_ydata())[-1] == 1

    percentiles = percentile_figure(summaries)
    [axes] = percentiles.axes
    stars = [line for line in axes.get_lines() if line.get_marker() == "*"]
    drawn = {(float(np.asarray(s.get_xdata())[0]), float(np.asarray(s.get_ydata())[0])) for s in stars}
    assert drawn == {(10.0, 26.0), (100.0, 49.0), (10.0, 44.0), (100.0, 160.0)}
    assert {"ρ = 0.1", "ρ = 0.5", "ρ = 0.9", "ρ = 0.5, A3C", "oracle"} < set(labels(percentiles))

    slow, fast = tracking_time_figure(summaries).axes
    assert [axes.get_title() for axes in (slow, fast)] == ["v = 2 m/s", "v = 5 m/s"]
    stars = [line for line in fast.get_lines() if line.get_marker() == "*"]
    assert sorted(float(np.asarray(s.get_ydata())[0]) for s in stars) == [62, 139]
    assert not [line for line in slow.get_lines() if line.get_marker() == "*"]
    # The oracle's 22 movements: 22 (50 / F + 5 m / v) at v = 5 m/s.
    oracle = next(line for line in fast.get_lines() if line.get_label() == "oracle")
    assert np.asarray(oracle.get_ydata()).tolist() == pytest.approx([22 * (50 / hertz + 1) for hertz in SAMPLING_HZ])


def test_the_command_leaves_the_table_the_figures_and_one_json_object(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One short chase of each setting with the trained controllers, from one command."""
    shorter = {"start_distance_m": 20.0, "max_movements": 30}
    tables_own = Cell.scenario.fget
    assert tables_own is not None
    monkeypatch.setattr(Cell, "scenario", property(lambda cell: dataclasses.replace(tables_own(cell), **shorter)))
    folder = tmp_path / "out"
    main(["reproduce", "--episodes", "1", "--seed", "9", "--processes", "1", "--folder", str(folder), "--json"])
    output = capsys.readouterr()
    summaries = json.loads(output.out)["summaries"]
    assert len(summaries) == len(cells())
    assert {
        (row["sampling_hz"], row["spatial_correlation"]) for row in summaries if row["controller"] == "paper"
    } == TWELVE
    assert all(row["episodes"] == 1 and row["seed"] == 9 for row in summaries)
    names = {path.name for path in folder.iterdir()}
    assert {TABLE_FILE, FADING_FILE, "results.md", "fig3-fading.png", "fig7-tracking-time.pdf"} <= names
    pictures = sorted(folder.glob("*.png"))
    assert [path.name[:4] for path in pictures] == ["fig3", "fig4", "fig5", "fig6", "fig7"]
    for picture in pictures:
        assert matplotlib.image.imread(picture).std() > 0.01
        assert picture.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    assert (folder / "results.md").read_text().startswith("| rho | F (Hz) |")
    shutil.rmtree(folder)


def test_quick_and_episodes_are_two_answers_to_one_question(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["reproduce", "--quick", "--episodes", "5", "--folder", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert "--quick" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
