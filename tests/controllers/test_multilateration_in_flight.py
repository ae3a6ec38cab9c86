"""``multilateration`` in flight: without noise, against scipy's robust fit, and in flights."""

import dataclasses
import functools
import math

import numpy as np
import pytest
import torch
from scipy.linalg import sqrtm
from scipy.optimize import least_squares

from swarmchase.batch.selection import join_chases, pack, select_chases
from swarmchase.batch.streams import chase_keys
from swarmchase.channel.fading_law import fading_law
from swarmchase.controllers import load_controller, multilateration
from swarmchase.controllers.condition import Condition
from swarmchase.controllers.multilateration import CAUCHY_SCALE
from swarmchase.controllers.particle import POWER_SPREAD_DB
from swarmchase.evaluation.chases import run_chases
from swarmchase.formation import tracker_position_m
from swarmchase.observation import Observation
from swarmchase.scenario import load_scenario
from swarmchase.world.environment import Environment

FLIGHT = load_scenario("flight")
WAYPOINTS = dataclasses.replace(FLIGHT, behaviour="waypoints", target_speed_mps=5.0)
NAMES = ["multilateration", "multilateration-unknown-power"]
LAW = fading_law(dataclasses.replace(FLIGHT, window_samples=5, doppler_spread_hz=100.069))
"""Of a quarter of a second at 10 m/s: 3 GHz * 10 m/s / c = 100 Hz of Doppler."""


def interval(number, target_m, target_mps, swarm_mps, silent=False):
    """Half a second without fading but its median; target and swarm fly on evenly, the swarm from the origin."""
    time_s = 0.5 * number + (torch.arange(10) + 1).double() / 20
    center_m = time_s[:, None] * torch.tensor(swarm_mps, dtype=torch.float64)
    position_m = tracker_position_m(center_m, torch.full((10,), 5.0, dtype=torch.float64))
    there_m = torch.tensor(target_m).double() + time_s[:, None] * torch.tensor(target_mps).double()
    distance_m = (position_m - there_m[:, None]).norm(dim=2)
    rssi_dbm = 23 - 30 - 26 * distance_m.log10() + LAW.median_db
    rssi_dbm = torch.full_like(rssi_dbm, math.nan) if silent else rssi_dbm
    return Observation(rssi_dbm[None].float(), position_m[None], time_s[None])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("target_mps", [(0.0, 0.0, 0.0), (4.0, -3.0, 0.5), (-5.0, 0.0, 0.0)])
def test_it_finds_place_and_velocity_without_noise(monkeypatch, name, target_mps):
    """After 8 s, of a velocity of which nothing is known beforehand."""
    monkeypatch.setattr(multilateration, "VELOCITY_SPREAD_MPS", torch.full((3,), 1e3, dtype=torch.float64))
    controller = load_controller(name, FLIGHT)
    memory = controller.begin(1, 0)
    for number in range(16):
        _, memory = controller.decide(interval(number, (70.0, 40.0, -10.0), target_mps, (6.0, 5.0, 0.0)), memory)
    there_m = np.array([70.0, 40.0, -10.0]) + 8 * np.array(target_mps)
    assert memory.estimate[0, :3].numpy() == pytest.approx(there_m, abs=0.5)
    assert memory.estimate[0, 4:].numpy() == pytest.approx(target_mps, abs=0.5)
    assert memory.condition.tolist() == [Condition.TRACKING]


