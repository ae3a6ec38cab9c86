"""Evaluation: times by pencil, intervals against independent derivations, one table whatever computes it."""

import json
import math
import os
import signal
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch

from swarmchase.commands.evaluate import summary_table
from swarmchase.errors import InputError, WorkerDiedError
from swarmchase.evaluation import table
from swarmchase.evaluation.chases import ChaseResult, run_chases
from swarmchase.evaluation.statistics import mean_interval, nearest_rank_percentile, percentile_interval
from swarmchase.evaluation.table import (
    Evaluation,
    evaluate,
    tracking_time_s,
)
from swarmchase.formation import Action
from swarmchase.networks.actor_critic import SwarmNetworks
from swarmchase.networks.weights import save_weights
from swarmchase.observation import Observation
from swarmchase.scenario import Scenario, paper_scenario

PROMISED_KEYS = {
    "controller",
    "sampling_hz",
    "spatial_correlation",
    "episodes",
    "seed",
    "success_rate",
    "movements_mean",
    "movements_p50",
    "movements_p90",
    "movements_p90_ci95",
    "movements_max",
    "tracking_time_mean_s",
}


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "fresh.safetensors"
    save_weights(path, SwarmNetworks(torch.Generator().manual_seed(7)), {"action_choice": "sampled"})
    return path


def result(chase: int, movements: int, path_length_m: float, reached: bool = True) -> ChaseResult:
    return ChaseResult(3, chase, 100.0, 0.0, 0.0, movements, reached, path_length_m)


@pytest.mark.parametrize(
    ("sampling_hz", "movements", "path_length_m", "speed_mps", "time_s"),
    [
        (10.0, 26, 104.0, 5.0, 26 * 5 + 20.8),  # 5 s to hear a window
        (10.0, 26, 104.0, 2.0, 26 * 5 + 52),
        (100.0, 49, 196.0, 5.0, 24.5 + 39.2),  # half a second to hear one
        (20.0, 1, 0.0, 2.0, 2.5),  # a movement of no length still costs a window
        (50.0, 0, 0.0, 5.0, 0.0),
    ],
)
def test_tracking_time_is_windows_and_flight(
    sampling_hz: float, movements: int, path_length_m: float, speed_mps: float, time_s: float
) -> None:
    scenario = paper_scenario(sampling_hz=sampling_hz)
    times_s = tracking_time_s(scenario, np.array([movements]), np.array([path_length_m]), speed_mps)
    assert times_s == pytest.approx(time_s, rel=1e-12)


# --- intervals -------------------------------------------------------------------------------------------------------


def at_most(count: int, chases: int, share: Fraction) -> Fraction:
    """P(B <= count) of a binomial, exactly."""
    return sum(
        (math.comb(chases, k) * share**k * (1 - share) ** (chases - k) for k in range(count + 1)), start=Fraction(0)
    )


@pytest.mark.parametrize(("chases", "percent"), [(40, 50), (40, 90), (101, 90), (200, 90)])
def test_percentile_interval_is_the_binomial_one(chases: int, percent: int) -> None:
    """Of the ranks 1..n, the narrowest pair with no more than 2.5 % beyond either end, found by counting."""
    share = Fraction(percent, 100)
    tail = Fraction(25, 1000)
    below = [at_most(rank - 1, chases, share) for rank in range(1, chases + 1)]  # P(the rank'th value > percentile)
    low = max(rank for rank in range(1, chases + 1) if below[rank - 1] <= tail)
    high = min(rank for rank in range(1, chases + 1) if 1 - below[rank - 1] <= tail)
    assert percentile_interval(np.arange(1, chases + 1), percent) == [low, high]


@pytest.mark.parametrize(
    ("distribution", "true_percentile", "allowed"),
    [
        # Exponential, 90th percentile ln 10. Ranks are discrete, so a little more than 95 % is covered.
        ("exponential", math.log(10), (0.94, 0.975)),
        # Movements have ties: P(X <= 3) = .822, P(X <= 4) = .9000. An interval that touches 4 covers it, so more do.
        ("geometric", 4.0, (0.94, 1.0)),
    ],
)
def test_percentile_interval_covers_the_truth_in_95_percent(
    distribution: str, true_percentile: float, allowed: tuple[float, float]
) -> None:
    generator = np.random.default_rng(1)
    draw = {
        "exponential": lambda: generator.exponential(size=300),
        "geometric": lambda: generator.geometric(0.4377, size=300),
    }[distribution]
    intervals = [percentile_interval(draw(), 90) for _ in range(3000)]
    covered = np.mean([low <= true_percentile <= high for low, high in intervals])
    assert allowed[0] <= covered <= allowed[1]


