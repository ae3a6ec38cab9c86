"""Live flights: trackers that never stop to listen. The real service, agents, link and vehicles, on a made clock."""

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from swarmchase import load_controller
from swarmchase.batch.streams import chase_keys
from swarmchase.errors import InputError
from swarmchase.formation import Action
from swarmchase.live.service.chase_state import ChaseState, Decision, Snapshot, Transition
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.live.service.separation import STRAYING_M
from swarmchase.live.service.settings import ServiceSettings
from swarmchase.observation import Observation
from swarmchase.scenario import Scenario, load_scenario
from swarmchase.simulation.fault_plan import fault_plan
from swarmchase.simulation.radio_in_flight import RadioInFlight, require_flight
from swarmchase.simulation.virtual_chase import VirtualChase, VirtualResult
from swarmchase.world.environment import Environment, State

NEAR = Scenario.from_dict(
    load_scenario("flight").to_dict() | {"behaviour": "waypoints", "start_distance_m": 30.0, "farthest_start_m": 60.0}
)
BY_OPERATOR = ServiceSettings(reached_windows=0)
FULL_SPEED_MPS = NEAR.tracker_speed_mps
TRACE = Path(__file__).parents[3] / "shared" / "data" / "birdseye" / "trace_634s.csv"
ONE, OTHER = np.triu_indices(6, 1)


class Flies:
    """A controller that always flies this way at full speed, and remembers what it saw."""

    name = "flies"

    def __init__(self, *way: float) -> None:
        way_m = torch.tensor([way], dtype=torch.float64)
        self.action = Action(torch.tensor([5.0], dtype=torch.float64), way_m * FULL_SPEED_MPS * NEAR.decision_s)
        self.seen: list[Observation] = []

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> None:
        pass

    def decide(self, observation: Observation, memory: None) -> tuple[Action, None]:
        self.seen.append(observation)
        return self.action, None


class Flight:
    """A virtual chase, and what of it only the site knows."""

    def __init__(self, controller: Any, faults: str = "", **options: Any) -> None:
        self.log: list[Decision | Transition] = []
        plan = fault_plan(faults)
        self.chase = VirtualChase(NEAR, controller, 3, 1, plan, recorder=self.log.append, **options)
        self.least_m = math.inf
        self.fastest_mps = 0.0

    def look(self) -> None:
        position_m = self.places_m()
        self.least_m = min(self.least_m, float(np.linalg.norm(position_m[ONE] - position_m[OTHER], axis=1).min()))
        speeds_mps = [math.hypot(*vehicle.velocity_mps) for vehicle in self.chase.site.vehicles]
        self.fastest_mps = max(self.fastest_mps, *speeds_mps)

    def places_m(self) -> np.ndarray:
        return np.array(self.chase.site.positions_m())

    def run(self) -> VirtualResult:
        return self.chase.run(self.look)

    def fly(self, seconds: float, also: Callable[[], None] = lambda: None) -> None:
        for _ in range(round(seconds / 0.025)):
            self.chase.tick()
            self.look()
            also()

    def begin(self) -> None:
        """Until the chase's own time runs."""
        while self.radio.now_s == 0:
            self.chase.tick()

    @property
    def radio(self) -> RadioInFlight:
        assert isinstance(self.chase.site.radio, RadioInFlight)
        return self.chase.site.radio

    @property
    def state(self) -> ChaseState:
        return self.chase.service.state

    def decisions(self) -> list[Decision]:
        return [entry for entry in self.log if isinstance(entry, Decision)]

    def states(self) -> list[str]:
        return [entry.after.value for entry in self.log if isinstance(entry, Transition)]


def still(num: int = 1) -> Action:
    return Action(torch.full((num,), 5.0, dtype=torch.float64), torch.zeros(num, 3, dtype=torch.float64))


@pytest.fixture(scope="module")
def undisturbed() -> Flight:
    flight = Flight(load_controller("particle", NEAR))
    flight.result = flight.run()  # type: ignore[attr-defined]
    return flight


