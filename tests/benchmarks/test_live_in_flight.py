"""Live flights beside the evaluation of the same chases: what counts, and the command from end to end."""

import json
import math
from typing import Any

import pytest

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from swarmchase.benchmarks.live import IN_FLIGHT, rows_in_flight, summary
from swarmchase.cli import main
from swarmchase.scenario import load_scenario
from swarmchase.simulation.virtual_chase import VirtualResult

SCENARIO = load_scenario("flight")
"""2 m, and 120 s."""


def ended(state: str, said_distance_m: float, flown_s: float, capture_s: float | None) -> VirtualResult:
    return VirtualResult(
        state=state,
        reason="",
        reached=state == "reached" and said_distance_m <= SCENARIO.success_radius_m,
        movements=round(2 * flown_s),
        movements_to_target=None,
        capture_s=capture_s,
        flown_s=flown_s,
        said_distance_m=said_distance_m,
        following_share=None,
        least_separation_m=6.0 + flown_s / 100,
        seconds=flown_s + 1,
        rejected={},
        decision_latency_s=[0.01],
    )


def test_what_is_called_reached_too_far_off_is_a_false_alarm_and_counts_as_the_limit() -> None:
    results = [
        ended("reached", 1.9, 20.0, 19.5),
        ended("reached", 2.9, 30.0, None),  # within a metre for receivers of positions
        ended("reached", 3.1, 10.0, None),
        ended("lost", 2.5, 120.0, 50.0),  # was there, and nobody has noticed
    ]
    told = summary(SCENARIO, results)
    assert (told["success_rate"], told["false_alarms"]) == (0.5, 1)
    assert told["said_s_mean"] == pytest.approx((20 + 30 + 120 + 120) / 4)
    assert told["capture_s_mean"] == pytest.approx((19.5 + 120 + 120 + 50) / 4)
    assert told["least_separation_m"] == pytest.approx(6.1)
    result = {"evaluation": {"capture_s_mean": 50.0}, "settings": {"no loss": told}}
    assert rows_in_flight(result)[0][-2:] == [f"{72.5 / 50:.2f}", "6.10"]


def test_the_command_measures_flights_and_evaluates_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    near = ["--start-distance-m", "5", "--farthest-start-m", "6", "--max-movements", "20"]
    words = ["benchmark", "live", "--scenario", "flight", "--behaviour", "hover", "--target-speed-mps", "0", *near]
    main([*words, "--chases", "2", "--json"])
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert (told["behaviour"], told["controller"], told["chases"]) == ("hover", "adaptive", 2)
    assert list(told["settings"]) == list(IN_FLIGHT)
    assert 0 < told["evaluation"]["capture_s_mean"] < 10.5
    for one in told["settings"].values():
        assert one["false_alarms"] == 0
        assert one["least_separation_m"] > 0.6
        assert math.isfinite(one["said_s_mean"])
    assert told["settings"]["no loss"]["success_rate"] == 1.0
