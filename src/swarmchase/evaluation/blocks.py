"""Evaluations of many controllers in many worlds, block by block: what is finished lies on disk and is found again."""

import dataclasses
import functools
import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import __version__
from ..controllers import ActionChoice, require_controller, weights_sha256
from ..errors import InputError
from ..files import require_writable_folder
from ..ranges import AT_LEAST_ONE, AT_LEAST_ZERO, checked_number
from ..scenario import Scenario
from ..world.environment import require_world
from .chases import DEFAULT_BATCH_SIZE, ChaseResult, chase_columns
from .table import Evaluation, evaluate
from .tables import Document, Row, checked_row, read_table, write_table

BLOCK_CHASES = 2_500
"""Chases between two saves."""

Unkept = Callable[[InputError], None]
"""Is told why a block could not be kept; the work goes on without."""
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
    action_choice: ActionChoice | None = None
    """How a learned controller acts; None is what its weights file says."""


@dataclass(frozen=True)
class Block:
    """Some chases of a job, kept on disk when they are done."""

    folder: Path
    job: Job
    seed: int
    first_chase: int
    episodes: int

    @property
    def path(self) -> Path:
        """Its file."""
        name = f"{self.job.name}-seed{self.seed}-{self.first_chase}-{self.episodes}.parquet"
        return self.folder / "blocks" / name

    @property
    def origin(self) -> dict[str, Any]:
        """What its chases are a function of: another origin is another block."""
        origin = {
            "version": __version__,
            "controller": self.job.controller,
            "weights_sha256": weights_sha256(self.job.controller, self.job.told),
            "scenario": self.job.told.to_dict(),
            "world": self.job.world.to_dict(),
            "seed": self.seed,
            "first_chase": self.first_chase,
            "episodes": self.episodes,
            "columns": [field.name for field in dataclasses.fields(ChaseResult)],
        }
        return origin if self.job.action_choice is None else origin | {"action_choice": self.job.action_choice}

    def load(self) -> list[ChaseResult] | None:
        """What an earlier run kept of this very block."""
        try:
            return read_table(self.path, "block", self._own_chases)
        except InputError:
            return None

    def save(self, chases: Sequence[ChaseResult], origin: dict[str, Any]) -> None:
        """Keep its chases. ``origin`` was taken before they ran: a weights file changed while they did must not be
        taken for theirs."""
        import pyarrow as pa

        table = pa.table(chase_columns(chases))
        require_writable_folder(self.path.parent)
        write_table(self.path, table, origin)

    def parts(self, episodes: int) -> list["Block"]:
        """The same chases in blocks of so many, the last of what is left."""
        end = self.first_chase + self.episodes
        return [
            dataclasses.replace(self, first_chase=first, episodes=min(episodes, end - first))
            for first in range(self.first_chase, end, episodes)
        ]

    def _own_chases(self, rows: list[Row], origin: Document) -> list[ChaseResult] | None:
        """None where they are another block's."""
        if origin != self.origin:
            return None
        chases = [checked_row(ChaseResult, row) for row in rows]
        if [chase.chase for chase in chases] != list(range(self.first_chase, self.first_chase + self.episodes)):
            raise ValueError("it does not hold the chases that it says")
        return chases


Running = Callable[[int, int, str], None]
"""Is told the chases of unfinished blocks that have ended, how many of them were found, and the job at work."""
Runner = Callable[[Sequence[Block], Running], Iterator[tuple[Block, list[ChaseResult]]]]
"""Runs blocks in any order and gives each with its chases as it ends: in processes, or on a cluster."""


def in_processes(processes: int) -> Runner:
    """Blocks one after another, each shared out to processes of this machine."""

    def run(blocks: Sequence[Block], running: Running) -> Iterator[tuple[Block, list[ChaseResult]]]:
        for block in blocks:
            told = functools.partial(_tell_running, running, block.job.name)
            yield block, run_block(block, processes, told)

    return run


def _tell_running(running: Running, name: str, chases: int) -> None:
    running(chases, 0, name)


def run_block(
    block: Block, processes: int = 1, finished: Callable[[int], None] | None = None, batch_size: int | None = None
) -> list[ChaseResult]:
    """The chases of a block, in the order of their numbers."""
    result = evaluate(
        block.job.told,
        block.job.controller,
        block.episodes,
        block.seed,
        block.job.action_choice,
        batch_size=DEFAULT_BATCH_SIZE if batch_size is None else batch_size,
        processes=processes,
        finished=finished,
        first_chase=block.first_chase,
        world=block.job.world,
    )
    return list(result.chases)


def evaluate_jobs(
    folder: Path,
    jobs: Sequence[Job],
    seed: int,
    processes: int,
    finished: Finished | None = None,
    runner: Runner | None = None,
    unkept: Unkept | None = None,
) -> list[Evaluation]:
    """Chases 0, 1, ... of the seed for every job, in their order; those of finished blocks are read from ``folder``.

    They run in processes of this machine, or by ``runner`` where that is given.

    Raises:
        InputError: no episodes, a folder that cannot be written, or a controller or world that is refused; before any
            work. Or the disk gets full and there is no ``unkept`` to tell.
        WorkerDiedError: a process was killed.
    """
    for job in jobs:
        checked_number("episodes", job.episodes, AT_LEAST_ONE)
    for controller, told in dict.fromkeys((job.controller, job.told) for job in jobs):
        require_controller(controller, told)
    for world in dict.fromkeys(job.world for job in jobs):
        require_world(world)
    checked_number("seed", seed, AT_LEAST_ZERO)
    require_writable_folder(folder)
    blocks = [block for job in jobs for block in Block(folder, job, seed, 0, job.episodes).parts(BLOCK_CHASES)]
    chases = {block: block.load() for block in blocks}
    missing = {block: block.origin for block, kept in chases.items() if kept is None}
    count = _Count(finished or (lambda _chases, _found, _job: None))
    for block, kept in chases.items():
        if kept is not None:
            count.block_ended(block, found=True)
    for block, result in (runner or in_processes(processes))(list(missing), count.running):
        chases[block] = result
        try:
            block.save(result, missing[block])
        except InputError as error:
            if unkept is None:
                raise
            unkept(error)
        count.block_ended(block, found=False)
    return [
        Evaluation(
            job.told,
            job.controller,
            job.action_choice,
            seed,
            [chase for block in blocks if block.job is job for chase in chases[block] or []],
            job.world,
        )
        for job in jobs
    ]


def file_name(text: str) -> str:
    """A file name that no other text has."""
    plain = re.sub(r"[^A-Za-z0-9.]+", "-", Path(text).stem if "/" in text else text).strip("-")
    return plain if plain == text else f"{plain}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


@dataclass
class _Count:
    """Chases that have ended in all, and those of them that were found on disk."""

    report: Finished
    ended: int = 0
    found: int = 0
    told: tuple[int, int] = (0, 0)

    def running(self, chases: int, found: int, job: str) -> None:
        """So many of unfinished blocks have ended."""
        self._tell(self.ended + chases, self.found + found, job)

    def block_ended(self, block: Block, found: bool) -> None:
        """A block is complete."""
        self.ended += block.episodes
        self.found += block.episodes if found else 0
        self._tell(self.ended, self.found, block.job.name)

    def _tell(self, chases: int, found: int, job: str) -> None:
        # Never less than before: a block that is complete says nothing of others that are at work with it.
        self.told = max(self.told[0], chases), max(self.told[1], found)
        self.report(*self.told, job)
