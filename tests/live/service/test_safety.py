"""The safety filter and its stream: no set-point outside the operator's limits, whatever a controller wants."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from swarmchase import formation
from swarmchase.errors import InputError
from swarmchase.live.service.safety import (
    ROOM_M,
    TRACKER_DIRECTION,
    Move,
    SafetyFilter,
    SafetyLimits,
    formation_m,
    is_clear,
)
from swarmchase.live.service.separation import BRAKING_MPS2, REACTION_S, Traffic, stopping_m
from swarmchase.live.service.set_point_stream import LEAD_S, LONGEST_STEP_S, SetPointStream

CHOICES_M = (1.0, 2.0, 3.0, 4.0, 5.0)
LIMITS = SafetyLimits()
NONE = np.empty((0, 3))
TINY_M = 1e-6
"""A micrometre for rounding."""
ARRIVED_M = 0.3


def at(*point_m: float) -> np.ndarray:
    return np.array(point_m, dtype=np.float64)


def held(center_m: np.ndarray, spacing_m: float) -> Move:
    return Move(center_m, spacing_m, (), "")


def wanted_move(
    displacement_m: np.ndarray,
    spacing_m: float,
    start_m: np.ndarray | None = None,
    obstacles_m: np.ndarray = NONE,
    limits: SafetyLimits = LIMITS,
    center_m: np.ndarray | None = None,
) -> Move:
    """What the filter makes of this, from the formation at spacing 5 around the centre or from where it is told."""
    center_m = at(0, 0, 0) if center_m is None else center_m
    start_m = formation_m(center_m, 5.0) if start_m is None else start_m
    safety = SafetyFilter(limits, CHOICES_M)
    return safety.move(held(center_m, 5.0), center_m + displacement_m, spacing_m, start_m, start_m, obstacles_m)


def worst_excess_m(limits: SafetyLimits, points_m: np.ndarray) -> float:
    """How far the outermost of these points is outside the fence; negative inside."""
    return float(np.nanmax(np.maximum(limits.low_m - points_m, points_m - limits.high_m)))


def least_distance_m(points_m: np.ndarray, obstacles_m: np.ndarray = NONE) -> float:
    """Of any two trackers and of any tracker from an obstacle."""
    points_m = points_m[np.isfinite(points_m).all(axis=1)]
    pairs = [np.linalg.norm(one - other) for one, other in itertools.combinations(points_m, 2)]
    return float(min([math.inf, *pairs, *(np.linalg.norm(one - other) for one in points_m for other in obstacles_m)]))


def traffic(position_m: np.ndarray, obstacles_m: np.ndarray = NONE, velocity_mps: np.ndarray | None = None) -> Traffic:
    """Vehicles in these places; the obstacles, of which there are no more than those without a place, stand still."""
    position_m = position_m.copy()
    position_m[np.flatnonzero(np.isnan(position_m).any(axis=1))[: len(obstacles_m)]] = obstacles_m
    return Traffic(
        position_m, np.zeros((6, 3)) if velocity_mps is None else velocity_mps, position_m, np.full((6, 3), np.nan)
    )


def test_the_formation_is_that_of_the_simulator() -> None:
    assert torch.equal(torch.from_numpy(TRACKER_DIRECTION), formation.TRACKER_DIRECTION)
    center_m = torch.tensor([[3.0, -7.5, 100.1]], dtype=torch.float64)
    theirs_m = formation.tracker_position_m(center_m, torch.tensor([3.0], dtype=torch.float64))[0]
    assert torch.equal(torch.from_numpy(formation_m(center_m[0].numpy(), 3.0)), theirs_m)


@pytest.mark.parametrize("spacing_m", CHOICES_M)
@pytest.mark.parametrize("displacement_m", [(4.0, 4, -4), (0.0, 0, 0), (-4.0, 2, 0)])
def test_the_paper_s_moves_pass_as_they_are(spacing_m: float, displacement_m: tuple[float, float, float]) -> None:
    for from_m in CHOICES_M:
        move = wanted_move(at(*displacement_m), spacing_m, formation_m(at(0, 0, 0), from_m))
        assert (move.reason, move.spacing_m, move.center_m.tolist()) == ("", spacing_m, list(displacement_m))
        assert len(move.legs) == 1
        assert (move.legs[0] == formation_m(at(*displacement_m), spacing_m)).all()


# The fence


def test_the_centre_stops_where_the_formation_would_touch_the_fence() -> None:
    """East fence at 200 m: with a spacing of 5 m the centre may go to 195."""
    move = wanted_move(at(4, 2, 0), 5.0, center_m=at(193, 0, 0))
    assert move.center_m == pytest.approx(at(195, 2, 0), abs=TINY_M)
    assert worst_excess_m(LIMITS, move.legs[0]) <= 0
    assert move.legs[0] - move.center_m == pytest.approx(5 * TRACKER_DIRECTION)
    assert move.reason == "centre moved by 2 m to keep the fence"


def test_altitudes_are_limits_too() -> None:
    limits = SafetyLimits(lowest_altitude_m=-3.0)
    move = wanted_move(at(0, 0, -4), 2.0, center_m=at(0, 0, 2), limits=limits)
    assert move.center_m == pytest.approx(at(0, 0, -1), abs=TINY_M)


def test_a_fence_too_small_for_the_spacing_narrows_it() -> None:
    limits = SafetyLimits(lowest_altitude_m=-3.0, highest_altitude_m=3.0)
    move = wanted_move(at(0, 0, 0), 5.0, formation_m(at(0, 0, 0), 2.0), limits=limits)
    assert move.spacing_m == pytest.approx(3, abs=1e-5)
    assert worst_excess_m(limits, move.legs[0]) <= 0


def test_a_fence_without_room_for_any_formation_keeps_all_where_they_are() -> None:
    limits = SafetyLimits(lowest_altitude_m=0.0, highest_altitude_m=1.0)
    move = wanted_move(at(4, 0, 0), 1.0, formation_m(at(0, 0, 0), 1.0), limits=limits)
    assert (move.legs, move.reason) == ((), "all stay where they are: the fence has no room for the formation")


# Separation


def test_a_spacing_that_is_too_narrow_is_widened() -> None:
    """3 m between neighbours, and the room beyond, need (3 + .4) / sqrt(2) m."""
    limits = SafetyLimits(minimum_separation_m=3.0)
    move = wanted_move(at(2, 0, 0), 1.0, limits=limits)
    assert move.spacing_m == pytest.approx((3 + ROOM_M) / math.sqrt(2), abs=1e-5)
    assert least_distance_m(move.legs[0]) >= 3 + ROOM_M
    assert move.reason == "spacing 2.4 m instead of 1 m"


@pytest.mark.parametrize(
    ("start", "end", "clear"),
    [
        ([(0, 0, 0), (9, 0, 0)], [(9, 0, 0), (0, 0, 0)], False),  # they swap places
        ([(0, 0, 0), (9, 0, 0)], [(9, 1.5, 0), (0, 0, 0)], False),  # and miss each other by less than a metre
        ([(0, 0, 0), (9, 0, 0)], [(9, 2.5, 0), (0, 0, 0)], True),  # and by more
        ([(0, 0, 0), (1, 0, 0)], [(5, 0, 0), (6, 0, 0)], True),  # side by side at the limit
        ([(0, 0, 0), (0.5, 0, 0)], [(5, 0, 0), (5.5, 0, 0)], True),  # too near already, and not getting nearer
        ([(0, 0, 0), (0.5, 0, 0)], [(5, 0, 0), (5.4, 0, 0)], False),  # too near already, and getting nearer
        ([(0, 0, 0), (0.5, 0, 0)], [(5, 0, 0), (9, 0, 0)], True),  # too near already, and parting
        ([(0, 0, 0), (math.nan,) * 3], [(9, 0, 0), (0, 0, 0)], True),  # one is not commanded
    ],
)
def test_ways_by_hand(start: list[tuple[float, ...]], end: list[tuple[float, ...]], clear: bool) -> None:
    start_m, end_m = (np.array(points, dtype=np.float64) for points in (start, end))
    assert is_clear(start_m, end_m, NONE, 1.0) is clear
    assert is_clear(start_m[::-1], end_m[::-1], NONE, 1.0) is clear


def test_an_obstacle_counts_like_a_tracker_that_stays() -> None:
    start_m, end_m = np.array([[0.0, 0, 0]]), np.array([[10.0, 0, 0]])
    assert not is_clear(start_m, end_m, np.array([[5.0, 0.9, 0]]), 1.0)
    assert is_clear(start_m, end_m, np.array([[5.0, 1.1, 0]]), 1.0)
    # Two obstacles next to each other are not the trackers' concern.
    assert is_clear(start_m, end_m, np.array([[5.0, 1.1, 0], [5.0, 1.2, 0]]), 1.0)


finite = st.floats(-8.0, 8.0)
point = st.tuples(finite, finite, finite)


@settings(deadline=None)
@given(st.lists(st.tuples(point, point), min_size=2, max_size=4))
def test_ways_against_many_points_on_them(ways: list[tuple[tuple[float, ...], tuple[float, ...]]]) -> None:
    """The closed form and the least distance at a thousand moments."""
    start_m, end_m = (np.array([way[side] for way in ways]) for side in (0, 1))
    share = np.linspace(0, 1, 1001)[:, None, None]
    flown_m = start_m + share * (end_m - start_m)
    margin_m = 17 * math.sqrt(3) * 2 / 1000
    for one, other in itertools.combinations(range(len(ways)), 2):
        distance_m = np.linalg.norm(flown_m[:, one] - flown_m[:, other], axis=1)
        needed_m = min(1.0, float(distance_m[0]))
        clear = is_clear(start_m[[one, other]], end_m[[one, other]], NONE, 1.0)
        if clear:
            assert distance_m.min() >= needed_m - TINY_M
        elif distance_m[0] >= 1:
            assert distance_m.min() < needed_m + margin_m


def test_crossing_ways_are_flown_in_turns() -> None:
    """The trackers of two axes sit in each other's places; together they would meet in the middle."""
    start_m = formation_m(at(0, 0, 0), 5.0)[[1, 0, 3, 2, 4, 5]]
    start_m[0, 2] += 1.5  # by turns they can just pass
    start_m[2, 2] -= 1.5
    move = wanted_move(at(0, 0, 0), 5.0, start_m)
    assert move.reason == "in turns to keep the separation"
    assert (move.legs[-1] == formation_m(at(0, 0, 0), 5.0)).all()
    legs = [start_m, *move.legs]
    for before_m, after_m in itertools.pairwise(legs):
        assert (before_m != after_m).any(axis=1).sum() <= 1
        assert is_clear(before_m, after_m, NONE, 1.0)


