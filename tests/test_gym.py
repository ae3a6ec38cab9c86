"""The Gymnasium environments: the interface's own checkers, seeds, bounds, and one lane against many."""

import dataclasses
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.env_checker import check_env as check_env_for_stable_baselines3

from swarmchase.channel.fading import DEEPEST_FADE_DB
from swarmchase.errors import InputError
from swarmchase.formation import action_from_choice
from swarmchase.gym import ENVIRONMENT_ID, ChaseEnv, ChaseVectorEnv, rssi_bounds_dbm
from swarmchase.scenario import load_scenario, paper_scenario
from swarmchase.world.environment import Environment
from swarmchase.world.radio import rssi_dbm

STAY = np.array([4, 2, 2, 2])
"""Spacing 5 m, no movement."""


def near(**changes):
    """A world whose chases end soon, both ways: the target 6 m away and at most five movements."""
    return {"start_distance_m": 6.0, "max_movements": 5, "success_radius_m": 3.0, **changes}


def run_python(program):
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()


def test_gymnasium_finds_the_chase_by_module_and_name_in_a_fresh_interpreter():
    program = (
        "import gymnasium; env = gymnasium.make('swarmchase.gym:swarmchase/Chase-v0', sampling_hz=50);"
        "print(env.unwrapped.scenario.sampling_hz, env.reset(seed=1)[0].shape[0])"
    )
    assert run_python(program) == ["50.0", "50"]


def test_registration_imports_nothing_heavy_until_make():
    program = (
        "import sys, gymnasium, swarmchase.gym_registration as registration;"
        "print('torch' in sys.modules, 'swarmchase.gym' in sys.modules);"
        "print(registration.ENVIRONMENT_ID in gymnasium.registry);"
        "gymnasium.make('swarmchase/Chase-v0'); print('torch' in sys.modules)"
    )
    assert run_python(program) == ["False", "False", "True", "True"]


def test_passes_gymnasium_checker_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(ENVIRONMENT_ID, **near(max_movements=500)).unwrapped)


