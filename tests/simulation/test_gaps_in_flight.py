"""Live flights in which trackers hear nothing for a while: they go on as they were told, and keep apart."""

import math
import re
from random import Random
from typing import Any

import numpy as np
import pytest
import torch

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from swarmchase.controllers import load_controller
from swarmchase.formation import Action
from swarmchase.live.alarms import Alarms, Severity
from swarmchase.live.events import Event, Events
from swarmchase.live.service import pursuit
from swarmchase.live.service.chase_state import Decision
from swarmchase.live.service.flight_separation import Seen
from swarmchase.live.service.orders import LONGEST_VALID_S
from swarmchase.live.service.pursuit import CLOSING_MPS, UNHEARD_S, ListenInFlight
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.live.service.separation import STRAYING_M
from swarmchase.live.service.settings import ServiceSettings
from swarmchase.scenario import Scenario, load_scenario
from swarmchase.simulation.fault_plan import fault_plan
from swarmchase.simulation.virtual_chase import START_NS, TICK_S, VirtualChase

SCENARIO = Scenario.from_dict(load_scenario("flight").to_dict() | {"start_distance_m": 30.0, "farthest_start_m": 60.0})
FULL_SPEED_MPS = SCENARIO.tracker_speed_mps
PLACES_M = 5.0 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
ONE, OTHER = np.triu_indices(6, 1)


class Wants:
    """A controller that flies this way at full speed, or, told none, any way, and turns every now and then."""

    name = "wants"

    def __init__(self, random: Random, *way: float) -> None:
        self.random, self.turns = random, not way
        self.way = np.array(way or (1.0, 0.0, 0.0))

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> None:
        pass

    def decide(self, observation: Any, memory: None) -> tuple[Action, None]:
        if self.turns and self.random.random() < 0.5:
            way = np.array([self.random.gauss(0.0, 1.0) for _ in range(3)])
            self.way = self.random.choice([1.0, 1.0, 0.3, 0.0]) * way / np.linalg.norm(way)
        displacement_m = torch.from_numpy(self.way[None]) * FULL_SPEED_MPS * SCENARIO.decision_s
        return Action(torch.tensor([5.0], dtype=torch.float64), displacement_m), None


class Flight:
    """A virtual chase, watched where the vehicles truly are."""

    def __init__(self, controller: Wants, faults: str = "", limits: SafetyLimits | None = None) -> None:
        settings = ServiceSettings(reached_windows=0)
        self.chase = VirtualChase(SCENARIO, controller, 3, 1, fault_plan(faults), settings, limits=limits)
        self.least_m = math.inf
        self.dies = False

    @property
    def now_s(self) -> float:
        return (self.chase.clock.now_ns() - START_NS) / 1e9

    def places_m(self) -> np.ndarray:
        return np.array(self.chase.site.positions_m())

    def speeds_mps(self) -> np.ndarray:
        return np.array([math.hypot(*vehicle.velocity_mps) for vehicle in self.chase.site.vehicles])

    def tick(self) -> None:
        if self.dies:
            self.chase.tick_without_service()
        else:
            self.chase.tick()
        places_m = self.places_m()
        self.least_m = min(self.least_m, float(np.linalg.norm(places_m[ONE] - places_m[OTHER], axis=1).min()))

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.tick()

    def place(self, places_m: np.ndarray) -> None:
        """At rest, and told to be there: seen from the centre that is told."""
        pace = self.chase.service._pace
        assert isinstance(pace, ListenInFlight)
        for vehicle, place_m in zip(self.chase.site.vehicles, pace._motion.center_m + places_m, strict=True):
            vehicle._true_position_m = tuple(place_m.tolist())
        self.chase.service._swarm.stream.set_point_m = pace._motion.center_m + places_m
        self.least_m = math.inf

    def off_m(self, tracker: int) -> float:
        """How far it is from where the others show that its place is."""
        return float(np.linalg.norm((self.places_m() - PLACES_M)[tracker] - self.center_m()))

    def center_m(self) -> np.ndarray:
        return np.asarray(np.median(self.places_m() - PLACES_M, axis=0))


