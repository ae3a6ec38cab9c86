"""A controller through many chases, a row of the evaluation's table each: its row is the same for any batch size."""

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from ..batch.streams import ChaseKey
from ..controllers.protocol import Controller
from ..errors import InputError
from ..scenario import Scenario
from ..world.environment import State
from .measures import Tracks
from .play import play

DEFAULT_BATCH_SIZE = 128


@dataclass(frozen=True)
class ChaseResult:
    """One row of the evaluation table."""

    seed: int
    chase: int
    target_x_m: float
    """Where the target was at the chase's end."""
    target_y_m: float
    target_z_m: float
    movements: int
    """Movements until the target was reached; MAX_STEPS + 1 where it was not."""
    reached: bool
    path_length_m: float
    """Sum of d_m, the distance flown by the centre."""
    capture_s: float | None = None
    """From the chase's beginning to when the target was reached, by the clock; where it was not, to the chase's end.
    None where chases are measured by movements."""
    least_distance_m: float | None = None
    """Between centre and target at any time at which it was judged; None as above."""
    following_s: float | None = None
    """The longest time without a break within ``FOLLOWING_RADIUS_M``; None where the chase ended with the capture."""
    belief_decisions: int | None = None
    """Decisions of a controller with a belief; None, and so below, where it has none."""
    belief_held: int | None = None
    """Of these, with the target inside the belief's 95 % region."""
    belief_radius_m: float | None = None
    """The longest half axis of the region, median of the decisions."""
    belief_error_m: float | None = None
    """From the belief's mean to the target, median of the decisions,"""
    belief_error_10_m: float | None = None
    """and after 10 seconds, or movements where chases are measured by these; None where the chase had ended."""
    belief_error_20_m: float | None = None
    belief_error_40_m: float | None = None
    belief_error_80_m: float | None = None


def run_chases(
    scenario: Scenario, controller: Controller, seed: int, chases: Sequence[int], batch_size: int = DEFAULT_BATCH_SIZE
) -> Iterator[ChaseResult]:
    """Run the consecutive ``chases`` of run ``seed`` and yield each as it ends, the earliest to end first.

    >>> from swarmchase import load_controller, paper_scenario
    >>> scenario = paper_scenario(start_distance_m=20)
    >>> for row in run_chases(scenario, load_controller("oracle", scenario), seed=1, chases=range(3)):
    ...     print(row.chase, row.reached, row.movements, f"{row.path_length_m:.1f} m")
    0 True 4 22.3 m
    2 True 4 20.6 m
    1 True 5 20.9 m

    A chase that goes on after the capture (``follow_s``) has the same row but for what is seen on its way.

    Raises:
        InputError: chases that are not consecutive, or no room for any.
    """
    consecutive = range(chases[0], chases[0] + len(chases)) if chases else range(0)
    if list(chases) != list(consecutive):
        raise InputError("chases are refused: their numbers must be consecutive")
    tracks = Tracks(scenario)
    captured: dict[int, ChaseResult] = {}
    for step in play(scenario, controller, seed, consecutive, batch_size):
        tracks.see(step)
        for row in step.captured_rows():
            captured[step.chases[row]] = _result(scenario, (seed, step.chases[row]), step.after, row, reached=True)
        for row in step.ended_rows():
            chase = step.chases[row]
            result = captured.pop(chase, None) or _result(scenario, (seed, chase), step.after, row, reached=False)
            yield dataclasses.replace(result, **tracks.end(chase))


def _result(scenario: Scenario, key: ChaseKey, state: State, row: int, reached: bool) -> ChaseResult:
    x_m, y_m, z_m = state.target_position_m[row].tolist()
    movements = int(state.movements[row]) if reached else scenario.max_movements + 1
    result = ChaseResult(*key, x_m, y_m, z_m, movements, reached, float(state.path_length_m[row]))
    if not scenario.is_told_in_seconds:
        return result
    capture_s = float((state.reached_s if reached else state.time_s)[row])
    return dataclasses.replace(result, capture_s=capture_s, least_distance_m=float(state.least_distance_m[row]))


def chase_columns(chases: Sequence[ChaseResult]) -> dict[str, list[Any]]:
    """The columns of a table of these chases; one of which they have nothing to say is left out."""
    columns = {
        field.name: [getattr(chase, field.name) for chase in chases] for field in dataclasses.fields(ChaseResult)
    }
    return {name: values for name, values in columns.items() if any(value is not None for value in values)}