def test_of_what_it_heard_what_is_old_counts_less_and_what_is_near_fades_sooner():
    """3.5 t^1.5 / sqrt(3) metres after t s, times 11.29 dB over the distance: at 100 m and 4 s 1.83 dB."""
    controller = load_controller("multilateration", FLIGHT)
    told = {}
    for distance_m in (100.0, 20.0):
        memory = controller.begin(1, 0)
        for number in range(9):
            observation = interval(number, (distance_m, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
            _, memory = controller.decide(observation, memory)
        # The newest two are an eighth of a second old on average, less half a sample; 16 more are 4 s.
        assert memory.age_s[0, [0, 1, 16]].tolist() == pytest.approx([0.1, 0.35, 4.1])
        told[distance_m] = memory.trust[0, 16].item()
    for distance_m, trust in told.items():
        wandered_db = 3.5 * 4.1**1.5 / math.sqrt(3) * 26 / math.log(10) / distance_m
        assert trust == pytest.approx(1 / math.hypot(1, wandered_db / LAW.standard_deviation_db), rel=0.02)


@pytest.mark.parametrize(("name", "power_is_known", "chase"), [(NAMES[0], True, 0), (NAMES[1], False, 1)])
def test_it_is_the_robust_fit_of_scipy(name, power_is_known, chase):
    controller, environment = load_controller(name, WAYPOINTS), Environment(WAYPOINTS)
    state, memory = environment.reset(chase_keys(1, 1, chase)), controller.begin(1, 1, chase)
    whitened, now_s = [], 0.0
    whitener = np.linalg.inv(sqrtm((1 - LAW.correlation) * np.eye(6) + LAW.correlation)) / LAW.standard_deviation_db
    for _ in range(24):
        observation = state.observation()
        action, memory = controller.decide(observation, memory)
        state, _ = environment.step(state, action)
        for piece in (slice(0, 5), slice(5, 10)):
            power_dbm = 10 * np.log10((10 ** (observation.rssi_dbm[0, piece].double().numpy() / 10)).mean(axis=0))
            places_m = observation.tracker_position_m[0, piece].numpy().mean(axis=0)
            whitened.append((power_dbm, places_m, observation.time_s[0, piece].numpy().mean()))
        now_s = observation.time_s[0, -1].item()

    def residuals(unknown):
        parts = [unknown[3:6] / [4, 4, 1.6]]
        excess_db = 0 if power_is_known else unknown[6]
        for power_dbm, places_m, time_s in whitened:
            age_s = now_s - time_s
            distance_m = np.linalg.norm(unknown[:3] - unknown[3:6] * age_s - places_m, axis=1)
            expected_dbm = 23 + excess_db - 30 - 26 * np.log10(distance_m.clip(min=1)) + LAW.median_db
            told_m = 10 ** ((23 - 30 + LAW.median_db - power_dbm.mean()) / 26)
            wandered_db = 3.5 * age_s**1.5 / math.sqrt(3) * 26 / math.log(10) / told_m
            trust = 1 / math.hypot(1, wandered_db / LAW.standard_deviation_db)
            parts.append(trust * whitener @ (power_dbm - expected_dbm))
        return np.concatenate([*parts, [excess_db / POWER_SPREAD_DB]])

    def cost(unknown):
        return CAUCHY_SCALE**2 / 2 * np.log1p((residuals(unknown) / CAUCHY_SCALE) ** 2).sum()

    found = memory.estimate[0, [0, 1, 2, 4, 5, 6, 3]].numpy()
    fit = least_squares(residuals, found, loss="cauchy", f_scale=CAUCHY_SCALE, x_scale="jac", xtol=1e-12, ftol=1e-12)
    assert cost(found) <= fit.cost + 0.02
    # And from the truth there is no better fit.
    truth = np.concatenate([state.target_position_m[0].numpy(), state.target.velocity_mps[0].numpy(), [0.0]])
    other = least_squares(residuals, truth, loss="cauchy", f_scale=CAUCHY_SCALE, x_scale="jac")
    assert cost(found) <= other.cost + 0.1


def test_in_silence_it_flies_on_with_the_target_and_before_any_sound_it_holds_still():
    controller = load_controller("multilateration", FLIGHT)
    flight = functools.partial(
        interval, target_m=(60.0, 0.0, 0.0), target_mps=(0.0, 5.0, 0.0), swarm_mps=(5.0, 0.0, 0.0)
    )
    action, memory = controller.decide(flight(0, silent=True), controller.begin(1, 0))
    assert action.displacement_m.tolist() == [[0, 0, 0]]
    assert memory.condition.tolist() == [Condition.DEAF]
    for number in range(1, 17):
        _, memory = controller.decide(flight(number), memory)
    before = memory.estimate
    assert before[0, 4:].tolist() == pytest.approx([0, 4, 0], abs=1)
    action, memory = controller.decide(flight(17, silent=True), memory)
    assert memory.condition.tolist() == [Condition.DEAF]
    assert (memory.estimate - before)[0, :3].tolist() == pytest.approx((before[0, 4:] / 2).tolist(), abs=0.3)
    assert action.displacement_m.norm().item() == pytest.approx(5)


@pytest.mark.parametrize("name", NAMES)
def test_a_chase_is_the_same_alone_and_in_any_batch(name):
    controller, environment = load_controller(name, WAYPOINTS), Environment(WAYPOINTS)

    def flown(numbers):
        states = [environment.reset(chase_keys(1, 1, number)) for number in numbers]
        memories = [controller.begin(1, 1, number) for number in numbers]
        state, memory = functools.reduce(join_chases, states), functools.reduce(join_chases, memories)
        for _ in range(10):
            action, memory = controller.decide(state.observation(), memory)
            state, _ = environment.step(state, action)
        return memory

    together = flown([3, 0, 5])
    for row, number in enumerate([3, 0, 5]):
        alone, _ = pack(flown([number]), "memory")
        in_batch, _ = pack(select_chases(together, [row]), "memory")
        for part, tensor in alone.items():
            assert torch.equal(tensor.nan_to_num(nan=1e30), in_batch[part].nan_to_num(nan=1e30)), part


def test_it_reaches_a_target_that_flies():
    """Of 300 flights it reached all; one that takes the target to stand still reaches one in a hundred."""
    results = list(run_chases(WAYPOINTS, load_controller("multilateration", WAYPOINTS), 1, range(8)))
    assert all(result.reached for result in results)
    assert np.mean([result.capture_s for result in results]) < 45


@pytest.mark.parametrize("time_s", [None, [math.nan] * 10, [1e9, *[-1e9] * 9]])
def test_nothing_makes_it_nan(time_s):
    controller = load_controller("multilateration", FLIGHT)
    generator, memory = np.random.default_rng(5), controller.begin(1, 0)
    for number in range(8):
        observation = interval(number, (60.0, 0.0, 0.0), (0.0, 5.0, 0.0), (5.0, 0.0, 0.0))
        levels_dbm = torch.tensor(generator.choice([math.nan, 3e38, -400.0, 0.0, -60.0], size=(1, 10, 6))).float()
        times_s = None if time_s is None else torch.tensor([time_s], dtype=torch.float64)
        action, memory = controller.decide(Observation(levels_dbm, observation.tracker_position_m, times_s), memory)
        assert action.displacement_m.isfinite().all()
        assert memory.estimate.isfinite().all()
