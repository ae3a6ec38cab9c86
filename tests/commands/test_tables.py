"""Tables in a pipe and at 80 columns: every cell whole, whatever their number."""

import itertools
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.table import Table

from swarmchase.cli import main
from swarmchase.commands import tables
from swarmchase.commands.compare import _show
from swarmchase.commands.tables import fits, print_table
from swarmchase.evaluation.comparison import AS_TOLD, Place, Result, summaries
from swarmchase.evaluation.table import evaluate
from swarmchase.reports.text_table import TextTable
from swarmchase.scenario import paper_scenario
from swarmchase.world.departures import departed

WIDTH = 80
CONTROLLERS = ("multilateration-unknown-power", "particle", "oracle", "gradient")
NEAR = paper_scenario(start_distance_m=8.0, max_movements=6)


def lines_of(capsys: pytest.CaptureFixture[str]) -> list[str]:
    told = capsys.readouterr().err
    assert "…" not in told
    return told.splitlines()


def cells(lines: list[str]) -> set[str]:
    return {cell.strip() for line in lines for cell in re.split("[│┃]", line)}


def results(worlds: tuple[str, ...], frequencies_hz: tuple[float, ...]) -> list[Result]:
    found = []
    for hertz, world_name, name in itertools.product(frequencies_hz, worlds, CONTROLLERS):
        told = paper_scenario(start_distance_m=8.0, max_movements=6, sampling_hz=hertz)
        world = departed(told, world_name)
        found.append(Result(Place(told, world_name, world), evaluate(told, name, 2, 1, world=world)))
    return found


def test_a_comparison_in_one_setting_has_one_row_a_controller(capsys: pytest.CaptureFixture[str]) -> None:
    rows = summaries(results((AS_TOLD,), (10.0,)))
    _show(rows)
    lines = lines_of(capsys)
    assert lines[0] == "F = 10 Hz, rho = 0.9, as told"
    assert max(map(len, lines)) <= WIDTH
    for row in rows:
        low, high = (100 * bound for bound in row["success_rate_ci95"])
        mine = [line for line in lines if re.search(rf"│ {row['controller']} +│", line)]
        assert any(f"{100 * row['success_rate']:.2f} % [{low:.2f}, {high:.2f}]" in line for line in mine)
        assert any(f"{row['movements_mean']:.2f} [" in line for line in mine)


def test_a_comparison_in_many_places_has_every_number_whole(capsys: pytest.CaptureFixture[str]) -> None:
    rows = summaries(results((AS_TOLD, "receivers off by up to 3 dB"), (10.0, 100.0)))
    _show(rows)
    lines = lines_of(capsys)
    assert max(map(len, lines)) <= WIDTH
    shown = cells(lines)
    for row in rows:
        low, high = row["movements_mean_ci95"]
        assert f"{row['movements_mean']:.2f} [{low:.2f}, {high:.2f}]" in shown


words = st.text("abc 0.%[]", min_size=1, max_size=30).map(str.strip).filter(bool)


@given(st.data())
def test_no_cell_is_cut_or_wrapped(data: st.DataObject) -> None:
    num_columns = data.draw(st.integers(2, 12))
    row = st.tuples(*[words] * num_columns)
    table = TextTable(data.draw(row), tuple(data.draw(st.lists(row, min_size=1, max_size=3))), num_keys=1)
    with tables.CONSOLE.capture() as captured:
        print_table(table)
    lines = captured.get().splitlines()
    assert {cell for one in table.rows for cell in one} <= cells(lines)
    # A key and a cell of 30 letters, at the most, fit beside one another.
    assert max(map(len, lines)) <= WIDTH
    if fits(table):
        assert len({line for line in lines if line.startswith("┏")}) == 1


def test_a_table_that_fits_keeps_its_title_and_caption(capsys: pytest.CaptureFixture[str]) -> None:
    for columns in (2, 9):
        table = Table(*(f"number {column}" for column in range(columns)), title="of numbers", caption="all of them")
        table.add_row(*["123,456.789"] * columns)
        print_table(table)
        lines = lines_of(capsys)
        assert "of numbers" in lines[0]
        assert "all of them" in lines[-1]
        assert sum(line.count("123,456.789") for line in lines) >= columns


@pytest.mark.parametrize("words", ["--scenario flight --max-movements 3 --follow-s 2 --controller particle", ""])
def test_an_evaluation_is_80_columns_wide_with_intervals_on_every_share(
    words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["evaluate", "--controller", "oracle", "--episodes", "2", "--processes", "1", *words.split()])
    lines = lines_of(capsys)
    assert max(map(len, lines)) <= WIDTH
    shares = [line for line in lines if re.search(r"\d %", line.replace("95 %", ""))]
    assert len(shares) >= (5 if words else 1)
    assert all(re.search(r"% \[\d+\.\d+, \d+\.\d+\]", line) for line in shares)
