"""What happens between two decisions: the swarm flies, so does the target, and the trackers listen.

``StopAndListen`` is the paper's: the swarm flies its displacement, hovers there and hears a window (Section III).
``ListenInFlight`` never stops: it hears the target on its way, and decides every ``decision_s``.
"""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch

from ..batch.array_types import Float, Tensor
from ..errors import InputError
from ..flight import FLIGHT_STEP_S, first_within_s, flown, least_m, length
from ..formation import Action, fastest_turn_rad_per_s
from ..scenario import Scenario
from .behaviours.protocol import Behaviour, Swarm, Target

SPEED_TOLERANCE = 1e-6
"""Share by which rounding may make a displacement longer than the swarm can fly, and a turn faster."""


@dataclass(frozen=True)
class Leg:
    """From one decision to the next. A place is one of all samples, or one each."""

    target: Target
    """At its end."""
    center_m: Float[Tensor, "chase 3"]
    """At its end."""
    velocity_mps: Float[Tensor, "chase 3"]
    """Of the centre, at its end."""
    path_length_m: Float[Tensor, "chase"]
    """Flown by the centre."""
    time_s: Float[Tensor, "chase"]
    """When it ends, since the chase began."""
    sample_time_s: Float[Tensor, "chase sample"]
    """When each sample is taken,"""
    sample_target_m: Float[Tensor, "chase place 3"]
    """where the target is then,"""
    sample_center_m: Float[Tensor, "chase place 3"]
    """where the swarm's centre is,"""
    sample_spacing_m: Float[Tensor, "chase place"]
    """and how far from it the trackers are."""
    moment_s: Float[Tensor, "chase moment"]
    """Since the chase began: moments at which the target is judged, between which the distance changes evenly,"""
    distance_m: Float[Tensor, "chase moment"]
    """and how far the centre is from it."""
    least_distance_m: Float[Tensor, "chase"]
    """Between centre and target, while it is judged."""
    reached_s: Float[Tensor, "chase"]
    """When the target was first reached; infinite where it was not."""


@runtime_checkable
@runtime_checkable
class Pace(Protocol):
    """How the swarm flies and listens. All tensors are float64."""

    def require_allowed(self, action: Action) -> None:
        """Refuse an action that the swarm cannot carry out.

        Raises:
            InputError: it cannot.
        """

    def begin(self, target: Target, swarm: Swarm, spacing_m: Float[Tensor, "chase"]) -> Leg:
        """The swarm hovers at its start and listens."""

    def fly(
        self,
        target: Target,
        swarm: Swarm,
        spacing_m: Float[Tensor, "chase"],
        time_s: Float[Tensor, "chase"],
        action: Action,
    ) -> Leg:
        """From where everybody is at this time, the swarm carries out an action, and listens."""


def pace_of(scenario: Scenario, behaviour: Behaviour, device: torch.device | str = "cpu") -> Pace:
    """The scenario's.

    Raises:
        InputError: a decision interval in which there is no sample.
    """
    if scenario.pace == "stop_and_listen":
        return StopAndListen(scenario, behaviour, device)
    return ListenInFlight(scenario, behaviour, device)