def test_a_lost_tracker_in_the_way_is_passed() -> None:
    """Tracker 1 got lost 3 m ahead of tracker 0; it holds there, and the others pass around it."""
    obstacle_m = np.array([[8.0, 0, 0]])
    start_m = formation_m(at(0, 0, 0), 5.0)
    start_m[1] = math.nan
    center_m, now = at(0, 0, 0), held(at(0, 0, 0), 5.0)
    safety = SafetyFilter(LIMITS, CHOICES_M)
    set_points_m = start_m
    for _ in range(4):
        move = safety.move(now, now.center_m + at(4, 0, 0), 5.0, set_points_m, set_points_m, obstacle_m)
        for before_m, after_m in itertools.pairwise([set_points_m, *move.legs]):
            assert is_clear(before_m, after_m, obstacle_m, 1.0)
        assert np.isnan(move.legs[-1][1]).all()
        set_points_m, now = move.legs[-1], move
    assert now.center_m[0] - center_m[0] > 12


def test_a_detour_stays_inside_the_fence() -> None:
    """An obstacle ahead of tracker 0, and no room to pass it above, below or to the north."""
    limits = SafetyLimits(fence_north_m=6.0, lowest_altitude_m=-6.0, highest_altitude_m=6.0)
    move = wanted_move(at(4, 0, 0), 5.0, obstacles_m=np.array([[7.0, 0.3, 0]]), limits=limits)
    assert move.reason == "by a detour to keep the separation"
    assert len(move.legs) == 3
    assert all(worst_excess_m(limits, leg_m) <= 0 for leg_m in move.legs)
    assert move.legs[0][0, 1] < -1


