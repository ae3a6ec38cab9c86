"""A controller over N chases: one table on disk, one row a chase, and its summary with confidence intervals.

The chases are shared out to processes; a chase is a function of its key alone, so the table is the same for any batch
size and any number of processes.
"""

import math
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import connection
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from .. import __version__
from ..batch.freed_memory import keep_freed_memory
from ..batch.shown import shown_chases
from ..controllers import ActionChoice, chosen_weights, load_controller, require_controller
from ..errors import InputError, WorkerDiedError
from ..processes.children import begin_child, start_helper, starting_children
from ..processes.stop_request import Interrupted
from ..ranges import AT_LEAST_ONE, AT_LEAST_ZERO, checked_number
from ..scenario import Scenario
from ..world.environment import require_world
from .chases import DEFAULT_BATCH_SIZE, ChaseResult, chase_columns, run_chases
from .measures import BELIEF_AFTER, FOLLOWED_S
from .statistics import mean_interval, nearest_rank_percentile, percentile_interval, ratio_interval, share_interval
from .tables import write_table

SPEEDS_MPS = (2.0, 5.0)
"""Tracker speeds of Fig. 7."""
CAPTURED_WITHIN_S = (60.0, 120.0, 300.0)
"""The share captured within these is told where chases are measured by the clock."""
SHARE_CHASES = 500
"""A further process is started for every so many chases: for fewer it would cost more time than it saves."""
LOOK_S = 0.2
"""At least so often ``finished`` is told the number, where processes do the work."""


def tracking_time_s(
    scenario: Scenario, movements: NDArray[Any], path_length_m: NDArray[Any], speed_mps: float
) -> NDArray[np.float64]:
    """tau(M, F) = M L / F + sum of d_m / v (Section IV), of each chase."""
    return np.asarray(movements * scenario.window_s + path_length_m / speed_mps, dtype=np.float64)


