"""How near vehicles truly come in thousands of situations made for it (``simulation.encounters``), and how often which
evasion was used. Each situation is a line of a file as soon as it is flown, and is not flown again.
"""

import json
import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..files import require_writable_file
from ..live.service.separation import MARGIN_M, STRAYING_M
from ..simulation.encounters import SEPARATIONS_M, Encounter, fly, from_json, situation, to_json

if TYPE_CHECKING:
    from rich.table import Table

Finished = Callable[[int], None]
"""Is told how many situations have been flown."""


def measure(situations: int, seed: int, processes: int, checkpoint: Path, finished: Finished) -> dict[str, Any]:
    """Situations ``seed``, ``seed`` + 1, ...

    Raises:
        InputError: a checkpoint that cannot be written, or that holds something else.
    """
    wanted = range(seed, seed + situations)
    require_writable_file(checkpoint, replaces=True)
    flown = {one.seed: one for one in _read(checkpoint)}
    left = [number for number in wanted if number not in flown]
    with open(checkpoint, "a", encoding="utf-8") as file:
        for encounter in _fly(left, processes):
            flown[encounter.seed] = encounter
            file.write(json.dumps(to_json(encounter)) + "\n")
            file.flush()
            finished(len(flown.keys() & set(wanted)))
    return _summary([flown[number] for number in wanted], seed)


def table(result: dict[str, Any]) -> "Table":
    """What people see."""
    from rich.table import Table

    shown = Table(
        "Limit (m)", "Situations", "Least true separation (m)", "Seed", "Promised (m)", "Least to spare (m)", "Seed"
    )
    for one in result["limits"]:
        shown.add_row(
            f"{one['limit_m']:g}",
            str(one["situations"]),
            f"{one['least_m']:.2f}",
            str(one["least_seed"]),
            f"{one['promised_m']:.2f}",
            f"{one['spare_m']:.2f}",
            str(one["spare_seed"]),
        )
    used = ", ".join(f"{word} {times}" for word, times in result["evasions"].items())
    shown.caption = f"{result['below']} below what is promised; {result['movements']} movements; {used}"
    return shown


def _read(checkpoint: Path) -> list[Encounter]:
    """Without the last line if that was cut: its situation is flown again."""
    if not checkpoint.exists():
        return []
    try:
        with open(checkpoint, "r+b") as file:
            whole, newline, _ = file.read().rpartition(b"\n")
            file.truncate(len(whole + newline))
        return [from_json(json.loads(line)) for line in whole.splitlines()]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"checkpoint {checkpoint} is refused: {error}") from error


def _fly(seeds: list[int], processes: int) -> Iterator[Encounter]:
    if processes == 1:
        yield from map(_flown, seeds)
        return
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield from pool.imap_unordered(_flown, seeds)


def _flown(seed: int) -> Encounter:
    return fly(situation(seed))


def _summary(encounters: list[Encounter], seed: int) -> dict[str, Any]:
    evasions: Counter[str] = Counter()
    for one in encounters:
        evasions.update(one.evasions)
    return {
        "situations": len(encounters),
        "seed": seed,
        "margin_m": MARGIN_M,
        "straying_m": STRAYING_M,
        "below": sum(one.spare_m < 0 for one in encounters),
        "movements": sum(one.movements for one in encounters),
        "evasions": dict(sorted(evasions.items())),
        "limits": [
            _of_limit(limit_m, [one for one in encounters if one.limit_m == limit_m])
            for limit_m in SEPARATIONS_M
            if any(one.limit_m == limit_m for one in encounters)
        ],
    }


def _of_limit(limit_m: float, encounters: list[Encounter]) -> dict[str, Any]:
    nearest = min(encounters, key=lambda one: one.least_m)
    scarcest = min(encounters, key=lambda one: one.spare_m)
    return {
        "limit_m": limit_m,
        "situations": len(encounters),
        "least_m": nearest.least_m,
        "least_seed": nearest.seed,
        "promised_m": scarcest.limit_m - scarcest.margin_m,
        "spare_m": scarcest.spare_m,
        "spare_seed": scarcest.seed,
    }
