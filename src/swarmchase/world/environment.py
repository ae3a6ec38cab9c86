"""The chase itself, batched: the only place that composes target, flight, radio and formation.

A step is: decide, fly, listen (on the way or after arrival: ``pace``), judge, reward (Section III, Algorithm 1). Axes
are (chase, ...); one chase is a batch of one. A chase is defined by its key alone, whatever batch it is in.
"""

from dataclasses import dataclass

import torch

from ..batch.array_types import Bool, Float, Int, Tensor
from ..batch.shown import shown_chases, shown_range
from ..batch.streams import ChaseKey
from ..channel.propagation import unfaded_dbm as unfaded_dbm_at
from ..errors import InputError
from ..formation import Action, tracker_position_m
from ..observation import Observation
from ..scenario import Scenario
from .behaviours import load_behaviour
from .behaviours.protocol import Swarm, Target
from .pace import Leg, pace_of
from .radio import Radio, RadioState
from .target import draw_start_m


@dataclass(frozen=True, repr=False)
class State:
    """Everything a batch of chases is at one moment, that of a decision.

    Metres are float64 in the chase's own frame (origin: the centre's start). A place is one of all samples of the
    window, or one each.
    """

    target: Target
    """U, where the target is and how it flies."""
    center_m: Float[Tensor, "chase 3"]
    """O_t, the centre of the swarm."""
    center_velocity_mps: Float[Tensor, "chase 3"]
    """How it flies."""
    spacing_m: Float[Tensor, "chase"]
    """d_t, distance of every tracker from the centre."""
    turned_rad: Float[Tensor, "chase"] | None
    """How far the trackers' cross has turned since the chase began; None where trackers stop to listen."""
    rssi_dbm: Float[Tensor, "chase sample tracker"]
    """S_t, the window heard since the last decision, float32."""
    sample_time_s: Float[Tensor, "chase sample"]
    """When it was heard, since the chase began,"""
    sample_center_m: Float[Tensor, "chase place 3"]
    """where the centre was,"""
    sample_spacing_m: Float[Tensor, "chase place"]
    """how far from it the trackers were,"""
    sample_turned_rad: Float[Tensor, "chase place"] | None
    """and how far their cross had turned since the chase began; None where trackers stop to listen."""
    time_s: Float[Tensor, "chase"]
    """Since the chase began."""
    movements: Int[Tensor, "chase"]
    """Movements made so far."""
    path_length_m: Float[Tensor, "chase"]
    """Distance flown by the centre so far."""
    least_distance_m: Float[Tensor, "chase"]
    """Between centre and target so far, while it was judged."""
    reached_s: Float[Tensor, "chase"]
    """When the target was first reached; infinite where it has not been."""
    radio: RadioState
    """What the radio carries from window to window."""

    def __repr__(self) -> str:
        after = f"{shown_range(self.movements)} movements, {shown_range(self.time_s)} s"
        away_m = shown_range(distance_to_target_m(self))
        return f"State({shown_chases(len(self.movements))} after {after}: target {away_m} m away)"

    @property
    def target_position_m(self) -> Float[Tensor, "chase 3"]:
        """U."""
        return self.target.position_m

    def observation(self) -> Observation:
        """What a controller may see of it."""
        places_m = tracker_position_m(self.sample_center_m, self.sample_spacing_m, self.sample_turned_rad)
        return Observation(self.rssi_dbm, places_m.expand(-1, self.rssi_dbm.shape[1], -1, -1), self.sample_time_s)


@dataclass(frozen=True)
class Outcome:
    """What one movement brought."""

    reward_m: Float[Tensor, "chase 4"]
    """R^d, R^x, R^y, R^z in this order, float64."""
    reached: Bool[Tensor, "chase"]
    """The centre has been within the success radius, ``follow_s`` ago or longer: termination."""
    truncated: Bool[Tensor, "chase"]
    """MAX_STEPS movements are spent and the target is not reached: truncation."""
    moment_s: Float[Tensor, "chase moment"]
    """Since the chase began: moments of the movement at which the target was judged,"""
    distance_m: Float[Tensor, "chase moment"]
    """and how far the centre was from it."""


