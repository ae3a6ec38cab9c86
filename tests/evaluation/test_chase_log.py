"""The log of one chase tells the same chase as the evaluation's table, and its numbers add up."""

import dataclasses
import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmchase.controllers import load_controller
from swarmchase.evaluation.chase_log import chase_log, run_chase, save_chase_log
from swarmchase.evaluation.chases import ChaseResult
from swarmchase.evaluation.table import evaluate
from swarmchase.scenario import Scenario, paper_scenario

SCENARIO = paper_scenario(start_distance_m=30.0, max_movements=40, sampling_hz=50)


def log_of(controller: str, seed: int, chase: int, scenario: Scenario = SCENARIO) -> dict[str, Any]:
    driver = load_controller(controller, scenario)
    return chase_log(scenario, driver, seed, chase, list(run_chase(scenario, driver, seed, chase)))


@pytest.mark.parametrize("controller", ["oracle", "random"])
@pytest.mark.parametrize("chase", [0, 3])
def test_log_is_the_evaluation_row_of_the_same_chase(controller: str, chase: int) -> None:
    log = log_of(controller, 6, chase)
    row = evaluate(SCENARIO, controller, episodes=4, seed=6).chases[chase]
    # The log counts the movements made; the table counts a failed chase as one more than may be made.
    movements = log["movements"] if log["reached"] else SCENARIO.max_movements + 1
    assert row == ChaseResult(
        log["seed"], log["chase"], *log["target_position_m"], movements, log["reached"], log["path_length_m"]
    )


def test_oracle_reaches_and_random_is_cut_off() -> None:
    assert [log_of(controller, 6, 0)["reached"] for controller in ("oracle", "random")] == [True, False]
    failed = log_of("random", 6, 0)
    last = failed["moments"][-1]
    assert (failed["movements"], last["reached"], last["truncated"]) == (SCENARIO.max_movements, False, True)


@pytest.mark.parametrize("controller", ["oracle", "random"])
def test_moments_follow_from_one_another(controller: str) -> None:
    log = log_of(controller, 2, 1)
    moments = log["moments"]
    target = np.array(log["target_position_m"])
    assert [moment["movement"] for moment in moments] == list(range(log["movements"] + 1))
    assert moments[0]["center_m"] == [0, 0, 0]
    assert moments[0]["reward_m"] == [0, 0, 0, 0]
    assert moments[0]["distance_m"] == pytest.approx(SCENARIO.start_distance_m)
    for before, after in itertools.pairwise(moments):
        moved = np.array(after["displacement_m"])
        assert np.allclose(np.array(before["center_m"]) + moved, after["center_m"], atol=1e-12)
        assert after["path_length_m"] - before["path_length_m"] == pytest.approx(np.linalg.norm(moved), abs=1e-9)
        assert after["reward_m"][0] == pytest.approx(before["distance_m"] - after["distance_m"], abs=1e-9)
        assert not before["reached"]
        assert not before["truncated"]
    # Rewards telescope: their sums are the distances won, the Euclidean one and those of the axes.
    won = np.sum([moment["reward_m"] for moment in moments], axis=0)
    end = np.array(moments[-1]["center_m"])
    assert won[0] == pytest.approx(SCENARIO.start_distance_m - log["final_distance_m"], abs=1e-9)
    assert won[1:] == pytest.approx(abs(target) - abs(end - target), abs=1e-9)
    assert log["final_distance_m"] == pytest.approx(math.dist(target, end), abs=1e-9)
    assert log["reached"] == (log["final_distance_m"] <= SCENARIO.success_radius_m)


def test_windows_are_those_of_six_trackers_and_grow_louder() -> None:
    log = log_of("oracle", 2, 1)
    windows = np.array([moment["rssi_dbm"] for moment in log["moments"]])
    assert windows.shape == (log["movements"] + 1, SCENARIO.window_samples, 6)
    # 30 m to less than 2 m away is more than 20 dB; a window's mean strays by a few.
    assert windows[-1].mean() - windows[0].mean() > 15


def test_times_are_movements_and_path() -> None:
    log = log_of("oracle", 2, 1)
    heard_s = log["movements"] * 1.0  # 50 samples at 50 Hz
    assert log["tracking_time_s"] == pytest.approx(
        {"2": heard_s + log["path_length_m"] / 2, "5": heard_s + log["path_length_m"] / 5}
    )


def test_saved_log_comes_back_equal_and_redoes_the_chase(tmp_path: Path) -> None:
    log = log_of("random", 9, 4)
    save_chase_log(tmp_path / "chase.json", log)
    read = json.loads((tmp_path / "chase.json").read_text())
    assert read == log
    scenario = Scenario.from_dict(read["scenario"])
    assert log_of(read["controller"], read["seed"], read["chase"], scenario) == log
    assert log_of(read["controller"], read["seed"], read["chase"] + 1, scenario) != log


def test_moments_are_told_one_by_one() -> None:
    """``chase`` shows each movement when it happens, not when all is over."""
    driver = load_controller("random", SCENARIO)
    telling = run_chase(SCENARIO, driver, 9, 4)
    first, second = next(telling), next(telling)
    assert (first.movement, second.movement) == (0, 1)
    assert dataclasses.asdict(second) == log_of("random", 9, 4)["moments"][1]