def test_a_centre_where_no_spacing_is_free_gives_way_to_one_beside_it() -> None:
    """Obstacles on tracker 0's place for every spacing."""
    obstacles_m = np.array([[spacing_m, 0, 4] for spacing_m in CHOICES_M])
    move = wanted_move(at(0, 0, 4), 5.0, obstacles_m=obstacles_m)
    assert move.reason == "centre moved by 2.8 m to keep the separation"
    assert least_distance_m(move.legs[-1], obstacles_m) >= 1


def test_ways_are_checked_from_where_the_trackers_are_too() -> None:
    """Tracker 0 lags 4 m behind its set-point, and from there it would fly through an obstacle beside it."""
    set_points_m = formation_m(at(0, 0, 0), 5.0)
    positions_m = set_points_m.copy()
    positions_m[0] = at(5, 4, 0)
    obstacle_m = np.array([[7.0, 2.2, 0]])
    safety, now = SafetyFilter(LIMITS, CHOICES_M), held(at(0, 0, 0), 5.0)
    wanted = (now, at(4, 0, 0), 5.0, set_points_m)
    assert safety.move(*wanted, set_points_m, obstacle_m).reason == ""
    move = safety.move(*wanted, positions_m, obstacle_m)
    assert move.reason != ""
    if move.legs:
        assert is_clear(positions_m, move.legs[0], obstacle_m, 1.0)


