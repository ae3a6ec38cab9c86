"""The Gymnasium environments: the interface's own checkers, seeds, bounds, and one lane against many."""

import dataclasses
import subprocess
import sys
import warnings

import gymnasium
import matplotlib.pyplot
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_env_for_stable_baselines3
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

import window_backend
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
        # Without the check of rendering, which opens a window: below it is looked at.
        check_env(gymnasium.make(ENVIRONMENT_ID, **near(max_movements=500)).unwrapped, skip_render_check=True)


def test_a_chase_in_flight_passes_gymnasiums_checker():
    """Ten samples a decision; the target flees."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        changes = {"scenario": load_scenario("flight"), "behaviour": "flee", **near(farthest_start_m=9.0)}
        check_env(gymnasium.make(ENVIRONMENT_ID, **changes).unwrapped, skip_render_check=True)
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
        lanes.reset(options={"reset_mask": [True, False]})
    with pytest.raises(InputError, match="resets no lane"):
        lanes.reset(options={"reset_mask": np.array([False, False])})
    with pytest.raises(InputError, match="'chas'"):
        ChaseEnv().reset(seed=1, options={"chas": 3})
    with pytest.raises(InputError, match="'chase'"):
        ChaseEnv().reset(seed=1, options={"chase": -3})
    with pytest.raises(InputError, match="'ansi' is refused: allowed is None or rgb_array or human"):
        ChaseEnv(render_mode="ansi")


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
    """Everything a walk through random actions returns; lanes that wait for it are reset."""
    generator = np.random.default_rng(3)
    trace = [env.reset(seed=seed)]
    for _ in range(num_steps):
        trace.append(env.step(generator.integers(0, 5, size=(env.num_envs, 4))))
        ended = trace[-1][2] | trace[-1][3]
        if env.metadata["autoreset_mode"] == AutoresetMode.DISABLED and ended.any():
            trace.append((*env.reset(options={"reset_mask": ended}), ended, ended))
    return trace


@pytest.mark.parametrize(
    "changes", [{}, {"continuity": "continuous", "los_phase": "independent"}], ids=["paper", "running"]
)
@pytest.mark.parametrize("seed", [21, [4, 9, 2, 2]], ids=["one seed", "list of seeds"])
@pytest.mark.parametrize("mode", AutoresetMode)
def test_vector_environment_equals_gymnasium_vectorising_single_ones(changes, seed, mode):
    worlds = {"num_envs": 4, **near(**changes)}
    batched = gymnasium.make_vec(ENVIRONMENT_ID, vectorization_mode="vector_entry_point", autoreset_mode=mode, **worlds)
    looped = gymnasium.make_vec(
        ENVIRONMENT_ID, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **worlds
    )
    assert isinstance(batched.unwrapped, ChaseVectorEnv)
    assert batched.metadata["autoreset_mode"] == looped.metadata["autoreset_mode"] == mode
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


def test_numpy_s_whole_numbers_are_seeds():
    for seed in (np.int64(5), np.uint8(5)):
        assert data_equivalence(ChaseEnv().reset(seed=seed), ChaseEnv().reset(seed=5), exact=True)
        many = ChaseVectorEnv(2).reset(seed=5)
        assert data_equivalence(ChaseVectorEnv(2).reset(seed=seed), many, exact=True)
        assert data_equivalence(ChaseVectorEnv(2).reset(seed=np.array([5, 6])), many, exact=True)


def test_options_ask_for_a_chase_of_the_run():
    env, asked = ChaseEnv(), ChaseEnv()
    env.reset(seed=3)
    second = env.reset()
    assert data_equivalence(asked.reset(seed=3, options={"chase": 1}), second, exact=True)
    assert data_equivalence(asked.reset(), env.reset(), exact=True)  # and the run goes on behind it


def test_a_missing_sample_has_the_lowest_level_of_the_space():
    env = ChaseEnv(missing_sample_share=0.5, silent_trackers=1)
    window_dbm, _ = env.reset(seed=1)
    assert window_dbm in env.observation_space
    is_missing = window_dbm == env.observation_space.low
    assert is_missing.all(axis=0).sum() == 1
    assert 0.4 < is_missing.mean() < 0.8


# --- pictures --------------------------------------------------------------------------------------------------------


def test_a_picture_shows_the_way_so_far_and_each_lane_its_own():
    lanes = ChaseVectorEnv(2, render_mode="rgb_array", **near(start_distance_m=60.0, max_movements=50))
    with pytest.raises(gymnasium.error.ResetNeeded):
        lanes.render()
    lanes.reset(seed=1)
    before = lanes.render()
    lanes.step(np.array([[4, 4, 4, 4], STAY]))
    after = lanes.render()
    assert [picture.shape for picture in after] == [(600, 480, 3)] * 2
    assert all(picture.dtype == np.uint8 for picture in after)
    assert (after[0] != before[0]).any()
    assert (after[0] != after[1]).any()
    lanes.reset(seed=1)
    assert np.array_equal(lanes.render()[0], before[0])  # another chase begins on an empty page
    assert ChaseVectorEnv(1).render() is None
    assert ChaseEnv().render() is None


def test_without_a_screen_a_window_is_refused():
    env = gymnasium.make(ENVIRONMENT_ID, render_mode="human", **near())
    with pytest.raises(InputError, match="there is no screen; rgb_array needs none"):
        env.reset(seed=1)


def test_a_window_follows_the_chase_by_itself(monkeypatch):
    matplotlib.pyplot.switch_backend("module://window_backend")
    try:
        env = gymnasium.make(ENVIRONMENT_ID, render_mode="human", **near())
        env.reset(seed=1)
        env.step(STAY)
        assert window_backend.SHOWN == ["shown", "drawn", "drawn"]
        env.close()
        assert not matplotlib.pyplot.get_fignums()
    finally:
        matplotlib.pyplot.switch_backend("agg")


# --- by its name, as others use it -----------------------------------------------------------------------------------

NAME = "swarmchase.gym:swarmchase/Chase-v0"


def test_gymnasium_s_wrappers_take_it_by_its_name():
    env = gymnasium.make(NAME, max_episode_steps=3, **near(start_distance_m=60.0, max_movements=50))
    env = gymnasium.wrappers.RecordEpisodeStatistics(env)
    env.reset(seed=1)
    *_, info = [env.step(STAY) for _ in range(3)][-1]
    assert info["episode"]["l"] == 3
    assert env.spec.max_episode_steps == 3


def test_a_film_is_recorded(tmp_path):
    pytest.importorskip("moviepy", reason="moviepy is not installed: pip install moviepy")
    films = tmp_path / "films"
    env = gymnasium.wrappers.RecordVideo(gymnasium.make(NAME, render_mode="rgb_array", **near()), str(films))
    env.reset(seed=1)
    while not any(env.step(STAY)[2:4]):
        pass
    env.close()
    assert [path.suffix for path in films.iterdir()] == [".mp4"]


@pytest.mark.parametrize("vec_env_cls", [DummyVecEnv, SubprocVecEnv])
def test_stable_baselines3_makes_many_by_its_name(vec_env_cls):
    envs = make_vec_env(NAME, n_envs=2, seed=1, env_kwargs=near(), vec_env_cls=vec_env_cls)
    try:
        assert envs.reset().shape == (2, 50, 6)
        for _ in range(6):
            windows_dbm, _, _, _ = envs.step(np.array([STAY, STAY]))
        assert windows_dbm.shape == (2, 50, 6)
    finally:
        envs.close()


def test_stable_baselines3_learns_from_it_by_its_name():
    model = PPO("MlpPolicy", NAME, n_steps=8, batch_size=8, n_epochs=1, seed=1, device="cpu")
    model.learn(8)
    action, _ = model.predict(ChaseEnv().reset(seed=1)[0])
    assert action in ChaseEnv().action_space