def test_a_gap_as_long_as_set_points_are_valid_costs_nothing() -> None:
    """Nobody flies within a metre of another's way. The one that has lost the link flies on with the others."""
    flight = Flight(Wants(Random(0), 0.96, 0.28, 0.0))
    flight.fly(6.0)
    flight.chase.network.cut(2, is_cut=True)
    flight.fly(LONGEST_VALID_S - 0.1)
    assert flight.speeds_mps().min() > 0.95 * FULL_SPEED_MPS
    assert flight.off_m(2) < 0.5
    # After that it brakes, and the five fly on without it.
    flight.fly(3.0)
    speeds_mps = flight.speeds_mps()
    assert speeds_mps[2] < 0.1
    assert np.delete(speeds_mps, 2).min() > 0.95 * FULL_SPEED_MPS
    assert flight.off_m(2) > 10.0


def test_one_that_flies_right_ahead_of_another_and_hears_nothing_does_not_have_all_brake() -> None:
    """North-east, tracker 2 flies 7 m ahead of 1: who is behind may not go on without news, who is ahead may. All
    slowed down while set-points were valid for as long for both of two.
    """
    flight = Flight(Wants(Random(0), math.sqrt(0.5), math.sqrt(0.5), 0.0))
    flight.fly(6.0)
    to_trackers = flight.chase.network._to_tracker
    to_trackers[2].is_cut = True
    for _ in range(round(1.5 / TICK_S)):
        flight.tick()
        assert flight.speeds_mps().min() > 0.95 * FULL_SPEED_MPS
    assert flight.off_m(2) < 0.5
    to_trackers[2].is_cut, to_trackers[1].is_cut = False, True
    flight.fly(1.5)
    assert flight.speeds_mps()[1] < 0.6 * FULL_SPEED_MPS
    assert np.delete(flight.speeds_mps(), 1).min() > 0.95 * FULL_SPEED_MPS


