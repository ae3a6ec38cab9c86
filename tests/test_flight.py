"""Kinematics with a pencil: how far and how fast after so many seconds, and when two are first near each other."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmchase.flight import first_within_s, flown, intercept_s, least_m


def vector(*rows):
    return torch.tensor(rows, dtype=torch.float64)


def after(seconds, velocity_mps=(0, 0, 0), wanted_mps=(10, 0, 0), acceleration_mps2=5.0):
    """Position and velocity of one that starts at (1, 2, 3)."""
    position_m, reached_mps = flown(
        vector((1, 2, 3)),
        vector(velocity_mps),
        vector(wanted_mps),
        torch.tensor([seconds], dtype=torch.float64),
        acceleration_mps2,
    )
    return (position_m - vector((1, 2, 3)))[0].tolist(), reached_mps[0].tolist()


@pytest.mark.parametrize(
    ("seconds", "velocity_mps", "wanted_mps", "acceleration_mps2", "way_m", "reached_mps"),
    [
        # From rest at 5 m/s2: 2.5 m and 5 m/s after a second, 10 m and 10 m/s after two, and from there 10 m a second.
        (1, (0, 0, 0), (10, 0, 0), 5.0, (2.5, 0, 0), (5, 0, 0)),
        (2, (0, 0, 0), (10, 0, 0), 5.0, (10, 0, 0), (10, 0, 0)),
        (5, (0, 0, 0), (10, 0, 0), 5.0, (40, 0, 0), (10, 0, 0)),
        # To a stop: from 4 m/s at 2 m/s2 it takes 2 s and 4 m, and no way after that.
        (1, (0, 4, 0), (0, 0, 0), 2.0, (0, 3, 0), (0, 2, 0)),
        (9, (0, 4, 0), (0, 0, 0), 2.0, (0, 4, 0), (0, 0, 0)),
        # Turning round on the spot: as far there as back.
        (4, (0, 0, 4), (0, 0, -4), 2.0, (0, 0, 0), (0, 0, -4)),
        # (3, 0, 0) to (0, 4, 0) is a change of 5 m/s: at 5 m/s2 half of it after half a second.
        (0.5, (3, 0, 0), (0, 4, 0), 5.0, (1.125, 0.5, 0), (1.5, 2, 0)),
        # No limit: at once.
        (2, (3, 0, 0), (0, 4, 0), None, (0, 8, 0), (0, 4, 0)),
        # Nothing to change.
        (2, (3, 0, 0), (3, 0, 0), 5.0, (6, 0, 0), (3, 0, 0)),
    ],
)
def test_way_and_velocity(seconds, velocity_mps, wanted_mps, acceleration_mps2, way_m, reached_mps):
    found_m, found_mps = after(seconds, velocity_mps, wanted_mps, acceleration_mps2)
    assert found_m == pytest.approx(way_m, abs=1e-12)
    assert found_mps == pytest.approx(reached_mps, abs=1e-12)


@pytest.mark.parametrize("acceleration_mps2", [0.1, 5.0, None])
def test_after_no_time_nothing_has_changed_to_the_last_bit(acceleration_mps2):
    position_m, velocity_mps, wanted_mps = torch.rand(3, 20, 3, dtype=torch.float64)
    found = flown(position_m, velocity_mps, wanted_mps, torch.zeros(20, dtype=torch.float64), acceleration_mps2)
    assert torch.equal(found[0], position_m)
    assert torch.equal(found[1], velocity_mps)


def test_moments_of_an_interval_are_those_one_by_one():
    generator = torch.Generator().manual_seed(1)
    start = [10 * torch.randn(7, 3, generator=generator, dtype=torch.float64) for _ in range(3)]
    seconds = 3 * torch.rand(7, 4, generator=generator, dtype=torch.float64)
    position_m, velocity_mps = flown(*start, seconds, 4.0)
    for moment in range(4):
        alone_m, alone_mps = flown(*start, seconds[:, moment], 4.0)
        assert torch.equal(position_m[:, moment], alone_m)
        assert torch.equal(velocity_mps[:, moment], alone_mps)


speeds = st.tuples(*[st.floats(-20, 20)] * 3)


@given(velocity_mps=speeds, wanted_mps=speeds, first_s=st.floats(0, 5), second_s=st.floats(0, 5))
@settings(max_examples=100, deadline=None)
def test_two_intervals_are_one_and_no_limit_is_passed(velocity_mps, wanted_mps, first_s, second_s):
    between_m, between_mps = after(first_s, velocity_mps, wanted_mps)
    following_m, following_mps = after(second_s, between_mps, wanted_mps)
    whole_m, whole_mps = after(first_s + second_s, velocity_mps, wanted_mps)
    assert np.add(between_m, following_m) == pytest.approx(np.array(whole_m), abs=1e-6)
    assert following_mps == pytest.approx(whole_mps, abs=1e-6)
    assert math.dist(between_mps, velocity_mps) <= 5 * first_s + 1e-9
    assert math.hypot(*whole_mps) <= max(math.hypot(*velocity_mps), math.hypot(*wanted_mps)) + 1e-9


@pytest.mark.parametrize(
    ("offsets_m", "first_s"),
    [
        # 12 m away and nearing by 10 m a second: within 2 m after one.
        ([(12, 0, 0), (2, 0, 0), (-8, 0, 0)], 1.0),
        ([(12, 0, 0), (-8, 0, 0), (-28, 0, 0)], 0.5),
        # There from the start, whatever follows.
        ([(0, 2, 0), (0, 9, 0), (0, 9, 0)], 0.0),
        # Passing at 1.2 m: within 2 m from 1.6 m before the nearest place, 8.4 of 20 m on the way.
        ([(-10, 1.2, 0), (10, 1.2, 0), (30, 1.2, 0)], 0.42),
        # Passing at exactly 2 m, in the middle of the second interval, and at a little more.
        ([(-9, 0, 2), (-1, 0, 2), (1, 0, 2)], 1.5),
        ([(-9, 0, 2.001), (-1, 0, 2.001), (1, 0, 2.001)], math.inf),
        # On the way to it, but not yet there; leaving.
        ([(9, 0, 0), (5, 0, 0), (2.5, 0, 0)], math.inf),
        ([(3, 0, 0), (5, 0, 0), (9, 0, 0)], math.inf),
        # No way at all.
        ([(3, 0, 0), (3, 0, 0), (3, 0, 0)], math.inf),
        # There, gone, and there again: the first counts.
        ([(3, 0, 0), (1, 0, 0), (3, 0, 0)], 0.5),
    ],
)
def test_when_two_are_first_near_each_other(offsets_m, first_s):
    found_s = first_within_s(vector(offsets_m), torch.arange(3.0, dtype=torch.float64)[None], 2.0)
    assert found_s.tolist() == pytest.approx([first_s], abs=1e-9)


def test_the_first_time_is_that_of_a_fine_search():
    """Against 2,001 places on the way of each of 500 pairs."""
    generator = np.random.default_rng(2)
    offset_m = generator.uniform(-8, 8, (500, 4, 3))
    share = np.linspace(0, 1, 667)
    way_m = np.concatenate(
        [
            offset_m[:, step, None] * (1 - share[:, None]) + offset_m[:, step + 1, None] * share[:, None]
            for step in range(3)
        ],
        axis=1,
    )
    time_s = np.concatenate([step + share for step in range(3)])
    near = np.linalg.norm(way_m, axis=2) <= 2.0
    searched_s = np.where(near.any(axis=1), time_s[near.argmax(axis=1)], np.inf)
    found_s = first_within_s(torch.from_numpy(offset_m), torch.arange(4.0).double().expand(500, -1), 2.0).numpy()
    assert 50 < np.isfinite(searched_s).sum() < 450
    # The search passes over what is near for less than its step.
    both = np.isfinite(searched_s)
    assert np.abs(found_s[both] - searched_s[both]).max() <= 1 / 666 + 1e-9
    assert np.isfinite(found_s[~both]).sum() <= 5


@pytest.mark.parametrize(
    ("offset_m", "velocity_mps", "meeting_s"),
    [
        ((100, 0, 0), (0, 0, 0), 10.0),  # it stands
        ((100, 0, 0), (-5, 0, 0), 100 / 15),  # it comes
        ((100, 0, 0), (5, 0, 0), 20.0),  # it goes
        ((30, 0, 0), (0, 8, 0), 5.0),  # 30, 40, 50: a right angle
        ((100, 0, 0), (10, 0, 0), math.inf),  # as fast, straight away
        ((100, 0, 0), (-10, 0, 0), 5.0),  # as fast, straight at it
        ((100, 0, 0), (0, 12, 0), math.inf),  # faster, across
        ((0, 0, 0), (3, 0, 0), 0.0),  # it is there
    ],
)
def test_when_a_pursuer_of_ten_metres_a_second_meets_what_keeps_its_velocity(
    offset_m: tuple[float, float, float], velocity_mps: tuple[float, float, float], meeting_s: float
) -> None:
    found_s = intercept_s(torch.tensor([offset_m]).double(), torch.tensor([velocity_mps]).double(), 10.0)
    assert found_s.tolist() == pytest.approx([meeting_s])


def test_the_least_length_of_an_offset() -> None:
    """From (3, 1) to (-1, 1) it passes at 1 m; then straight away, nearest at its beginning; then it stays."""
    offset_m = torch.tensor([[[3, 1, 0], [-1, 1, 0], [-4, 1, 0]], [[3, 4, 0]] * 3]).double()
    assert least_m(offset_m).tolist() == pytest.approx([1, 5])
