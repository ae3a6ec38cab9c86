"""The chase as Gymnasium environments, one chase or many side by side.

    gymnasium.make("swarmchase.gym:swarmchase/Chase-v0", sampling_hz=10, spatial_correlation=0.9)
    gymnasium.make_vec("swarmchase.gym:swarmchase/Chase-v0", num_envs=64)

Actions are four choices 0..4 in the order d, x, y, z (Section III.A), observations the RSSI window in dBm (Eq. 6). The
reward is one number, R^d; the paper's four rewards (Eqs. 7-8) are in ``info["reward_m"]``.
"""

import math
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from .batch.selection import join_chases, select_chases
from .batch.streams import ChaseKey, chase_keys
from .channel.fading import DEEPEST_FADE_DB
from .channel.propagation import reference_dbm, unfaded_dbm
from .errors import InputError
from .formation import Action, action_from_choice
from .gym_registration import ENVIRONMENT_ID
from .ranges import AT_LEAST_ONE, checked_number
from .scenario import NUM_TRACKERS, Scenario
from .world.environment import Environment, Outcome, State, distance_to_target_m

__all__ = ["ENVIRONMENT_ID", "ChaseEnv", "ChaseVectorEnv"]

FADING_PEAK_HEADROOM_DB = 20.0
"""Room for fading above its mean power: |h|^2 > 100 is rarer than 1e-43 a sample for any K. It would be clipped."""

WindowDbm = NDArray[np.float32]
Choices = NDArray[Any]
"""Whole numbers of any width; the action space refuses all else."""


def rssi_bounds_dbm(scenario: Scenario) -> tuple[float, float]:
    """Lowest and highest RSSI: the deepest fade at the farthest a chase can get, a peak at the reference distance."""
    farthest_step_m = math.sqrt(3) * max(abs(choice_m) for choice_m in scenario.displacement_choices_m)
    widest_spacing_m = max(scenario.initial_spacing_m, *scenario.spacing_choices_m)
    movement_s = scenario.decision_s
    if scenario.pace == "stop_and_listen":
        movement_s = scenario.window_s + farthest_step_m / scenario.tracker_speed_mps
    # Each in the opposite direction, as long as a chase may last, and the window before it.
    farthest_m = scenario.farthest_start_m or scenario.start_distance_m
    farthest_m += scenario.max_movements * farthest_step_m + widest_spacing_m
    if scenario.behaviour != "hover":
        farthest_m += (scenario.max_movements + 1) * movement_s * scenario.target_speed_mps
    weakest_dbm = float(unfaded_dbm(scenario, torch.tensor(farthest_m)))
    strongest_dbm = reference_dbm(scenario)
    return weakest_dbm + DEEPEST_FADE_DB, strongest_dbm + FADING_PEAK_HEADROOM_DB


def _observation_space(scenario: Scenario) -> "spaces.Box[np.float32]":
    low_dbm, high_dbm = rssi_bounds_dbm(scenario)
    return spaces.Box(low_dbm, high_dbm, (scenario.samples_a_decision, NUM_TRACKERS), np.float32)


def _action_space(scenario: Scenario) -> spaces.MultiDiscrete:
    return spaces.MultiDiscrete([len(scenario.spacing_choices_m)] + 3 * [len(scenario.displacement_choices_m)])


