"""Shadowing: a Gaussian field with the correlation that its module says, and no seam from call to call."""

import math

import numpy as np
import pytest
import torch

from swarmchase.batch.streams import chase_keys
from swarmchase.channel.shadowing import EVALUATED_S, Shadowing
from swarmchase.scenario import Scenario, paper_scenario

NUM_CHASES = 20_000


def world(**changes: object) -> Scenario:
    return paper_scenario(**{"shadowing_db": 4.0, "shadowing_distance_m": 20.0, **changes})


def shadowed_db(
    scenario: Scenario, target_m: np.ndarray, trackers_m: np.ndarray, num_chases: int = NUM_CHASES
) -> np.ndarray:
    """[chase, place, tracker] of many chases with the target at [place, 3] and the trackers at [place, tracker, 3]."""
    shadowing = Shadowing(scenario)
    state = shadowing.begin(chase_keys(8, num_chases))
    target = torch.from_numpy(target_m).double().expand(num_chases, -1, -1)
    trackers = torch.from_numpy(trackers_m).double().expand(num_chases, -1, -1, -1)
    parts = [
        shadowing.added_db(state, target[:, one : one + 1], trackers[:, one : one + 1]) for one in range(len(target_m))
    ]
    return torch.cat(parts, dim=1).double().numpy()


def six(first_m: tuple[float, float, float]) -> np.ndarray:
    """Six trackers 0, 1, 5, 10, 20 and 60 m from the first, in one direction."""
    direction = np.array([2.0, -1, 2]) / 3
    return np.array(first_m) + np.array([0.0, 1, 5, 10, 20, 60])[:, None] * direction


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_correlation_between_trackers_and_along_the_target_s_way(share: float) -> None:
    """c exp(-|y - y'| / d) + (1 - c) exp(-|x - x'| / d), from 20,000 chases: known to .007."""
    target_m = np.array([[80.0, 0, 10], [80, 6, 18], [50, 40, 10]])  # 0, 10 and 50 m from the first
    field_db = shadowed_db(world(shadowing_common_share=share), target_m, np.stack([six((1, 2, 3))] * 3))
    assert np.abs(field_db.mean(axis=0)).max() < 5 * 4 / math.sqrt(NUM_CHASES)
    assert field_db.std(axis=0) == pytest.approx(np.full((3, 6), 4.0), rel=0.03)
    place = six((0, 0, 0))
    apart_m = np.linalg.norm(place[:, None] - place, axis=2)
    target_apart_m = np.linalg.norm(target_m[:, None] - target_m, axis=2)
    found = np.corrcoef(field_db.reshape(NUM_CHASES, 18).T).reshape(3, 6, 3, 6)
    expected = share * np.exp(-target_apart_m[:, None, :, None] / 20) + (1 - share) * np.exp(
        -apart_m[None, :, None, :] / 20
    )
    assert np.abs(found - expected).max() < 0.035


@pytest.mark.parametrize("distance_m", [5.0, 50.0])
def test_correlation_falls_over_its_distance_in_every_direction(distance_m: float) -> None:
    scenario = world(shadowing_distance_m=distance_m, shadowing_common_share=0.0)
    origin = np.zeros((1, 3))
    axes = np.concatenate([np.zeros((1, 3)), distance_m * np.eye(3), [[0, 0, -2 * distance_m], [3 * distance_m, 0, 0]]])
    field_db = shadowed_db(scenario, origin, axes[None])[:, 0]
    with_origin = np.corrcoef(field_db.T)[0]
    assert with_origin == pytest.approx(np.exp(-np.array([0.0, 1, 1, 1, 2, 3])), abs=0.03)


def test_it_is_gaussian() -> None:
    """Maximum error of the distribution of 120,000 values; kurtosis 3."""
    from scipy.stats import kurtosis, norm

    far_apart = np.arange(6)[:, None] * np.array([500.0, 0, 0])
    field_db = shadowed_db(world(shadowing_common_share=0.3), np.zeros((1, 3)), far_apart[None]).ravel()
    empirical = (np.arange(len(field_db)) + 0.5) / len(field_db)
    assert np.abs(empirical - norm.cdf(np.sort(field_db), scale=4)).max() < 0.01
    assert kurtosis(field_db, fisher=False) == pytest.approx(3, abs=0.1)


def flight(num_chases: int, num_samples: int, sampling_hz: float) -> tuple[torch.Tensor, torch.Tensor]:
    """A target at 8 m/s and trackers at 10 m/s, on straight ways."""
    time_s = torch.arange(num_samples, dtype=torch.float64)[:, None] / sampling_hz
    target_m = torch.tensor([60.0, 0, 5]) + time_s * torch.tensor([0.0, 8, 0])
    trackers_m = torch.from_numpy(six((0, 0, 0))) + (time_s * torch.tensor([6.0, 8, 0]))[:, None]
    return target_m.double().expand(num_chases, -1, -1), trackers_m.double().expand(num_chases, -1, -1, -1)


@pytest.mark.parametrize(("num_samples", "sampling_hz"), [(1, 20), (2, 20), (10, 20), (50, 100), (50, 10), (3, 1)])
def test_on_the_way_it_is_interpolated_between_places_it_really_has(num_samples: int, sampling_hz: float) -> None:
    scenario = world(sampling_hz=sampling_hz)
    shadowing = Shadowing(scenario)
    state = shadowing.begin(chase_keys(2, 5))
    target_m, trackers_m = flight(5, num_samples, sampling_hz)
    found_db = shadowing.added_db(state, target_m, trackers_m)
    exact_db = torch.cat(
        [
            shadowing.added_db(state, target_m[:, one : one + 1], trackers_m[:, one : one + 1])
            for one in range(num_samples)
        ],
        dim=1,
    )
    assert found_db.shape == (5, num_samples, 6)
    for end in (0, -1):
        assert torch.allclose(found_db[:, end], exact_db[:, end], atol=1e-4)
    right = (found_db - exact_db).abs().amax(dim=(0, 2)) < 1e-4
    apart = right.nonzero().flatten().diff()
    assert num_samples == 1 or apart.max() <= max(1, math.ceil(EVALUATED_S * sampling_hz))
    assert (found_db - exact_db).abs().max() < 4  # a standard deviation: of it 5 m take a half


def test_nobody_who_stays_where_he_is_hears_it_change() -> None:
    shadowing = Shadowing(world())
    state = shadowing.begin(chase_keys(2, 3))
    target_m, trackers_m = flight(3, 1, 10)
    assert torch.equal(shadowing.added_db(state, target_m, trackers_m), shadowing.added_db(state, target_m, trackers_m))


def test_a_chase_is_the_same_in_any_batch() -> None:
    shadowing = Shadowing(world())
    target_m, trackers_m = flight(300, 10, 20)
    trackers_m = trackers_m + torch.arange(300)[:, None, None, None]
    keys = chase_keys(4711, 300)
    among_all = shadowing.added_db(shadowing.begin(keys), target_m, trackers_m)
    for chase in (0, 1, 7, 150, 299):
        for company in ([chase], [5, 6, chase], [chase, *range(10, 109)]):
            state = shadowing.begin([keys[one] for one in company])
            found_db = shadowing.added_db(state, target_m[company], trackers_m[company])
            assert torch.equal(found_db[company.index(chase)], among_all[chase])
