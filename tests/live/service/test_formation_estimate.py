"""Centre and spacing from places of which some are false."""

import numpy as np
import pytest

from swarmchase.live.service.formation_estimate import (
    claimed_centers_m,
    fitted_formation,
    median_m,
    medians,
)
from swarmchase.live.service.safety import formation_m

CENTER_M = np.array([10.0, -20, 30])
EAST_M = np.array([1.0, 0, 0])


def test_with_six_that_agree_the_centre_is_the_mean_bit_for_bit() -> None:
    random = np.random.default_rng(1)
    for spacing_m in (1.0, 3.0, 5.0):
        position_m = formation_m(CENTER_M, spacing_m) + random.normal(0, 0.3, (6, 3))
        estimate = fitted_formation(position_m)
        assert estimate.agrees.all()
        assert np.array_equal(estimate.center_m, position_m.mean(axis=0))
        assert estimate.spacing_m == pytest.approx(spacing_m, abs=0.5)


@pytest.mark.parametrize("off_m", [5.1, 29.9, 1000.0])
@pytest.mark.parametrize("liar", range(6))
def test_one_that_is_elsewhere_moves_nothing(liar: int, off_m: float) -> None:
    for direction in (*np.eye(3), *-np.eye(3), np.ones(3) / np.sqrt(3)):
        position_m = formation_m(CENTER_M, 4.0)
        position_m[liar] += off_m * direction
        estimate = fitted_formation(position_m)
        assert estimate.agrees.tolist() == [tracker != liar for tracker in range(6)]
        assert (estimate.center_m, estimate.spacing_m) == (pytest.approx(CENTER_M), pytest.approx(4.0))
        assert median_m(claimed_centers_m(position_m, 4.0)) == pytest.approx(CENTER_M)


@pytest.mark.parametrize(
    ("moved_m", "missing", "agree"),
    [
        ({}, [], [0, 1, 2, 3, 4, 5]),
        ({2: 4.0 * EAST_M}, [], [0, 1, 2, 3, 4, 5]),  # within what receivers of positions may err
        ({0: 30.0 * EAST_M, 1: 30.0 * EAST_M}, [], [2, 3, 4, 5]),  # two that agree on a lie
        ({0: 30.0 * EAST_M, 5: 900.0 * EAST_M}, [], [1, 2, 3, 4]),
        ({4: 30.0 * EAST_M}, [1, 2], [0, 3, 5]),  # one of four
        ({4: 30.0 * EAST_M}, [1, 2, 3], []),  # one of three contradicts the others: nobody can say which one
        ({4: 30.0 * EAST_M}, [0, 1, 2, 3], [4, 5]),  # of two even less
        ({0: 30.0 * EAST_M, 2: -30.0 * EAST_M, 4: 60.0 * EAST_M}, [], []),
    ],
)
def test_who_agrees_is_the_largest_set(moved_m: dict[int, np.ndarray], missing: list[int], agree: list[int]) -> None:
    position_m = formation_m(CENTER_M, 5.0)
    for tracker, way_m in moved_m.items():
        position_m[tracker] += way_m
    position_m[missing] = np.nan
    assert np.flatnonzero(fitted_formation(position_m).agrees).tolist() == agree


def test_noise_of_half_a_metre_makes_nobody_a_liar() -> None:
    random = np.random.default_rng(2)
    for _ in range(300):
        assert fitted_formation(formation_m(CENTER_M, 5.0) + random.normal(0, 0.5, (6, 3))).agrees.all()


@pytest.mark.parametrize("number", [1, 2, 5, 6])
def test_medians_are_those_of_numpy(number: int) -> None:
    values = np.random.default_rng(number).normal(size=(number, 4))
    assert np.array_equal(medians(values), np.median(values, axis=0))