def test_who_is_too_near_to_an_obstacle_does_not_stay_there() -> None:
    """Tracker 0 is at 5 m, the obstacle at 5.6: with a spacing of 4 m it is far enough."""
    move = wanted_move(at(0, 0, 0), 5.0, obstacles_m=np.array([[5.6, 0, 0]]))
    assert (move.center_m.tolist(), move.spacing_m) == ([0, 0, 0], 4)
    assert move.reason == "spacing 4 m instead of 5 m to keep the separation"


def test_where_nothing_is_free_all_stay() -> None:
    """Walls of obstacles all around."""
    start_m = formation_m(at(0, 0, 0), 5.0)
    grid = np.arange(-13.0, 14.0, 1.5)
    walls_m = np.array([(x, y, z) for x in grid for y in grid for z in grid])
    walls_m = walls_m[np.linalg.norm(walls_m[:, None] - start_m[None], axis=2).min(axis=1) > 1.05]
    move = wanted_move(at(4, 4, 4), 5.0, start_m, walls_m)
    assert move.legs == ()
    assert move.reason == "all stay where they are: every way would come too near to another tracker"
    assert (move.center_m == 0).all()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(4))
def test_what_is_no_number_moves_nobody(bad: float, place: int) -> None:
    wanted = [2.0, 2.0, 2.0, 3.0]
    wanted[place] = bad
    move = wanted_move(at(*wanted[:3]), wanted[3])
    assert (move.legs, move.reason) == ((), "all stay where they are: the wanted move is no number")
    assert (move.center_m.tolist(), move.spacing_m) == ([0, 0, 0], 5)


# The stream


def test_the_stream_keeps_to_the_speed_and_to_straight_synchronous_ways() -> None:
    """20 m for one and 10 m for the others at 5 m/s: 4 s for all."""
    stream = SetPointStream(LIMITS)
    start_m = formation_m(at(0, 0, 0), 5.0)
    for tracker, position_m in enumerate(start_m):
        stream.hold(tracker, position_m)
    end_m = start_m + at(0, 0, 10)
    end_m[4, 2] += 10
    stream.fly((end_m,))
    assert stream.ways_m() == [20]
    for step in range(1, 81):
        assert not stream.has_arrived
        stream.advance(0.05, traffic(stream.set_point_m))
        assert stream.set_point_m == pytest.approx(start_m + (end_m - start_m) * step / 80)
    assert stream.has_arrived
    assert (stream.set_point_m == end_m).all()


def test_the_stream_waits_for_a_tracker_that_lags() -> None:
    stream = SetPointStream(LIMITS)
    start_m = formation_m(at(0, 0, 0), 5.0)
    for tracker, position_m in enumerate(start_m):
        stream.hold(tracker, position_m)
    stream.fly((start_m + at(40, 0, 0),))
    for _ in range(100):
        position_m = stream.set_point_m.copy()
        position_m[2] = start_m[2]
        stream.advance(0.05, traffic(position_m))
    assert stream.set_point_m[:, 0] - start_m[:, 0] == pytest.approx(np.full(6, 5.0 * LEAD_S), abs=0.25)
    stream.advance(0.05, traffic(stream.set_point_m))
    assert stream.set_point_m[2, 0] > 5.0 * LEAD_S - 0.1


