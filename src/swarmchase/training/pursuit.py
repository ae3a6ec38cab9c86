"""Training of ``pursuit`` in its own flights: it is told where the target was, and rewarded for coming near.

The loss of an interval has two parts. One is supervised: how far the estimates of place and velocity are from what the
simulator knows, relative to the distance. The other is an advantage actor-critic's (Mnih et al. 2016) with generalised
advantages (Schulman et al. 2016, High-dimensional continuous control using generalized advantage estimation), on what
the correction and the exploration around it have won: metres nearer, and the target. Without it the network flies
straight to where it believes the target to be; with it it learns what nobody told it, such as to drive a target that
flees to an end of its altitude band.

Many flights go on side by side, in turns of a few intervals; whoever has reached the target, or has flown long or far
enough, is replaced by a new flight between two turns.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch.nn.functional import huber_loss

from ..batch.array_types import Bool, Float, Int, Tensor
from ..batch.selection import join_chases, pack, select_chases, unpack
from ..errors import InputError
from ..formation import Action
from ..networks.pursuit import PursuitNetwork, PursuitReading, at_most_one
from ..observation import mean_position_m
from ..ranges import AT_LEAST_ONE, POSITIVE, SEED, SHARE, ranged, require_ranges
from ..scenario import Scenario, load_scenario
from ..world.environment import Environment, State

LONGEST_INTERVALS = 400
FARTHEST_M = 450.0
"""A flight that has come to this many intervals, or so far from the target, ends."""
NEAR_SHARE, NEAREST_SHARE = 0.5, 0.1
"""So many flights begin nearer than the scenario's, at a share of the distance between this and 1."""
CHASES_A_LESSON = 1 << 27
"""So many of a training's chases a lesson has to itself."""
SLOW = 0.5
"""Times its speed a target flies at first."""
CLEAR_M, CLEAR_SHARE = 3.0, 0.5
"""An error of so many metres, and this share of the distance, counts as 1."""
VELOCITY_WEIGHT = 0.1 / 5.0
SPREAD_WEIGHT = 0.05
MOST_SPREADS = 5.0
"""Errors of more standard deviations count in proportion, not by their square (Huber 1964)."""
POLICY_WEIGHT, VALUE_WEIGHT = 0.3, 0.02
REWARD_REACHED, REWARD_INTERVAL = 5.0, -0.1
"""For the target, and for every interval; coming nearer by an interval at full speed is worth 1."""
DISCOUNT, TRACE = 0.98, 0.95
MOST_ADVANTAGE = 4.0
"""In standard deviations."""
EARLY_EXPLORATION, LATE_EXPLORATION = 0.45, 0.05
"""Standard deviation of the exploration, in full speeds, while nothing is reinforced: at first, and where it would have
come to if that were all of the training."""


@dataclass(frozen=True, kw_only=True)
class PursuitSettings:
    """A training of a ``PursuitNetwork``."""

    lessons: tuple[str, ...] = ("flight:flee:8:20",)
    """Each a scenario, a behaviour, the target's speed in m/s and F in Hz."""
    flights: int = ranged(192, AT_LEAST_ONE)
    """Side by side, shared out evenly between the lessons."""
    intervals: int = ranged(16, AT_LEAST_ONE)
    """Of a turn: so far back in time an update looks."""
    exploration: float = ranged(0.2, POSITIVE)
    """Standard deviation, in full speeds, while it is reinforced."""
    supervised_share: float = ranged(0.35, SHARE)
    """Of the updates, the first ones, in which nothing is reinforced."""
    slow_share: float = ranged(0.2, SHARE)
    """Of the updates, the first ones, in which targets fly at half their speed."""
    learning_rate: float = ranged(1e-3, POSITIVE)
    """At first; it falls with a cosine to a hundredth."""
    max_gradient_norm: float = ranged(1.0, POSITIVE)
    """A longer gradient is shortened to this."""
    max_updates: int = ranged(20_000, AT_LEAST_ONE)
    start_sha256: str | None = None
    """Of the weights file that it began with; None for weights that were drawn."""
    seed: int = ranged(0, SEED)
    """Of flights, exploration and initial weights."""

    def __post_init__(self) -> None:
        require_ranges(self)
        for lesson in self.lessons:
            lesson_scenario(lesson)
        if not self.lessons:
            raise InputError("no lessons: needed is one at least, as in flight:flee:8:20")
        if self.flights % len(self.lessons):
            raise InputError(
                f"{self.flights} flights for {len(self.lessons)} lessons are refused: each needs as many as the others"
            )