class StopAndListen:
    """Fly, then hover and hear a window. The target is reached while the swarm hovers."""

    def __init__(self, scenario: Scenario, behaviour: Behaviour, device: torch.device | str = "cpu") -> None:
        self._scenario = scenario
        self._behaviour = behaviour
        self._spacing_choices_m = torch.tensor(scenario.spacing_choices_m, dtype=torch.float64, device=device)
        self._displacement_choices_m = torch.tensor(scenario.displacement_choices_m, dtype=torch.float64, device=device)
        farthest_m = math.sqrt(3) * max(map(abs, scenario.displacement_choices_m))
        self._travel_steps = math.ceil(farthest_m / scenario.tracker_speed_mps / FLIGHT_STEP_S)
        self._window = _Moments(
            scenario.window_s, torch.arange(scenario.window_samples, dtype=torch.float64) / scenario.sampling_hz, device
        )

    def require_allowed(self, action: Action) -> None:
        """Only the choices of the action sets (Section III.A); the cross does not turn."""
        if action.turn_rad is not None:
            raise InputError("turn_rad is refused: trackers that stop to listen do not turn their cross")
        _require_choices("spacing_m", action.spacing_m, self._spacing_choices_m)
        _require_choices("displacement_m", action.displacement_m, self._displacement_choices_m)

    def begin(self, target: Target, swarm: Swarm, spacing_m: Float[Tensor, "chase"]) -> Leg:
        """Hears its first window."""
        nothing = torch.zeros_like(spacing_m)
        return self._heard(target, swarm.center_m, spacing_m, begin_s=nothing, path_length_m=nothing)

    def fly(
        self,
        target: Target,
        swarm: Swarm,
        spacing_m: Float[Tensor, "chase"],
        time_s: Float[Tensor, "chase"],
        action: Action,
    ) -> Leg:
        """Flies straight at ``tracker_speed_mps``, then hears a window."""
        center_m = swarm.center_m + action.displacement_m
        travel_m = action.displacement_m.norm(dim=1)
        travel_s = self._travel_s(travel_m)
        if not self._behaviour.is_still:
            way_m = action.displacement_m / self._travel_steps
            velocity_mps = action.displacement_m / travel_s.clamp_min(FLIGHT_STEP_S)[:, None]
            for step in range(self._travel_steps):
                seen = Swarm(swarm.center_m + step * way_m, velocity_mps)
                target = self._behaviour.fly(target, travel_s / self._travel_steps, seen)
        return self._heard(target, center_m, action.spacing_m, time_s + travel_s, travel_m)

    def _travel_s(self, travel_m: Float[Tensor, "chase"]) -> Float[Tensor, "chase"]:
        """From rest to rest: as fast as permitted, with speeding up and braking where acceleration is limited."""
        speed_mps, acceleration_mps2 = self._scenario.tracker_speed_mps, self._scenario.tracker_acceleration_mps2
        if acceleration_mps2 is None:
            return travel_m / speed_mps
        reaches_speed = travel_m >= speed_mps**2 / acceleration_mps2
        at_speed_s = travel_m / speed_mps + speed_mps / acceleration_mps2
        return torch.where(reaches_speed, at_speed_s, 2 * (travel_m / acceleration_mps2).sqrt())

    def _heard(
        self,
        target: Target,
        center_m: Float[Tensor, "chase 3"],
        spacing_m: Float[Tensor, "chase"],
        begin_s: Float[Tensor, "chase"],
        path_length_m: Float[Tensor, "chase"],
    ) -> Leg:
        """The window that a swarm hovering here hears from this moment on."""
        if self._behaviour.is_still:
            sample_target_m = target.position_m[:, None]
            least_distance_m = length(center_m - target.position_m)
            moment_s, distance_m = begin_s[:, None], least_distance_m[:, None]
            is_there = least_distance_m <= self._scenario.success_radius_m
            reached_s = torch.where(is_there, begin_s, torch.inf)
        else:
            hovering = Swarm(center_m, torch.zeros_like(center_m))
            target, target_m = self._window.flown(self._behaviour, target, [hovering] * self._window.steps)
            sample_target_m = self._window.at_samples(target_m)
            offset_m = center_m[:, None] - target_m
            least_distance_m, distance_m = least_m(offset_m), length(offset_m)
            moment_s = begin_s[:, None] + self._window.moment_s
            reached_s = first_within_s(offset_m, moment_s, self._scenario.success_radius_m)
        return Leg(
            target=target,
            center_m=center_m,
            velocity_mps=torch.zeros_like(center_m),
            path_length_m=path_length_m,
            time_s=begin_s + self._scenario.window_s,
            sample_time_s=begin_s[:, None] + self._window.sample_s,
            sample_target_m=sample_target_m,
            sample_center_m=center_m[:, None].expand_as(sample_target_m),
            sample_spacing_m=spacing_m[:, None].expand(sample_target_m.shape[:2]),
            moment_s=moment_s,
            distance_m=distance_m,
            least_distance_m=least_distance_m,
            reached_s=reached_s,
        )