def test_a_loop_that_stood_still_does_not_make_up_for_it() -> None:
    stream = SetPointStream(LIMITS)
    stream.hold(0, at(0, 0, 0))
    end_m = np.full((6, 3), math.nan)
    end_m[0] = at(40, 0, 0)
    stream.fly((end_m,))
    stream.advance(60.0, traffic(stream.set_point_m))
    assert stream.set_point_m[0, 0] == pytest.approx(5 * LONGEST_STEP_S)


def test_the_stream_stops_before_somebody_who_has_flown_into_the_way() -> None:
    stream = SetPointStream(LIMITS)
    stream.hold(0, at(0, 0, 0))
    end_m = np.full((6, 3), math.nan)
    end_m[0] = at(10, 0, 0)
    stream.fly((end_m,))
    for _ in range(100):
        stream.advance(0.05, traffic(stream.set_point_m, np.array([[5.0, 0.2, 0]])))
    assert 3.9 < stream.set_point_m[0, 0] <= 5 - math.sqrt(1 - 0.2**2)
    assert not stream.has_arrived
    assert stream.blocked_s > 3
    for _ in range(100):
        stream.advance(0.05, traffic(stream.set_point_m))
    assert stream.set_point_m[0].tolist() == [10, 0, 0]


def test_a_released_tracker_is_left_out_and_comes_back_where_it_is() -> None:
    stream = SetPointStream(LIMITS)
    stream.hold(0, at(0, 0, 0))
    stream.hold(2, at(0, 9, 0))
    end_m = np.full((6, 3), math.nan)
    end_m[0], end_m[2] = at(5, 0, 0), at(5, 9, 0)
    stream.fly((end_m,))
    stream.advance(0.2, traffic(stream.set_point_m))
    stream.release(2)
    assert stream.commanded.tolist() == [True, False, False, False, False, False]
    stream.hold(2, at(1.5, 9, 0))
    for _ in range(10):
        stream.advance(0.2, traffic(stream.set_point_m))
    assert stream.has_arrived
    assert stream.set_point_m[[0, 2]].tolist() == [[5, 0, 0], [1.5, 9, 0]]


@settings(deadline=None)
@given(st.lists(st.lists(st.tuples(*(st.floats(-1e6, 1e6) for _ in range(3))), min_size=6, max_size=6), max_size=3))
def test_whatever_legs_it_is_given_the_stream_keeps_to_the_limits(legs: list[list[tuple[float, float, float]]]) -> None:
    """It trusts nobody."""
    stream = SetPointStream(SafetyLimits(highest_speed_mps=100.0))
    for tracker, position_m in enumerate(formation_m(at(0, 0, 0), 5.0)):
        stream.hold(tracker, position_m)
    stream.fly(tuple(np.array(leg) for leg in legs))
    for _ in range(30):
        before_m = stream.set_point_m
        stream.advance(0.25, traffic(before_m))
        stream.turn()
        assert worst_excess_m(LIMITS, stream.set_point_m) <= 0
        assert least_distance_m(stream.set_point_m) >= 1 - TINY_M
        assert np.linalg.norm(stream.set_point_m - before_m, axis=1).max() <= 25 + TINY_M


# The ways of vehicles


def moving_traffic(position_m: np.ndarray, velocity_mps: np.ndarray) -> Traffic:
    """Who is not commanded comes to rest where it can stop."""
    return Traffic(position_m, velocity_mps, position_m + stopping_m(velocity_mps), np.full((6, 3), np.nan))


def two(one_m: np.ndarray, other_m: np.ndarray) -> np.ndarray:
    points_m = np.full((6, 3), math.nan)
    points_m[0], points_m[1] = one_m, other_m
    return points_m


@settings(deadline=None, max_examples=30)
@given(st.tuples(point, point, point, point))
def test_ways_against_many_points_of_both(ends: tuple[tuple[float, ...], ...]) -> None:
    """The closed form and the least distance of 401 x 401 points, which is at most a step too large."""
    one_m, one_end_m, other_m, other_end_m = (np.array(end) for end in ends)
    share = np.linspace(0, 1, 401)[:, None]
    points_m, others_m = one_m + share * (one_end_m - one_m), other_m + share * (other_end_m - other_m)
    by_hand_m = np.linalg.norm(points_m[:, None] - others_m[None], axis=2).min()
    ways = traffic(two(one_m, other_m)).ways(two(one_end_m, other_end_m))
    apart_m = ways.apart_m()
    assert by_hand_m - 28 / 400 <= apart_m[0] <= by_hand_m + TINY_M
    assert np.isinf(apart_m[1:]).all()


