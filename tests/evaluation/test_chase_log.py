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
from swarmchase.scenario import Scenario, load_scenario, paper_scenario

SCENARIO = paper_scenario(start_distance_m=30.0, max_movements=40, sampling_hz=50)

FLIGHT = Scenario.from_dict(
    load_scenario("flight").to_dict() | {"start_distance_m": 20.0, "farthest_start_m": 40.0, "max_movements": 30}
)
FLYING = [
    # Away at half the swarm's speed: captured.
    dataclasses.replace(FLIGHT, behaviour="flee", target_speed_mps=5.0),
    # A target that stands still, as the paper's does: the swarm's flight alone is by the clock.
    FLIGHT,
    # The paper's pace, with a target that does not wait for it.
    paper_scenario(
        start_distance_m=30.0, max_movements=12, sampling_hz=100, behaviour="straight", target_speed_mps=1.0
    ),
]
"""Chases that are measured by the clock."""


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


@pytest.mark.parametrize("scenario", FLYING, ids=["flee", "hover", "stop and listen"])
@pytest.mark.parametrize("controller", ["oracle", "random"])
@pytest.mark.parametrize("chase", [0, 3])
def test_a_log_by_the_clock_is_the_evaluation_row_of_the_same_chase(
    scenario: Scenario, controller: str, chase: int
) -> None:
    log = log_of(controller, 6, chase, scenario)
    row = evaluate(scenario, controller, episodes=4, seed=6).chases[chase]
    last = log["moments"][-1]
    movements = log["movements"] if log["reached"] else scenario.max_movements + 1
    assert row == ChaseResult(
        log["seed"],
        log["chase"],
        *last["target_position_m"],
        movements,
        log["reached"],
        log["path_length_m"],
        log["capture_s"],
        log["least_distance_m"],
    )
    assert log["format"] == 2
    assert "tracking_time_s" not in log


def test_some_of_these_are_captured_and_some_are_not() -> None:
    endings = [(log := log_of(name, 6, 0, FLYING[0]))["reached"] and log["capture_s"] for name in ("oracle", "random")]
    assert endings[0] > 0
    assert endings[1] is False
    failed = log_of("random", 6, 0, FLYING[0])
    # One interval of listening before the first movement, then one each.
    assert failed["capture_s"] == pytest.approx(31 * 0.5)


@pytest.mark.parametrize("scenario", FLYING, ids=["flee", "hover", "stop and listen"])
def test_moments_by_the_clock_follow_from_one_another(scenario: Scenario) -> None:
    log = log_of("oracle", 2, 1, scenario)
    moments = log["moments"]
    assert np.linalg.norm(log["target_position_m"]) >= scenario.start_distance_m - 1e-9
    for before, after in itertools.pairwise(moments):
        seconds = after["time_s"] - before["time_s"]
        assert seconds > 0
        flown_m = math.dist(before["target_position_m"], after["target_position_m"])
        assert flown_m <= scenario.target_speed_mps * seconds + 1e-9
        assert before["sample_time_s"][-1] <= before["time_s"] + 1e-9 <= after["sample_time_s"][0] + 1e-6
        assert after["least_distance_m"] <= min(before["least_distance_m"], after["distance_m"]) + 1e-9
        assert before["reached_s"] is None
        if scenario.pace == "listen_in_flight":
            assert seconds == pytest.approx(scenario.decision_s)
            mean_mps = (np.array(before["center_velocity_mps"]) + after["center_velocity_mps"]) / 2
            moved_m = np.array(after["center_m"]) - before["center_m"]
            # Velocity changes by at most 5 m/s^2, so that the mean of both ends errs by little.
            assert np.linalg.norm(moved_m - mean_mps * seconds) <= 5 * seconds**2 / 4
    for moment in moments:
        assert np.array(moment["rssi_dbm"]).shape == (len(moment["sample_time_s"]), 6)
        assert moment["distance_m"] == pytest.approx(math.dist(moment["center_m"], moment["target_position_m"]))
    assert log["reached"] == (moments[-1]["reached_s"] is not None)
    assert log["reached"]
    assert moments[-2]["time_s"] < log["capture_s"] <= moments[-1]["time_s"]


def test_the_papers_chase_has_the_log_it_always_had() -> None:
    log = log_of("random", 9, 4)
    assert list(log) == [
        "version", "scenario", "controller", "seed", "chase", "target_position_m", "reached", "movements",
        "final_distance_m", "path_length_m", "tracking_time_s", "moments",
    ]  # fmt: skip
    assert list(log["moments"][0]) == [
        "movement", "center_m", "spacing_m", "displacement_m", "distance_m", "reward_m", "path_length_m", "rssi_dbm",
        "reached", "truncated",
    ]  # fmt: skip
