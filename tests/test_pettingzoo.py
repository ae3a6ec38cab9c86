"""The four decisions as agents: PettingZoo's own tests, and the same chase as the Gymnasium environment's."""

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

from swarmchase.gym import ChaseEnv
from swarmchase.pettingzoo_env import AGENTS, parallel_env

NEAR = {"start_distance_m": 6.0, "max_movements": 5, "success_radius_m": 3.0}


def test_passes_pettingzoo_s_own_tests() -> None:
    parallel_api_test(parallel_env(**NEAR), num_cycles=30)
    parallel_seed_test(lambda: parallel_env(**NEAR), num_cycles=10)


def test_it_is_the_gymnasium_environment_with_the_paper_s_four_rewards() -> None:
    four, one = parallel_env(**NEAR), ChaseEnv(**NEAR)
    windows_dbm, infos = four.reset(seed=5)
    window_dbm, info = one.reset(seed=5)
    generator, ended = np.random.default_rng(2), False
    while not ended:
        assert all(np.array_equal(windows_dbm[agent], window_dbm) for agent in AGENTS)
        assert all(infos[agent]["distance_m"] == info["distance_m"] for agent in AGENTS)
        choices = generator.integers(0, 5, 4)
        windows_dbm, rewards_m, terminated, truncated, infos = four.step(dict(zip(AGENTS, choices, strict=True)))
        window_dbm, reward_m, is_terminated, is_truncated, info = one.step(choices)
        assert list(rewards_m.values()) == info["reward_m"].tolist()
        assert rewards_m["spacing"] == reward_m
        assert set(terminated.values()) == {is_terminated}
        assert set(truncated.values()) == {is_truncated}
        ended = is_terminated or is_truncated
    assert four.agents == []
    with pytest.raises(Exception, match="call reset"):
        four.step(dict.fromkeys(AGENTS, 0))