def test_nobody_sets_out_across_the_way_of_one_that_may_still_be_stopped_on_it() -> None:
    """Tracker 1 is 4 m from its set-point: tracker 0 may not cross between, though the set-points are far apart."""
    stream = SetPointStream(LIMITS)
    stream.hold(0, at(2, -2, 0))
    stream.hold(1, at(4, 0, 0))
    end_m = two(at(2, 2, 0), at(4, 0, 0))
    stream.fly((end_m,))
    behind_m = two(at(2, -2, 0), at(0, 0, 0))
    for _ in range(40):
        stream.advance(0.05, traffic(behind_m))
        behind_m[0] = stream.set_point_m[0]
    assert -1.2 < stream.set_point_m[0, 1] <= -1
    for _ in range(40):  # it has arrived
        stream.advance(0.05, traffic(stream.set_point_m))
    assert stream.has_arrived


def test_a_set_point_is_pulled_back_from_somebody_who_comes_into_the_way() -> None:
    """Tracker 0 flies at 2 m/s and is 4 m from its set-point; tracker 1, which its pilot flies, comes into its way."""
    stream = SetPointStream(LIMITS)
    stream.hold(0, at(4, 0, 0))
    position_m, velocity_mps = two(at(0, 0, 0), at(3, 0.5, 0)), np.zeros((6, 3))
    velocity_mps[0] = at(2, 0, 0)
    stream.advance(0.05, moving_traffic(position_m, velocity_mps))
    assert stream.set_point_m[0] == pytest.approx(at(2 * REACTION_S + 2**2 / (2 * BRAKING_MPS2), 0, 0))
    assert stream.pulled_back == 1
    # Where it can no longer do anything about it, it is not led on.
    position_m[1] = at(0.5, 0.5, 0)
    stream.advance(0.05, moving_traffic(position_m, velocity_mps))
    assert stream.set_point_m[0, 0] <= 2 * REACTION_S + 2**2 / (2 * BRAKING_MPS2) + TINY_M
    # Who flies away from it is let go.
    stream.set_point_m[0] = at(-4, 0, 0)
    stream.advance(0.05, moving_traffic(position_m, np.zeros((6, 3))))
    assert stream.set_point_m[0].tolist() == [-4, 0, 0]


def test_what_a_vehicle_flies_beside_its_way_counts() -> None:
    """At 2 m/s across its way it gets 1 m away from it before it has stopped."""
    velocity_mps = np.zeros((6, 3))
    velocity_mps[0], velocity_mps[1] = at(3, 2, 0), at(-1, 0, 0)
    ways = moving_traffic(two(at(0, 0, 0), at(0, 9, 0)), velocity_mps).ways(two(at(5, 0, 0), at(5, 9, 0)))
    assert ways.stray_m[:2] == pytest.approx([2**2 / (2 * BRAKING_MPS2), 1 / (2 * BRAKING_MPS2)])


@pytest.mark.parametrize(
    ("instead_m", "flown_m"),
    [
        pytest.param(at(math.nan, math.nan, math.nan), 3.0, id="believed"),
        pytest.param(at(9, 0, 0), 3.0, id="stands far off"),
        pytest.param(at(3, 0.5, 0), 2.13, id="stands beside the way: sqrt(.75) m before it"),
    ],
)
def test_one_that_may_stand_elsewhere_is_in_the_way_there_and_not_between(
    instead_m: np.ndarray, flown_m: float
) -> None:
    """Tracker 1 says that it is 1 km beyond; the way between that and the other place crosses that of tracker 0."""
    stream = SetPointStream(LIMITS)
    stream.hold(0, at(0, 0, 0))
    stream.fly((two(at(3, 0, 0), at(math.nan, math.nan, math.nan)),))
    says_m = two(at(0, 0, 0), at(1.5, 1000, 0))
    nowhere_m = np.full((6, 3), math.nan)
    for _ in range(100):
        says_m[0] = stream.set_point_m[0]
        stream.advance(0.05, Traffic(says_m, np.zeros((6, 3)), says_m, two(nowhere_m[0], instead_m)))
    assert stream.set_point_m[0, 0] == pytest.approx(flown_m, abs=0.04)