class ListenInFlight:
    """Fly and hear at once, for ``decision_s``. The target is reached anywhere on the way.

    The centre's velocity goes to displacement / ``decision_s`` as fast as its acceleration permits, so that it may end
    short of the displacement, or beside it; the spacing changes evenly, and so does the direction of the cross.
    """

    def __init__(self, scenario: Scenario, behaviour: Behaviour, device: torch.device | str = "cpu") -> None:
        if scenario.samples_a_decision < 1:
            raise InputError(
                f"decision_s = {scenario.decision_s:g} is refused: allowed is at least 1 / sampling_hz = "
                f"{1 / scenario.sampling_hz:g}, the time from one sample to the next"
            )
        self._scenario = scenario
        self._behaviour = behaviour
        sample_s = torch.arange(1, scenario.samples_a_decision + 1, dtype=torch.float64) / scenario.sampling_hz
        self._interval = _Moments(scenario.decision_s, sample_s, device)
        self._farthest_m = scenario.tracker_speed_mps * scenario.decision_s
        self._spacing_m = (min(scenario.spacing_choices_m), max(scenario.spacing_choices_m))
        self._most_rad = fastest_turn_rad_per_s(scenario) * scenario.decision_s

    def require_allowed(self, action: Action) -> None:
        """Any displacement that is no farther than ``decision_s`` at full speed, any spacing between the choices, and
        no faster a turn than ``fastest_turn_rad_per_s``.
        """
        lowest_m, highest_m = self._spacing_m
        allowed = (action.spacing_m >= lowest_m) & (action.spacing_m <= highest_m)
        if not allowed.all():
            raise InputError(
                f"spacing_m = {action.spacing_m[~allowed][0].item()} is refused: "
                f"allowed is between {lowest_m:g} and {highest_m:g}"
            )
        way_m = length(action.displacement_m)
        allowed = way_m <= self._farthest_m * (1 + SPEED_TOLERANCE)
        if not allowed.all():
            raise InputError(
                f"displacement_m of {way_m[~allowed][0].item():.9g} m is refused: allowed is at most "
                f"{self._farthest_m:g} m, decision_s at tracker_speed_mps"
            )
        if action.turn_rad is not None:
            allowed = action.turn_rad.abs() <= self._most_rad * (1 + SPEED_TOLERANCE)
            if not allowed.all():
                raise InputError(
                    f"turn_rad = {action.turn_rad[~allowed][0].item():.9g} is refused: allowed is between "
                    f"{-self._most_rad:g} and {self._most_rad:g}"
                )

    def begin(self, target: Target, swarm: Swarm, spacing_m: Float[Tensor, "chase"]) -> Leg:
        """Hovers for one interval."""
        still_mps = torch.zeros_like(swarm.center_m)
        return self._flown(target, swarm, still_mps, (spacing_m, spacing_m), torch.zeros_like(spacing_m))

    def fly(
        self,
        target: Target,
        swarm: Swarm,
        spacing_m: Float[Tensor, "chase"],
        time_s: Float[Tensor, "chase"],
        action: Action,
    ) -> Leg:
        """Flies towards the displacement's velocity."""
        wanted_mps = action.displacement_m / self._scenario.decision_s
        return self._flown(target, swarm, wanted_mps, (spacing_m, action.spacing_m), time_s)

    def _flown(
        self,
        target: Target,
        swarm: Swarm,
        wanted_mps: Float[Tensor, "chase 3"],
        spacing_m: tuple[Float[Tensor, "chase"], Float[Tensor, "chase"]],
        begin_s: Float[Tensor, "chase"],
    ) -> Leg:
        """``spacing_m`` is that at the beginning and that at the end."""
        interval, acceleration_mps2 = self._interval, self._scenario.tracker_acceleration_mps2
        moment_s = interval.moment_s.expand(len(begin_s), -1)
        sample_s = interval.sample_s.expand(len(begin_s), -1)
        center_m, velocity_mps = flown(swarm.center_m, swarm.velocity_mps, wanted_mps, moment_s, acceleration_mps2)
        sample_center_m, _ = flown(swarm.center_m, swarm.velocity_mps, wanted_mps, sample_s, acceleration_mps2)
        if self._behaviour.is_still:
            target_m = target.position_m[:, None].expand_as(center_m)
        else:
            seen = [Swarm(center_m[:, step], velocity_mps[:, step]) for step in range(interval.steps)]
            target, target_m = interval.flown(self._behaviour, target, seen)
        offset_m = center_m - target_m
        moment_s = begin_s[:, None] + moment_s
        before_m, after_m = spacing_m
        return Leg(
            target=target,
            center_m=center_m[:, -1],
            velocity_mps=velocity_mps[:, -1],
            path_length_m=length(center_m.diff(dim=1)).sum(dim=1),
            time_s=begin_s + self._scenario.decision_s,
            sample_time_s=begin_s[:, None] + sample_s,
            sample_target_m=interval.at_samples(target_m),
            sample_center_m=sample_center_m,
            sample_spacing_m=torch.lerp(
                before_m[:, None], after_m[:, None], (sample_s / self._scenario.decision_s).clamp_max(1.0)
            ),
            moment_s=moment_s,
            distance_m=length(offset_m),
            least_distance_m=least_m(offset_m),
            reached_s=first_within_s(offset_m, moment_s, self._scenario.success_radius_m),
        )


class _Moments:
    """The flight steps of an interval, and where its samples fall among them."""

    def __init__(self, seconds: float, sample_s: Float[Tensor, "sample"], device: torch.device | str) -> None:
        self.steps = math.ceil(seconds / FLIGHT_STEP_S - 1e-9)
        self._step_s = seconds / self.steps
        self.moment_s = torch.linspace(0.0, seconds, self.steps + 1, dtype=torch.float64, device=device)
        """The beginning and the end of every step [moment], since the interval began."""
        self.sample_s = sample_s.to(device, torch.float64)
        """[sample]"""
        place = (self.sample_s / self._step_s).clamp(0.0, self.steps)
        self._step = place.long().clamp_max(self.steps - 1)
        self._share = (place - self._step)[:, None]

    def flown(
        self, behaviour: Behaviour, target: Target, seen: list[Swarm]
    ) -> tuple[Target, Float[Tensor, "chase moment 3"]]:
        """The target at the end, and where it was at every moment; it sees the swarm at the beginning of each step."""
        seconds = torch.full_like(target.position_m[:, 0], self._step_s)
        target_m = [target.position_m]
        for swarm in seen:
            target = behaviour.fly(target, seconds, swarm)
            target_m.append(target.position_m)
        return target, torch.stack(target_m, dim=1)

    def at_samples(self, position_m: Float[Tensor, "chase moment 3"]) -> Float[Tensor, "chase sample 3"]:
        """Where the samples fall: straight from moment to moment."""
        return torch.lerp(position_m[:, self._step], position_m[:, self._step + 1], self._share)


def _require_choices(name: str, value: Float[Tensor, "..."], choices: Float[Tensor, "choice"]) -> None:
    allowed = torch.isin(value, choices)
    if not allowed.all():
        raise InputError(f"{name} = {value[~allowed][0].item()} is refused: allowed is one of {choices.tolist()}")
