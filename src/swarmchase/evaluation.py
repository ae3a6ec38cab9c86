"""A controller over N chases: one table on disk, one row a chase, and its summary with confidence intervals.

The chases are split into blocks over processes; a chase is a function of its key alone, so the table is the same for
any batch size and any number of processes.
"""

import dataclasses
import json
import math
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.stats import binom

from . import __version__
from .chases import DEFAULT_BATCH_SIZE, ChaseResult, nearest_rank_percentile, run_chases
from .controllers import ActionChoice, load_controller
from .errors import InputError
from .files import atomic_path
from .scenario import Scenario

SPEEDS_MPS = (2.0, 5.0)
"""Tracker speeds of Fig. 7."""
BLOCK_CHASES = 500
"""Chases a process takes at a time."""
CONFIDENCE = 0.95


def tracking_time_s(scenario: Scenario, movements: int, path_length_m: float, speed_mps: float) -> float:
    """tau(M, F) = M L / F + sum of d_m / v (Section IV)."""
    return movements * scenario.window_s + path_length_m / speed_mps


@dataclass(frozen=True)
class Evaluation:
    """The chases of one controller in one scenario."""

    scenario: Scenario
    controller: str
    action_choice: ActionChoice | None
    seed: int
    chases: Sequence[ChaseResult]
    """In the order of their numbers."""

    def summary(self) -> dict[str, Any]:
        """The figures of one row of a results table.

        Failed chases count as MAX_STEPS + 1 movements and are never dropped.
        """
        movements = np.array([chase.movements for chase in self.chases])
        reached = sum(chase.reached for chase in self.chases)
        return {
            "controller": self.controller,
            "action_choice": self.action_choice,
            "sampling_hz": self.scenario.sampling_hz,
            "spatial_correlation": self.scenario.spatial_correlation,
            "episodes": len(self.chases),
            "seed": self.seed,
            "success_rate": reached / len(self.chases),
            "movements_mean": float(movements.mean()),
            "movements_mean_ci95": mean_interval(movements),
            "movements_p50": nearest_rank_percentile(movements, 50),
            "movements_p50_ci95": percentile_interval(movements, 50),
            "movements_p90": nearest_rank_percentile(movements, 90),
            "movements_p90_ci95": percentile_interval(movements, 90),
            "movements_max": int(movements.max()),
            "tracking_time_mean_s": {f"{speed:g}": float(np.mean(self._times_s(speed))) for speed in SPEEDS_MPS},
            "version": __version__,
        }

    def save_parquet(self, path: Path) -> None:
        """Write one row a chase, with everything needed to redo it in the file's metadata, whole or not at all."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = {
            field.name: [getattr(chase, field.name) for chase in self.chases]
            for field in dataclasses.fields(ChaseResult)
        }
        times = {f"tracking_time_{speed:g}mps_s": self._times_s(speed) for speed in SPEEDS_MPS}
        origin = {
            "version": __version__,
            "scenario": self.scenario.to_dict(),
            "controller": self.controller,
            "action_choice": self.action_choice,
            "seed": self.seed,
        }
        table = pa.table({**columns, **times}).replace_schema_metadata({"swarmchase": json.dumps(origin)})
        with atomic_path(path) as temporary:
            pq.write_table(table, temporary)

    def _times_s(self, speed_mps: float) -> list[float]:
        return [
            tracking_time_s(
                self.scenario, min(chase.movements, self.scenario.max_movements), chase.path_length_m, speed_mps
            )
            for chase in self.chases
        ]


def percentile_interval(values: "np.ndarray[Any, Any]", percent: float) -> list[float]:
    """A 95 % confidence interval of a percentile from order statistics: binomial, whatever the distribution."""
    ordered = np.sort(values)
    share = (1 - CONFIDENCE) / 2
    low = int(binom.ppf(share, len(ordered), percent / 100))
    high = int(binom.ppf(1 - share, len(ordered), percent / 100)) + 1
    return [float(ordered[max(0, low - 1)]), float(ordered[min(len(ordered) - 1, high - 1)])]


def mean_interval(values: "np.ndarray[Any, Any]") -> list[float]:
    """A 95 % confidence interval of the mean, normal approximation."""
    half_width = 1.96 * float(values.std(ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.inf
    return [float(values.mean()) - half_width, float(values.mean()) + half_width]


def evaluate(
    scenario: Scenario,
    controller: str,
    episodes: int,
    seed: int,
    action_choice: ActionChoice | None = None,
    batch_size: int = DEFAULT_BATCH_SIZE,
    processes: int = 1,
    finished: Callable[[int], None] | None = None,
) -> Evaluation:
    """Run ``episodes`` chases of ``controller`` (a name or the path of a weights file).

    ``finished`` is told the number of chases that have ended: 0 when all is checked and work begins, then each time
    some end.

    Raises:
        InputError: no episodes, no batch, an unknown controller or a broken weights file.
    """
    for name, value in (("episodes", episodes), ("batch_size", batch_size), ("processes", processes)):
        if value < 1:
            raise InputError(f"{name} = {value} is refused: allowed is at least 1")
    if seed < 0:
        raise InputError(f"seed = {seed} is refused: allowed is at least 0")
    load_controller(controller, scenario, action_choice)
    block = _Block(scenario, controller, action_choice, seed, batch_size)
    firsts = range(0, episodes, BLOCK_CHASES)
    blocks = [range(first, min(first + BLOCK_CHASES, episodes)) for first in firsts]
    chases: list[ChaseResult] = []
    report = finished or (lambda _chases: None)
    report(0)
    for results in _run_blocks(block, blocks, min(processes, len(blocks))):
        chases.extend(results)
        report(len(chases))
    return Evaluation(scenario, controller, action_choice, seed, sorted(chases, key=lambda chase: chase.chase))


@dataclass(frozen=True)
class _Block:
    """What a process needs to run chases; small enough to send."""

    scenario: Scenario
    controller: str
    action_choice: ActionChoice | None
    seed: int
    batch_size: int

    def run(self, chases: range) -> Iterator[ChaseResult]:
        controller = load_controller(self.controller, self.scenario, self.action_choice)
        return run_chases(self.scenario, controller, self.seed, chases, self.batch_size)


def _run_blocks(block: _Block, blocks: Sequence[range], processes: int) -> Iterator[list[ChaseResult]]:
    """The results of all chases, some at a time, in whatever order they end."""
    if processes == 1:
        for chases in blocks:
            for result in block.run(chases):
                yield [result]
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        futures = [pool.submit(_run_block, block, chases) for chases in blocks]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _run_block(block: _Block, chases: range) -> list[ChaseResult]:
    return list(block.run(chases))
