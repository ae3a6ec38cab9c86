"""How a swarm closes in: to be checked with a pencil."""

import numpy as np
import pytest

from swarmchase.live.estimate import region_of
from swarmchase.live.interception import flown_mps, interception
from swarmchase.live.service.chase_state import Decision

CASES = [
    # centre, its velocity, target, its velocity: closing speed, time to go, where
    # Head on: 4 m/s and 6 m/s over 50 m.
    ((0, 0, 0), (4, 0, 0), (50, 0, 0), (-6, 0, 0), 10.0, 5.0, [20.0, 0.0, 0.0]),
    # Behind it: 10 m/s after 5 m/s over 25 m.
    ((0, 0, 0), (0, 10, 0), (0, 25, 0), (0, 5, 0), 5.0, 5.0, [0.0, 50.0, 0.0]),
    # It flies across: only what points at it counts, 3/5 of 10 m/s.
    ((0, 0, 0), (10, 0, 0), (30, 40, 0), (0, 0, 0), 6.0, 8.3, [30.0, 40.0, 0.0]),
    # It is faster.
    ((0, 0, 0), (5, 0, 0), (20, 0, 0), (8, 0, 0), -3.0, None, None),
    # In 200 s nobody flies as he does now.
    ((0, 0, 0), (1, 0, 0), (200, 0, 0), (0, 0, 0), 1.0, None, None),
    # There.
    ((1, 2, 3), (5, 0, 0), (1, 2, 3), (5, 0, 0), 0.0, None, None),
]


@pytest.mark.parametrize(("center", "swarm", "target", "flies", "closing", "to_go", "where"), CASES)
def test_interception(
    center: object, swarm: object, target: object, flies: object, closing: float, to_go: float | None, where: object
) -> None:
    points = [np.array(one, dtype=np.float64) for one in (center, swarm, target, flies)]
    assert interception(*points) == {"closing_mps": closing, "time_to_go_s": to_go, "position_m": where}


def test_the_swarm_is_as_fast_as_most_of_its_trackers() -> None:
    """5 m east in half a second; one that says otherwise moves nothing."""
    at_m = np.zeros((2, 6, 3))
    at_m[1, :, 0] = 5.0
    at_m[1, 4] = [-300.0, 7.0, 0.0]
    decision = Decision(0, 1, np.zeros((2, 6)), at_m, 5.0, (0.0, 0.0, 0.0), "", np.array([1.0, 1.5]))
    assert flown_mps(decision) == pytest.approx([10.0, 0.0, 0.0])
    stands = Decision(0, 1, np.zeros((2, 6)), at_m, 5.0, (0.0, 0.0, 0.0), "")
    assert flown_mps(stands) is None


def test_the_region_of_a_cross() -> None:
    """Points on the axes, 3 m, 2 m and 1 m from the middle, as many of each: an ellipsoid with axes in that ratio."""
    points_m = np.array(
        [sign * length * axis for length, axis in zip((3, 2, 1), np.eye(3), strict=True) for sign in (1, -1)]
    )
    region = region_of(points_m + np.array([10.0, 0.0, 0.0]))
    assert region["center_m"] == [10.0, 0.0, 0.0]
    lengths_m = np.linalg.norm(region["half_axes_m"], axis=1)
    # All six lie on it.
    assert lengths_m == pytest.approx([1.0, 2.0, 3.0], rel=0.02)
