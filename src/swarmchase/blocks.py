"""Evaluations of many controllers in many worlds, block by block: what is finished lies on disk and is found again."""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import __version__
from .chases import ChaseResult
from .controllers import load_controller, weights_path
from .errors import InputError
from .evaluation import Evaluation, evaluate
from .files import atomic_path, require_writable_folder
from .scenario import Scenario

if TYPE_CHECKING:
    import pyarrow as pa

BLOCK_CHASES = 2_500
"""Chases between two saves."""

Finished = Callable[[int, int, str], None]
"""Is told the chases that have ended in all, how many of them an earlier run had left, and the job at work."""


@dataclass(frozen=True)
class Job:
    """One controller in one world."""

    name: str
    """In messages and file names; another job has another one."""
    controller: str
    told: Scenario
    """What the controller is told."""
    world: Scenario
    """Where its chases are."""
    episodes: int


def evaluate_jobs(
    folder: Path, jobs: Sequence[Job], seed: int, processes: int, finished: Finished | None = None
) -> list[Evaluation]:
    """Chases 0, 1, ... of the seed for every job, in their order; those of finished blocks are read from ``folder``.

    Raises:
        InputError: no episodes, a folder that cannot be written, or a controller that is refused; before any work.
        WorkerDiedError: a process was killed.
    """
    for job in jobs:
        if job.episodes < 1:
            raise InputError(f"episodes = {job.episodes} is refused: allowed is at least 1")
    for controller, told in dict.fromkeys((job.controller, job.told) for job in jobs):
        load_controller(controller, told)
    if seed < 0:
        raise InputError(f"seed = {seed} is refused: allowed is at least 0")
    require_writable_folder(folder)
    count = _Count(finished or (lambda _chases, _found, _job: None))
    evaluations = []
    for job in jobs:
        count.job = job.name
        chases: list[ChaseResult] = []
        for first in range(0, job.episodes, BLOCK_CHASES):
            block = _Block(folder, job, seed, first, min(BLOCK_CHASES, job.episodes - first))
            kept = block.load()
            chases.extend(block.run(processes, count.running) if kept is None else kept)
            count.block_ended(block.episodes, found=kept is not None)
        evaluations.append(Evaluation(job.told, job.controller, None, seed, chases, job.world))
    return evaluations


def weights_sha256(controller: str, scenario: Scenario) -> str | None:
    """Which weights a trained controller has; None for one that has none."""
    path = weights_path(controller, scenario)
    return None if path is None else hashlib.sha256(path.read_bytes()).hexdigest()


def save_table(path: Path, table: "pa.Table") -> None:
    """Write a Parquet file, whole or not at all."""
    import pyarrow.parquet as pq

    with atomic_path(path) as temporary:
        pq.write_table(table, temporary, compression="zstd")


@dataclass
class _Count:
    """Chases that have ended in all, and those of them that were found on disk."""

    report: Finished
    job: str = ""
    ended: int = 0
    found: int = 0

    def running(self, chases: int) -> None:
        """So many of the block at work have ended."""
        self.report(self.ended + chases, self.found, self.job)

    def block_ended(self, chases: int, found: bool) -> None:
        """A block is complete."""
        self.ended += chases
        self.found += chases if found else 0
        self.report(self.ended, self.found, self.job)


@dataclass(frozen=True)
class _Block:
    """Some chases of a job, kept on disk when they are done."""

    folder: Path
    job: Job
    seed: int
    first_chase: int
    episodes: int

    @property
    def path(self) -> Path:
        name = f"{self.job.name}-seed{self.seed}-{self.first_chase}-{self.episodes}.parquet"
        return self.folder / "blocks" / name

    @property
    def origin(self) -> dict[str, Any]:
        """What its chases are a function of: another origin is another block."""
        return {
            "version": __version__,
            "controller": self.job.controller,
            "weights_sha256": weights_sha256(self.job.controller, self.job.told),
            "scenario": self.job.told.to_dict(),
            "world": self.job.world.to_dict(),
            "seed": self.seed,
            "first_chase": self.first_chase,
            "episodes": self.episodes,
        }

    def load(self) -> list[ChaseResult] | None:
        """What an earlier run kept of this very block."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            table = pq.read_table(self.path)
            if json.loads(table.schema.metadata[b"swarmchase"]) != self.origin:
                return None
            return [ChaseResult(**row) for row in table.to_pylist()]
        except (OSError, pa.ArrowInvalid, KeyError, TypeError, ValueError):
            return None

    def run(self, processes: int, finished: Callable[[int], None]) -> list[ChaseResult]:
        # Before the chases: a weights file changed while they run must not be taken for theirs.
        metadata = {"swarmchase": json.dumps(self.origin)}
        result = evaluate(
            self.job.told,
            self.job.controller,
            self.episodes,
            self.seed,
            processes=processes,
            finished=finished,
            first_chase=self.first_chase,
            world=self.job.world,
        )
        import pyarrow as pa

        chases = list(result.chases)
        table = pa.Table.from_pylist([dataclasses.asdict(chase) for chase in chases])
        require_writable_folder(self.path.parent)
        save_table(self.path, table.replace_schema_metadata(metadata))
        return chases
