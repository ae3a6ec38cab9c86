"""The flight benchmark: both worlds fly the same chases, and what is reported is what was measured."""

import numpy as np
import pytest
import torch
from rich.console import Console

from swarmchase.batch.streams import chase_keys
from swarmchase.benchmarks import flight as benchmark
from swarmchase.formation import Action, displacement_towards
from swarmchase.world.environment import Environment


@pytest.mark.parametrize("chase", [0, 3, 5])
def test_numpys_chase_is_ours(chase: int) -> None:
    """Until a target that flees has been at an end of its altitude band, and has been reached: every level and place.

    Fading is read in float64 there and in float32 here, which differs by more where it is deep.
    """
    scenario = benchmark.flight_scenario()
    environment = Environment(scenario)
    state = environment.reset(chase_keys(1, 1, chase))
    numpys = benchmark.NumpyChase(scenario, (1, chase))
    spacing_m = torch.tensor([5.0], dtype=torch.float64)
    levels_apart_db = []
    for _ in range(scenario.max_movements):
        levels_apart_db.append(np.abs(numpys.level_dbm - state.rssi_dbm[0].numpy()))
        np.testing.assert_allclose(numpys.target_m, state.target_position_m[0], atol=1e-6)
        np.testing.assert_allclose(numpys.center_m, state.center_m[0], atol=1e-6)
        if state.reached_s.isfinite():
            break
        displacement_m = displacement_towards(scenario, state.target_position_m - state.center_m)
        state, _ = environment.step(state, Action(spacing_m, displacement_m))
        numpys.step(displacement_m[0].numpy(), 5.0)
    assert numpys.reached_s == pytest.approx(state.reached_s.item())
    apart_db = np.concatenate(levels_apart_db)
    assert np.median(apart_db) < 0.001
    assert np.quantile(apart_db, 0.99) < 0.02


def test_the_result_says_what_was_measured() -> None:
    result = benchmark.measure(repeats=1, batch=4, flights=1, decisions=6)
    rates = result["chase_s_per_s"]
    # One turn: four of ours in the time of four, one of numpy's.
    assert result["ratio_to_numpy"] == pytest.approx(rates["swarmchase"] / rates["numpy"])
    for behaviour, rate in result["particle_flights_per_s"].items():
        assert result["minutes_of_10000_flights_on_two_cores"][behaviour] == pytest.approx(10_000 / rate / 120)
    console = Console(record=True, width=120)
    console.print(benchmark.table(result))
    shown = console.export_text()
    assert f"{rates['numpy']:,.0f}" in shown
    assert "flights of particle, jink" in shown
