"""The chase as Gymnasium environments, one chase or many side by side.

    gymnasium.make("swarmchase.gym:swarmchase/Chase-v0", sampling_hz=10, spatial_correlation=0.9)
    gymnasium.make_vec("swarmchase.gym:swarmchase/Chase-v0", num_envs=64)

Actions are four choices 0..4 in the order d, x, y, z (Section III.A); all are always allowed. Observations are the RSSI
window in dBm, [sample, tracker] (Eq. 6); a sample that is missing has the lowest level of the space. The reward is one
number, R^d; the paper's four rewards (Eqs. 7-8) are in ``info["reward_m"]``.
"""

import dataclasses
import math
import operator
from collections.abc import Sequence
from typing import Any, SupportsIndex

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
from .gym_picture import Picture
from .gym_registration import ENVIRONMENT_ID
from .ranges import AT_LEAST_ONE, AT_LEAST_ZERO, checked_number
from .scenario import NUM_TRACKERS, Scenario
from .world.environment import Environment, Outcome, State, distance_to_target_m

__all__ = ["ENVIRONMENT_ID", "ChaseEnv", "ChaseVectorEnv"]

RENDER_FPS = 4
"""Frames a second at which films of chases are shown."""
FADING_PEAK_HEADROOM_DB = 20.0
"""Room for fading above its mean power: |h|^2 > 100 is rarer than 1e-43 a sample for any K. It would be clipped."""

WindowDbm = NDArray[np.float32]
Choices = NDArray[Any]
"""Whole numbers of any width; the action space refuses all else."""
Seeds = SupportsIndex | Sequence[SupportsIndex | None] | NDArray[Any] | None
"""Of the first lane, or of each."""


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


class UnknownKeywordError(InputError, TypeError):
    """As Python refuses a keyword: libraries that offer one of their own (``frameskip``) go on without it."""


def _known_scenario(scenario: Scenario | None, changes: dict[str, Any]) -> Scenario:
    known = [field.name for field in dataclasses.fields(Scenario)]
    for name in changes:
        if name not in known:
            raise UnknownKeywordError(f"got an unexpected keyword argument {name!r}; allowed are {', '.join(known)}")
    return Scenario.from_dict({**(scenario or Scenario()).to_dict(), **changes})


def _plain_seed(seed: SupportsIndex | None) -> int | None:
    """numpy's whole numbers are as good as Python's."""
    return None if seed is None else operator.index(seed)