class _Lanes:
    """Chases side by side. Each lane plays one run: its chase 0, and at every later start the next."""

    def __init__(self, scenario: Scenario | None, changes: dict[str, Any], num_lanes: int) -> None:
        self.scenario = Scenario.from_dict({**(scenario or Scenario()).to_dict(), **changes})
        self.action_space = _action_space(self.scenario)
        self.observation_space = _observation_space(self.scenario)
        self._batched_action_space = batch_space(self.action_space, num_lanes)
        self._environment = Environment(self.scenario)
        self._next_key: dict[int, ChaseKey] = {}
        self._state: State | None = None
        self.ended = np.ones(num_lanes, dtype=bool)
        """Lanes with no chase under way."""

    def reset(self, seeds: Sequence[int | None], np_random: np.random.Generator) -> None:
        """Start a chase in every lane: chase 0 of the run ``seed``, or, where that is None, the next of its run."""
        for lane, seed in enumerate(seeds):
            if seed is not None:
                self._next_key[lane] = chase_keys(seed, 1)[0]
            elif lane not in self._next_key:
                self._next_key[lane] = chase_keys(int(np_random.integers(2**63)), 1)[0]
        self._state = self._environment.reset(self._take_keys(range(len(seeds))))
        self.ended = np.zeros_like(self.ended)

    def step(self, choices: Choices) -> Outcome:
        """Move the lanes whose chase is under way; the outcome is theirs. The others start their next chase."""
        state, action = self._started, self._action(choices)
        if self.ended.any():
            moved_lanes, started_lanes = np.flatnonzero(~self.ended).tolist(), np.flatnonzero(self.ended).tolist()
            started = self._environment.reset(self._take_keys(started_lanes))
            moved, outcome = self._environment.step(
                select_chases(state, moved_lanes), select_chases(action, moved_lanes)
            )
            self._state = select_chases(join_chases(moved, started), np.argsort(moved_lanes + started_lanes).tolist())
        else:
            moved_lanes = list(range(len(self.ended)))
            self._state, outcome = self._environment.step(state, action)
        self.ended = np.zeros_like(self.ended)
        self.ended[moved_lanes] = (outcome.reached | outcome.truncated).numpy()
        return outcome

    def window_dbm(self) -> WindowDbm:
        """What every lane hears, within the bounds of the observation space."""
        low_dbm, high_dbm = self.observation_space.low[0, 0], self.observation_space.high[0, 0]
        clipped: WindowDbm = np.clip(self._started.rssi_dbm.numpy(), low_dbm, high_dbm, order="C")
        return clipped

    def distance_m(self) -> NDArray[np.float64]:
        """Distance of each lane's centre from its target."""
        return distance_to_target_m(self._started).numpy()

    def movements(self) -> NDArray[np.int64]:
        """Movements each lane has made in its chase."""
        return self._started.movements.numpy().copy()

    @property
    def _started(self) -> State:
        if self._state is None:
            raise gymnasium.error.ResetNeeded("no chase has begun: call reset() before step()")
        return self._state

    def _action(self, choices: Choices) -> Action:
        if not self._batched_action_space.contains(choices):
            raise InputError(
                f"actions of shape {choices.shape} and type {choices.dtype} are refused: each of "
                f"{len(self.ended)} must be in {self.action_space}"
            )
        return action_from_choice(self.scenario, torch.from_numpy(choices.astype(np.int64)))

    def _take_keys(self, lanes: Sequence[int]) -> list[ChaseKey]:
        keys = [self._next_key[lane] for lane in lanes]
        self._next_key.update({lane: (seed, chase + 1) for lane, (seed, chase) in zip(lanes, keys, strict=True)})
        return keys