def lesson_scenario(lesson: str) -> Scenario:
    """The scenario of a lesson: ``flight:flee:8:20`` is flight with a target that flees at 8 m/s, heard at 20 Hz.

    Raises:
        InputError: it is none, or none of flight.
    """
    try:
        name, behaviour, speed, frequency = lesson.rsplit(":", 3)
        speed_mps, sampling_hz = float(speed), float(frequency)
    except ValueError:
        raise InputError(
            f"lesson {lesson!r} is refused: needed is scenario:behaviour:target_speed_mps:sampling_hz, "
            "as in flight:flee:8:20"
        ) from None
    scenario = replace(
        load_scenario(name),
        behaviour=behaviour,
        target_speed_mps=speed_mps,
        sampling_hz=sampling_hz,
        max_movements=LONGEST_INTERVALS,
    )
    if scenario.pace != "listen_in_flight":
        raise InputError(f"lesson {lesson!r} is refused: in {name} trackers stop to listen")
    Environment(scenario)
    return scenario


@dataclass(frozen=True)
class _Flights:
    """Of one lesson."""

    state: State
    memory: Float[Tensor, "chase memory"]
    age: Int[Tensor, "chase"]
    """Intervals that each has flown, and a share of the longest that the first ones are taken to have flown: else all
    would end together."""
    is_over: Bool[Tensor, "chase"]


@dataclass(frozen=True)
class Turn:
    """What an update learns from, one after another [interval]."""

    estimate_loss: list[Float[Tensor, ""]]
    log_probability: list[Float[Tensor, "chase"]]
    value: list[Float[Tensor, "chase"]]
    reward: list[Float[Tensor, "chase"]]
    is_reached: list[Bool[Tensor, "chase"]]
    counts: list[Bool[Tensor, "chase"]]
    """Whether the chase was still on when the interval began: who has the target is rewarded no more."""


