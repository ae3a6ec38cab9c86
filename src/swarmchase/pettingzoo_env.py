"""The paper's four decisions as agents of PettingZoo's parallel API (extra: pettingzoo).

    from swarmchase.pettingzoo_env import parallel_env
    env = parallel_env(sampling_hz=10, spatial_correlation=0.9)

The paper trains a network for each of spacing, x, y and z (Section III.B), which all hear the same window and have a
reward each (Eqs. 7-8): that is what these four agents are. They decide together, and their chase ends for all at once.
"""

from typing import Any, SupportsIndex

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from .gym import ChaseEnv, WindowDbm
from .gym_registration import ENVIRONMENT_ID
from .scenario import Scenario

AGENTS = ("spacing", "x", "y", "z")
"""In the order d, x, y, z of Section III.A."""


class ChaseParallelEnv(ParallelEnv[str, WindowDbm, Any]):  # type: ignore[misc]  # it has no types
    """One chase, decided by four agents; worlds and rendering as of ``ChaseEnv``.

    Actions are choices 0..4, observations the RSSI window in dBm [sample, tracker], the same for all. Rewards are
    R^d, R^x, R^y, R^z; every agent's info is that of ``ChaseEnv``.
    """

    metadata = {**ChaseEnv.metadata, "name": ENVIRONMENT_ID, "is_parallelizable": True}  # noqa: RUF012

    def __init__(self, scenario: Scenario | None = None, render_mode: str | None = None, **changes: Any) -> None:
        self._chase = ChaseEnv(scenario, render_mode, **changes)
        self.scenario = self._chase.scenario
        self.render_mode = render_mode
        self.possible_agents = list(AGENTS)
        self.agents: list[str] = []
        choices = self._chase.action_space
        assert isinstance(choices, spaces.MultiDiscrete)
        self._action_spaces = {
            agent: spaces.Discrete(int(number)) for agent, number in zip(AGENTS, choices.nvec, strict=True)
        }
        self._observation_spaces = dict.fromkeys(AGENTS, self._chase.observation_space)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Of this agent; always the same object."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Of this agent; always the same object."""
        return self._action_spaces[agent]

    def reset(
        self, seed: SupportsIndex | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, WindowDbm], dict[str, dict[str, Any]]]:
        """As ``ChaseEnv.reset``; options that it does not know are passed over, as PettingZoo wants it."""
        known = {name: value for name, value in (options or {}).items() if name == "chase"}
        window_dbm, info = self._chase.reset(seed=seed, options=known)
        self.agents = list(AGENTS)
        return self._each(window_dbm), self._each(info)

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[dict[str, WindowDbm], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """One movement, of all four decisions.

        Raises:
            InputError: an action outside its space.
            gymnasium.error.ResetNeeded: the chase has ended, or never began.
        """
        choices = np.array([actions[agent] for agent in AGENTS])
        window_dbm, _, terminated, truncated, info = self._chase.step(choices)
        rewards = dict(zip(AGENTS, info["reward_m"].tolist(), strict=True))
        if terminated or truncated:
            self.agents = []
        return self._each(window_dbm), rewards, self._each(terminated), self._each(truncated), self._each(info)

    def render(self) -> NDArray[np.uint8] | None:
        """As ``ChaseEnv.render``."""
        return self._chase.render()

    def close(self) -> None:
        """As ``ChaseEnv.close``."""
        self._chase.close()

    @staticmethod
    def _each(value: Any) -> dict[str, Any]:
        return dict.fromkeys(AGENTS, value)


def parallel_env(**keywords: Any) -> ChaseParallelEnv:
    """The environment under the name that PettingZoo's environments have."""
    return ChaseParallelEnv(**keywords)