def test_a_target_that_flies_is_caught_by_trackers_that_never_stop(undisturbed: Flight) -> None:
    result = undisturbed.result  # type: ignore[attr-defined]
    assert (result.state, result.reached) == ("reached", True), result.reason
    assert undisturbed.states() == ["connecting", "pursuing", "reached"]
    assert result.capture_s <= undisturbed.radio.now_s == pytest.approx(0.5 * result.movements, abs=0.3)
    assert undisturbed.least_m > 6.5  # of the 7.07 m of the formation
    assert 9.5 < undisturbed.fastest_mps <= 12.0


def test_samples_are_taken_all_the_time_each_where_it_was_taken(undisturbed: Flight) -> None:
    decisions = undisturbed.decisions()
    time_s = np.concatenate([decision.time_s for decision in decisions])  # type: ignore[arg-type]
    # Every sample once, 1 / F apart: by the trackers' own clocks, to the shortest delay of the link.
    np.testing.assert_allclose(np.diff(time_s), 1 / NEAR.sampling_hz, atol=1e-6)
    position_m = np.concatenate([decision.tracker_position_m for decision in decisions])
    speed_mps = np.linalg.norm(np.diff(position_m, axis=0), axis=2) * NEAR.sampling_hz
    assert 9.0 < speed_mps.max() < 13.0
    assert np.isfinite(np.concatenate([decision.rssi_dbm for decision in decisions])).all()


def test_what_is_recorded_asks_the_controller_again_with_the_same_answers(undisturbed: Flight) -> None:
    controller = load_controller("particle", NEAR)
    memory = controller.begin(1, 3, 1)
    for decision in undisturbed.decisions():
        assert decision.time_s is not None
        observation = Observation(
            torch.from_numpy(decision.rssi_dbm).float()[None],
            torch.from_numpy(decision.tracker_position_m)[None],
            torch.from_numpy(decision.time_s)[None],
        )
        action, memory = controller.decide(observation, memory)
        again = (float(action.spacing_m[0]), *action.displacement_m[0].tolist())
        assert again == (decision.spacing_m, *decision.displacement_m)


def test_it_is_the_evaluated_chase_where_both_can_be_the_same(undisturbed: Flight) -> None:
    """Its first window, heard while all hover; and the target's way, which does not look at the swarm."""
    environment = Environment(NEAR)
    state: State = environment.reset(chase_keys(3, 1, 1))
    first, live = state.observation(), undisturbed.decisions()[0]
    np.testing.assert_allclose(live.rssi_dbm, first.rssi_dbm[0].numpy(), atol=1e-3)
    np.testing.assert_allclose(live.tracker_position_m, first.tracker_position_m[0].numpy(), atol=1e-6)
    assert first.time_s is not None
    assert live.time_s is not None
    # The service sees a sample as late as the link is at its fastest, here a tick, and half a period.
    np.testing.assert_allclose(live.time_s, first.time_s[0].numpy(), atol=0.5 / NEAR.sampling_hz + 1e-6)
    flight, way_m = Flight(Flies(0, 0, 0), settings=BY_OPERATOR), []
    flight.begin()
    for _ in range(6):
        state, _ = environment.step(state, still())
        way_m.append((float(state.time_s[0]), state.target_position_m[0].tolist()))
    for time_s, target_m in way_m:
        while flight.radio.now_s < time_s - 1e-6:
            flight.chase.tick()
        assert flight.radio.target_m == pytest.approx(tuple(target_m), abs=1e-6)


@pytest.mark.parametrize("way", [(1.0, 0.0, 0.0), (math.sqrt(0.5), math.sqrt(0.5), 0.0), (0.0, 0.6, 0.8)])
def test_the_formation_flies_at_full_speed_whichever_way_and_none_comes_too_near(way: tuple[float, ...]) -> None:
    flight = Flight(Flies(*way), settings=BY_OPERATOR)
    flight.begin()
    flight.fly(4.0)
    before_m = flight.places_m()
    flight.fly(2.0)
    flown_m = (flight.places_m() - before_m).mean(axis=0)
    # 10 m/s; where trackers follow one another within 7 m a little less.
    assert 18.0 < float(flown_m @ np.array(way)) <= 20.5
    assert flight.least_m > 6.0


