"""Flights with one transmitter and with two: what counts, and the command from end to end."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from live_bench import Bench
from swarmchase.benchmarks.live import LiveWork
from swarmchase.benchmarks.transmitters import SETTINGS, Refusal, TransmittersResult, fly, report, transmitter_rows
from swarmchase.cli import main
from swarmchase.live.service.chase_state import NOT_ONE_TRANSMITTER
from swarmchase.scenario import load_scenario

SCENARIO = dataclasses.replace(load_scenario("flight"), behaviour="hover", start_distance_m=5.0, farthest_start_m=6.0)


def test_where_another_place_is_called_reached_that_counts() -> None:
    flight = fly(LiveWork(SCENARIO, "particle", 0, 1), "")
    assert (flight.chase.state, flight.hears_two, flight.is_refused) == ("reached", False, False)
    elsewhere = dataclasses.replace(flight.chase, said_distance_m=150.0)
    aborted = dataclasses.replace(flight.chase, state="aborted")
    lost = dataclasses.replace(flight.chase, state="lost", reason="239 movements are spent")
    refused = dataclasses.replace(lost, reason=f"{lost.reason}; {NOT_ONE_TRANSMITTER}")
    results = [
        flight,
        TransmittersResult(elsewhere, False, False),
        TransmittersResult(elsewhere, True, False),  # told of two no longer
        TransmittersResult(aborted, True, True),
        TransmittersResult(lost, False, False),
        TransmittersResult(refused, True, False),
    ]
    told = report(SCENARIO, "particle", 0, {"one transmitter": results})
    assert transmitter_rows(told) == [["hover", "one transmitter", "1", "2 [4%, 78%]", "2", "3 [12%, 88%]"]]


@pytest.mark.parametrize(
    ("beside_s", "two_s", "refused_s"),
    [
        ([(5, 40)], (0, 40), 15),
        ([(5, 40)], (20, 40), 30),  # only then it told of two
        ([(5, 9), (11, 14), (16, 40)], (0, 40), 15),  # it passed, and turned round
        ([(5, 9), (20, 40)], (0, 40), 30),  # it had left
        ([(5, 9)], (0, 40), None),
        ([(5, 11), (30, 38)], (0, 40), None),
        ([(5, 40)], (0, 12), None),
        ([(5, 40)], (0, 0), None),
    ],
)
def test_a_flight_is_refused_where_two_are_told_of_for_a_while_beside_one(
    beside_s: list[tuple[int, int]], two_s: tuple[int, int], refused_s: int | None
) -> None:
    """Snapshots of a real service, every half second, in which these two say what the case says."""
    refusal, snapshot, ended_s = Refusal(), Bench().service.snapshot(), list[float]()
    for second in np.arange(0.0, 40.0, 0.5).tolist():
        share = 0.9 if any(begin <= second < end for begin, end in beside_s) else 0.0
        hears_two = two_s[0] <= second < two_s[1]
        time_ns = snapshot.time_ns + round(second * 1e9)
        refusal.take(dataclasses.replace(snapshot, time_ns=time_ns, share_within=share, hears_two=hears_two))
        ended_s += [second] if refusal.is_long else []
    assert (ended_s[0] if ended_s else None) == refused_s
    assert refusal.hears_two == (two_s != (0, 0))


def test_the_command_flies_them_all(capsys: pytest.CaptureFixture[str]) -> None:
    near = ["--start-distance-m", "5", "--farthest-start-m", "6", "--behaviour", "hover"]
    words = ["benchmark", "transmitters", "--scenario", "flight", *near, "--controller", "particle", "--episodes", "2"]
    main([*words, "--json"])
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert list(told["settings"]) == list(SETTINGS)
    # From 5 m on the other one is not noticed, and does no harm.
    assert [one["reached"] for one in told["settings"].values()] == [2] * len(SETTINGS)


def test_a_target_that_stands_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["benchmark", "transmitters", "--controller", "particle", "--episodes", "2"])
    assert "say --scenario flight" in capsys.readouterr().err