@dataclass(frozen=True, repr=False)
class Evaluation:
    """The chases of one controller in one scenario.

    >>> from swarmchase import paper_scenario
    >>> evaluate(paper_scenario(start_distance_m=20), "oracle", episodes=4, seed=1)
    Evaluation('oracle', 4 chases of seed 1 in Scenario(sampling_hz=10.0, spatial_correlation=0.9, \
start_distance_m=20.0): 4 reached, movements mean 4.5)
    """

    scenario: Scenario
    controller: str
    action_choice: ActionChoice | None
    seed: int
    chases: Sequence[ChaseResult]
    """In the order of their numbers."""
    world: Scenario | None = None
    """Where the chases were, if not in the scenario that the controller was told."""

    def __repr__(self) -> str:
        reached = sum(chase.reached for chase in self.chases)
        mean = sum(chase.movements for chase in self.chases) / max(len(self.chases), 1)
        return (
            f"Evaluation({self.controller!r}, {shown_chases(len(self.chases))} of seed {self.seed} in "
            f"{self.world or self.scenario!r}: {reached} reached, movements mean {mean:.1f})"
        )

    @property
    def weights(self) -> str | None:
        """Which of a family's trained controllers this was, as ``paper/F10-rho0.9``; None for any other controller."""
        chosen = chosen_weights(self.controller, self.scenario)
        return None if chosen is None else chosen.name

    def summary(self) -> dict[str, Any]:
        """The figures of one row of a results table.

        Failed chases count as MAX_STEPS + 1 movements and are never dropped.
        """
        movements, times_s = np.array([chase.movements for chase in self.chases]), self._times_s()
        reached = sum(chase.reached for chase in self.chases)
        return {
            "controller": self.controller,
            "action_choice": self.action_choice,
            "weights": self.weights,
            "sampling_hz": self.scenario.sampling_hz,
            "spatial_correlation": self.scenario.spatial_correlation,
            "window_s": self.scenario.window_s,
            "episodes": len(self.chases),
            "seed": self.seed,
            "success_rate": reached / len(self.chases),
            "success_rate_ci95": share_interval(reached, len(self.chases)),
            "movements_mean": float(movements.mean()),
            "movements_mean_ci95": mean_interval(movements),
            "movements_p50": nearest_rank_percentile(movements, 50),
            "movements_p50_ci95": percentile_interval(movements, 50),
            "movements_p90": nearest_rank_percentile(movements, 90),
            "movements_p90_ci95": percentile_interval(movements, 90),
            "movements_max": int(movements.max()),
            "tracking_time_mean_s": {f"{speed:g}": float(times_s[speed].mean()) for speed in SPEEDS_MPS},
            "tracking_time_mean_s_ci95": {f"{speed:g}": mean_interval(times_s[speed]) for speed in SPEEDS_MPS},
            **self._capture(),
            **self._following(),
            **self._belief(),
            "version": __version__,
        }

    def _capture(self) -> dict[str, Any]:
        """Figures of capture by the clock, where that is what chases are measured by.

        A chase without a capture counts as long as it lasted: the limit.
        """
        if not (self.world or self.scenario).is_told_in_seconds:
            return {}
        capture_s = np.array([chase.capture_s for chase in self.chases])
        captured_s = np.where([chase.reached for chase in self.chases], capture_s, math.inf)
        within = {f"{limit_s:g}": int((captured_s <= limit_s).sum()) for limit_s in CAPTURED_WITHIN_S}
        least_m = np.array([chase.least_distance_m for chase in self.chases])
        return {
            "capture_s_mean": float(capture_s.mean()),
            "capture_s_mean_ci95": mean_interval(capture_s),
            "capture_s_p50": nearest_rank_percentile(capture_s, 50),
            "capture_s_p50_ci95": percentile_interval(capture_s, 50),
            "capture_s_p90": nearest_rank_percentile(capture_s, 90),
            "capture_s_p90_ci95": percentile_interval(capture_s, 90),
            "captured_within_s": {limit: number / len(capture_s) for limit, number in within.items()},
            "captured_within_s_ci95": {
                limit: share_interval(number, len(capture_s)) for limit, number in within.items()
            },
            "least_distance_m_mean": float(least_m.mean()),
            "path_length_m_mean": float(np.mean([chase.path_length_m for chase in self.chases])),
        }

    def _following(self) -> dict[str, Any]:
        """How long the target was followed, where chases go on after the capture."""
        if any(chase.following_s is None for chase in self.chases):
            return {}
        following_s = np.array([chase.following_s for chase in self.chases])
        followed = int((following_s >= FOLLOWED_S).sum())
        return {
            "following_s_mean": float(following_s.mean()),
            "following_s_mean_ci95": mean_interval(following_s),
            f"followed_{FOLLOWED_S:g}_s": followed / len(following_s),
            f"followed_{FOLLOWED_S:g}_s_ci95": share_interval(followed, len(following_s)),
        }

    def _belief(self) -> dict[str, Any]:
        """What the controller's belief is worth, where it has one. Medians are over chases, of a chase's own medians;
        after a time, over the chases that last so long.
        """
        if any(chase.belief_decisions is None for chase in self.chases):
            return {}
        held, decisions, radius_m, error_m = (
            np.array([getattr(chase, f"belief_{what}") for chase in self.chases])
            for what in ("held", "decisions", "radius_m", "error_m")
        )
        after_m = {
            f"{after}": [
                error for chase in self.chases if (error := getattr(chase, f"belief_error_{after}_m")) is not None
            ]
            for after in BELIEF_AFTER
        }
        return {
            "belief_coverage_95": float(held.sum() / decisions.sum()),
            "belief_coverage_95_ci95": ratio_interval(held, decisions),
            "belief_radius_m_p50": nearest_rank_percentile(radius_m, 50),
            "belief_error_m_p50": nearest_rank_percentile(error_m, 50),
            "belief_error_m_p50_after": {
                after: nearest_rank_percentile(errors, 50) for after, errors in after_m.items() if errors
            },
        }

    def save_parquet(self, path: Path) -> None:
        """Write one row a chase, with everything needed to redo it in the file's metadata, whole or not at all."""
        import pyarrow as pa

        times = {f"tracking_time_{speed:g}mps_s": time_s for speed, time_s in self._times_s().items()}
        origin = {
            "version": __version__,
            "scenario": self.scenario.to_dict(),
            "world": (self.world or self.scenario).to_dict(),
            "controller": self.controller,
            "action_choice": self.action_choice,
            "weights": self.weights,
            "seed": self.seed,
        }
        write_table(path, pa.table({**chase_columns(self.chases), **times}), origin, compression="snappy")

    def _times_s(self) -> dict[float, NDArray[np.float64]]:
        """The time of each chase at each speed; a failed chase's is that of the windows it heard."""
        world = self.world or self.scenario
        movements = np.minimum([chase.movements for chase in self.chases], world.max_movements)
        path_length_m = np.array([chase.path_length_m for chase in self.chases])
        return {speed: tracking_time_s(world, movements, path_length_m, speed) for speed in SPEEDS_MPS}