def test_a_chase_in_flight_passes_gymnasiums_checker():
    """Ten samples a decision; the target flees."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        changes = {"scenario": load_scenario("flight"), "behaviour": "flee", **near(farthest_start_m=9.0)}
        check_env(gymnasium.make(ENVIRONMENT_ID, **changes).unwrapped)
        envs = ChaseVectorEnv(3, **changes)
    windows_dbm, _ = envs.reset(seed=2)
    assert windows_dbm.shape == (3, 10, 6)
    for _ in range(8):  # some end by then, and others begin in their place
        windows_dbm, _, _, _, _ = envs.step(np.full((3, 4), 4))
        assert envs.observation_space.contains(windows_dbm)


# An RSSI window is [sample, tracker] and is not flattened for anybody's taste: Stable-Baselines3 flattens it itself.
@pytest.mark.filterwarnings("ignore:Your observation  has an unconventional shape:UserWarning:stable_baselines3")
@pytest.mark.parametrize("changes", [{}, near()], ids=["paper", "chases end within the check"])
def test_passes_stable_baselines3_checker(changes):
    check_env_for_stable_baselines3(ChaseEnv(**changes))


def test_reward_info_and_observation_are_those_of_the_environment():
    environment = Environment(paper_scenario())
    state = environment.reset([(11, 0)])
    env = ChaseEnv()
    window_dbm, info = env.reset(seed=11)
    assert np.array_equal(window_dbm, state.rssi_dbm[0])
    assert info["movements"] == 0
    assert info["distance_m"] == pytest.approx(100, abs=1e-9)
    for movement, choice in enumerate([[0, 0, 1, 2], [3, 4, 3, 2]], start=1):
        state, outcome = environment.step(state, action_from_choice(environment.scenario, torch.tensor([choice])))
        window_dbm, reward, terminated, truncated, info = env.step(np.array(choice))
        assert np.array_equal(window_dbm, state.rssi_dbm[0])
        assert np.array_equal(info["reward_m"], outcome.reward_m[0])
        assert reward == outcome.reward_m[0, 0]
        assert (terminated, truncated, info["movements"]) == (False, False, movement)
        assert info["distance_m"] == pytest.approx(float((state.center_m - state.target_position_m).norm()))


def test_reached_is_termination_and_spent_movements_are_truncation():
    # 2.5 m away and a success radius of 3 m: the first movement, to nowhere, reaches it. At 6 m none does.
    env = ChaseEnv(**near(start_distance_m=2.5))
    env.reset(seed=0)
    assert env.step(STAY)[2:4] == (True, False)
    env = ChaseEnv(**near(max_movements=2))
    env.reset(seed=0)
    assert env.step(STAY)[2:4] == (False, False)
    assert env.step(STAY)[2:4] == (False, True)


def test_resets_without_a_seed_walk_through_the_run():
    environment = Environment(paper_scenario())
    env = ChaseEnv()
    heard = [env.reset(seed=5)[0], env.reset()[0], env.reset()[0], env.reset(seed=5)[0]]
    for window_dbm, chase in zip(heard, [0, 1, 2, 0], strict=True):
        assert np.array_equal(window_dbm, environment.reset([(5, chase)]).rssi_dbm[0])


def test_a_fresh_environment_without_a_seed_draws_its_run_from_np_random():
    first, second, third = ChaseEnv(), ChaseEnv(), ChaseEnv()
    first.np_random = np.random.default_rng(8)
    second.np_random = np.random.default_rng(8)
    window_dbm = first.reset()[0]
    assert np.array_equal(window_dbm, second.reset()[0])
    assert not np.array_equal(window_dbm, third.reset()[0])


@pytest.mark.parametrize(
    "action",
    [[5, 0, 0, 0], [-1, 0, 0, 0], [0, 0, 0], [0.0, 0.0, 0.0, 0.0], [[0, 0, 0, 0]]],
    ids=["too high", "negative", "three", "not whole", "batched"],
)
def test_refuses_actions_outside_the_space(action):
    env, lanes = ChaseEnv(), ChaseVectorEnv(num_envs=2)
    env.reset(seed=0)
    lanes.reset(seed=0)
    with pytest.raises(InputError, match="refused"):
        env.step(np.array(action))
    with pytest.raises(InputError, match="refused"):
        lanes.step(np.array([action, action]))


def test_refuses_to_step_where_no_chase_is_under_way():
    env, lanes = ChaseEnv(**near(max_movements=1)), ChaseVectorEnv(num_envs=2)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(STAY)
    with pytest.raises(gymnasium.error.ResetNeeded):
        lanes.step(np.array([STAY, STAY]))
    env.reset(seed=0)
    env.step(STAY)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(STAY)


def test_refuses_bad_arguments():
    with pytest.raises(InputError, match="sampling_herz"):
        ChaseEnv(sampling_herz=10)
    with pytest.raises(InputError, match="num_envs"):
        ChaseVectorEnv(num_envs=0)
    lanes = ChaseVectorEnv(num_envs=2)
    with pytest.raises(InputError, match="3 seeds"):
        lanes.reset(seed=[1, 2, 3])
    with pytest.raises(InputError, match="seed = -1"):
        lanes.reset(seed=[-1, 2])
    with pytest.raises(InputError, match="reset_mask"):
        lanes.reset(options={"reset_mask": np.array([True, False])})


def test_keywords_change_the_given_scenario_and_keep_the_rest():
    env = ChaseEnv(paper_scenario(rician_k=7.0, sampling_hz=20), sampling_hz=50)
    assert env.scenario == paper_scenario(rician_k=7.0, sampling_hz=50)


def test_bounds_hold_the_weakest_and_the_strongest_a_chase_can_hear():
    # Pencil: 500 movements of 4 sqrt(3) m away from the target and 5 m of spacing; 10 n = 26 dB a decade, L_0 = 30 dB.
    scenario = paper_scenario()
    farthest_m = 100 + 500 * 4 * 3**0.5 + 5
    low_dbm, high_dbm = rssi_bounds_dbm(scenario)
    assert low_dbm == pytest.approx(23 - 30 - 26 * np.log10(farthest_m) - 200, abs=1e-4)
    assert high_dbm == pytest.approx(23 - 30 + 20)
    silence = torch.zeros(1, 6, 2, scenario.window_samples)
    weakest_dbm = rssi_dbm(scenario, torch.full((1, 1, 6), farthest_m, dtype=torch.float64), silence)
    assert float(weakest_dbm.min()) == pytest.approx(low_dbm, abs=1e-3)
    assert low_dbm - DEEPEST_FADE_DB < float(rssi_dbm(scenario, torch.full((1, 1, 6), 1000.0), silence + 1).min())


def test_a_target_that_flies_may_be_farther_when_the_chase_ends():
    """60 to 300 m at the start, then apart at 2.8 sqrt(3) m a decision and 5 m/s; 120 s, with the first interval."""
    scenario = load_scenario("flight")
    flees = dataclasses.replace(scenario, behaviour="flee")
    for world, flown_m in ((scenario, 0), (flees, 5 * 120)):
        farthest_m = 300 + 239 * 2.8 * 3**0.5 + 5 + flown_m
        assert rssi_bounds_dbm(world)[0] == pytest.approx(23 - 30 - 26 * np.log10(farthest_m) - 200, abs=1e-4)


def test_what_exceeds_the_bounds_is_clipped(monkeypatch):
    def loud_then_silent(self, state, time_s, moved_m=None):
        fading = torch.zeros(len(time_s), 6, 2, 50)
        fading[..., 0] = 1e30
        fading[..., 1] = 1e-30
        return fading, state

    monkeypatch.setattr("swarmchase.channel.drawn_windows.DrawnWindows.gain", loud_then_silent)
    env = ChaseEnv(path_loss_exponent=8.0)
    window_dbm, _ = env.reset(seed=0)
    assert window_dbm in env.observation_space
    assert (window_dbm[0] == env.observation_space.high[0]).all()
    assert (window_dbm[1] < -200).all()


def walk(env, num_steps, seed):
    """Everything a walk through random actions returns."""
    generator = np.random.default_rng(3)
    trace = [env.reset(seed=seed)]
    for _ in range(num_steps):
        trace.append(env.step(generator.integers(0, 5, size=(env.num_envs, 4))))
    return trace


@pytest.mark.parametrize(
    "changes", [{}, {"continuity": "continuous", "los_phase": "independent"}], ids=["paper", "running"]
)
@pytest.mark.parametrize("seed", [21, [4, 9, 2, 2]], ids=["one seed", "list of seeds"])
def test_vector_environment_equals_gymnasium_vectorising_single_ones(changes, seed):
    worlds = near(**changes)
    batched = gymnasium.make_vec(ENVIRONMENT_ID, num_envs=4, vectorization_mode="vector_entry_point", **worlds)
    looped = gymnasium.make_vec(ENVIRONMENT_ID, num_envs=4, vectorization_mode="sync", **worlds)
    assert isinstance(batched.unwrapped, ChaseVectorEnv)
    assert batched.metadata["autoreset_mode"] == looped.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    assert (batched.action_space, batched.observation_space) == (looped.action_space, looped.observation_space)
    batched_trace, looped_trace = walk(batched, 40, seed), walk(looped, 40, seed)
    for one, other in zip(batched_trace, looped_trace, strict=True):
        assert data_equivalence(one, other, exact=True)
    # The walk passed through both ends, so the agreement includes what follows them.
    assert any(step[2].any() for step in batched_trace[1:])
    assert any(step[3].any() for step in batched_trace[1:])
    # Without a seed every lane goes on with its own run.
    assert data_equivalence(batched.reset(), looped.reset(), exact=True)


def test_vector_environment_starts_all_lanes_anew_at_once():
    worlds = {"num_envs": 3, **near(max_movements=1, start_distance_m=50.0)}
    batched = ChaseVectorEnv(**worlds)
    looped = gymnasium.make_vec(ENVIRONMENT_ID, vectorization_mode="sync", **worlds)
    for one, other in zip(walk(batched, 5, 0), walk(looped, 5, 0), strict=True):
        assert data_equivalence(one, other, exact=True)


def test_lanes_without_seeds_play_different_runs():
    lanes = ChaseVectorEnv(num_envs=3)
    windows_dbm, _ = lanes.reset()
    assert not np.array_equal(windows_dbm[0], windows_dbm[1])
    assert not np.array_equal(windows_dbm[1], windows_dbm[2])


def test_returned_arrays_are_the_callers_own():
    lanes = ChaseVectorEnv(num_envs=2)
    lanes.reset(seed=0)
    actions = np.array([STAY, STAY])
    windows_dbm, rewards_m, terminated, truncated, info = lanes.step(actions)
    for array in (windows_dbm, rewards_m, terminated, truncated, *info.values()):
        array[...] = 1
    other = ChaseVectorEnv(num_envs=2)
    other.reset(seed=0)
    other.step(actions)
    assert data_equivalence(lanes.step(actions), other.step(actions), exact=True)
