"""Flights with one transmitter and with two: what counts, and the command from end to end."""

import dataclasses
import json
from typing import Any

import pytest

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from swarmchase.benchmarks.live import LiveWork
from swarmchase.benchmarks.transmitters import SETTINGS, TransmittersResult, fly, report, transmitter_rows
from swarmchase.cli import main
from swarmchase.scenario import load_scenario

SCENARIO = dataclasses.replace(load_scenario("flight"), behaviour="hover", start_distance_m=5.0, farthest_start_m=6.0)


def test_where_another_place_is_called_reached_that_counts() -> None:
    flight = fly(LiveWork(SCENARIO, "particle", 0, 1), "")
    assert (flight.chase.state, flight.hears_two, flight.is_refused) == ("reached", False, False)
    elsewhere = dataclasses.replace(flight.chase, said_distance_m=150.0)
    aborted = dataclasses.replace(flight.chase, state="aborted")
    lost = dataclasses.replace(flight.chase, state="lost")
    results = [
        flight,
        TransmittersResult(elsewhere, False, False),
        TransmittersResult(elsewhere, True, False),  # told of two no longer
        TransmittersResult(aborted, True, True),
        TransmittersResult(lost, False, False),
    ]
    told = report(SCENARIO, "particle", 0, {"one transmitter": results})
    assert transmitter_rows(told) == [["hover", "one transmitter", "1", "2 [5%, 85%]", "1", "2 [5%, 85%]"]]


def test_the_command_flies_both(capsys: pytest.CaptureFixture[str]) -> None:
    near = ["--start-distance-m", "5", "--farthest-start-m", "6", "--behaviour", "hover"]
    words = ["benchmark", "transmitters", "--scenario", "flight", *near, "--controller", "particle", "--episodes", "2"]
    main([*words, "--json"])
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert list(told["settings"]) == list(SETTINGS)
    # From 5 m on the other one, 150 m away, is not noticed, and does no harm.
    assert [one["reached"] for one in told["settings"].values()] == [2, 2]


def test_a_target_that_stands_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["benchmark", "transmitters", "--controller", "particle", "--episodes", "2"])
    assert "say --scenario flight" in capsys.readouterr().err