def test_hold_stops_within_the_way_that_braking_takes_and_resume_goes_on() -> None:
    flight = Flight(Flies(1, 0, 0), settings=BY_OPERATOR)
    flight.begin()
    flight.fly(3.5)
    flight.chase.service.hold()
    before_m = flight.places_m()
    flight.fly(5.0)
    flown_m = np.linalg.norm(flight.places_m() - before_m, axis=1)
    assert flown_m.max() < FULL_SPEED_MPS**2 / (2 * 4.0) + 2.0
    speeds_mps = [math.hypot(*vehicle.velocity_mps) for vehicle in flight.chase.site.vehicles]
    assert (flight.state, max(speeds_mps) < 0.05) == (ChaseState.HOLDING, True)
    flight.chase.service.resume()
    flight.fly(2.0)
    assert flight.state is ChaseState.PURSUING
    assert flight.fastest_mps > 5.0
    flight.chase.service.abort()
    flight.fly(4.0)
    speeds_mps = [math.hypot(*vehicle.velocity_mps) for vehicle in flight.chase.site.vehicles]
    assert (flight.state, max(speeds_mps) < 0.05) == (ChaseState.ABORTED, True)
    assert flight.states() == ["connecting", "pursuing", "holding", "holding", "pursuing", "aborted"]
    assert flight.least_m > 6.0


def test_the_centre_that_is_shown_brakes_with_the_swarm_when_the_target_is_reached() -> None:
    centers_m: list[np.ndarray] = []

    def watch(snapshot: Snapshot) -> None:
        if snapshot.state is ChaseState.REACHED:
            centers_m.append(np.array(snapshot.center_m))

    flight = Flight(Flies(1, 0, 0), settings=BY_OPERATOR, watch=watch)
    flight.fly(5.0)
    flight.chase.service.declare_reached()
    flight.fly(4.0)
    steps_m = np.linalg.norm(np.diff(centers_m, axis=0), axis=1)
    assert 0.3 < steps_m.max() <= FULL_SPEED_MPS * 0.05 + 1e-6
    assert float(steps_m.sum()) == pytest.approx(FULL_SPEED_MPS**2 / (2 * 4.0), abs=0.7)
    assert np.linalg.norm(flight.places_m().mean(axis=0) - centers_m[-1]) < 0.2


@pytest.mark.parametrize("fault", ["kill=0@5", "restart=0@5", "frozen=0@5", "pilot"])
def test_whoever_stops_in_the_midst_of_a_flight_is_not_run_into(fault: str) -> None:
    """East and north at full speed: tracker 0 flies ahead of 3, and 2 of 1, 7 m before them."""
    plan = "" if fault == "pilot" else fault
    flight = Flight(Flies(math.sqrt(0.5), math.sqrt(0.5), 0), plan, settings=BY_OPERATOR)
    flight.fly(5.0)
    if fault == "pilot":
        flight.chase.site.vehicles[0].take_over()
    flight.fly(6.0)
    assert flight.least_m >= SafetyLimits().minimum_separation_m - STRAYING_M
    assert flight.state is ChaseState.PURSUING
    if fault.startswith("restart"):
        # It is back in its place, 5 m east of the centre, which the others have flown on with.
        flight.fly(9.0)
        place_m = np.median(flight.places_m(), axis=0) + np.array([5.0, 0.0, 0.0])
        assert np.linalg.norm(flight.places_m()[0] - place_m) < 2.0
        assert flight.least_m >= SafetyLimits().minimum_separation_m - STRAYING_M
    else:
        # The others have gone on without it.
        left_m, *others_m = flight.places_m()
        assert np.linalg.norm(np.mean(others_m, axis=0) - left_m) > 20.0


