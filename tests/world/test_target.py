"""Where targets start: around the swarm, within the scenario's limits of distance, elevation and altitude."""

import math

import numpy as np
import pytest
import torch

from swarmchase.batch.streams import ChaseStreams, chase_keys
from swarmchase.errors import InputError
from swarmchase.scenario import paper_scenario
from swarmchase.world.target import draw_start_m

KEYS = chase_keys(1, 4000)
LIMITS = {
    "start_distance_m": 60.0,
    "farthest_start_m": 300.0,
    "highest_elevation_deg": 30.0,
    "lowest_altitude_m": 5.0,
    "highest_altitude_m": 120.0,
}


def uniformity(values, low, high):
    """The largest difference between the shares found and those of the uniform distribution."""
    ordered = np.sort((np.asarray(values) - low) / (high - low))
    return np.abs(ordered - np.linspace(0, 1, len(ordered))).max()


def test_the_paper_s_starts_are_what_they_were():
    """100 m in the direction of three normals, to the last bit."""
    normals = ChaseStreams.of(KEYS, "target").standard_normal(3).double()
    expected_m = 100.0 * normals / torch.linalg.vector_norm(normals, dim=1, keepdim=True)
    assert torch.equal(draw_start_m(paper_scenario(), KEYS), expected_m)


def test_distance_is_uniform_up_to_the_farthest_start():
    start_m = draw_start_m(paper_scenario(start_distance_m=60.0, farthest_start_m=300.0), KEYS)
    assert uniformity(start_m.norm(dim=1), 60, 300) < 0.03
    towards = start_m / start_m.norm(dim=1, keepdim=True)
    assert all(uniformity(towards[:, axis], -1, 1) < 0.03 for axis in range(3))


def test_directions_are_uniform_on_the_belt_of_the_sphere():
    """Height is uniform on a belt, as bearing is; a bearing is that of the paper's start."""
    start_m = draw_start_m(paper_scenario(highest_elevation_deg=30.0), KEYS)
    assert start_m.norm(dim=1).tolist() == pytest.approx([100.0] * len(KEYS))
    assert uniformity(start_m[:, 2], -50, 50) < 0.03
    assert uniformity(torch.atan2(start_m[:, 1], start_m[:, 0]), -math.pi, math.pi) < 0.03
    paper_m = draw_start_m(paper_scenario(), KEYS)
    assert torch.allclose(start_m[:, 1] / start_m[:, 0], paper_m[:, 1] / paper_m[:, 0])


def test_starts_are_within_all_limits_at_their_distance():
    scenario = paper_scenario(**LIMITS)
    start_m = draw_start_m(scenario, KEYS)
    distance_m, altitude_m = start_m.norm(dim=1), 50.0 + start_m[:, 2]
    assert altitude_m.min() >= 5
    assert altitude_m.max() <= 120
    assert (start_m[:, 2].abs() <= 0.5 * distance_m + 1e-9).all()
    without_m = draw_start_m(paper_scenario(start_distance_m=60.0, farthest_start_m=300.0), KEYS)
    assert torch.allclose(distance_m, without_m.norm(dim=1))
    # At 60 m elevation alone decides, 30 m up and down; at 300 m the band alone, 45 m down and 70 m up.
    near_m = draw_start_m(paper_scenario(**LIMITS | {"farthest_start_m": 60.0}), KEYS)
    far_m = draw_start_m(paper_scenario(**LIMITS | {"start_distance_m": 300.0}), KEYS)
    assert uniformity(near_m[:, 2], -30, 30) < 0.03
    assert uniformity(far_m[:, 2], -45, 70) < 0.03


def test_a_level_start():
    assert draw_start_m(paper_scenario(highest_elevation_deg=0.0), KEYS)[:, 2].abs().max() == 0


@pytest.mark.parametrize("first", [0, 7])
def test_a_chase_s_start_is_the_same_in_any_batch(first):
    scenario = paper_scenario(**LIMITS)
    batch_m = draw_start_m(scenario, chase_keys(1, 20))
    assert torch.equal(draw_start_m(scenario, chase_keys(1, 1, first)), batch_m[first : first + 1])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"farthest_start_m": 99.0}, "farthest_start_m = 99 is refused: allowed is at least start_distance_m = 100"),
        (
            {"lowest_altitude_m": 80.0, "highest_altitude_m": 80.0},
            "lowest_altitude_m = 80 is refused: allowed is less than highest_altitude_m = 80",
        ),
        (
            {"lowest_altitude_m": 101.0, "highest_elevation_deg": 30.0},
            "no start is within lowest_altitude_m, highest_altitude_m and highest_elevation_deg 100 m from a swarm at "
            "start_altitude_m = 50",
        ),
    ],
)
def test_limits_that_leave_nothing_are_refused(changes, message):
    with pytest.raises(InputError) as refusal:
        draw_start_m(paper_scenario(**changes), KEYS[:3])
    assert str(refusal.value) == message
