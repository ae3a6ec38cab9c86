"""One chase, movement by movement: what ``swarmchase chase`` tells, logs and draws."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..controllers.protocol import Controller
from ..files import write_text_atomically
from ..scenario import Scenario
from ..world.environment import Outcome, State, distance_to_target_m
from ..world.target import draw_start_m
from .play import Step, play
from .table import SPEEDS_MPS, tracking_time_s

FORMAT = 2
"""Of the log of a chase that is measured by the clock. The log of one measured by movements is the first format, which
has no number.
"""


@dataclass(frozen=True)
class Moment:
    """The swarm after one movement; movement 0 is the start."""

    movement: int
    center_m: list[float]
    spacing_m: float
    displacement_m: list[float]
    distance_m: float
    """From the centre to the target, which the controller does not know."""
    reward_m: list[float]
    """R^d, R^x, R^y, R^z of this movement."""
    path_length_m: float
    rssi_dbm: list[list[float]]
    """The window heard here: its samples, each of six trackers."""
    reached: bool
    truncated: bool


@dataclass(frozen=True)
class LoggedBelief:
    """Where the controller took the target to be, and whether it was right."""

    mean_m: list[float]
    radius_m: float
    """The longest half axis of its 95 % region."""
    error_m: float
    """From the mean to the target."""
    is_held: bool
    """Whether the target was inside the region."""


@dataclass(frozen=True)
class TimedMoment(Moment):
    """The same, and when: where chases are measured by the clock. Times are since the chase began."""

    time_s: float
    """Of the decision that follows; the window was heard until then."""
    center_velocity_mps: list[float]
    target_position_m: list[float]
    target_velocity_mps: list[float]
    sample_time_s: list[float]
    """When each sample of the window was heard."""
    least_distance_m: float
    """Between centre and target so far."""
    reached_s: float | None
    """When the target was first reached; None where it has not been."""
    belief: LoggedBelief | None
    """At the moment before, by which the controller decided to come here; None where it has none."""


def run_chase(scenario: Scenario, controller: Controller, seed: int, chase: int) -> Iterator[Moment]:
    """Chase number ``chase`` of run ``seed``, yielded movement by movement; ``TimedMoment``s where the scenario is told
    in seconds.
    """
    for number, step in enumerate(play(scenario, controller, seed, range(chase, chase + 1), 1)):
        came = step.outcome, step.action.displacement_m[0].tolist()
        if scenario.is_told_in_seconds:
            if number == 0:
                yield _timed_moment(step.before, None, [0.0, 0.0, 0.0], None)
            yield _timed_moment(step.after, *came, _logged_belief(step))
        else:
            if number == 0:
                yield _moment(step.before, None, [0.0, 0.0, 0.0])
            yield _moment(step.after, *came)


def chase_log(
    scenario: Scenario, controller: Controller, seed: int, chase: int, moments: list[Moment]
) -> dict[str, Any]:
    """The whole chase as JSON can hold it: what is needed to redo it, its summary and every movement.

    The target's position in the head is that of its start.
    """
    last = moments[-1]
    return {
        "version": __version__,
        **({"format": FORMAT} if isinstance(last, TimedMoment) else {}),
        "scenario": scenario.to_dict(),
        "controller": controller.name,
        "seed": seed,
        "chase": chase,
        "target_position_m": draw_start_m(scenario, [(seed, chase)])[0].tolist(),
        "reached": last.reached,
        "movements": last.movement,
        "final_distance_m": last.distance_m,
        "path_length_m": last.path_length_m,
        **(_times_by_clock(last) if isinstance(last, TimedMoment) else _times_at_speeds(scenario, last)),
        "moments": [asdict(moment) for moment in moments],
    }


def save_chase_log(path: Path, log: dict[str, Any]) -> None:
    """Write the log as JSON, whole or not at all."""
    write_text_atomically(path, json.dumps(log) + "\n")


def _times_at_speeds(scenario: Scenario, last: Moment) -> dict[str, Any]:
    way = np.array(last.movement), np.array(last.path_length_m)
    return {"tracking_time_s": {f"{speed:g}": float(tracking_time_s(scenario, *way, speed)) for speed in SPEEDS_MPS}}


def _times_by_clock(last: TimedMoment) -> dict[str, Any]:
    """As the evaluation's table has them: where the target was not reached, how long the chase lasted."""
    return {
        "capture_s": last.time_s if last.reached_s is None else last.reached_s,
        "least_distance_m": last.least_distance_m,
    }


def _moment(state: State, outcome: Outcome | None, displacement_m: list[float]) -> Moment:
    return Moment(
        movement=int(state.movements[0]),
        center_m=state.center_m[0].tolist(),
        spacing_m=float(state.spacing_m[0]),
        displacement_m=displacement_m,
        distance_m=float(distance_to_target_m(state)[0]),
        reward_m=[0.0] * 4 if outcome is None else outcome.reward_m[0].tolist(),
        path_length_m=float(state.path_length_m[0]),
        rssi_dbm=[[round(value, 3) for value in sample] for sample in state.rssi_dbm[0].tolist()],
        reached=outcome is not None and bool(outcome.reached[0]),
        truncated=outcome is not None and bool(outcome.truncated[0]),
    )


def _logged_belief(step: Step) -> LoggedBelief | None:
    if step.belief is None:
        return None
    target_m = step.before.target_position_m
    return LoggedBelief(
        mean_m=step.belief.mean_m[0].tolist(),
        radius_m=float(step.belief.radius_m[0]),
        error_m=float(step.belief.error_m(target_m)[0]),
        is_held=bool(step.belief.holds(target_m)[0]),
    )


def _timed_moment(
    state: State, outcome: Outcome | None, displacement_m: list[float], belief: LoggedBelief | None
) -> TimedMoment:
    moment = _moment(state, outcome, displacement_m)
    return TimedMoment(
        **{field.name: getattr(moment, field.name) for field in fields(moment)},
        time_s=float(state.time_s[0]),
        center_velocity_mps=state.center_velocity_mps[0].tolist(),
        target_position_m=state.target.position_m[0].tolist(),
        target_velocity_mps=state.target.velocity_mps[0].tolist(),
        sample_time_s=[round(time_s, 6) for time_s in state.sample_time_s[0].tolist()],
        least_distance_m=float(state.least_distance_m[0]),
        reached_s=float(state.reached_s[0]) if state.reached_s[0].isfinite() else None,
        belief=belief,
    )