def evaluate(
    scenario: Scenario,
    controller: str,
    episodes: int,
    seed: int,
    action_choice: ActionChoice | None = None,
    batch_size: int = DEFAULT_BATCH_SIZE,
    processes: int = 1,
    finished: Callable[[int], None] | None = None,
    first_chase: int = 0,
    world: Scenario | None = None,
) -> Evaluation:
    """Run ``episodes`` chases of ``controller`` (a name or the path of a weights file), from number ``first_chase`` on.

    The controller is told ``scenario``; the chases are in ``world`` where that is given.

    ``finished`` is told the number of chases that have ended: 0 when all is checked and work begins, then each time
    some end, and now and then while none does. What it raises ends the evaluation.

    Raises:
        InputError: no episodes, no batch, an unknown controller, a broken weights file, or a world in which no chase
            can be flown.
        WorkerDiedError: a process was killed, or failed with the error it printed.
        Interrupted: a process was told to stop by a signal.
    """
    for name, value in (("episodes", episodes), ("batch_size", batch_size), ("processes", processes)):
        checked_number(name, value, AT_LEAST_ONE)
    for name, value in (("seed", seed), ("first_chase", first_chase)):
        checked_number(name, value, AT_LEAST_ZERO)
    require_controller(controller, scenario)
    require_world(world or scenario)
    work = _Work(scenario, world or scenario, controller, action_choice, seed, batch_size)
    chases: list[ChaseResult] = []
    report = finished or (lambda _chases: None)
    report(0)
    chosen = range(first_chase, first_chase + episodes)
    for result in _run(work, chosen, min(processes, math.ceil(episodes / SHARE_CHASES))):
        chases += [] if result is None else [result]
        report(len(chases))
    in_order = sorted(chases, key=lambda chase: chase.chase)
    return Evaluation(scenario, controller, action_choice, seed, in_order, world)


@dataclass(frozen=True)
class _Work:
    """What a process needs to run chases; small enough to send."""

    told: Scenario
    world: Scenario
    controller: str
    action_choice: ActionChoice | None
    seed: int
    batch_size: int

    def run(self, chases: range) -> Iterator[ChaseResult]:
        controller = load_controller(self.controller, self.told, self.action_choice)
        return run_chases(self.world, controller, self.seed, chases, self.batch_size)


def _run(work: _Work, chases: range, processes: int) -> Iterator[ChaseResult | None]:
    """The results of all chases, in whatever order they end; None where none has ended for a while."""
    if processes == 1:
        yield from work.run(chases)
        return
    start_helper()
    context = multiprocessing.get_context("spawn")
    running: dict[connection.Connection, multiprocessing.process.BaseProcess] = {}
    try:
        with starting_children():
            for number in range(processes):
                share = chases[number * len(chases) // processes : (number + 1) * len(chases) // processes]
                receiver, sender = context.Pipe(duplex=False)
                process = context.Process(target=_run_share, args=(work, share, sender), daemon=True)
                process.start()
                sender.close()
                running[receiver] = process
        yield from _received(dict(running))
    finally:
        for one in running.values():
            one.kill()  # it leaves other signals to this process
        for one in running.values():
            one.join()


def _received(
    running: "dict[connection.Connection, multiprocessing.process.BaseProcess]",
) -> Iterator[ChaseResult | None]:
    """What the processes send until each has ended well, and None now and then; a process that dies closes its pipe."""
    while running:
        ready = connection.wait(list(running), LOOK_S)
        if not ready:
            yield None
        for receiver in ready:
            assert isinstance(receiver, connection.Connection)
            try:
                message = receiver.recv()
            except (EOFError, OSError):
                process = running.pop(receiver)
                process.join()
                if process.exitcode != 0:
                    raise WorkerDiedError(
                        f"a process of the evaluation died with exit code {process.exitcode} (a negative one is the "
                        "signal that killed it; 9 is what a machine out of memory sends)"
                    ) from None
                continue
            if isinstance(message, InputError | Interrupted):
                raise message
            yield message


def _run_share(work: _Work, chases: range, sender: connection.Connection) -> None:
    """The whole life of a process: send every result, or why its input was refused."""
    request = begin_child()
    torch.set_num_threads(1)
    keep_freed_memory()
    with sender:
        try:
            for result in work.run(chases):
                sender.send(Interrupted(request.number) if request.made else result)
        except InputError as error:
            sender.send(error)