class Lesson:
    """Flights of one scenario that go on from turn to turn."""

    def __init__(
        self, scenario: Scenario, num_flights: int, network: PursuitNetwork, seed: int, number: int, device: str
    ) -> None:
        """``number`` is that of the lesson in a training whose chases are those of ``seed``."""
        self._scenario, self._network, self._seed, self._device = scenario, network, seed, device
        slow = replace(scenario, target_speed_mps=SLOW * scenario.target_speed_mps)
        self._environments = {False: Environment(scenario, device), True: Environment(slow, device)}
        self._full_m = scenario.tracker_speed_mps * scenario.decision_s
        self._chases = torch.Generator().manual_seed(seed + number)
        self._next_chase = number * CHASES_A_LESSON
        self._flights = self._begun(num_flights)
        age = torch.randint(LONGEST_INTERVALS, (num_flights,), generator=self._chases).to(device)
        self._flights = replace(self._flights, age=age)

    def turn_loss(
        self, intervals: int, exploration: float, reinforced: bool, slow: bool, generator: torch.Generator
    ) -> Float[Tensor, ""]:
        """Fly on for so many intervals; the loss of all of them."""
        self._renew()
        flights, turn = self._flights, Turn([], [], [], [], [], [])
        state, memory, is_over, age = flights.state, flights.memory.detach(), flights.is_over, flights.age
        has_target = torch.zeros_like(is_over)
        for _ in range(intervals):
            reading, memory = self._read(state, memory)
            turn.estimate_loss.append(_estimate_loss(reading, state))
            before_m = _distance_m(state)
            state, is_reached, log_probability = self._flown(state, reading, exploration, slow, generator)
            after_m = _distance_m(state)
            turn.log_probability.append(log_probability)
            turn.value.append(reading.value)
            won = (before_m - after_m).float() / self._full_m + REWARD_INTERVAL
            turn.reward.append(won + torch.where(is_reached, REWARD_REACHED, 0.0))
            turn.is_reached.append(is_reached)
            turn.counts.append(~has_target)
            has_target = has_target | is_reached
            age = age + 1
            is_over = is_over | is_reached | (age >= LONGEST_INTERVALS) | (after_m > FARTHEST_M)
        self._flights = _Flights(state, memory.detach(), age, is_over)
        loss = torch.stack(turn.estimate_loss).mean()
        if not reinforced:
            return loss
        with torch.no_grad():
            last = self._read(state, memory)[0].value
        return loss + _reinforced_loss(turn, last)

    def _read(
        self, state: State, memory: Float[Tensor, "chase memory"]
    ) -> tuple[PursuitReading, Float[Tensor, "chase memory"]]:
        observation = state.observation()
        place_m, center_m = mean_position_m(observation).float(), state.center_m.float()
        reading, following = self._network(observation.rssi_dbm, place_m, center_m, memory)
        return reading, following

    def _flown(
        self, state: State, reading: PursuitReading, exploration: float, slow: bool, generator: torch.Generator
    ) -> tuple[State, Bool[Tensor, "chase"], Float[Tensor, "chase"]]:
        """The state after an interval, who has reached the target, and how probable the command was."""
        command = reading.command
        drawn = torch.randn(command.shape, generator=generator, device=command.device)
        taken = command.detach() + exploration * drawn
        log_probability = -(taken - command).square().sum(dim=1) / (2 * exploration**2)
        spacing_m = torch.full_like(state.spacing_m, max(self._scenario.spacing_choices_m))
        displacement_m = at_most_one(taken.double()) * self._full_m
        with torch.no_grad():
            state, outcome = self._environments[slow].step(state, Action(spacing_m, displacement_m))
        return state, outcome.reached, log_probability

    def _renew(self) -> None:
        flights = self._flights
        over = flights.is_over.nonzero()[:, 0].tolist()
        if over:
            going = (~flights.is_over).nonzero()[:, 0].tolist()
            self._flights = join_chases(select_chases(flights, going), self._begun(len(over)))

    def _begun(self, number: int) -> _Flights:
        keys = [(self._seed, self._next_chase + chase) for chase in range(number)]
        self._next_chase += number
        drawn = torch.rand(2, number, generator=self._chases, dtype=torch.float64)
        nearness = torch.where(drawn[0] < NEAR_SHARE, NEAREST_SHARE + (1 - NEAREST_SHARE) * drawn[1], 1.0)
        state = self._environments[False].reset(keys, nearness)
        memory = self._network.begin(self._scenario, number).to(self._device)
        age = torch.zeros(number, dtype=torch.int64, device=self._device)
        return _Flights(state, memory, age, torch.zeros_like(age, dtype=torch.bool))

    def pack(self, prefix: str) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        """Where its flights stand."""
        tensors, positions = pack(self._flights, prefix)
        return tensors, {
            "streams": positions,
            "next_chase": self._next_chase,
            "chases": self._chases.get_state().tolist(),
        }

    def unpack(self, prefix: str, tensors: dict[str, torch.Tensor], document: dict[str, Any]) -> None:
        """Go on where ``pack`` was.

        Raises:
            InputError, LookupError, TypeError, ValueError: it is not that.
        """
        self._flights = unpack(self._flights, prefix, tensors, document["streams"])
        self._next_chase = int(document["next_chase"])
        self._chases.set_state(torch.tensor(document["chases"], dtype=torch.uint8))