def test_who_flies_on_because_it_has_not_heard_that_all_brake_is_not_astray(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = Flight(Wants(Random(0), 0.96, 0.28, 0.0))
    flight.fly(6.0)
    flight.chase.network._to_tracker[2].is_cut = True
    # From now on it is said that somebody would come too near: the set-points stay.
    monkeypatch.setattr(
        pursuit,
        "least_apart_m",
        lambda seen, orders, *_: np.array([[0.9 - 0.05 * min(k, 1)] * 15 for k in range(len(orders.rest_m))]),
    )
    flight.fly(1.6)
    pace = flight.chase.service._pace
    assert isinstance(pace, ListenInFlight)
    rest_m, told_m = pace._fresh_rest_m(), flight.chase.service._swarm.stream.set_point_m
    heard_m = pace._heard_m(rest_m)
    assert np.linalg.norm(rest_m - told_m, axis=1)[2] > 10.0
    assert np.linalg.norm(rest_m - heard_m, axis=1).max() < 2.0
    assert [tracker.left_out for tracker in flight.chase.service.snapshot().trackers] == [""] * 6


def test_in_a_turn_it_goes_on_along_the_way_that_was_meant() -> None:
    controller = Wants(Random(0), 1.0, 0.0, 0.0)
    flight = Flight(controller)
    flight.fly(5.5)
    controller.way = np.array([0.6, 0.8, 0.0])
    flight.fly(0.8)
    flight.chase.network.cut(4, is_cut=True)
    flight.fly(1.5)
    assert flight.off_m(4) < 2.0
    turned_mps = np.array(flight.chase.site.vehicles[4].velocity_mps)
    assert turned_mps / FULL_SPEED_MPS == pytest.approx([0.6, 0.8, 0.0], abs=0.1)


def test_a_swarm_whose_service_dies_comes_to_rest_inside_the_fence() -> None:
    limits = SafetyLimits(-60.0, 60.0, -60.0, 60.0, -40.0, 40.0, FULL_SPEED_MPS)
    flight = Flight(Wants(Random(0), 1.0, 0.0, 0.0), limits=limits)
    while flight.places_m()[:, 0].max() < 35.0:
        flight.tick()
    flight.dies = True
    flight.fly(1.0)
    assert flight.speeds_mps().max() > 1.0
    flight.fly(5.0)
    assert flight.speeds_mps().max() < 0.05
    assert 50.0 < flight.places_m()[:, 0].max() <= 60.0
    assert flight.least_m > 4.9


def test_a_swarm_that_is_kept_in_one_place_is_an_alarm_until_it_moves_and_one_that_hovers_is_none() -> None:
    controller = Wants(Random(0), 1e-9, 0.0, 0.0)
    flight = Flight(controller, limits=SafetyLimits(-20.0, 20.0, -20.0, 20.0, -20.0, 20.0, FULL_SPEED_MPS))
    told: list[Event] = []
    events = Events(Alarms(flight.chase.link), [told.append])
    flight.chase._watch = events

    def critical() -> list[str]:
        return [alarm.text for alarm in events.alarms if alarm.severity is Severity.CRITICAL]

    flight.fly(13.0)
    assert critical() == []
    controller.way = np.array([1.0, 0.0, 0.0])
    flight.fly(9.0)  # there after four of them
    assert critical() == []
    flight.fly(9.0)
    assert [re.sub(r"\d+ s", "N s", text) for text in critical()] == [
        "the swarm has not moved for N s, and is to fly on: aside or slower to keep the fence"
    ]
    controller.way = np.array([-1.0, 0.0, 0.0])
    flight.fly(3.0)
    assert critical() == []
    assert [event.text for event in told if "the swarm" in event.text] == [
        "the swarm does not move, and is to fly on: aside or slower to keep the fence",
        "the swarm is kept in one place no more",
    ]


@pytest.mark.parametrize("seed", range(3))
def test_all_keep_apart_whatever_is_wanted_and_whoever_hears_nothing_or_is_stopped(seed: int) -> None:
    """Bursts on every link; besides, links are cut and pilots take over at any moment."""
    random = Random(f"gaps {seed}")
    flight = Flight(Wants(random), random.choice(["burst=0.15", "burst=0.3,delay=0.05", "burst=0.15,delay=0.08"]))
    events = [
        (what, random.randrange(6), start_s, start_s + random.uniform(0.5, 4.0))
        for what in ("cut", "cut", "pilot")
        for start_s in [random.uniform(3.0, 9.0)]
    ]
    while flight.now_s < 11.0:
        for tracker, vehicle in enumerate(flight.chase.site.vehicles):
            now = {
                what for what, whose, start_s, end_s in events if whose == tracker and start_s <= flight.now_s < end_s
            }
            (vehicle.take_over if "pilot" in now else vehicle.give_back)()
            flight.chase.network.cut(tracker, "cut" in now)
        flight.tick()
    assert flight.least_m >= SafetyLimits().minimum_separation_m - STRAYING_M
    assert np.linalg.norm(flight.center_m()) > 5.0


@pytest.mark.parametrize(
    "places_m",
    [
        # Of a real run: tracker 3 had fallen behind, and 1 was on its way to its place.
        [
            [4.6, -0.5, 0.0],
            [-5.66, 1.59, 0.0],
            [0.75, 4.94, 0.0],
            [-6.34, 0.79, -0.11],
            [0.0, 0.0, 5.0],
            [0.0, 0.0, -5.0],
        ],
        PLACES_M[[1, 0, 2, 3, 4, 5]],
        PLACES_M[[0, 1, 3, 2, 5, 4]],
    ],
    ids=["one beside another", "two in each other's places", "four in each other's places"],
)
def test_those_that_are_in_each_others_way_go_round_each_other(places_m: Any) -> None:
    """All stood still for the rest of the flight, and nobody was told."""
    controller = Wants(Random(0), 0.76, -0.65, 0.0)
    flight = Flight(controller)
    flight.fly(3.0)
    controller.way = np.array([1e-9, 0.0, 0.0])
    flight.fly(3.0)
    assert flight.speeds_mps().max() < 0.01
    flight.place(np.array(places_m))
    recorded: list[Any] = []
    flight.chase._recorder = recorded.append
    controller.way = np.array([0.76, -0.65, 0.0])
    before_m = flight.center_m()
    flight.fly(12.0)
    assert np.linalg.norm(flight.center_m() - before_m) > 30.0
    assert flight.least_m >= SafetyLimits().minimum_separation_m - STRAYING_M
    flight.fly(4.0)
    assert max(flight.off_m(tracker) for tracker in range(6)) < 3.0
    changed = [entry.changed for entry in recorded if isinstance(entry, Decision)]
    assert any("are in each other's way" in words for words in changed)
    assert "in each other's way" not in changed[-1]


@pytest.mark.parametrize("beside_m", [[0.5, 0.3, 0.0], [0.0, 0.0, 0.55], [-0.4, 0.4, 0.1]])
def test_those_that_stand_too_near_to_each_other_are_led_apart(beside_m: list[float]) -> None:
    """In a real run two stood 0.59 m from each other for 17 s: any way on would have led them nearer at first."""
    controller = Wants(Random(0), 0.76, -0.65, 0.0)
    flight = Flight(controller)
    flight.fly(3.0)
    controller.way = np.array([1e-9, 0.0, 0.0])
    flight.fly(3.0)
    places_m = PLACES_M.copy()
    places_m[2] = places_m[1] + beside_m
    flight.place(places_m)
    controller.way = np.array([0.76, -0.65, 0.0])
    flight.fly(2.0)
    apart_m = math.dist(*(flight.chase.site.vehicles[tracker].position_m for tracker in (1, 2)))
    assert apart_m >= SafetyLimits().minimum_separation_m
    before_m = flight.center_m()
    flight.fly(8.0)
    assert np.linalg.norm(flight.center_m() - before_m) > 30.0


def test_a_controller_that_often_changes_its_mind_brings_nobody_too_near() -> None:
    """Two trackers in line, the one behind without news for a second: it had heard one of many set-points.
    They came to 0.23 m of each other while set-points were told apart by their age alone.
    """
    scenario = Scenario.from_dict(load_scenario("flight").to_dict() | {"behaviour": "waypoints", "max_movements": 40})
    chase = VirtualChase(scenario, load_controller("pursuit", scenario), 0, 0, fault_plan("burst=0.15"))
    assert chase.run().least_separation_m > SafetyLimits().minimum_separation_m - STRAYING_M


@pytest.mark.parametrize(("is_misplaced", "is_pulled_back"), [(False, True), (True, False)])
def test_nobody_is_pulled_back_to_where_it_comes_nearer_to_another(
    monkeypatch: pytest.MonkeyPatch, is_misplaced: bool, is_pulled_back: bool
) -> None:
    """All fly east, set-points 12.5 m ahead, and tracker 3 is told to go into the way of 5: both are pulled back to
    where they can stop, 10 m ahead. But 3 has said nothing for a while, and it is taken to be where it is not, 0.5 m
    from 5: there it would stop 0.5 m from 5, while by its set-point it keeps away.
    """
    flight = Flight(Wants(Random(0), 1.0, 0.0, 0.0))
    flight.fly(6.0)
    pace = flight.chase.service._pace
    assert isinstance(pace, ListenInFlight)
    swarm = pace._swarm
    seen = Seen(swarm.traffic(), swarm.position_ages_s())
    before_m, places_m = swarm.stream.set_point_m.copy(), swarm.places_now_m()
    older = pace._told.older(swarm.now_ns, swarm.obeyed_ns())
    if is_misplaced:
        places_m[3] = places_m[5] + np.array([0.0, -0.5, 0.0])
        monkeypatch.setattr(swarm, "places_now_m", lambda: places_m)
    else:
        swarm.stream.set_point_m[3] = before_m[3] = before_m[5] + np.array([0.0, -0.5, 0.0])
    too_near_m = np.full((2, len(ONE)), 7.0)
    too_near_m[:, (ONE == 3) & (OTHER == 5)] = 0.5
    pace._stay(seen, False, too_near_m, TICK_S, older)
    moved = np.linalg.norm(swarm.stream.set_point_m - before_m, axis=1) > 1e-6
    assert moved.tolist() == [False, False, False, is_pulled_back, False, is_pulled_back]
    assert swarm.stream.pulled_back == is_pulled_back


def test_who_has_heard_nothing_is_excused_for_as_far_as_it_has_flown_and_comes_back_at_2_mps() -> None:
    flight = Flight(Wants(Random(0), 1.0, 0.0, 0.0))
    flight.fly(6.0)
    pace = flight.chase.service._pace
    assert isinstance(pace, ListenInFlight)
    assert pace._excused_m.tolist() == [0.0] * 6
    flight.chase.network.cut(2, is_cut=True)
    flight.fly(1.5)
    assert pace._excused_m[2] == pytest.approx((1.5 - UNHEARD_S) * FULL_SPEED_MPS, abs=1.1)
    assert np.delete(pace._excused_m, 2).tolist() == [0.0] * 5
    flight.chase.network.cut(2, is_cut=False)
    flight.fly(3.0)
    # It takes 0.1 s until that is known.
    assert pace._excused_m[2] == pytest.approx(12.5 - 3.0 * CLOSING_MPS + 1.2, abs=1.1)
    flight.fly(6.0)
    assert pace._excused_m.tolist() == [0.0] * 6