@pytest.mark.parametrize(
    ("values", "percent", "interval"),
    [
        ([7], 90, [7, 7]),  # never beyond the values
        ([9, 3], 50, [3, 9]),
        ([5] * 60, 90, [5, 5]),  # ties
        ([501] * 30 + [1], 50, [501, 501]),
        (list(range(20, 0, -1)), 50, [6, 15]),  # order does not matter; the textbook's 6th and 15th of 20
    ],
)
def test_percentile_interval_of_hand_made_values(values: list[int], percent: int, interval: list[float]) -> None:
    assert percentile_interval(np.array(values), percent) == interval


def test_mean_interval_by_hand_and_by_coverage() -> None:
    # Mean 3, standard deviation sqrt(10 / 4), n = 5.
    low, high = mean_interval(np.array([1, 2, 3, 4, 5])) or []
    assert (low, high) == pytest.approx((3 - 1.385904, 3 + 1.385904), abs=1e-6)
    assert mean_interval(np.array([8])) is None
    generator = np.random.default_rng(2)
    intervals = np.array([mean_interval(generator.exponential(size=400)) for _ in range(3000)])
    assert 0.935 <= np.mean((intervals[:, 0] <= 1) & (intervals[:, 1] >= 1)) <= 0.96


# --- the summary and the table ---------------------------------------------------------------------------------------

FOUR_CHASES = [
    result(0, 20, 100.0),
    result(1, 24, 120.0),
    result(2, 22, 104.0),
    result(3, 501, 1400.0, reached=False),
]


def test_summary_of_four_chases_by_pencil() -> None:
    summary = Evaluation(paper_scenario(sampling_hz=50, spatial_correlation=0.5), "oracle", None, 3, FOUR_CHASES)
    row = summary.summary()
    assert row.keys() >= PROMISED_KEYS
    assert json.loads(json.dumps(row, allow_nan=False)) == row
    assert (row["controller"], row["sampling_hz"], row["spatial_correlation"]) == ("oracle", 50.0, 0.5)
    assert (row["episodes"], row["seed"], row["success_rate"]) == (4, 3, 0.75)
    assert row["movements_mean"] == (20 + 24 + 22 + 501) / 4  # the failed one counts, as MAX_STEPS + 1
    assert (row["movements_p50"], row["movements_p90"], row["movements_max"]) == (22, 501, 501)
    assert row["movements_p90_ci95"] == [22, 501]  # P(B <= 1) = .004 and P(B <= 2) = .052
    # A window lasts a second. The failed chase heard 500 windows, not 501.
    windows_s = (20 + 24 + 22 + 500) / 4
    path_m = (100 + 120 + 104 + 1400) / 4
    assert row["tracking_time_mean_s"] == pytest.approx({"2": windows_s + path_m / 2, "5": windows_s + path_m / 5})


def test_summary_of_one_chase_is_json_and_a_table() -> None:
    row = Evaluation(paper_scenario(), "oracle", None, 3, FOUR_CHASES[:1]).summary()
    assert json.loads(json.dumps(row, allow_nan=False))["movements_mean_ci95"] is None
    shown = dict(zip(*(map(str, column.cells) for column in summary_table(row).columns), strict=True))
    assert shown["movements, mean"] == "20.0"  # no interval
    assert shown["movements, 90th percentile"] == "20 [20, 20]"


class Slantwise:
    """A plug-in's mistake: it flies where the paper's world has no place."""

    name = "slantwise"

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> torch.Tensor:
        return torch.zeros(num_chases)

    def decide(self, observation: Observation, memory: torch.Tensor) -> tuple[Action, torch.Tensor]:
        chases = len(observation.rssi_dbm)
        return Action(torch.full((chases,), 5.0).double(), torch.full((chases, 3), 3.5).double()), memory


def test_an_action_that_is_refused_is_told_with_the_controller_that_chose_it() -> None:
    with pytest.raises(
        InputError, match=r"^controller 'slantwise': displacement_m = 3.5 is refused: allowed is one of"
    ):
        list(run_chases(paper_scenario(), Slantwise(), seed=0, chases=range(2)))


def test_failed_chases_are_counted_and_never_dropped() -> None:
    scenario = paper_scenario(max_movements=4)  # nobody flies 100 m in four movements
    outcome = evaluate(scenario, "oracle", episodes=9, seed=5)
    assert [chase.chase for chase in outcome.chases] == list(range(9))
    assert {(chase.movements, chase.reached) for chase in outcome.chases} == {(5, False)}
    summary = outcome.summary()
    assert (summary["success_rate"], summary["movements_mean"], summary["movements_p90"]) == (0.0, 5.0, 5.0)


