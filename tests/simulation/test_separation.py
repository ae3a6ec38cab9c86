"""Vehicles keep apart, not only set-points: the real service, agents, link and vehicles, and what truly flies.

``swarmchase benchmark separation`` flies ten thousand such situations; here are the first of them.
"""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from swarmchase.benchmarks import separation as benchmark
from swarmchase.errors import InputError
from swarmchase.formation import Action
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.live.service.separation import MARGIN_M, POSITION_ERROR_M, STRAYING_M
from swarmchase.live.service.set_point_stream import SetPointStream
from swarmchase.live.service.settings import ServiceSettings
from swarmchase.live.tracker.vehicles import VehicleLimits
from swarmchase.observation import Observation
from swarmchase.simulation import encounters
from swarmchase.simulation.encounters import DIES, MOST_ERROR_M, PILOT, Event, Situation, fly, situation
from swarmchase.simulation.faulty_path import Faults
from swarmchase.simulation.virtual_chase import VirtualChase

IDEAL = VehicleLimits()


@pytest.mark.parametrize("seed", range(16))
def test_in_situations_of_every_kind_the_true_separation_is_kept(seed: int) -> None:
    """Lag, wind, wrong places, pilots, dead and frozen agents, cut links, a service that hangs or dies."""
    one = situation(seed)
    encounter = fly(one)
    assert encounter.movements > 0
    assert encounter.least_m >= one.limits.minimum_separation_m - one.margin_m


def test_the_margin_is_that_of_the_vehicles_that_are_flown() -> None:
    assert MARGIN_M == 2 * POSITION_ERROR_M + STRAYING_M
    assert MOST_ERROR_M == POSITION_ERROR_M
    drawn = [situation(seed) for seed in range(200)]
    assert max(one.margin_m for one in drawn) == MARGIN_M
    words = {event.what for one in drawn for event in one.events}
    assert words == {"pilot", "cut link", "service hangs", "service dies", "kill", "restart", "frozen", "slow"}


class FliesNorthEast:
    """In the narrowest formation, in which tracker 3 then follows tracker 0, sqrt(2) m behind it."""

    name = "north-east"

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> None:
        pass

    def decide(self, observation: Observation, memory: None) -> tuple[Action, None]:
        return Action(torch.tensor([1.0]), torch.tensor([[4.0, 4.0, 0.0]])), memory


@pytest.mark.parametrize("taken_over_s", [1.2, 1.5, 1.8, 2.1])
def test_who_is_stopped_in_mid_flight_is_not_flown_into(taken_over_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pilot takes tracker 0 at several moments of a movement, at the default limit of 1 m; where set-points alone are
    kept apart tracker 3 passes it at 1 to 4 cm. The others go on.
    """
    monkeypatch.setattr(encounters, "_WantsAnything", FliesNorthEast)
    taken_over = Event(PILOT, 0, taken_over_s, math.inf)
    encounter = fly(Situation(0, SafetyLimits(), 1.0, tuple(range(6)), (IDEAL,) * 6, Faults(), (taken_over,)))
    assert 1 <= encounter.least_m < 1.05
    assert encounter.pair == (0, 3)
    assert encounter.movements == 2
    assert encounter.evasions["by a detour"] == 1


def test_trackers_that_lose_their_controller_come_back_at_the_distances_at_which_they_went() -> None:
    """And to where each of them began."""
    one = dataclasses.replace(situation(46), vehicles=(IDEAL,) * 6, events=(Event(DIES, -1, 5.0, math.inf),))
    starts_m = [vehicle.true_position_m for vehicle in encounters._vehicles(one)]
    places_m: list[list[tuple[float, float, float]]] = []
    nearest = encounters._nearest

    def watched(positions_m: list[tuple[float, float, float]]) -> tuple[float, tuple[int, int]]:
        places_m.append(positions_m)
        return nearest(positions_m)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(encounters, "_nearest", watched)
        encounter = fly(one)
    assert encounter.least_m >= one.limits.minimum_separation_m - STRAYING_M
    assert max(math.dist(start_m, at_m) for start_m, at_m in zip(starts_m, places_m[-1], strict=True)) < 0.15
    farthest_m = max(math.dist(starts_m[0], at_m[0]) for at_m in places_m)
    assert farthest_m > 2


def test_at_a_corner_all_wait_until_everybody_has_arrived() -> None:
    """In turns, or by a detour: nobody begins a leg before all report to be where the last one ended."""
    turns: list[float] = []
    turn = SetPointStream.turn
    chases: list[VirtualChase] = []

    def watched(stream: SetPointStream) -> None:
        position_m = chases[-1].service._swarm.positions_m()
        turns.append(float(np.nanmax(np.linalg.norm(stream.set_point_m - position_m, axis=1))))
        turn(stream)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SetPointStream, "turn", watched)
        patch.setattr(encounters, "_happen", lambda one, chase, _: chases.append(chase))
        encounter = fly(dataclasses.replace(situation(18), vehicles=(IDEAL,) * 6, events=()))
    assert encounter.evasions.keys() & {"in turns", "by a detour"}
    assert len(turns) >= 3
    assert max(turns) <= ServiceSettings().arrival_tolerance_m


def test_the_benchmark_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    """What is in the file is not flown again; a line that was cut is."""
    checkpoint, told = tmp_path / "flown.jsonl", []
    first = benchmark.measure(1, 3, 1, checkpoint, told.append)
    assert (told, first["situations"], first["below"]) == ([1], 1, 0)
    (line,) = checkpoint.read_text().splitlines()
    checkpoint.write_text(json.dumps({**json.loads(line), "least_m": 0.25}) + "\n" + line[:50])
    again = benchmark.measure(2, 3, 1, checkpoint, told.append)
    assert told == [1, 2]
    assert [json.loads(one)["seed"] for one in checkpoint.read_text().splitlines()] == [3, 4]
    assert min(one["least_m"] for one in again["limits"]) == 0.25
    assert again["below"] == 1


def test_a_checkpoint_of_something_else_is_refused(tmp_path: Path) -> None:
    checkpoint = tmp_path / "flown.jsonl"
    checkpoint.write_text('{"seed": 1}\n')
    with pytest.raises(InputError, match="is refused"):
        benchmark.measure(1, 0, 1, checkpoint, lambda _flown: None)
