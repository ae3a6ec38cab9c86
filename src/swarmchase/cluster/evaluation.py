"""Blocks of chases as tasks on a cluster: the runner that ``evaluation.blocks.evaluate_jobs`` takes for its processes.

A block is cut into parts, a task each; what has ended of a block that is not complete lies on disk like a block of its
own, and is found again.
"""

import functools
import itertools
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from ..batch.freed_memory import keep_freed_memory
from ..controllers import controller_names
from ..errors import WorkerDiedError
from ..evaluation.blocks import Block, Runner, Running, run_block
from ..evaluation.chases import ChaseResult
from ..networks.weights import read_weights
from ..processes.temporary_folder import temporary_folder
from .connection import Cluster, own_error
from .software import installed, require_same_software

PART_CHASES = 500
"""Chases of a task: some seconds to some tens of seconds of a CPU."""
PART_LIMIT_S = 3_600.0
"""Between two parts that end."""
POLL_S = 1.0
"""How often the clock is looked at while nothing ends."""
RETRIES = 10
"""Of a part whose node or process dies under it."""
PARTS_A_CPU = 4
"""Parts handed to the cluster at a time: one to be at work on, the others to go on with."""


def on_cluster(cluster: Cluster, batch_size: int | None = None) -> Runner:
    """Runs blocks on a cluster, in parts; the chases are those that this machine would give.

    The runner raises:
        InputError: a node that joined has other software, or a part was refused there.
        WorkerDiedError: a part failed with an error, its processes die again and again, or nothing ends.
    """

    def run(blocks: Sequence[Block], running: Running) -> Iterator[tuple[Block, list[ChaseResult]]]:
        parts = {block: block.parts(PART_CHASES) for block in blocks}
        block_of = {part: block for block, its in parts.items() for part in its}
        kept = {part: chases for part in block_of if (chases := part.load()) is not None}
        found = sum(part.episodes for part in kept)
        ended: dict[Block, list[ChaseResult]] = {}
        missing = [part for part in block_of if part not in kept]

        def report(part: Block) -> None:
            running(sum(one.episodes for one in ended), min(found, sum(map(len, ended.values()))), part.job.name)

        for part, chases in itertools.chain(kept.items(), _ended_parts(cluster, missing, batch_size, report)):
            ended[part] = chases
            block = block_of[part]
            if all(one in ended for one in parts[block]):
                yield block, [chase for one in parts[block] for chase in ended.pop(one)]
                _forget(parts[block], block)
            report(part)

    return run


def _forget(parts: Sequence[Block], block: Block) -> None:
    """The block is on disk as a whole."""
    for part in parts:
        if part != block:
            part.path.unlink(missing_ok=True)


def _ended_parts(
    cluster: Cluster, parts: Sequence[Block], batch_size: int | None, wait: Callable[[Block], None]
) -> Iterator[tuple[Block, list[ChaseResult]]]:
    """Each part as it ends, and has been saved; ``wait`` is told one that is at work, now and then."""
    ray = cluster.ray
    task = ray.remote(num_cpus=1, max_retries=RETRIES, scheduling_strategy="SPREAD")(_chases)
    here = installed()
    weights = {part.job.controller: ray.put(_own_weights(part.job.controller)) for part in parts}
    origins = {part: part.origin for part in parts}
    waiting = list(reversed(parts))
    at_work: dict[Any, Block] = {}
    heard_s = time.monotonic()
    while waiting or at_work:
        while waiting and len(at_work) < PARTS_A_CPU * max(1, cluster.num_cpus()):
            part = waiting.pop()
            at_work[task.remote(part, weights[part.job.controller], batch_size, here)] = part
        for done in ray.wait(list(at_work), num_returns=1, timeout=POLL_S)[0]:
            part = at_work.pop(done)
            chases = _result(ray, done, part)
            part.save(chases, origins[part])
            yield part, chases
            heard_s = time.monotonic()
        for part in itertools.islice(at_work.values(), 1):
            wait(part)
        if time.monotonic() > heard_s + PART_LIMIT_S:
            raise WorkerDiedError(
                f"no chases have ended for {PART_LIMIT_S:g} s: {len(at_work)} parts wait for a CPU or are at work; "
                f"{cluster.shown_resources()}"
            )


def _result(ray: Any, done: Any, part: Block) -> list[ChaseResult]:
    try:
        chases: list[ChaseResult] = ray.get(done, timeout=PART_LIMIT_S)
    except ray.exceptions.RayTaskError as error:
        raise own_error(f"a part of {part.job.name}", error) from error
    except ray.exceptions.RayError as error:
        raise WorkerDiedError(f"a part of {part.job.name} was lost:\n{error}") from error
    return chases


def _own_weights(controller: str) -> bytes | None:
    """A weights file that only this machine has; None for a controller that comes with the package."""
    return None if controller in controller_names() else read_weights(Path(controller))


def _chases(
    part: Block, weights: bytes | None, batch_size: int | None, expected: dict[str, str | None]
) -> list[ChaseResult]:
    """The chases of a part, on some node."""
    torch.set_num_threads(1)
    keep_freed_memory()
    require_same_software(socket.gethostname(), _installed_once(), expected)
    if weights is None:
        return run_block(part, batch_size=batch_size)
    with temporary_folder("swarmchase-weights-") as folder:
        file = folder / "given.safetensors"
        file.write_bytes(weights)
        return run_block(replace(part, job=replace(part.job, controller=str(file))), batch_size=batch_size)


_installed_once = functools.cache(installed)