def test_parquet_holds_one_row_a_chase_and_what_made_it(tmp_path: Path) -> None:
    scenario = paper_scenario(sampling_hz=50, spatial_correlation=0.5)
    Evaluation(scenario, "oracle", None, 3, FOUR_CHASES).save_parquet(tmp_path / "new" / "table.parquet")
    table = pq.read_table(tmp_path / "new" / "table.parquet")
    assert table.to_pydict() == {
        "seed": [3] * 4,
        "chase": [0, 1, 2, 3],
        "target_x_m": [100.0] * 4,
        "target_y_m": [0.0] * 4,
        "target_z_m": [0.0] * 4,
        "movements": [20, 24, 22, 501],
        "reached": [True, True, True, False],
        "path_length_m": [100.0, 120.0, 104.0, 1400.0],
        "tracking_time_2mps_s": [70.0, 84.0, 74.0, 1200.0],
        "tracking_time_5mps_s": [40.0, 48.0, 42.8, 780.0],
    }
    origin = json.loads(table.schema.metadata[b"swarmchase"])
    assert origin.keys() == {"version", "scenario", "world", "controller", "action_choice", "weights", "seed"}
    assert Scenario.from_dict(origin["scenario"]) == Scenario.from_dict(origin["world"]) == scenario
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["table.parquet"]


# --- one table, whatever computes it ---------------------------------------------------------------------------------

SMALL = paper_scenario(start_distance_m=12.0, max_movements=8)


def table_of(folder: Path, **how: Any) -> bytes:
    evaluate(SMALL, seed=11, **how).save_parquet(folder / "table.parquet")
    return (folder / "table.parquet").read_bytes()


@pytest.fixture
def small_shares(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let a second process be worth its while for a few chases."""
    monkeypatch.setattr(table, "SHARE_CHASES", 5)
    return


@pytest.mark.parametrize("controller", ["random", "oracle", "learned"])
def test_table_is_the_same_for_any_batch_size(controller: str, weights: Path, tmp_path: Path) -> None:
    name = str(weights) if controller == "learned" else controller
    tables = {
        batch_size: table_of(tmp_path, controller=name, episodes=12, batch_size=batch_size)
        for batch_size in (1, 7, 128)
    }
    assert tables[1] == tables[7] == tables[128]
    if controller == "learned":
        assert table_of(tmp_path, controller=name, episodes=12, action_choice="greedy") != tables[7]


@pytest.mark.usefixtures("small_shares")
def test_two_processes_make_the_same_table_tell_of_every_chase_and_leave_none_out(weights: Path) -> None:
    told: list[int] = []
    outcome = evaluate(SMALL, str(weights), episodes=11, seed=2, processes=2, finished=told.append)
    assert list(dict.fromkeys(told)) == list(range(12))  # some more than once, while none ends
    assert told == sorted(told)
    assert [chase.chase for chase in outcome.chases] == list(range(11))
    assert outcome == evaluate(SMALL, str(weights), episodes=11, seed=2)


def test_chases_are_those_of_a_longer_run() -> None:
    few = evaluate(SMALL, "random", episodes=5, seed=4).chases
    assert few == evaluate(SMALL, "random", episodes=15, seed=4).chases[:5]
    assert few != evaluate(SMALL, "random", episodes=5, seed=5).chases


def test_percentiles_are_of_the_nearest_rank() -> None:
    assert [nearest_rank_percentile([4, 1, 3, 2, 5], percent) for percent in (1, 20, 21, 50, 90, 100)] == [
        1,
        1,
        2,
        3,
        5,
        5,
    ]


# --- what goes wrong -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"episodes": 0}, "episodes = 0"),
        ({"batch_size": 0}, "batch_size = 0"),
        ({"processes": -1}, "processes = -1"),
        ({"seed": -1}, "seed = -1"),
        ({"controller": "nobody"}, "no controller 'nobody'"),
    ],
)
def test_bad_input_is_refused_before_work_begins(bad: dict[str, Any], words: str) -> None:
    told: list[int] = []
    given = {"controller": "oracle", "episodes": 3, "seed": 0} | bad
    with pytest.raises(InputError, match=words):
        evaluate(SMALL, **given, finished=told.append)
    assert told == []


def killed_at_once(*_arguments: Any) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fails_at_once(_work: Any, _chases: range, sender: Any) -> None:
    with sender:
        sender.send(InputError("weights file gone.safetensors is damaged"))


@pytest.mark.parametrize(
    ("life", "error", "words"),
    [(killed_at_once, WorkerDiedError, "exit code -9"), (fails_at_once, InputError, "gone.safetensors is damaged")],
)
@pytest.mark.usefixtures("small_shares")
def test_a_process_that_dies_is_an_error_and_no_hang(
    monkeypatch: pytest.MonkeyPatch, life: Any, error: type[Exception], words: str
) -> None:
    monkeypatch.setattr(table, "_run_share", life)
    with pytest.raises(error, match=words):
        evaluate(SMALL, "random", episodes=10, seed=0, processes=2)
