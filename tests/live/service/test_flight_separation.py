"""Vehicles that fly behind one another: how near they may come, whoever of them stops."""

import numpy as np
import pytest

from swarmchase.live.service.flight_separation import (
    HARDEST_BRAKING_MPS2,
    Braking,
    Seen,
    blocked,
    least_apart_m,
    may_become,
)
from swarmchase.live.service.separation import Traffic

BRAKING = Braking(nominal_mps2=4.0, most_mps2=5.0)
NOWHERE = np.full((6, 3), np.nan)


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
    least_m = least_apart_m(seen, set_point_m[None], BRAKING)[0]
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
    assert may_become(before, after, separation_m=1.0) is allowed


def test_both_of_a_pair_are_blocked() -> None:
    least_m = np.full(15, np.inf)
    least_m[5] = 0.5  # trackers 1 and 2, after the five pairs of tracker 0
    assert np.flatnonzero(blocked(least_m, 0.8)).tolist() == [1, 2]
    assert not blocked(least_m, 0.5).any()