class _Lanes:
    """Chases side by side. Each lane plays one run: its chase 0, and at every later start the next."""

    def __init__(self, scenario: Scenario, num_lanes: int, render_mode: str | None) -> None:
        self.scenario = scenario
        self.action_space = _action_space(scenario)
        self.observation_space = _observation_space(scenario)
        self._batched_action_space = batch_space(self.action_space, num_lanes)
        self._environment = Environment(scenario)
        self._next_key: dict[int, ChaseKey] = {}
        self._state: State | None = None
        self.ended = np.ones(num_lanes, dtype=bool)
        """Lanes with no chase under way."""
        self._pictures = None if render_mode is None else [Picture(scenario) for _ in range(num_lanes)]

    def reset(
        self,
        seeds: Sequence[int | None],
        np_random: np.random.Generator,
        options: dict[str, Any] | None,
        lanes: Sequence[int] | None = None,
    ) -> None:
        """Start a chase in these lanes, or in every one: chase 0 of the run ``seed``, or the one that the options say;
        where the seed is None, the next of the lane's run.
        """
        chase = _asked_chase(options)
        lanes = range(len(seeds)) if lanes is None else lanes
        for lane in lanes:
            seed = seeds[lane]
            if seed is None and lane not in self._next_key:
                seed = int(np_random.integers(2**63))
            if seed is not None:
                self._next_key[lane] = chase_keys(seed, 1)[0]
            if chase is not None:
                self._next_key[lane] = (self._next_key[lane][0], chase)
        self.start(lanes)

    def start(self, lanes: Sequence[int]) -> None:
        """The next chase of each of these lanes; the others stay as they are."""
        keys = [self._next_key[lane] for lane in lanes]
        self._next_key.update({lane: (seed, chase + 1) for lane, (seed, chase) in zip(lanes, keys, strict=True)})
        started = self._environment.reset(keys)
        others = np.setdiff1d(np.arange(len(self.ended)), lanes).tolist()
        if others:
            kept = select_chases(self._started, others)
            started = select_chases(join_chases(kept, started), np.argsort([*others, *lanes]).tolist())
        self._state = started
        self.ended[list(lanes)] = False
        self._note(lanes, anew=True)

    def step(self, choices: Choices) -> Outcome:
        """Move the lanes whose chase is under way; the outcome is theirs. The others start their next chase."""
        action = self._action(choices)
        moved_lanes, waiting_lanes = np.flatnonzero(~self.ended).tolist(), np.flatnonzero(self.ended).tolist()
        moved, outcome = self._environment.step(
            select_chases(self._started, moved_lanes), select_chases(action, moved_lanes)
        )
        if waiting_lanes:
            both = join_chases(moved, select_chases(self._started, waiting_lanes))
            moved = select_chases(both, np.argsort(moved_lanes + waiting_lanes).tolist())
        self._state = moved
        self._note(moved_lanes)
        if waiting_lanes:
            self.start(waiting_lanes)
        self.ended[moved_lanes] = (outcome.reached | outcome.truncated).numpy()
        return outcome

    def render(self) -> list[NDArray[np.uint8]]:
        """Every lane's chase so far."""
        assert self._pictures is not None
        self._require_started()
        return [picture.draw() for picture in self._pictures]

    def show(self) -> None:
        """The first lane's chase so far, in a window."""
        if self._pictures is not None:
            self._pictures[0].show()

    def close(self) -> None:
        """What shows them."""
        for picture in self._pictures or ():
            picture.close()

    def _note(self, lanes: Sequence[int], anew: bool = False) -> None:
        if self._pictures is not None:
            for lane in lanes:
                self._pictures[lane].note(self._started, lane, anew)

    def window_dbm(self) -> WindowDbm:
        """What every lane hears, within the bounds of the observation space."""
        low_dbm, high_dbm = self.observation_space.low[0, 0], self.observation_space.high[0, 0]
        window_dbm = np.nan_to_num(self._started.rssi_dbm.numpy(), nan=low_dbm)
        clipped: WindowDbm = np.clip(window_dbm, low_dbm, high_dbm, order="C")
        return clipped

    def distance_m(self) -> NDArray[np.float64]:
        """Distance of each lane's centre from its target."""
        return distance_to_target_m(self._started).numpy()

    def movements(self) -> NDArray[np.int64]:
        """Movements each lane has made in its chase."""
        return self._started.movements.numpy().copy()

    @property
    def _started(self) -> State:
        self._require_started()
        assert self._state is not None
        return self._state

    def _require_started(self) -> None:
        if self._state is None:
            raise gymnasium.error.ResetNeeded("no chase has begun: call reset() first")

    def _action(self, choices: Choices) -> Action:
        if not self._batched_action_space.contains(choices):
            raise InputError(
                f"actions of shape {choices.shape} and type {choices.dtype} are refused: each of "
                f"{len(self.ended)} must be in {self.action_space}"
            )
        return action_from_choice(self.scenario, torch.from_numpy(choices.astype(np.int64)))


def _asked_chase(options: dict[str, Any] | None) -> int | None:
    """``options["chase"]``: the number of the chase in its run.

    Raises:
        InputError: an option that nobody knows, or no number of a chase.
    """
    unknown = sorted(set(options or {}) - {"chase"})
    if unknown:
        raise InputError(f"options {unknown} are refused: allowed is 'chase', the number of the chase in its run")
    chase = (options or {}).get("chase")
    return None if chase is None else int(checked_number("options['chase']", operator.index(chase), AT_LEAST_ZERO))