def test_the_one_silence_of_a_scenario_is_that_of_the_chase_s_own_time() -> None:
    """As in the evaluation, which has the same radio; before the chase the target is heard."""
    scenario = Scenario.from_dict(NEAR.to_dict() | {"silence_s": 1.0, "silence_at_s": 0.0})
    log: list[Decision | Transition] = []
    chase = VirtualChase(scenario, Flies(0.6, 0.8, 0.0), 3, 1, settings=BY_OPERATOR, recorder=log.append)
    while chase.service.state is not ChaseState.PURSUING:
        chase.tick()
    assert max(one.rssi_age_s for one in chase.service.snapshot().trackers) < 0.3
    for _ in range(120):
        chase.tick()
    decisions = [entry for entry in log if isinstance(entry, Decision)]
    time_s = np.concatenate([one.time_s for one in decisions if one.time_s is not None])
    is_heard = np.isfinite(np.concatenate([one.rssi_dbm for one in decisions])).all(axis=1)
    assert time_s[is_heard].min() == pytest.approx(1.0, abs=0.026)
    assert time_s[~is_heard].max() == pytest.approx(0.95, abs=0.026)
    assert not any("lost" in entry.reason for entry in log if isinstance(entry, Transition))


def test_no_vehicle_leaves_the_fence_and_the_words_say_why() -> None:
    limits = SafetyLimits(-30.0, 30.0, -30.0, 30.0, -40.0, 40.0, FULL_SPEED_MPS)
    flight = Flight(Flies(1, 0, 0), settings=BY_OPERATOR, limits=limits)
    farthest_m = [0.0]

    def look() -> None:
        farthest_m[0] = max(farthest_m[0], float(flight.places_m()[:, 0].max()))

    flight.begin()
    flight.fly(8.0, look)
    assert 25.0 < farthest_m[0] <= 30.2
    assert "fence" in flight.decisions()[-1].changed
    assert flight.least_m > 6.0


@pytest.mark.skipif(not TRACE.exists(), reason="the recorded flight is not there")
def test_a_target_that_flies_where_a_real_one_was_recorded_is_caught(tmp_path: Path) -> None:
    """A DJI UAV, once a second, rounded to 11 m; its limits make a way of the steps."""
    rows = [row for row in csv.DictReader(TRACE.read_text(encoding="utf-8").splitlines()) if row["drone_lat"]]
    began = {name: float(rows[0][name]) for name in ("t_unix", "drone_lat", "drone_lon")}
    north_m = 111_320.0
    east_m = north_m * math.cos(math.radians(began["drone_lat"]))
    track = tmp_path / "track.csv"
    with track.open("w", encoding="utf-8") as file:
        file.write("time_s,x_m,y_m,z_m\n")
        for row in rows:
            time_s, lat, lon = (float(row[name]) - since for name, since in began.items())
            file.write(f"{time_s},{lon * east_m:.2f},{lat * north_m:.2f},0\n")
    scenario = Scenario.from_dict(NEAR.to_dict() | {"behaviour": str(track)})
    chase = VirtualChase(scenario, load_controller("particle", scenario), 3, 1)
    assert isinstance(chase.site.radio, RadioInFlight)
    result = chase.run()
    assert (result.state, result.reached) == ("reached", True), result.reason
    # Until it was caught it stood where it took off, as it did for half a minute.
    assert result.flown_s is not None
    environment, seconds = Environment(scenario), 0.0
    state: State = environment.reset(chase_keys(3, 1, 1))
    while seconds < result.flown_s - scenario.decision_s:
        state, _ = environment.step(state, still())
        seconds = float(state.time_s[0])
    assert math.dist(chase.site.radio.target_m, state.target_position_m[0].tolist()) < 5.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"continuity": "independent"}, "continuity = 'independent' is refused in flight"),
        ({"decision_s": 0.05}, "decision_s = 0.05 is refused: a live chase needs at least 0.1"),
        ({"tracker_acceleration_mps2": None}, "no vehicle turns at once"),
        ({"behaviour": "dance"}, "no behaviour 'dance'"),
        ({"decision_s": 0.5, "sampling_hz": 1.0}, "decision_s = 0.5 is refused"),
    ],
)
def test_moving_worlds_that_no_site_plays_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        require_flight(Scenario.from_dict(NEAR.to_dict() | changes))


def test_a_controller_without_a_belief_needs_the_operator_s_word() -> None:
    with pytest.raises(InputError, match=r"gradient is refused in flight: it has no belief"):
        Flight(load_controller("gradient", NEAR))