class ChaseEnv(gymnasium.Env[WindowDbm, Choices]):
    """One chase. Reaching the target is termination, MAX_STEPS movements without it truncation.

    Args:
        scenario: the world; Table I without it.
        changes: any field of ``Scenario`` by keyword, on top of it.

    ``info`` holds ``distance_m``, ``movements`` and, after a movement, ``reward_m`` (R^d, R^x, R^y, R^z).
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium wants it so)

    def __init__(self, scenario: Scenario | None = None, **changes: Any) -> None:
        self._lanes = _Lanes(scenario, changes, num_lanes=1)
        self.scenario = self._lanes.scenario
        self.action_space = self._lanes.action_space
        self.observation_space = self._lanes.observation_space

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[WindowDbm, dict[str, Any]]:
        """Start chase 0 of the run ``seed``; without a seed the next chase of the run, or a run drawn at random."""
        super().reset(seed=seed)
        self._lanes.reset([seed], self.np_random)
        return self._lanes.window_dbm()[0], self._info()

    def step(self, action: Choices) -> tuple[WindowDbm, float, bool, bool, dict[str, Any]]:
        """One movement.

        Raises:
            InputError: an action outside the action space.
            gymnasium.error.ResetNeeded: the chase has ended, or never began.
        """
        if self._lanes.ended[0]:
            raise gymnasium.error.ResetNeeded("no chase is under way: call reset() before step()")
        outcome = self._lanes.step(np.asarray(action)[None])
        info = {**self._info(), "reward_m": outcome.reward_m[0].numpy()}
        reward = float(outcome.reward_m[0, 0])
        return self._lanes.window_dbm()[0], reward, bool(outcome.reached), bool(outcome.truncated), info

    def _info(self) -> dict[str, Any]:
        return {"distance_m": float(self._lanes.distance_m()[0]), "movements": int(self._lanes.movements()[0])}


class ChaseVectorEnv(gymnasium.vector.VectorEnv[WindowDbm, Choices, NDArray[Any]]):
    """Many chases in one batch, number by number what ``num_envs`` single ``ChaseEnv`` are.

    Its autoreset mode is ``AutoresetMode.NEXT_STEP``, Gymnasium's default: the step that ends a chase returns its last
    observation, and the step after it ignores the action, starts the lane's next chase and gives reward 0.

    Args:
        num_envs: number of chases side by side.
        scenario: the world; Table I without it.
        changes: any field of ``Scenario`` by keyword, on top of it.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 (Gymnasium wants it so)

    def __init__(self, num_envs: int = 1, scenario: Scenario | None = None, **changes: Any) -> None:
        checked_number("num_envs", num_envs, AT_LEAST_ONE)
        self._lanes = _Lanes(scenario, changes, num_envs)
        self.num_envs = num_envs
        self.scenario = self._lanes.scenario
        self.single_action_space = self._lanes.action_space
        self.single_observation_space = self._lanes.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[WindowDbm, dict[str, Any]]:
        """Start a chase in every lane: lane i plays the run ``seed + i``, or ``seed[i]``; None goes on with its run.

        Raises:
            InputError: another number of seeds than lanes, or a ``reset_mask`` (no lane resets alone but by itself).
        """
        if options and "reset_mask" in options:
            raise InputError("options['reset_mask'] is refused: lanes are reset all at once, or by themselves")
        if seed is None or isinstance(seed, int):
            super().reset(seed=seed)
            seeds = [None if seed is None else seed + lane for lane in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise InputError(f"{len(seeds)} seeds are refused: allowed is one for each of {self.num_envs} lanes")
        self._lanes.reset(seeds, self.np_random)
        return self._lanes.window_dbm(), self._info()

    def step(
        self, actions: Choices
    ) -> tuple[WindowDbm, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """One movement in every lane, or its next chase where the last step ended one.

        Raises:
            InputError: an action outside the action space.
            gymnasium.error.ResetNeeded: no chase has begun.
        """
        moving = ~self._lanes.ended
        outcome = self._lanes.step(np.asarray(actions))
        reward_m = np.zeros((self.num_envs, 4))
        terminated, truncated = np.zeros(self.num_envs, dtype=bool), np.zeros(self.num_envs, dtype=bool)
        reward_m[moving] = outcome.reward_m.numpy()
        terminated[moving], truncated[moving] = outcome.reached.numpy(), outcome.truncated.numpy()
        info = self._info()
        if moving.any():
            info |= {"reward_m": reward_m, "_reward_m": moving}
        return self._lanes.window_dbm(), reward_m[:, 0].copy(), terminated, truncated, info

    def _info(self) -> dict[str, Any]:
        """Gymnasium's form: beside each array, under its name with ``_``, which lanes it speaks of."""
        info: dict[str, Any] = {"distance_m": self._lanes.distance_m(), "movements": self._lanes.movements()}
        return info | {f"_{name}": np.ones(self.num_envs, dtype=bool) for name in info}