def test_at_a_corner_the_stream_waits_to_be_told() -> None:
    stream = SetPointStream(LIMITS)
    stream.hold(0, at(0, 0, 0))
    corner_m, end_m = two(at(1, 0, 0), at(1, 0, 0)), two(at(1, 1, 0), at(1, 1, 0))
    stream.fly((corner_m, end_m))
    assert stream.ways_m() == [1, 1]
    for _ in range(20):
        stream.advance(0.05, traffic(stream.set_point_m))
    assert stream.is_at_corner
    assert not stream.has_arrived
    assert stream.set_point_m[0].tolist() == [1, 0, 0]
    stream.turn()
    for _ in range(20):
        stream.advance(0.05, traffic(stream.set_point_m))
    assert stream.has_arrived
    assert stream.set_point_m[0].tolist() == [1, 1, 0]


# Whatever a controller does

hostile = st.one_of(
    st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308, 0.0, 4.0, -4.0]),
    st.floats(-20, 20),
    st.floats(),
)
actions = st.lists(st.tuples(hostile, hostile, hostile, hostile), min_size=1, max_size=5)
tight = SafetyLimits(
    fence_west_m=-12.0,
    fence_east_m=15.0,
    fence_south_m=-9.0,
    fence_north_m=20.0,
    lowest_altitude_m=-8.0,
    highest_altitude_m=9.0,
    minimum_separation_m=1.2,
    highest_speed_mps=6.0,
)


def flown(
    limits: SafetyLimits,
    start_m: np.ndarray,
    obstacles_m: np.ndarray,
    wanted: list[tuple[float, float, float, float]],
    follow: float,
    pulled_back_m: dict[int, np.ndarray] | None = None,
) -> list[np.ndarray]:
    """Every set-point that these actions get out, for trackers that fly this share of their way in each step.

    ``pulled_back_m`` is told where the trackers were at the steps in which set-points were pulled back to them.
    """
    safety, stream = SafetyFilter(limits, CHOICES_M), SetPointStream(limits)
    for tracker in np.flatnonzero(np.isfinite(start_m).all(axis=1)):
        stream.hold(int(tracker), start_m[tracker])
    now, position_m = held(np.nanmean(start_m, axis=0), 5.0), start_m.copy()
    out = [stream.set_point_m.copy()]
    for x_m, y_m, z_m, spacing_m in wanted:
        now = safety.move(now, now.center_m + at(x_m, y_m, z_m), spacing_m, stream.set_point_m, position_m, obstacles_m)
        stream.fly(now.legs)
        for _ in range(40):
            pulled_back = stream.pulled_back
            stream.advance(0.2, traffic(position_m, obstacles_m))
            if pulled_back_m is not None and stream.pulled_back > pulled_back:
                pulled_back_m[len(out)] = position_m
            if np.nanmax(np.linalg.norm(stream.set_point_m - position_m, axis=1)) <= ARRIVED_M:
                stream.turn()
            out.append(stream.set_point_m.copy())
            ahead_m = np.nanmax(np.linalg.norm(stream.set_point_m - position_m, axis=1))
            assert ahead_m <= limits.highest_speed_mps * LEAD_S + TINY_M
            position_m = position_m + follow * (stream.set_point_m - position_m)
    return out


def legal_start(data: st.DataObject, limits: SafetyLimits, number: int) -> np.ndarray:
    """Anywhere inside the fence, the separation apart, one by one beside where they were drawn."""
    points_m: list[np.ndarray] = []
    for _ in range(number):
        share = at(*data.draw(st.tuples(*(st.floats(0, 1) for _ in range(3)))))
        place_m = limits.low_m + share * (limits.high_m - limits.low_m)
        # Step along x, and row by row along y, until it is free.
        for _ in range(600):
            if least_distance_m(np.array([*points_m, place_m])) >= limits.minimum_separation_m:
                break
            place_m = place_m + at(1.3, 0, 0)
            if place_m[0] > limits.high_m[0]:
                place_m = np.array([limits.low_m[0], place_m[1] + 1.3, place_m[2]])
            if place_m[1] > limits.high_m[1]:
                place_m[1] = limits.low_m[1]
        points_m.append(place_m)
    return np.array(points_m)


