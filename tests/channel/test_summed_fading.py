"""The spread of a sample's power where one transmitter is heard, or two: against the samples that the world plays."""

import dataclasses

import numpy as np
import pytest
import torch

from swarmchase.channel.fading import fading_db
from swarmchase.channel.fading_process import fading_process
from swarmchase.channel.summed_fading import LEAST_NP, STEP_NP, log_density
from swarmchase.scenario import load_scenario

FLIGHT = load_scenario("flight")


def levels_np(number: int) -> np.ndarray:
    return LEAST_NP + STEP_NP * np.arange(number)


@pytest.mark.parametrize("rician_k", [0.0, 1.0, 3.0, 25.0])
@pytest.mark.parametrize("weaker", [0.0, 0.005, 0.1, 1.0])
def test_it_is_a_density_whose_mean_is_what_both_transmit(rician_k: float, weaker: float) -> None:
    density = np.exp(log_density(rician_k, weaker))
    assert density.sum() * STEP_NP == pytest.approx(1.0, abs=2e-3)
    power = (density * np.exp(levels_np(len(density)))).sum() * STEP_NP
    assert power == pytest.approx(1.0 + weaker, rel=0.01)


@pytest.mark.parametrize("rician_k", [1.0, 3.0, 9.0])
@pytest.mark.parametrize("weaker", [0.0, 0.04, 0.25, 1.0])
def test_it_is_how_the_powers_are_spread_that_the_world_adds_up(rician_k: float, weaker: float) -> None:
    scenario = dataclasses.replace(FLIGHT, rician_k=rician_k)
    time_s = torch.arange(400, dtype=torch.float64)[None].repeat(20, 1) / scenario.sampling_hz
    moved_m = torch.full((20, 400, 6), 0.5, dtype=torch.float64)
    powers = []
    for seed in (1, 2):
        process = fading_process(scenario)
        fading, _ = process.gain(process.begin([(seed, chase) for chase in range(20)]), time_s, moved_m)
        powers.append(10 ** (fading_db(fading).double().numpy().ravel() / 10))
    played_np = np.sort(np.log(powers[0] + weaker * powers[1]))
    density = np.exp(log_density(rician_k, weaker))
    share = np.interp(played_np, levels_np(len(density)) + STEP_NP / 2, np.cumsum(density) * STEP_NP)
    # The greatest distance of the two distributions; of 48,000 samples of six trackers that fade alike 0.02 is much.
    assert np.abs(share - (np.arange(len(share)) + 0.5) / len(share)).max() < 0.02
