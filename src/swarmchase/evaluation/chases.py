"""A controller through many chases: the loop under evaluation, the training's auxiliary agent and ``chase``.

The batch is kept full: a chase that ends makes room for the next. Since every chase has its own streams, its
row in the table is the same for any batch size.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..batch.selection import join_chases, select_chases
from ..batch.streams import ChaseKey, chase_keys
from ..controllers.protocol import Controller
from ..errors import InputError
from ..scenario import Scenario
from ..world.environment import Environment, State

DEFAULT_BATCH_SIZE = 128


@dataclass(frozen=True)
class ChaseResult:
    """One row of the evaluation table."""

    seed: int
    chase: int
    target_x_m: float
    target_y_m: float
    target_z_m: float
    movements: int
    """Movements until the target was reached; MAX_STEPS + 1 where it was not."""
    reached: bool
    path_length_m: float
    """Sum of d_m, the distance flown by the centre."""


def run_chases(
    scenario: Scenario, controller: Controller, seed: int, chases: Sequence[int], batch_size: int = DEFAULT_BATCH_SIZE
) -> Iterator[ChaseResult]:
    """Run the consecutive ``chases`` of run ``seed`` and yield each as it ends, the earliest to end first.

    Raises:
        InputError: chases that are not consecutive, or no room for any.
    """
    waiting = list(chases)
    if waiting != list(range(waiting[0], waiting[0] + len(waiting)) if waiting else []):
        raise InputError("chases are refused: their numbers must be consecutive")
    if batch_size < 1:
        raise InputError(f"batch_size = {batch_size} is refused: allowed is at least 1")
    environment = Environment(scenario)
    numbers: list[int] = []
    state: State | None = None
    memory = None
    while waiting or numbers:
        admitted, waiting = waiting[: batch_size - len(numbers)], waiting[batch_size - len(numbers) :]
        if admitted:
            new_state = environment.reset(chase_keys(seed, len(admitted), admitted[0]))
            new_memory = controller.begin(len(admitted), seed, admitted[0])
            state = new_state if state is None or not numbers else join_chases(state, new_state)
            memory = new_memory if not numbers else join_chases(memory, new_memory)
            numbers = numbers + admitted
        assert state is not None
        action, memory = controller.decide(state.observation(), memory)
        state, outcome = environment.step(state, action)
        ended = (outcome.reached | outcome.truncated).tolist()
        if any(ended):
            reached = outcome.reached.tolist()
            for row in np.flatnonzero(ended):
                yield _result(scenario, (seed, numbers[row]), state, int(row), reached[row])
            running = [row for row, end in enumerate(ended) if not end]
            numbers = [numbers[row] for row in running]
            if running:
                state, memory = select_chases(state, running), select_chases(memory, running)


def _result(scenario: Scenario, key: ChaseKey, state: State, row: int, reached: bool) -> ChaseResult:
    x_m, y_m, z_m = state.target_position_m[row].tolist()
    movements = int(state.movements[row]) if reached else scenario.max_movements + 1
    return ChaseResult(*key, x_m, y_m, z_m, movements, reached, float(state.path_length_m[row]))