@settings(max_examples=60, deadline=None)
@given(st.data(), actions, st.sampled_from([1.0, 0.5, 0.1]), st.integers(0, 2))
def test_no_controller_gets_a_set_point_through_that_violates_a_limit(
    data: st.DataObject, wanted: list[tuple[float, float, float, float]], follow: float, num_lost: int
) -> None:
    """From any legal start, with any number of lost trackers anywhere."""
    points_m = legal_start(data, tight, 6)
    start_m, obstacles_m = points_m.copy(), points_m[:num_lost]
    start_m[:num_lost] = math.nan
    assert least_distance_m(points_m) >= tight.minimum_separation_m
    out = flown(tight, start_m, obstacles_m, wanted, follow)
    for set_points_m in out:
        assert worst_excess_m(tight, set_points_m) <= 0
        assert least_distance_m(set_points_m, obstacles_m) >= tight.minimum_separation_m - TINY_M
    for before_m, after_m in itertools.pairwise(out):
        assert np.nanmax(np.linalg.norm(after_m - before_m, axis=1)) <= tight.highest_speed_mps * 0.2 + TINY_M


@settings(max_examples=60, deadline=None)
@given(st.lists(point, min_size=6, max_size=6), actions, st.sampled_from([1.0, 0.3]), st.integers(0, 2))
@example([(0.0, 0.0, 0.0)] * 6, [(1e308, 1e308, 1e308, 1e308)], 0.3, 0)
@example(
    [(0.0, 0.0, 0.0)] * 2 + [(0.0, -1.0, -4.0)] * 2 + [(0.0, 0.0, 0.0), (5.0, 0.0, 0.0)],
    [(1e308, 1e308, 1e308, 6.0)],
    0.3,
    1,
)
def test_from_an_illegal_start_nothing_gets_worse(
    start: list[tuple[float, ...]], wanted: list[tuple[float, float, float, float]], follow: float, num_lost: int
) -> None:
    """Outside the fence, on top of one another: no coordinate gets further out, no pair that is too near nearer; but
    who is in another's way gets its set-point back on its way to it, since what counts is where it is.
    """
    limits = dataclasses.replace(tight, fence_west_m=-5.0, fence_south_m=0.0, minimum_separation_m=3.0)
    points_m = np.array(start)
    start_m, obstacles_m = points_m.copy(), points_m[:num_lost]
    start_m[:num_lost] = math.nan
    pulled_back_m: dict[int, np.ndarray] = {}
    out = flown(limits, start_m, obstacles_m, wanted, follow, pulled_back_m)
    for step, (before_m, after_m) in enumerate(itertools.pairwise(out), start=1):
        if step in pulled_back_m:
            ahead_m = [np.linalg.norm(set_point_m - pulled_back_m[step], axis=1) for set_point_m in (before_m, after_m)]
            assert not (ahead_m[1] > ahead_m[0] + TINY_M).any()
            continue
        assert not (after_m < np.minimum(limits.low_m, before_m)).any()
        assert not (after_m > np.maximum(limits.high_m, before_m)).any()
        for one, other in itertools.combinations(range(6), 2):
            before, after = (np.linalg.norm(points[one] - points[other]) for points in (before_m, after_m))
            assert not after < min(limits.minimum_separation_m, before) - TINY_M


def test_from_outside_the_fence_they_come_in() -> None:
    start_m = formation_m(at(210, 0, 0), 5.0)
    out = flown(LIMITS, start_m, NONE, [(0.0, 0.0, 0.0, 5.0)] * 2, 1.0)
    assert worst_excess_m(LIMITS, out[0]) == 15
    assert worst_excess_m(LIMITS, out[-1]) <= 0


# The operator's limits


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"fence_west_m": math.nan}, "fence_west_m = nan is refused"),
        ({"fence_east_m": math.inf}, "fence_east_m = inf is refused"),
        ({"highest_altitude_m": 2e5}, "highest_altitude_m = 200000.0 is refused"),
        ({"lowest_altitude_m": 150.0}, "there is no room"),
        ({"highest_speed_mps": 0.0}, "highest_speed_mps = 0.0 is refused"),
        ({"highest_speed_mps": 201.0}, "highest_speed_mps = 201.0 is refused"),
        ({"minimum_separation_m": -1.0}, "minimum_separation_m = -1.0 is refused"),
    ],
)
def test_limits_that_cannot_be_are_refused(limits: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        SafetyLimits(**limits)