def exploration_at(settings: PursuitSettings, update: int) -> float:
    """Standard deviation of the exploration in this update."""
    if is_reinforced(settings, update):
        return settings.exploration
    share = update / settings.max_updates
    return EARLY_EXPLORATION + (LATE_EXPLORATION - EARLY_EXPLORATION) * share


def is_reinforced(settings: PursuitSettings, update: int) -> bool:
    """Whether this update also rewards."""
    return update >= settings.supervised_share * settings.max_updates


def learning_rate_at(settings: PursuitSettings, update: int) -> float:
    """Of Adam in this update."""
    falling = 0.5 * (1 + math.cos(math.pi * update / settings.max_updates))
    return settings.learning_rate * (0.01 + 0.99 * falling)


def _distance_m(state: State) -> Float[Tensor, "chase"]:
    distance_m: Tensor = (state.target.position_m - state.center_m).norm(dim=1)
    return distance_m


def _estimate_loss(reading: PursuitReading, state: State) -> Float[Tensor, ""]:
    """Of place, distance, direction, velocity and how sure they are."""
    way_m = (state.target.position_m - state.center_m).float()
    distance_m, estimated_m = way_m.norm(dim=1), reading.way_m.norm(dim=1)
    error_m = (reading.way_m - way_m).square().sum(dim=1).add(1e-4).sqrt()
    ratio = ((estimated_m + 1) / (distance_m + 1)).log().abs()
    cosine = (reading.way_m * way_m).sum(dim=1) / (estimated_m * distance_m).clamp(min=1e-3)
    velocity_error_mps = (reading.velocity_mps - state.target.velocity_mps.float()).norm(dim=1)
    spreads = error_m.detach() / reading.spread_m
    surprise = 3 * reading.spread_m.log() + huber_loss(
        spreads, torch.zeros_like(spreads), reduction="none", delta=MOST_SPREADS
    )
    loss: Tensor = (
        error_m / (CLEAR_M + CLEAR_SHARE * distance_m)
        + ratio
        + (1 - cosine)
        + VELOCITY_WEIGHT * velocity_error_mps
        + SPREAD_WEIGHT * surprise
    ).mean()
    return loss


def _reinforced_loss(turn: Turn, last_value: Float[Tensor, "chase"]) -> Float[Tensor, ""]:
    """Of actor and critic."""
    value, counts = torch.stack(turn.value), torch.stack(turn.counts)
    won = advantages(turn, last_value)
    loss: Tensor = POLICY_WEIGHT * policy_loss(won[counts], torch.stack(turn.log_probability)[counts])
    return loss + VALUE_WEIGHT * (value - (won + value).detach())[counts].square().mean()


def advantages(turn: Turn, last_value: Float[Tensor, "chase"]) -> Float[Tensor, "interval chase"]:
    """Generalised advantages of a turn after which the critic expects ``last_value``."""
    with torch.no_grad():
        advantage, following = torch.zeros_like(last_value), last_value
        backwards: list[Tensor] = []
        steps = zip(turn.reward, turn.value, turn.is_reached, strict=True)
        for reward, value, reached in reversed(list(steps)):
            goes_on = (~reached).float()
            advantage = reward + DISCOUNT * goes_on * following - value + DISCOUNT * TRACE * goes_on * advantage
            backwards.append(advantage)
            following = value
        return torch.stack(backwards[::-1])


def policy_loss(advantage: Float[Tensor, "interval"], log_probability: Float[Tensor, "interval"]) -> Float[Tensor, ""]:
    """Less where what won more than others is more probable."""
    relative = ((advantage - advantage.mean()) / (advantage.std() + 1e-6)).clamp(-MOST_ADVANTAGE, MOST_ADVANTAGE)
    return -(relative * log_probability).mean()