class ChaseEnv(gymnasium.Env[WindowDbm, Choices]):
    """One chase. Reaching the target is termination, MAX_STEPS movements without it truncation.

    Args:
        scenario: the world; Table I without it.
        render_mode: ``rgb_array`` for pictures from ``render``, ``human`` for a window that follows by itself.
        changes: any field of ``Scenario`` by keyword, on top of it.

    ``info`` holds ``distance_m``, ``movements`` and, after a movement, ``reward_m`` (R^d, R^x, R^y, R^z).
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": RENDER_FPS}  # noqa: RUF012 (Gymnasium wants it so)

    def __init__(self, scenario: Scenario | None = None, render_mode: str | None = None, **changes: Any) -> None:
        _require_render_mode(render_mode, self.metadata)
        self.render_mode = render_mode
        self._lanes = _Lanes(_known_scenario(scenario, changes), 1, render_mode)
        self.scenario = self._lanes.scenario
        self.action_space = self._lanes.action_space
        self.observation_space = self._lanes.observation_space

    def reset(
        self,
        *,
        seed: SupportsIndex | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[WindowDbm, dict[str, Any]]:
        """Start chase 0 of the run ``seed``; without a seed the next chase of the run, or a run drawn at random.
        ``options={"chase": 7}`` starts chase 7 of the run instead.
        """
        plain_seed = _plain_seed(seed)
        super().reset(seed=plain_seed)
        self._lanes.reset([plain_seed], self.np_random, options)
        self._follow()
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
        self._follow()
        info = {**self._info(), "reward_m": outcome.reward_m[0].numpy()}
        reward = float(outcome.reward_m[0, 0])
        return self._lanes.window_dbm()[0], reward, bool(outcome.reached), bool(outcome.truncated), info

    def render(self) -> NDArray[np.uint8] | None:
        """[height, width, 3] of the chase so far in the mode ``rgb_array``; a window shows itself.

        Raises:
            gymnasium.error.ResetNeeded: no chase has begun.
        """
        return self._lanes.render()[0] if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close the window."""
        self._lanes.close()

    def _follow(self) -> None:
        if self.render_mode == "human":
            self._lanes.show()

    def _info(self) -> dict[str, Any]:
        return {"distance_m": float(self._lanes.distance_m()[0]), "movements": int(self._lanes.movements()[0])}


def _require_render_mode(render_mode: str | None, metadata: dict[str, Any]) -> None:
    allowed = metadata["render_modes"]
    if render_mode is not None and render_mode not in allowed:
        raise InputError(f"render_mode = {render_mode!r} is refused: allowed is None or {' or '.join(allowed)}")


