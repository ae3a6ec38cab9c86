"""The same chases and the same training on a GPU. Skipped where PyTorch sees none."""

import dataclasses
from pathlib import Path

import pytest
import torch

from swarmchase.batch.streams import chase_keys
from swarmchase.formation import action_from_choice
from swarmchase.networks.weights import load_weights
from swarmchase.scenario import paper_scenario
from swarmchase.training.batched import train_batched
from swarmchase.training.settings import PRESETS
from swarmchase.world.environment import Environment

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="PyTorch sees no GPU")

ROUNDING_DB = 1e-3
"""Sines, logarithms and products of another processor, in float32."""


@pytest.mark.parametrize(("sampling_hz", "spatial_correlation"), [(10, 0.1), (10, 0.9), (100, 0.1), (100, 0.9)])
def test_chases_are_the_same(sampling_hz: float, spatial_correlation: float) -> None:
    scenario = paper_scenario(sampling_hz=sampling_hz, spatial_correlation=spatial_correlation)
    keys, generator = chase_keys(1, 256), torch.Generator().manual_seed(2)
    on_cpu, on_gpu = Environment(scenario), Environment(scenario, "cuda")
    cpu, gpu = on_cpu.reset(keys), on_gpu.reset(keys)
    for _ in range(15):
        choice = torch.randint(0, 5, (256, 4), generator=generator)
        cpu, cpu_outcome = on_cpu.step(cpu, action_from_choice(scenario, choice))
        gpu, gpu_outcome = on_gpu.step(gpu, action_from_choice(scenario, choice.cuda()))
        assert (cpu.rssi_dbm - gpu.rssi_dbm.cpu()).abs().max() < ROUNDING_DB
        assert torch.equal(cpu_outcome.reached, gpu_outcome.reached.cpu())


@pytest.mark.parametrize("preset", sorted(PRESETS.keys() - {"paper", "fast"}))
def test_two_updates_give_almost_the_same_weights(preset: str, tmp_path: Path) -> None:
    """Adam makes a whole step of a gradient that is next to nothing, whatever its sign: hence not the same to the last
    bit.
    """
    settings = dataclasses.replace(
        PRESETS[preset], max_updates=2, chases_per_agent=16, evaluation_interval=10, evaluation_chases=1
    )
    weights = []
    for device in ("cpu", "cuda"):
        folder = tmp_path / device
        result = train_batched([paper_scenario(max_movements=20)], settings, folder, device=device)
        networks = load_weights(result.weights)[0]
        weights.append(torch.cat([parameter.detach().double().flatten() for parameter in networks.parameters()]))
    assert (weights[0] - weights[1]).norm() / weights[0].norm() < 0.005
