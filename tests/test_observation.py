"""What controllers make of a window: mean powers and positions, by hand, missing samples included."""

import math

import numpy as np
import pytest
import torch

from swarmchase.errors import InputError
from swarmchase.observation import Observation, center_m, checked_observation, mean_position_m, mean_power_dbm
from swarmchase.scenario import paper_scenario

NAN, INF = math.nan, math.inf


def heard(*samples_of_one_tracker, dtype=torch.float32):
    """One chase in which tracker 0 hears these samples and the others nothing but -50 dBm."""
    rssi_dbm = torch.full((1, len(samples_of_one_tracker), 6), -50.0, dtype=dtype)
    rssi_dbm[0, :, 0] = torch.tensor(samples_of_one_tracker, dtype=dtype)
    return Observation(rssi_dbm, torch.zeros(*rssi_dbm.shape, 3, dtype=torch.float64))


@pytest.mark.parametrize(
    ("samples_dbm", "mean_dbm"),
    [
        ((-60, -60, -60), -60),
        # 1 mW and 100 mW are 50.5 mW on average: 17.0329 dBm, where the mean of the dB values is 10.
        ((0, 20), 17.0329),
        # A deep fade among three samples takes a third of the power: 1.7609 dB.
        ((-60, -200, -60), -61.7609),
        ((-60, NAN, -60), -60),
        ((NAN, 0, NAN, 20), 17.0329),
        # What is no number is no sample, on either side.
        ((INF, -60, -INF), -60),
        ((NAN,), NAN),
        ((NAN, INF, -INF), NAN),
        # 10^-40 mW is no float32, and neither is 10^40 mW.
        ((-400, -400), -400),
        ((-400, -390), -392.5964),  # (1 + 10) / 2 of the weaker: 7.4036 dB above it
        ((400, 400), 400),
        ((-400, 400), 396.9897),  # half of the stronger
    ],
)
def test_mean_power_by_hand(samples_dbm, mean_dbm):
    found = mean_power_dbm(heard(*samples_dbm).rssi_dbm)
    assert found.shape == (1, 6)
    assert found[0, 0].item() == pytest.approx(mean_dbm, abs=1e-4, nan_ok=True)
    assert found[0, 1:].tolist() == [-50] * 5


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_mean_power_is_that_of_numpy_with_a_mask(dtype):
    generator = np.random.default_rng(1)
    levels_dbm = generator.normal(-60, 8, (20, 50, 6))
    levels_dbm[generator.random(levels_dbm.shape) < 0.3] = np.nan
    expected_dbm = 10 * np.log10(np.nanmean(10 ** (levels_dbm / 10), axis=1))
    np.testing.assert_allclose(mean_power_dbm(torch.tensor(levels_dbm, dtype=dtype)).numpy(), expected_dbm, atol=1e-4)


def test_mean_power_of_a_chase_is_the_same_in_any_batch():
    """Bit for bit: a particle's weight may hang on the last one."""
    generator = torch.Generator().manual_seed(2)
    rssi_dbm = -60 + 6 * torch.randn(256, 50, 6, generator=generator)
    rssi_dbm[torch.rand(256, 50, 6, generator=generator) < 0.1] = NAN
    whole = mean_power_dbm(rssi_dbm)
    for size in (1, 3, 8, 13):
        parts = [mean_power_dbm(part) for part in rssi_dbm.split(size)]
        assert torch.equal(torch.cat(parts), whole), size


def test_a_window_is_left_as_it_was():
    observation = heard(-60, NAN, INF)
    before = observation.rssi_dbm.clone()
    mean_power_dbm(observation.rssi_dbm)
    assert torch.equal(observation.rssi_dbm.nan_to_num(1, 2, 3), before.nan_to_num(1, 2, 3))


def test_positions_by_hand():
    """Tracker u moves from u to u + 2 along y in three samples: u + 1 on average; the centre ends at 2.5 + 2."""
    position_m = torch.zeros(1, 3, 6, 3)
    position_m[0, :, :, 1] = torch.arange(3.0)[:, None] + torch.arange(6.0)
    observation = Observation(torch.zeros(1, 3, 6), position_m)
    assert mean_position_m(observation)[0].tolist() == [[0, tracker + 1, 0] for tracker in range(6)]
    assert center_m(observation).tolist() == [[0, 4.5, 0]]
    assert mean_position_m(observation).dtype == center_m(observation).dtype == torch.float64


@pytest.mark.parametrize(
    ("window", "positions"),
    [((1, 6), (1, 6, 3)), ((1, 2, 6), (1, 2, 6)), ((1, 2, 6), (1, 3, 6, 3)), ((1, 2, 6), (1, 2, 6, 2))],
)
def test_shapes_that_do_not_belong_together_are_refused(window, positions):
    """Where nothing checks the annotations; here jaxtyping would be first."""
    observation = object.__new__(Observation)
    object.__setattr__(observation, "rssi_dbm", torch.zeros(window))
    object.__setattr__(observation, "tracker_position_m", torch.zeros(positions))
    with pytest.raises(InputError, match="must be"):
        observation.__post_init__()


# What controllers take in


def test_what_is_no_level_is_missing_and_nothing_else_changes():
    observation = heard(-60, 0, 31, 127, -128, 17, 121, -89, NAN, INF, -INF, -300, -60, -60, -60)
    found = checked_observation(observation, paper_scenario()).rssi_dbm[0]
    expected = [-60, *[NAN] * 6, -89, *[NAN] * 4, -60, -60, -60]
    np.testing.assert_array_equal(found[:, 0].numpy(), np.array(expected, dtype=np.float32))
    assert (found[:, 1:] == -50).all()


def test_a_window_with_levels_alone_is_the_same_object():
    """A deep fade and a missing sample are nothing wild."""
    observation = heard(-60, -140, NAN, -55)
    assert checked_observation(observation, paper_scenario()) is observation


@pytest.mark.parametrize(("wild_dbm", "most_db"), [(17.0, 0.0), (-5.0, 0.0), (-39.0, 0.0), (-40.5, 5.7)])
def test_one_wild_sample_in_fifty_cannot_move_a_window_far(wild_dbm, most_db):
    """+17 among -60 would be worth 60 dB of mean power."""
    observation = heard(*[-60] * 49, wild_dbm)
    power_dbm = mean_power_dbm(checked_observation(observation, paper_scenario()).rssi_dbm)[0, 0].item()
    assert -60 <= power_dbm <= -60 + most_db + 1e-4


@pytest.mark.parametrize("bad", [NAN, INF, -INF])
def test_a_position_that_is_no_number_is_refused(bad):
    observation = heard(-60, -61)
    observation.tracker_position_m[0, 1, 3, 2] = bad
    with pytest.raises(InputError, match="tracker_position_m must be finite"):
        checked_observation(observation, paper_scenario())