class Environment:
    """The chase of one scenario on one device.

    >>> from swarmchase import paper_scenario
    >>> environment = Environment(paper_scenario())
    >>> state = environment.reset([(1, chase) for chase in range(3)])  # chases 0, 1 and 2 of seed 1
    >>> state
    State(3 chases after 0 movements, 5 s: target 100 m away)
    >>> state.observation().rssi_dbm.shape
    torch.Size([3, 50, 6])

    Raises:
        InputError: a behaviour nobody knows, or fields of the scenario that do not go together.
    """

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self.scenario = scenario
        self._device = torch.device(device)
        self._radio = Radio(scenario, device)
        self._behaviour = load_behaviour(scenario, device)
        self._pace = pace_of(scenario, self._behaviour, device)

    def __repr__(self) -> str:
        return f"Environment({self.scenario!r})"

    def reset(self, keys: list[ChaseKey], nearness: Float[Tensor, "chase"] | None = None) -> State:
        """The start of these chases: the target drawn around the swarm, which hovers and hears its first window.

        ``nearness`` puts each target at this share of its distance: training may begin anywhere.
        """
        start_m = draw_start_m(self.scenario, keys)
        if nearness is not None:
            start_m = start_m * nearness[:, None]
        start_m = start_m.to(self._device)
        spacing_m = torch.full((len(keys),), self.scenario.initial_spacing_m, dtype=torch.float64, device=self._device)
        hovering = Swarm(torch.zeros_like(start_m), torch.zeros_like(start_m))
        leg = self._pace.begin(self._behaviour.begin(keys, start_m), hovering, spacing_m)
        nothing = torch.zeros(len(keys), dtype=torch.int64, device=self._device)
        # It counts as reached by a movement, not where it is there from the first.
        return self._after(
            leg,
            spacing_m,
            self._turned(None, leg, None),
            nothing,
            leg.path_length_m,
            leg.least_distance_m,
            torch.full_like(leg.reached_s, torch.inf),
            self._radio.begin(keys),
        )

    def step(self, state: State, action: Action) -> tuple[State, Outcome]:
        """Carry out one action in every chase: act, fly, listen, judge.

        Raises:
            InputError: an action that the scenario's pace does not allow, or for another number of chases.
        """
        self._require_allowed(state, action)
        swarm = Swarm(state.center_m, state.center_velocity_mps)
        leg = self._pace.fly(state.target, swarm, state.spacing_m, state.time_s, action)
        path_length_m = state.path_length_m + leg.path_length_m
        least_distance_m = torch.minimum(state.least_distance_m, leg.least_distance_m)
        reached_s = torch.minimum(state.reached_s, leg.reached_s)
        following = self._after(
            leg,
            action.spacing_m,
            self._turned(state.turned_rad, leg, action.turn_rad),
            state.movements + 1,
            path_length_m,
            least_distance_m,
            reached_s,
            state.radio,
        )
        return following, self._outcome(state, following, leg)

    def _turned(
        self, before_rad: Float[Tensor, "chase"] | None, leg: Leg, turn_rad: Float[Tensor, "chase"] | None
    ) -> tuple[Float[Tensor, "chase"], Float[Tensor, "chase place"]] | None:
        """How far the cross has turned at the end of a leg, and at its samples; None where trackers stop to listen."""
        if self.scenario.pace == "stop_and_listen":
            return None
        if before_rad is None:
            before_rad = torch.zeros_like(leg.time_s)
        if turn_rad is None:
            return before_rad, before_rad[:, None].expand_as(leg.sample_time_s)
        left_s = leg.time_s[:, None] - leg.sample_time_s
        after_rad = before_rad + turn_rad
        return after_rad, after_rad[:, None] - turn_rad[:, None] * (left_s / self.scenario.decision_s).clamp(0.0, 1.0)

    def _after(
        self,
        leg: Leg,
        spacing_m: Float[Tensor, "chase"],
        turned_rad: tuple[Float[Tensor, "chase"], Float[Tensor, "chase place"]] | None,
        movements: Int[Tensor, "chase"],
        path_length_m: Float[Tensor, "chase"],
        least_distance_m: Float[Tensor, "chase"],
        reached_s: Float[Tensor, "chase"],
        radio: RadioState,
    ) -> State:
        """Listen on a leg; ``turned_rad`` is that at its end and that at its samples."""
        end_rad, sample_rad = turned_rad or (None, None)
        trackers_m = tracker_position_m(leg.sample_center_m, leg.sample_spacing_m, sample_rad)
        rssi_dbm, radio = self._radio.heard_dbm(radio, leg.sample_time_s, leg.sample_target_m, trackers_m)
        return State(
            target=leg.target,
            center_m=leg.center_m,
            center_velocity_mps=leg.velocity_mps,
            spacing_m=spacing_m,
            turned_rad=end_rad,
            rssi_dbm=rssi_dbm,
            sample_time_s=leg.sample_time_s,
            sample_center_m=leg.sample_center_m,
            sample_spacing_m=leg.sample_spacing_m,
            sample_turned_rad=sample_rad,
            time_s=leg.time_s,
            movements=movements,
            path_length_m=path_length_m,
            least_distance_m=least_distance_m,
            reached_s=reached_s,
            radio=radio,
        )

    def _outcome(self, before: State, after: State, leg: Leg) -> Outcome:
        return Outcome(
            reward_m=distance_reduction_m(before, after),
            reached=after.time_s >= after.reached_s + self.scenario.follow_s,
            truncated=(after.movements >= self.scenario.max_movements) & after.reached_s.isinf(),
            moment_s=leg.moment_s,
            distance_m=leg.distance_m,
        )

    def _require_allowed(self, state: State, action: Action) -> None:
        given, needed = [action.spacing_m, action.displacement_m], [state.spacing_m, state.center_m]
        if action.turn_rad is not None:
            given, needed = [*given, action.turn_rad], [*needed, state.spacing_m]
        if [tuple(part.shape) for part in given] != [tuple(part.shape) for part in needed]:
            shapes = " and ".join(str(tuple(part.shape)) for part in given)
            raise InputError(
                f"an action of shapes {shapes} is refused: {len(state.spacing_m)} chases need spacing_m [chase], "
                "displacement_m [chase, 3] and, if any, turn_rad [chase]"
            )
        self._pace.require_allowed(action)


def require_world(scenario: Scenario) -> None:
    """Refuse a world in which no chase can be flown, before there is any work.

    Raises:
        InputError: what ``Environment`` refuses, or there is no place to start.
    """
    Environment(scenario)
    draw_start_m(scenario, [(0, 0)])


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
    position_m = tracker_position_m(state.center_m, state.spacing_m, state.turned_rad)
    return unfaded_dbm_at(scenario, (position_m - state.target_position_m[:, None]).norm(dim=2))


def distance_reduction_m(before: State, after: State) -> Float[Tensor, "chase 4"]:
    """Eqs. (7)-(8): R^d, the Euclidean distance won, and R^x, R^y, R^z, the distance won on each axis.

    The paper writes R^b for the reward of the spacing network; it is R^d.
    """
    euclidean_m = distance_to_target_m(before) - distance_to_target_m(after)
    per_axis_m = (before.center_m - before.target_position_m).abs() - (after.center_m - after.target_position_m).abs()
    return torch.cat([euclidean_m[:, None], per_axis_m], dim=1)
