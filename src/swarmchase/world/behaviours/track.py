"""``path/to/track.csv``: flies where somebody flew before, from its own start.

The file is a table with a header line, ``time_s,x_m,y_m,z_m`` or ``time_s,east_m,north_m,up_m``; other columns are
passed over. Between two rows the way is straight; after the last the target hovers.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ...batch.array_types import Float, Tensor
from ...batch.streams import ChaseKey
from ...errors import InputError
from ...flight import direction, length
from ...ranges import MOST_SHOWN_CHARACTERS, shown
from ...reading import opened_table
from ...scenario import Scenario
from .protocol import Swarm, Target
from .steering import Steering

COLUMNS = (("time_s", "x_m", "y_m", "z_m"), ("time_s", "east_m", "north_m", "up_m"))
MOST_ROWS = 1_000_000
"""Of a track: a day at ten a second."""
SETTLING_S = 0.5
"""What is left of the way to the track shrinks to 1 / e in this time, where that is little."""


@dataclass(frozen=True)
class Progress:
    """From where each target began the track, and when in the track it is."""

    origin_m: Float[Tensor, "chase 3"]
    time_s: Float[Tensor, "chase"]


class Track:
    """A ``Behaviour`` that follows a recorded track as well as the scenario's limits allow.

    Where the track is faster than ``target_speed_mps`` it falls behind, and catches up later.

    Raises:
        InputError: the file cannot be read, or is no track.
    """

    is_still = False

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._steering = Steering(scenario)
        self._device = torch.device(device)
        rows = torch.tensor(read_track(Path(scenario.behaviour)), dtype=torch.float64)
        time_s, place_m = rows[:, 0], rows[:, 1:] - rows[0, 1:]
        # Rows of the same moment have a jump between them, and no time in which it could be flown.
        velocity_mps = place_m.diff(dim=0) / time_s.diff().clamp_min(1e-9)[:, None]
        self._time_s = (time_s - time_s[0]).to(self._device)
        self._place_m = place_m.to(self._device)
        self._velocity_mps = torch.cat([velocity_mps, torch.zeros(1, 3, dtype=torch.float64)]).to(self._device)

    def begin(self, keys: Sequence[ChaseKey], start_m: Float[Tensor, "chase 3"]) -> Target:
        """At rest where the track begins."""
        start_m = start_m.to(self._device)
        return Target.at_rest(start_m, Progress(start_m, torch.zeros_like(start_m[:, 0])))

    def fly(self, target: Target, seconds: Float[Tensor, "chase"], swarm: Swarm) -> Target:
        """With the track's velocity, and towards where it is now; half of the acceleration is kept to stop there."""
        plan: Progress = target.plan
        row = torch.searchsorted(self._time_s, plan.time_s, right=True) - 1
        velocity_mps = self._velocity_mps[row]
        place_m = plan.origin_m + self._place_m[row] + velocity_mps * (plan.time_s - self._time_s[row])[:, None]
        place_m[:, 2] = self._steering.band.inside_m(place_m[:, 2])
        left_m = place_m - target.position_m
        distance_m = length(left_m)[:, None]
        stopping_mps = (self._steering.acceleration_mps2 * distance_m).sqrt_()
        wanted_mps = velocity_mps + direction(left_m) * torch.minimum(stopping_mps, distance_m / SETTLING_S)
        return self._steering.flown(target, wanted_mps, seconds, Progress(plan.origin_m, plan.time_s + seconds))


def read_track(path: Path) -> list[tuple[float, ...]]:
    """Rows of seconds and three places in metres.

    Raises:
        InputError: the file cannot be read, lacks a column, goes back in time, or has a row without four finite
            numbers, fewer than two rows or more than ``MOST_ROWS``.
    """
    rows: list[tuple[float, ...]] = []
    with opened_table(path, "track") as table:
        given = table.fieldnames or []
        columns = next((names for names in COLUMNS if set(names) <= set(given)), None)
        if columns is None:
            needed = " or ".join(",".join(names) for names in COLUMNS)
            raise InputError(f"track {path} needs columns {needed}: it has {','.join(given)[:MOST_SHOWN_CHARACTERS]}")
        for number, fields in enumerate(table, start=1):
            row = tuple(_number(path, number, name, fields[name]) for name in columns)
            if rows and row[0] < rows[-1][0]:
                raise InputError(
                    f"track {path} goes back in time: row {number} is of {row[0]:g} s, after {rows[-1][0]:g} s"
                )
            rows.append(row)
            if len(rows) > MOST_ROWS:
                raise InputError(f"track {path} has more than {MOST_ROWS} rows")
    if len(rows) < 2:
        raise InputError(f"track {path} has too few rows: {len(rows)}, needed are at least 2")
    return rows


def _number(path: Path, row: int, column: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"track {path}: row {row} has {column} = {shown(value)}; a finite number is needed")
    return number
