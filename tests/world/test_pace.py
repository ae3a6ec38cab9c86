"""What happens between two decisions, with a pencil: how the swarm flies, when and where it hears, when it is there."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from swarmchase.batch.streams import chase_keys
from swarmchase.errors import InputError
from swarmchase.formation import Action, displacement_towards
from swarmchase.scenario import Scenario, load_scenario, paper_scenario
from swarmchase.world.environment import Environment, State

FLIGHT = load_scenario("flight")


def vector(*rows: tuple[float, float, float]) -> torch.Tensor:
    return torch.tensor(rows, dtype=torch.float64)


def situation(environment: Environment, target_m: tuple[float, float, float], **changes: Any) -> State:
    state = environment.reset([(0, 0)])
    return replace(state, target=replace(state.target, position_m=vector(target_m)), **changes)


def action(displacement_m: tuple[float, float, float], spacing_m: float = 5.0) -> Action:
    return Action(torch.tensor([spacing_m], dtype=torch.float64), vector(displacement_m))


FAR_M = (1000.0, 0.0, 0.0)


def test_in_flight_the_swarm_speeds_up_from_rest_and_hears_on_its_way() -> None:
    """At 5 m/s2 half a second from rest: 2.5 m/s and 5 t^2 / 2; samples every 1 / 20 s, the last at the decision."""
    environment = Environment(FLIGHT)
    before = situation(environment, FAR_M)
    after, _ = environment.step(before, action((5, 0, 0), spacing_m=3.0))
    assert before.time_s.tolist() == [0.5]  # one interval was heard before the first decision
    assert after.time_s.tolist() == [1.0]
    assert after.center_velocity_mps[0].tolist() == pytest.approx([2.5, 0, 0])
    assert after.center_m[0].tolist() == pytest.approx([0.625, 0, 0])
    assert after.path_length_m.tolist() == pytest.approx([0.625])
    sample_s = [(number + 1) / 20 for number in range(10)]
    assert after.sample_time_s[0].tolist() == pytest.approx([0.5 + one_s for one_s in sample_s])
    assert after.sample_center_m[0, :, 0].tolist() == pytest.approx([2.5 * one_s**2 for one_s in sample_s])
    # The spacing goes evenly from 5 to 3 m; tracker 3 sits at -y.
    heard_m = after.observation().tracker_position_m[0, :, 3]
    assert heard_m[:, 1].tolist() == pytest.approx([-5 + 2 * one_s / 0.5 for one_s in sample_s])
    assert after.rssi_dbm.shape == (1, 10, 6)


def test_in_flight_the_swarm_reaches_its_speed_and_keeps_it() -> None:
    """10 m/s after 2 s, on 10 m; then 5 m every half second."""
    environment = Environment(FLIGHT)
    state = situation(environment, FAR_M)
    for _ in range(6):
        state, _ = environment.step(state, action((5, 0, 0)))
    assert state.center_velocity_mps[0].tolist() == pytest.approx([10, 0, 0])
    assert state.center_m[0].tolist() == pytest.approx([10 + 2 * 5, 0, 0])


@pytest.mark.parametrize(
    ("target_m", "reached_s", "least_m"),
    [
        # At 10 m/s in the middle of x = 0 ... 5: passing 1 m beside it, 2 m away sqrt(3) m before.
        ((3, 1, 0), 0.5 + (3 - math.sqrt(3)) / 10, 1.0),
        ((3, 2.1, 0), math.inf, 2.1),  # passing it too far off
        ((7.0, 0, 0), 1.0, 2.0),  # there with the end
        ((7.001, 0, 0), math.inf, 2.001),
        ((1, 0, 0), 0.5, 0.0),  # there already, and through it
    ],
)
def test_in_flight_the_target_is_reached_anywhere_on_the_way(
    target_m: tuple[float, float, float], reached_s: float, least_m: float
) -> None:
    environment = Environment(FLIGHT)
    far = torch.full((1,), math.inf, dtype=torch.float64)
    before = situation(environment, target_m, center_velocity_mps=vector((10, 0, 0)), least_distance_m=far)
    after, outcome = environment.step(before, action((5, 0, 0)))
    assert after.reached_s.tolist() == pytest.approx([reached_s])
    assert after.least_distance_m.tolist() == pytest.approx([least_m])
    assert outcome.reached.tolist() == [math.isfinite(reached_s)]


def test_a_chase_that_goes_on_ends_so_long_after_the_capture_and_is_not_cut_off() -> None:
    """Reached .3 s into the first movement, the only one that there may be: ends with the decision 1 s after that."""
    environment = Environment(replace(FLIGHT, follow_s=1.0, max_movements=1))
    state = situation(environment, (5, 0, 0), center_velocity_mps=vector((10, 0, 0)))
    ended = []
    while not (ended and ended[-1]):
        state, outcome = environment.step(state, action((5, 0, 0)))
        ended.append(outcome.reached.item())
        assert not outcome.truncated.item()
        assert state.reached_s.tolist() == pytest.approx([0.5 + 0.3])
        # The movement's ten flight steps, each with the distance at its beginning and its end.
        assert outcome.moment_s[0].tolist() == pytest.approx(
            [state.time_s.item() - 0.05 * k for k in range(10, -1, -1)]
        )
        past_m = [abs(10 * (moment_s - 0.5) - 5) for moment_s in outcome.moment_s[0].tolist()]
        assert outcome.distance_m[0].tolist() == pytest.approx(past_m)
    assert ended == [False, False, True]
    assert state.time_s.item() == 2.0


def test_who_stops_to_listen_takes_the_time_to_fly_and_to_hear_and_the_target_flies_meanwhile() -> None:
    """A target that flees at 1 m/s from a swarm behind it: .8 s of travel and 5 s of window, less what it needs to
    speed up (v^2 / 2 a = .125 m at 4 m/s2) in the window before.
    """
    scenario = paper_scenario(behaviour="flee", target_speed_mps=1.0, continuity="continuous")
    environment = Environment(scenario)
    before = environment.reset([(0, 0)])
    away = before.target.position_m / before.target.position_m.norm()
    assert before.target.position_m.norm().item() == pytest.approx(100 + 5 - 0.125)
    assert before.time_s.tolist() == [5.0]
    after, _ = environment.step(before, action((0, 0, 4)))
    assert after.time_s.tolist() == pytest.approx([5 + 0.8 + 5])
    flown_m = after.target.position_m - before.target.position_m
    assert flown_m.norm().item() == pytest.approx(5.8, abs=0.01)
    assert (flown_m * away).sum().item() == pytest.approx(5.8, abs=0.05)
    assert after.center_m.tolist() == [[0, 0, 4]]


def test_speeding_up_and_braking_take_time_where_acceleration_is_limited() -> None:
    """4 m at most 2 m/s with 1 m/s2: 2 s up, 2 s down, no metre between; 1 m: 2 sqrt(1) s."""
    environment = Environment(paper_scenario(tracker_speed_mps=2.0, tracker_acceleration_mps2=1.0))
    before = situation(environment, FAR_M)
    for displacement_m, travel_s in (((4, 0, 0), 4.0), ((2, 0, 0), 2 * math.sqrt(2)), ((0, 0, 0), 0.0)):
        after, _ = environment.step(before, action(displacement_m))
        assert (after.time_s - before.time_s).tolist() == pytest.approx([travel_s + 5])


@pytest.mark.parametrize(
    ("displacement_m", "spacing_m", "message"),
    [
        ((5.1, 0, 0), 5.0, "displacement_m of 5.1 m is refused: allowed is at most 5 m"),
        ((3, 3, 3), 5.0, "displacement_m of 5.19615242 m is refused"),
        ((math.nan, 0, 0), 5.0, "displacement_m of nan m is refused"),
        ((1, 0, 0), 5.5, "spacing_m = 5.5 is refused: allowed is between 1 and 5"),
        ((1, 0, 0), math.nan, "spacing_m = nan is refused"),
    ],
)
def test_in_flight_no_action_is_beyond_the_swarm(
    displacement_m: tuple[float, float, float], spacing_m: float, message: str
) -> None:
    environment = Environment(FLIGHT)
    with pytest.raises(InputError, match=message):
        environment.step(environment.reset(chase_keys(0, 1)), action(displacement_m, spacing_m))


def turning(turn_rad: float | None) -> Action:
    return replace(action((0, 0, 0)), turn_rad=None if turn_rad is None else vector((turn_rad, 0, 0))[0, :1])


def test_in_flight_the_cross_turns_evenly_and_goes_on_from_where_it_is() -> None:
    """Half a radian in half a second, twice; tracker 0 begins at +x, tracker 2 at +y, 5 m from a centre that hovers."""
    environment = Environment(FLIGHT)
    state = situation(environment, FAR_M)
    for begin_rad in (0.0, 0.5):
        state, _ = environment.step(state, turning(0.5))
        heard_m = state.observation().tracker_position_m[0]
        for number in range(10):
            turned_rad = begin_rad + (number + 1) / 20
            across_m = (5 * math.cos(turned_rad), 5 * math.sin(turned_rad), 0)
            assert heard_m[number, 0].tolist() == pytest.approx(across_m, abs=1e-9)
            assert heard_m[number, 2].tolist() == pytest.approx((-across_m[1], across_m[0], 0), abs=1e-9)
            assert heard_m[number, 5].tolist() == pytest.approx((0, 0, -5), abs=1e-9)
    still, _ = environment.step(state, turning(None))
    assert still.turned_rad is not None
    assert still.turned_rad.tolist() == pytest.approx([1.0])


def test_levels_follow_the_cross_as_it_turns() -> None:
    """A target 10 m along x: the tracker at +x is 5 m from it, the one at -x 15 m; half a turn later it is 15 m."""
    environment = Environment(replace(FLIGHT, rician_k=1e12))
    state = situation(environment, (10.0, 0.0, 0.0))
    for _ in range(6):
        state, _ = environment.step(state, turning(math.pi / 6 / 1.1))
    assert state.turned_rad is not None
    left_rad = math.pi - state.turned_rad.item()
    state, _ = environment.step(state, turning(left_rad))
    assert state.rssi_dbm[0, -1, :2].tolist() == pytest.approx(
        [23 - 30 - 26 * math.log10(15), 23 - 30 - 26 * math.log10(5)], abs=1e-3
    )


@pytest.mark.parametrize("turn_rad", [0.51, -0.51, math.nan])
def test_no_cross_turns_faster_than_its_trackers_can(turn_rad: float) -> None:
    """1 rad/s takes 5 m/s2 at 5 m."""
    environment = Environment(FLIGHT)
    message = rf"turn_rad = {turn_rad:g} is refused: allowed is between -0\.5 and 0\.5"
    with pytest.raises(InputError, match=message):
        environment.step(environment.reset(chase_keys(0, 1)), turning(turn_rad))


def test_who_stops_to_listen_does_not_turn() -> None:
    environment = Environment(paper_scenario())
    with pytest.raises(InputError, match="turn_rad is refused: trackers that stop to listen do not turn their cross"):
        environment.step(environment.reset(chase_keys(0, 1)), turning(0.1))


def test_an_interval_without_a_sample_is_refused() -> None:
    with pytest.raises(InputError, match=r"decision_s = 0\.04 is refused: allowed is at least 1 / sampling_hz = 0\.05"):
        Environment(replace(FLIGHT, decision_s=0.04))


@pytest.mark.parametrize(
    ("scenario", "way_m", "displacement_m"),
    [
        (paper_scenario(), (60, -3.1, 0.9), (4, -4, 0)),  # the nearest choice on each axis
        (FLIGHT, (30, -40, 0), (3, -4, 0)),  # 5 m that way
        (FLIGHT, (0.3, -0.4, 0), (3, -4, 0)),  # no slower near it: who brakes behind one that flees never catches it
        (FLIGHT, (0, 0, 0), (0, 0, 0)),
    ],
)
def test_the_way_to_the_target(
    scenario: Scenario, way_m: tuple[float, float, float], displacement_m: tuple[float, float, float]
) -> None:
    assert displacement_towards(scenario, vector(way_m))[0].tolist() == pytest.approx(displacement_m)
