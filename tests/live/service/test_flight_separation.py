"""Vehicles that fly behind one another: how near they may come, whoever of them stops or hears nothing."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmchase.live.link.messages import FeedForward, Metres, SetPoint
from swarmchase.live.service.flight_separation import (
    AHEAD_S,
    HARDEST_BRAKING_MPS2,
    Seen,
    least_apart_m,
    longest_free,
    those_behind,
)
from swarmchase.live.service.orders import KEPT_S, Braking, Onward, Orders, Told
from swarmchase.live.service.separation import STRAYING_M, Traffic
from swarmchase.live.tracker.vehicles.simulated import SimulatedVehicle, VehicleLimits

BRAKING = Braking(nominal_mps2=4.0, most_mps2=5.0)
NOWHERE = np.full((6, 3), np.nan)
NOBODY_TOLD = Told().older(0, [None] * 6)


def resting(set_point_m: np.ndarray) -> Orders:
    """One set of set-points that do not move on."""
    zeros = np.zeros((1, 6))
    return Orders(set_point_m[None], np.zeros((1, 6, 3)), zeros, zeros)


def on_a_line(
    x_m: list[float],
    speed_mps: float,
    told_m: list[float],
    age_s: float = 0.0,
    stop_m: float = np.nan,
    instead_m: float = np.nan,
) -> float:
    """The least distance of trackers 0 and 1, all on the x axis; NaN where tracker 0 is told nothing."""
    position_m, velocity_mps, set_point_m, stops_m, instead = (NOWHERE.copy() for _ in range(5))
    position_m[:2], velocity_mps[:2], set_point_m[:2] = 0.0, 0.0, 0.0
    position_m[:2, 0], velocity_mps[:2, 0], set_point_m[:2, 0] = x_m, speed_mps, told_m
    set_point_m[np.isnan(set_point_m[:, 0])] = np.nan
    stops_m[0], instead[0] = (stop_m, 0, 0), (instead_m, 0, 0)
    seen = Seen(Traffic(position_m, velocity_mps, stops_m, instead), np.full(6, age_s))
    least_m = least_apart_m(seen, resting(set_point_m), NOBODY_TOLD, BRAKING, math.inf)[0]
    # Of the others nothing is known.
    assert np.isinf(least_m[1:]).all()
    return float(least_m[0])


def test_braking_takes_the_way_of_physics() -> None:
    assert BRAKING.rest_m(np.array([[10.0, 0, 0]])).tolist() == [[12.5, 0, 0]]
    assert BRAKING.most_mps2 < HARDEST_BRAKING_MPS2


@pytest.mark.parametrize(
    ("x_m", "told_m", "least_m"),
    [
        ([0, -7], [0, -7], 7.0),
        ([0, -20], [0, -3], 3.0),
        ([0, -20], [0, -0.5], 0.5),
        ([0, -20], [0, 5], 0.0),  # through it
        ([0, -7], [12, 5], 0.0),  # the one ahead may stay: it has no speed to lose
    ],
)
def test_from_rest_the_whole_way_counts(x_m: list[float], told_m: list[float], least_m: float) -> None:
    assert on_a_line(x_m, 0.0, told_m) == pytest.approx(least_m, abs=0.35)


def test_who_flies_ahead_cannot_stop_at_once() -> None:
    """At 10 m/s it gets 8.3 m, braking hardest, and the one 7.1 m behind it 12.5 m, told to where that is."""
    assert on_a_line([0, -7.07], 10.0, [12.5, 5.43]) == pytest.approx(100 / 12 - 5.43, abs=0.7)
    # Nearer behind it, it would be run into.
    assert on_a_line([0, -4.0], 10.0, [12.5, 8.5]) < 0.5


def test_what_was_seen_a_while_ago_may_have_stopped_since() -> None:
    fresh_m = on_a_line([0, -7.07], 8.0, [8.0, 0.93])
    old_m = on_a_line([-2.4, -9.47], 8.0, [8.0, 0.93], age_s=0.3)
    assert old_m < fresh_m - 1.0


def test_who_is_not_commanded_may_be_anywhere_until_it_stops_and_where_it_may_stand_instead() -> None:
    assert on_a_line([0, -20], 0.0, [np.nan, -10], stop_m=-6.0) == pytest.approx(4.0, abs=0.35)
    assert on_a_line([0, -20], 0.0, [np.nan, -10], stop_m=0.0, instead_m=-12.0) == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize(
    ("before_m", "after_m", "allowed"),
    [(3.0, 1.0, True), (3.0, 0.9, False), (0.8, 0.9, True), (0.8, 0.8, True), (0.8, 0.7, False)],
)
def test_set_points_go_on_where_none_is_too_near_or_at_least_not_nearer(
    before_m: float, after_m: float, allowed: bool
) -> None:
    far_m = np.full(15, np.inf)
    before, after = far_m.copy(), far_m.copy()
    before[3], after[3] = before_m, after_m
    assert (longest_free(before, after[None], separation_m=1.0) is not None) is allowed


def test_who_would_come_too_near_without_news_is_sent_on_for_shorter_and_the_others_are_not() -> None:
    """Sets that are valid for shorter and shorter: trackers 0 and 1 may be sent the third, 1 and 2 the second."""
    after_m = np.full((4, 15), np.inf)
    after_m[:2, 0], after_m[0, 5] = 0.5, 0.5
    chosen = longest_free(np.full(15, np.inf), after_m, separation_m=1.0)
    assert chosen is not None
    assert chosen.tolist() == [2, 2, 1, 0, 0, 0]
    # One that is free is not, where a shorter one is not.
    after_m[3, 0] = 0.5
    assert longest_free(np.full(15, np.inf), after_m, separation_m=1.0) is None


def test_who_flies_ahead_of_another_is_not_sent_on_for_shorter_because_of_it() -> None:
    """Trackers 0 and 1 may be sent the third set, 1 and 2 the second; 1 flies behind 0 and ahead of 2."""
    after_m = np.full((4, 15), np.inf)
    after_m[:2, 0], after_m[0, 5] = 0.5, 0.5
    place_m = np.array([[9.0, 5, 0], [2.0, 0, 0], [-2.0, 0, 0], [0.0, 0, 0], [0.0, 0, 0], [0.0, 0, 0]])
    one_behind, other_behind = those_behind(place_m, np.array([3.0, 0.0, 0.0]))
    assert one_behind[[0, 5]].tolist() == [False, False]
    assert other_behind[[0, 5]].tolist() == [True, True]
    chosen = longest_free(np.full(15, np.inf), after_m, 1.0, (one_behind, other_behind))
    assert chosen is not None
    assert chosen.tolist() == [0, 2, 1, 0, 0, 0]


def sent(told: Told, time_s: float, rest_m: Metres, forward_mps: float | None) -> None:
    """To all; those that move on are valid for 2 s."""
    onward = None if forward_mps is None else Onward(np.array([forward_mps, 0.0, 0.0]), np.full(6, 2.0), BRAKING)
    told.note(round(time_s * 1e9), np.tile(rest_m, (6, 1)), onward)


def test_of_what_may_be_the_last_that_was_heard_those_that_differ_most_count() -> None:
    """One that moves on for 20 m, between others that do not: no choice by age alone would find it."""
    told = Told()
    sent(told, 0.0, (0.0, 0.0, 0.0), None)
    sent(told, 0.05, (1.0, 0.0, 0.0), 10.0)
    sent(told, 0.1, (2.0, 0.0, 0.0), None)
    sent(told, 0.15, (0.0, 9.0, 0.0), None)
    sent(told, 0.2, (2.0, 3.0, 0.0), None)
    obeyed_ns = [None, 0, 40_000_000, 60_000_000, 170_000_000, 200_000_000]
    older = told.older(250_000_000, obeyed_ns)
    for tracker in (0, 1, 2):
        assert older.since_s[:, tracker] == pytest.approx([0.25, 0.2, 0.1])
        assert older.velocity_mps[:, tracker, 0].tolist() == [0, 10, 0]
        assert older.valid_s[:, tracker].tolist() == [0, 2, 0]
        assert older.rest_m[:, tracker].tolist() == [[0, 0, 0], [1, 0, 0], [0, 9, 0]]
    assert older.since_s[:, 3] == pytest.approx([0.2, 0.1, 0.15])
    assert older.since_s[:2, 4] == pytest.approx([0.1, 0.1])
    assert older.since_s[:, 5] == pytest.approx([0.05] * 3)


def test_what_was_sent_before_a_tracker_was_given_up_counts_on() -> None:
    told = Told()
    sent(told, 0.0, (0.0, 0.0, 0.0), None)
    sent(told, 0.05, (1.0, 0.0, 0.0), 10.0)
    sent(told, 0.1, (2.0, 0.0, 0.0), None)
    sent(told, 0.15, (math.nan, math.nan, math.nan), None)
    older = told.older(200_000_000, [None] * 6)
    assert older.since_s[:2, 0] == pytest.approx([0.2, 0.15])
    nobody = Told()
    sent(nobody, 0.0, (math.nan, math.nan, math.nan), None)
    assert np.isnan(nobody.older(0, [None] * 6).rest_m).all()


def test_what_nobody_obeys_any_more_is_forgotten() -> None:
    told = Told()
    for step in range(101):
        sent(told, step / 20, (float(step), 0.0, 0.0), None)
    older = told.older(5 * 10**9, [None, 0, 5 * 10**9, 4 * 10**9, None, None])
    assert older.since_s[0].tolist() == [KEPT_S, KEPT_S, 0, 1, KEPT_S, KEPT_S]
    # The others in between, evenly: half way, then a quarter.
    assert older.since_s[1:, 0] == pytest.approx([1.5, 2.25], abs=0.06)


SPEEDS = st.tuples(*[st.floats(-7.0, 7.0)] * 2, st.floats(-3.0, 3.0))
CHANGES = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
VALID_S = st.sampled_from([0.0, 0.2, 0.5, 1.0, 2.0])
BEHAVIOURS = st.tuples(st.integers(0, 3), st.one_of(st.none(), st.floats(0.0, 3.0)))
"""Which order is the last that it has heard, and when a pilot or a failsafe stops it."""


@settings(max_examples=40)
@given(
    flown_mps=SPEEDS,
    between_m=st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(-4.0, 4.0)),
    older_s=st.floats(0.1, 2.0),
    changes=st.tuples(CHANGES, CHANGES, CHANGES),
    valid_s=st.tuples(VALID_S, VALID_S, VALID_S, VALID_S),
    behaviours=st.tuples(BEHAVIOURS, BEHAVIOURS),
)
def test_no_two_come_nearer_than_that_whatever_each_has_heard_and_whenever_it_stops(
    flown_mps: Metres,
    between_m: Metres,
    older_s: float,
    changes: tuple[Metres, ...],
    valid_s: tuple[float, ...],
    behaviours: tuple[tuple[int, float | None], ...],
) -> None:
    """Two real vehicles of a formation that turns as hard as it can, any way. Since the oldest order they have flown
    straight on; now each obeys the one that it has heard last, of four.
    """
    starts_m, velocity, between_s = np.array([[0.0, 0.0, 0.0], between_m]), np.array(flown_mps), older_s / 3
    orders = Orders(np.full((4, 6, 3), np.nan), np.zeros((4, 6, 3)), np.zeros((4, 6)), np.zeros((4, 6)))
    center_m, moves_mps = -older_s * velocity, velocity
    for number, seconds in enumerate(valid_s):
        orders.rest_m[number, :2] = starts_m + center_m + BRAKING.rest_m(moves_mps)
        orders.velocity_mps[number, :2], orders.valid_s[number, :2] = moves_mps, seconds
        orders.since_s[number] = (3 - number) * between_s
        center_m = center_m + moves_mps * between_s
        turned = np.array(changes[min(number, 2)])
        moves_mps = moves_mps + BRAKING.most_mps2 * between_s * turned / max(float(np.linalg.norm(turned)), 1.0)
    position_m, seen_mps = NOWHERE.copy(), np.zeros((6, 3))
    position_m[:2], seen_mps[:2] = starts_m, velocity
    seen = Seen(Traffic(position_m, seen_mps, NOWHERE, NOWHERE), np.zeros(6))
    older = Orders(*(one[:3] for one in (orders.rest_m, orders.velocity_mps, orders.valid_s, orders.since_s)))
    promised_m = float(least_apart_m(seen, orders.only(3), older, BRAKING, math.inf)[0, 0])
    ways_m = []
    for tracker, (heard, stops_s) in enumerate(behaviours):
        moves: Metres = tuple(orders.velocity_mps[heard, tracker].tolist())
        rest_m: Metres = tuple(orders.rest_m[heard, tracker].tolist())
        obeyed = SetPoint(tracker, 0, 0, rest_m, FeedForward(moves, valid_s[heard], BRAKING.nominal_mps2))
        since_s = float(orders.since_s[heard, tracker])
        ways_m.append(flown_way_m(tuple(starts_m[tracker].tolist()), flown_mps, obeyed, since_s, stops_s))
    truly_m = min(math.dist(one_m, other_m) for one_m, other_m in zip(*ways_m, strict=True))
    assert truly_m >= promised_m - STRAYING_M


def flown_way_m(
    start_m: Metres, velocity_mps: Metres, obeyed: SetPoint, since_s: float, stops_s: float | None
) -> list[Metres]:
    """Of a vehicle that obeys nothing else, and is stopped as hard as any is."""
    vehicle = SimulatedVehicle(start_m, VehicleLimits(12.0, BRAKING.most_mps2))
    vehicle._velocity_mps = velocity_mps
    way_m, step_s = [start_m], 0.05
    vehicle.update(0)
    for step in range(round(AHEAD_S / step_s)):
        now_s = step * step_s
        if stops_s is not None and now_s >= stops_s:
            vehicle._limits = VehicleLimits(12.0, HARDEST_BRAKING_MPS2)
            vehicle.hold()
        else:
            vehicle.go_to(obeyed.rest_m(now_s + since_s))
        vehicle.update(round((now_s + step_s) * 1e9))
        way_m.append(vehicle.position_m)
    return way_m
