"""The chase itself, batched: the only place that composes target, channel and formation.

One movement is act, move, observe, reward (Section III, Algorithm 1). Axes are (chase, ...); one chase is a
batch of one. A chase is defined by its key alone, whatever batch it is in.
"""

from dataclasses import dataclass

import torch

from ..batch.array_types import Bool, Float, Int, Tensor
from ..batch.streams import ChaseKey
from ..channel.fading import window_time_s
from ..channel.propagation import unfaded_dbm as unfaded_dbm_at
from ..errors import InputError
from ..formation import Action, tracker_position_m
from ..observation import Observation
from ..scenario import Scenario
from .radio import Radio, RadioState
from .target import draw_target_position_m


@dataclass(frozen=True)
class State:
    """Everything a batch of chases is at one moment.

    Metres are float64 in the chase's own frame (origin: the centre's start).
    """

    target_position_m: Float[Tensor, "chase 3"]
    """U, where the target is."""
    center_m: Float[Tensor, "chase 3"]
    """O_t, the centre of the swarm."""
    spacing_m: Float[Tensor, "chase"]
    """d_t, distance of every tracker from the centre."""
    rssi_dbm: Float[Tensor, "chase sample tracker"]
    """S_t, the window heard at this position, float32."""
    movements: Int[Tensor, "chase"]
    """Movements made so far."""
    path_length_m: Float[Tensor, "chase"]
    """Distance flown by the centre so far."""
    time_s: Float[Tensor, "chase"]
    """Since the chase began: when this window began, float64."""
    radio: RadioState
    """What the radio carries from window to window."""

    def observation(self) -> Observation:
        """What a controller may see of it."""
        position_m = tracker_position_m(self.center_m, self.spacing_m)
        return Observation(self.rssi_dbm, position_m[:, None].expand(-1, self.rssi_dbm.shape[1], -1, -1))


@dataclass(frozen=True)
class Outcome:
    """What one movement brought."""

    reward_m: Float[Tensor, "chase 4"]
    """R^d, R^x, R^y, R^z in this order, float64."""
    reached: Bool[Tensor, "chase"]
    """The centre is within the success radius: termination."""
    truncated: Bool[Tensor, "chase"]
    """MAX_STEPS movements are spent and the target is not reached: truncation."""


class Environment:
    """The chase of one scenario on one device."""

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self.scenario = scenario
        self._device = torch.device(device)
        self._radio = Radio(scenario, device)
        self._sample_s = window_time_s(scenario, torch.zeros(1, dtype=torch.float64, device=device))
        """Of a window's samples, since its beginning."""
        self._spacing_choices_m = torch.tensor(scenario.spacing_choices_m, dtype=torch.float64, device=device)
        self._displacement_choices_m = torch.tensor(scenario.displacement_choices_m, dtype=torch.float64, device=device)

    def reset(self, keys: list[ChaseKey], nearness: Float[Tensor, "chase"] | None = None) -> State:
        """The start of these chases: the target drawn on its sphere, the swarm hovering, its first window heard.

        ``nearness`` puts each target at this share of its distance: training may begin anywhere.
        """
        target_position_m = draw_target_position_m(self.scenario, keys)
        if nearness is not None:
            target_position_m = target_position_m * nearness[:, None]
        target_position_m = target_position_m.to(self._device)
        center_m = torch.zeros_like(target_position_m)
        spacing_m = torch.full((len(keys),), self.scenario.initial_spacing_m, dtype=torch.float64, device=self._device)
        time_s = torch.zeros(len(keys), dtype=torch.float64, device=self._device)
        radio = self._radio.begin(keys)
        rssi_dbm, radio = self._window_dbm(radio, time_s, target_position_m, center_m, spacing_m)
        return State(
            target_position_m=target_position_m,
            center_m=center_m,
            spacing_m=spacing_m,
            rssi_dbm=rssi_dbm,
            movements=torch.zeros(len(keys), dtype=torch.int64, device=self._device),
            path_length_m=torch.zeros(len(keys), dtype=torch.float64, device=self._device),
            time_s=time_s,
            radio=radio,
        )

    def step(self, state: State, action: Action) -> tuple[State, Outcome]:
        """Carry out one action in every chase: act, move, observe, reward.

        Raises:
            InputError: an action outside the action sets of Section III.A, or for another number of chases.
        """
        self._require_allowed(state, action)
        center_m = state.center_m + action.displacement_m
        travel_m = action.displacement_m.norm(dim=1)
        time_s = state.time_s + self.scenario.window_s + travel_m / self.scenario.tracker_speed_mps
        rssi_dbm, radio = self._window_dbm(state.radio, time_s, state.target_position_m, center_m, action.spacing_m)
        following = State(
            target_position_m=state.target_position_m,
            center_m=center_m,
            spacing_m=action.spacing_m,
            rssi_dbm=rssi_dbm,
            movements=state.movements + 1,
            path_length_m=state.path_length_m + travel_m,
            time_s=time_s,
            radio=radio,
        )
        return following, self._outcome(state, following)

    def _window_dbm(
        self,
        radio: RadioState,
        begin_s: Float[Tensor, "chase"],
        target_position_m: Float[Tensor, "chase 3"],
        center_m: Float[Tensor, "chase 3"],
        spacing_m: Float[Tensor, "chase"],
    ) -> tuple[Float[Tensor, "chase sample tracker"], RadioState]:
        """The window that a swarm hovering here hears from this moment on."""
        trackers_m = tracker_position_m(center_m, spacing_m)
        time_s = begin_s[:, None] + self._sample_s
        return self._radio.heard_dbm(radio, time_s, target_position_m[:, None], trackers_m[:, None])

    def _outcome(self, before: State, after: State) -> Outcome:
        reached = distance_to_target_m(after) <= self.scenario.success_radius_m
        return Outcome(
            reward_m=distance_reduction_m(before, after),
            reached=reached,
            truncated=(after.movements >= self.scenario.max_movements) & ~reached,
        )

    def _require_allowed(self, state: State, action: Action) -> None:
        given, needed = (action.spacing_m, action.displacement_m), (state.spacing_m, state.center_m)
        if [tuple(part.shape) for part in given] != [tuple(part.shape) for part in needed]:
            raise InputError(
                f"an action of shapes {tuple(given[0].shape)} and {tuple(given[1].shape)} is refused: "
                f"{len(state.spacing_m)} chases need spacing_m [chase] and displacement_m [chase, 3]"
            )
        _require_choices("spacing_m", action.spacing_m, self._spacing_choices_m)
        _require_choices("displacement_m", action.displacement_m, self._displacement_choices_m)


