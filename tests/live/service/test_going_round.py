"""Who goes which way, with a pencil."""

import numpy as np
import pytest

from swarmchase.live.service.going_round import PAIRS, ways_apart, ways_aside

FAR_M = 100.0 * np.arange(1, 7)[:, None] * np.ones(3)
NORTH, EAST, AWAY = [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("apart_m", "ways_of_the_first"),
    [
        ([4.0, 0.0, 0.0], [NORTH, [0.0, -1.0, 0.0], AWAY]),
        ([1.0, 0.0, 0.0], [[0.5**0.5, 0.5**0.5, 0.0], [0.5**0.5, -(0.5**0.5), 0.0], AWAY]),
        ([0.0, 0.0, 4.0], [EAST, [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    ],
    ids=["side by side", "too near to go round", "one above the other"],
)
def test_two_in_each_others_way_go_opposite_ways_and_nobody_else_goes_any(
    apart_m: list[float], ways_of_the_first: list[list[float]]
) -> None:
    places_m = FAR_M.copy()
    places_m[1] = places_m[3] + apart_m
    in_the_way = (PAIRS[0] == 1) & (PAIRS[1] == 3)
    ways = list(ways_aside(in_the_way, places_m, 1.0))
    np.testing.assert_allclose([way[1] for way in ways], ways_of_the_first, atol=1e-12)
    for way in ways:
        np.testing.assert_allclose(way[3], -way[1])
        assert not way[[0, 2, 4, 5]].any()


def test_those_that_are_to_be_further_apart_go_away_from_each_other_and_nobody_else_goes_any() -> None:
    places_m = FAR_M.copy()
    places_m[1], places_m[4] = places_m[3] + [3.0, 0.0, 4.0], places_m[3] + [-3.0, 0.0, 4.0]
    in_the_way = ((PAIRS[0] == 1) & (PAIRS[1] == 3)) | ((PAIRS[0] == 3) & (PAIRS[1] == 4))
    way = ways_apart(in_the_way, places_m)
    np.testing.assert_allclose(way[[1, 3, 4]], [[0.6, 0.0, 0.8], [0.0, 0.0, -1.0], [-0.6, 0.0, 0.8]], atol=1e-12)
    assert not way[[0, 2, 5]].any()