class ChaseVectorEnv(gymnasium.vector.VectorEnv[WindowDbm, Choices, NDArray[Any]]):
    """Many chases in one batch, number by number what ``num_envs`` single ``ChaseEnv`` are.

    Args:
        num_envs: number of chases side by side.
        scenario: the world; Table I without it.
        render_mode: ``rgb_array`` for a tuple of pictures from ``render``.
        autoreset_mode: what follows a chase that has ended, as in Gymnasium's own vector environments. ``NEXT_STEP``:
            the step after it ignores the lane's action, starts its next chase and gives reward 0; ``SAME_STEP``: the
            step that ends it starts the next, ``info`` has ``final_obs`` and ``final_info``; ``DISABLED``: the lane
            waits for ``reset(options={"reset_mask": ...})``.
        changes: any field of ``Scenario`` by keyword, on top of it.
    """

    metadata = {  # noqa: RUF012 (Gymnasium wants it so)
        "render_modes": ["rgb_array"],
        "render_fps": RENDER_FPS,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        scenario: Scenario | None = None,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **changes: Any,
    ) -> None:
        checked_number("num_envs", num_envs, AT_LEAST_ONE)
        _require_render_mode(render_mode, self.metadata)
        self.render_mode = render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self._lanes = _Lanes(_known_scenario(scenario, changes), num_envs, render_mode)
        self.num_envs = num_envs
        self.scenario = self._lanes.scenario
        self.single_action_space = self._lanes.action_space
        self.single_observation_space = self._lanes.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(self, *, seed: Seeds = None, options: dict[str, Any] | None = None) -> tuple[WindowDbm, dict[str, Any]]:
        """Start a chase in every lane, or in those of ``options["reset_mask"]``: lane i plays the run ``seed + i``, or
        ``seed[i]``; None goes on with its run. ``options={"chase": 7}`` starts chase 7 of each.

        Raises:
            InputError: another number of seeds than lanes, a mask of another form, or an option that nobody knows.
        """
        seeds = self._seeds(seed)
        mask, others = self._mask(dict(options or {}))
        super().reset(seed=seeds[0] if np.ndim(seed) == 0 else None)  # type: ignore[arg-type]
        self._lanes.reset(seeds, self.np_random, others, np.flatnonzero(mask).tolist())
        return self._lanes.window_dbm(), self._info(mask)

    def step(
        self, actions: Choices
    ) -> tuple[WindowDbm, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """One movement in every lane, or its next chase where the last step ended one.

        Raises:
            InputError: an action outside the action space.
            gymnasium.error.ResetNeeded: no chase has begun, or one has ended and nothing starts the next.
        """
        moving = ~self._lanes.ended
        if self.autoreset_mode == AutoresetMode.DISABLED and not moving.all():
            lanes = np.flatnonzero(~moving).tolist()
            raise gymnasium.error.ResetNeeded(f"the chases of lanes {lanes} have ended: reset them with a reset_mask")
        outcome = self._lanes.step(np.asarray(actions))
        reward_m = np.zeros((self.num_envs, 4))
        terminated, truncated = np.zeros(self.num_envs, dtype=bool), np.zeros(self.num_envs, dtype=bool)
        reward_m[moving] = outcome.reward_m.numpy()
        terminated[moving], truncated[moving] = outcome.reached.numpy(), outcome.truncated.numpy()
        info: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._lanes.ended.any():
            info = self._finals(reward_m)
            moving = ~self._lanes.ended
            self._lanes.start(np.flatnonzero(self._lanes.ended).tolist())
        info |= self._info(np.ones(self.num_envs, dtype=bool))
        if moving.any():
            info |= {"reward_m": np.where(moving[:, None], reward_m, 0.0), "_reward_m": moving}
        return self._lanes.window_dbm(), reward_m[:, 0].copy(), terminated, truncated, info

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """[height, width, 3] of every lane's chase so far.

        Raises:
            gymnasium.error.ResetNeeded: no chase has begun.
        """
        return None if self.render_mode is None else tuple(self._lanes.render())

    def _seeds(self, seed: Seeds) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, SupportsIndex) and np.ndim(seed) == 0:  # type: ignore[arg-type]
            return [operator.index(seed) + lane for lane in range(self.num_envs)]
        seeds = [_plain_seed(one) for one in seed]  # type: ignore[union-attr]
        if len(seeds) != self.num_envs:
            raise InputError(f"{len(seeds)} seeds are refused: allowed is one for each of {self.num_envs} lanes")
        return seeds

    def _mask(self, options: dict[str, Any]) -> tuple[NDArray[np.bool_], dict[str, Any]]:
        """Lanes to be reset, and the other options."""
        mask = options.pop("reset_mask", np.ones(self.num_envs, dtype=bool))
        if not isinstance(mask, np.ndarray) or mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            raise InputError(
                f"options['reset_mask'] is refused: allowed is one truth value for each of {self.num_envs}"
            )
        if not mask.any():
            raise InputError("options['reset_mask'] is refused: it resets no lane")
        return mask, options

    def _finals(self, reward_m: NDArray[np.float64]) -> dict[str, Any]:
        """How the chases looked that have just ended, in Gymnasium's form."""
        windows_dbm, info = self._lanes.window_dbm(), self._info(self._lanes.ended)
        finals: dict[str, Any] = {}
        for lane in np.flatnonzero(self._lanes.ended).tolist():
            final_info = {name: info[name][lane] for name in ("distance_m", "movements")}
            final_info = {name: value.item() for name, value in final_info.items()} | {"reward_m": reward_m[lane]}
            finals = self._add_info(finals, {"final_obs": windows_dbm[lane], "final_info": final_info}, lane)
        return finals

    def _info(self, lanes: NDArray[np.bool_]) -> dict[str, Any]:
        """Gymnasium's form: beside each array, under its name with ``_``, which lanes it speaks of."""
        everything = {"distance_m": self._lanes.distance_m(), "movements": self._lanes.movements()}
        info: dict[str, Any] = {name: np.where(lanes, values, 0) for name, values in everything.items()}
        return info | {f"_{name}": lanes.copy() for name in info}
