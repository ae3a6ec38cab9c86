"""A controller in the world, movement by movement: the loop under evaluation, chase log and decision times.

The batch is kept full: a chase that ends makes room for the next. Since every chase has its own streams, what happens
in it is the same for any batch size.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..batch.selection import join_chases, select_chases
from ..batch.streams import chase_keys
from ..controllers.belief import Belief, Believing
from ..controllers.protocol import Controller, KnowsTarget
from ..errors import InputError
from ..formation import Action
from ..ranges import AT_LEAST_ONE, checked_number
from ..scenario import Scenario
from ..world.environment import Environment, Outcome, State


@dataclass(frozen=True)
class Step:
    """One movement of every chase at work, a row each."""

    chases: list[int]
    """Their numbers."""
    before: State
    belief: Belief | None
    """What the controller believed when it decided; None where it has none."""
    action: Action
    after: State
    outcome: Outcome
    decision_s: float
    """Wall time that the controller took for the actions."""

    def captured_rows(self) -> list[int]:
        """The rows of the chases in which this movement was the first to reach the target."""
        is_first = self.after.reached_s.isfinite() & self.before.reached_s.isinf()
        return [int(row) for row in np.flatnonzero(is_first.tolist())]

    def ended_rows(self) -> list[int]:
        """The rows of the chases that this movement ended."""
        return [int(row) for row in np.flatnonzero((self.outcome.reached | self.outcome.truncated).tolist())]


def play(scenario: Scenario, controller: Controller, seed: int, chases: range, batch_size: int) -> Iterator[Step]:
    """Play these chases of run ``seed`` in the world of ``scenario``, ``batch_size`` of them at a time.

    A controller that ``KnowsTarget`` is told it before every decision.

    Args:
        chases: consecutive numbers; they begin in this order.

    Raises:
        InputError: no room for any chase, or an action that the world does not allow.
    """
    checked_number("batch_size", batch_size, AT_LEAST_ONE)
    environment = Environment(scenario)
    numbers: list[int] = []
    state: State | None = None
    memory: Any = None
    waiting = chases
    while waiting or numbers:
        room = batch_size - len(numbers)
        admitted, waiting = waiting[:room], waiting[room:]
        if admitted:
            new_state = environment.reset(chase_keys(seed, len(admitted), admitted[0]))
            new_memory = controller.begin(len(admitted), seed, admitted[0])
            state = new_state if state is None or not numbers else join_chases(state, new_state)
            memory = new_memory if not numbers else join_chases(memory, new_memory)
            numbers = [*numbers, *admitted]
        assert state is not None
        if isinstance(controller, KnowsTarget):
            memory = controller.told(memory, state.target.position_m, state.target.velocity_mps)
        observation = state.observation()
        began_s = time.perf_counter()
        action, memory = controller.decide(observation, memory)
        decision_s = time.perf_counter() - began_s
        belief = controller.belief(memory) if isinstance(controller, Believing) else None
        try:
            after, outcome = environment.step(state, action)
        except InputError as error:
            # Where many controllers are at work, only here is it known whose action it was.
            raise InputError(f"controller {controller.name!r}: {error}") from error
        step = Step(numbers, state, belief, action, after, outcome, decision_s)
        yield step
        state, ended = after, set(step.ended_rows())
        if ended:
            running = [row for row in range(len(numbers)) if row not in ended]
            numbers = [numbers[row] for row in running]
            if running:
                state, memory = select_chases(state, running), select_chases(memory, running)