def _require_choices(name: str, value: Float[Tensor, "..."], choices: Float[Tensor, "choice"]) -> None:
    allowed = torch.isin(value, choices)
    if not allowed.all():
        raise InputError(f"{name} = {value[~allowed][0].item()} is refused: allowed is one of {choices.tolist()}")


def distance_to_target_m(state: State) -> Float[Tensor, "chase"]:
    """|O_t - U|."""
    distance_m: Tensor = torch.linalg.vector_norm(state.center_m - state.target_position_m, dim=1)
    return distance_m


def counterfactual_reward_m(scenario: Scenario, state: State) -> Float[Tensor, "chase 3 choice"]:
    """The distance R^x, R^y, R^z (Eq. 8) that each displacement of A^x, A^y, A^z would win here, float64.

    The simulator knows the target, so it knows the reward of every choice and not only of the one taken.
    """
    remaining_m = state.target_position_m - state.center_m
    choices_m = torch.tensor(scenario.displacement_choices_m, dtype=torch.float64, device=remaining_m.device)
    return remaining_m.abs()[..., None] - (remaining_m[..., None] - choices_m).abs()


def unfaded_dbm(scenario: Scenario, state: State) -> Float[Tensor, "chase tracker"]:
    """What each tracker would hear here if nothing faded: only the simulator can know it, float64."""
    return unfaded_dbm_at(scenario, _tracker_distance_m(state.target_position_m, state.center_m, state.spacing_m))


def _tracker_distance_m(
    target_position_m: Float[Tensor, "chase 3"], center_m: Float[Tensor, "chase 3"], spacing_m: Float[Tensor, "chase"]
) -> Float[Tensor, "chase tracker"]:
    distance_m: Tensor = (tracker_position_m(center_m, spacing_m) - target_position_m[:, None, :]).norm(dim=2)
    return distance_m


def distance_reduction_m(before: State, after: State) -> Float[Tensor, "chase 4"]:
    """Eqs. (7)-(8): R^d, the Euclidean distance won, and R^x, R^y, R^z, the distance won on each axis.

    The paper writes R^b for the reward of the spacing network; it is R^d.
    """
    euclidean_m = distance_to_target_m(before) - distance_to_target_m(after)
    per_axis_m = (before.center_m - before.target_position_m).abs() - (after.center_m - after.target_position_m).abs()
    return torch.cat([euclidean_m[:, None], per_axis_m], dim=1)
