"""One chase, movement by movement: what ``swarmchase chase`` tells, logs and draws."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..controllers.protocol import Controller
from ..files import write_text_atomically
from ..scenario import Scenario
from ..world.environment import Outcome, State, distance_to_target_m
from ..world.target import draw_target_position_m
from .play import play
from .table import SPEEDS_MPS, tracking_time_s


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
    """The window heard here, [sample][tracker]."""
    reached: bool
    truncated: bool


def run_chase(scenario: Scenario, controller: Controller, seed: int, chase: int) -> Iterator[Moment]:
    """Chase number ``chase`` of run ``seed``, yielded movement by movement."""
    for number, step in enumerate(play(scenario, controller, seed, range(chase, chase + 1), 1)):
        if number == 0:
            yield _moment(step.before, None, [0.0, 0.0, 0.0])
        yield _moment(step.after, step.outcome, step.action.displacement_m[0].tolist())


def chase_log(
    scenario: Scenario, controller: Controller, seed: int, chase: int, moments: list[Moment]
) -> dict[str, Any]:
    """The whole chase as JSON can hold it: what is needed to redo it, its summary and every movement."""
    last = moments[-1]
    way = np.array(last.movement), np.array(last.path_length_m)
    times = {f"{speed:g}": float(tracking_time_s(scenario, *way, speed)) for speed in SPEEDS_MPS}
    return {
        "version": __version__,
        "scenario": scenario.to_dict(),
        "controller": controller.name,
        "seed": seed,
        "chase": chase,
        "target_position_m": draw_target_position_m(scenario, [(seed, chase)])[0].tolist(),
        "reached": last.reached,
        "movements": last.movement,
        "final_distance_m": last.distance_m,
        "path_length_m": last.path_length_m,
        "tracking_time_s": times,
        "moments": [asdict(moment) for moment in moments],
    }


def save_chase_log(path: Path, log: dict[str, Any]) -> None:
    """Write the log as JSON, whole or not at all."""
    write_text_atomically(path, json.dumps(log) + "\n")


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
