"""The paper's Section IV: its twelve settings evaluated, block by block, into one table.

Beside ``paper`` in all twelve, ``paper-a3c`` is evaluated where one was trained, in a fifth of the chases, and the
oracle once: it hears nothing, so all settings are one to it. A finished block is kept on disk; a run that was
interrupted goes on behind the last one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import __version__
from ..batch.streams import ChaseKey
from ..channel.fading import fading_db
from ..channel.fading_process import first_window
from ..controllers import weights_sha256
from ..controllers.shipped import WEIGHTS_FOLDER, setting_name, shipped_families
from ..errors import InputError
from ..scenario import Scenario, paper_scenario
from .blocks import Finished, Job, Runner, Unkept, evaluate_jobs
from .chases import ChaseResult
from .paper_results import SAMPLING_HZ, SPATIAL_CORRELATION
from .table import Evaluation
from .tables import Document, Row, checked_row, read_document, read_rows, read_table, write_table

if TYPE_CHECKING:
    import pyarrow as pa

COMPARISON_SHARE = 5
"""``paper-a3c`` is evaluated in one of so many chases: the first ones."""
TABLE_FILE = "reproduction.parquet"
FADING_FILE = "fading.parquet"
TRAINING_LOG = WEIGHTS_FOLDER / "paper-a3c" / "F10-rho0.9-training.parquet"
FADING_SETTINGS = ((20.0, 0.1), (10.0, 0.9))
"""(F, rho) of Fig. 3 (a) and (b)."""


@dataclass(frozen=True)
class Cell:
    """One controller in one of the paper's settings."""

    controller: str
    sampling_hz: float
    spatial_correlation: float

    @property
    def name(self) -> str:
        """Its name in files and messages."""
        return f"{self.controller}-{setting_name(self.sampling_hz, self.spatial_correlation)}"

    def episodes(self, of_twelve: int) -> int:
        """Its chases where the twelve settings have so many each."""
        return max(min(1, of_twelve), of_twelve // COMPARISON_SHARE) if self.controller == "paper-a3c" else of_twelve

    @property
    def scenario(self) -> Scenario:
        """Table I with this F and rho."""
        return paper_scenario(sampling_hz=self.sampling_hz, spatial_correlation=self.spatial_correlation)


def cells() -> list[Cell]:
    """What is evaluated, the easy settings first; of ``paper-a3c`` what this installation holds."""
    twelve = [(sampling_hz, rho) for rho in reversed(SPATIAL_CORRELATION) for sampling_hz in SAMPLING_HZ]
    a3c = {one.setting for one in shipped_families().get("paper-a3c", []) if one.is_here}
    return [
        Cell("oracle", *twelve[0]),
        *(Cell("paper", *setting) for setting in twelve),
        *(Cell("paper-a3c", *setting) for setting in twelve if setting in a3c),
    ]


def reproduce(
    folder: Path,
    episodes: int,
    seed: int,
    processes: int,
    finished: Finished | None = None,
    runner: Runner | None = None,
    unkept: Unkept | None = None,
) -> list[Evaluation]:
    """Evaluate every cell: its blocks lie in ``folder``, and ``save_evaluations`` makes a table.

    The chases run in processes of this machine, or by ``runner`` where that is given.

    Raises:
        InputError: no episodes, a folder that cannot be written, or one with the table of another run.
        WorkerDiedError: a process was killed.
    """
    _require_same_command(folder / TABLE_FILE, _command(episodes, seed))
    jobs = [Job(cell.name, cell.controller, cell.scenario, cell.scenario, cell.episodes(episodes)) for cell in cells()]
    return evaluate_jobs(folder, jobs, seed, processes, finished, runner, unkept)


def save_evaluations(folder: Path, evaluations: Sequence[Evaluation]) -> None:
    """Write the table, one row a chase, and the fading examples.

    Raises:
        InputError: they cannot be written.
    """
    write_table(folder / TABLE_FILE, _movement_table(evaluations), _movement_document(evaluations))
    save_fading(folder, evaluations[0].seed)


def save_fading(folder: Path, seed: int) -> None:
    """Write the fading examples, of chase 0 of this seed.

    Raises:
        InputError: they cannot be written.
    """
    write_table(folder / FADING_FILE, fading_table(seed), _fading_document(seed))


def _command(episodes: int, seed: int) -> str:
    return f"swarmchase reproduce --episodes {episodes} --seed {seed}"


def _require_same_command(path: Path, command: str) -> None:
    if not path.exists():
        return
    try:
        before = read_document(path, "reproduction table").get("command", "something else")
    except InputError:
        before = "something else"
    if before != command:
        raise InputError(f"{path} was made by {before!r}, not by {command!r}: choose another folder")


def _movement_table(evaluations: Sequence[Evaluation]) -> "pa.Table":
    """One row a chase of every cell."""
    import pyarrow as pa

    rows = [(one, chase) for one in evaluations for chase in one.chases]
    columns = {
        "controller": pa.array([one.controller for one, _ in rows]).dictionary_encode(),
        "sampling_hz": [one.scenario.sampling_hz for one, _ in rows],
        "spatial_correlation": [one.scenario.spatial_correlation for one, _ in rows],
        "seed": [chase.seed for _, chase in rows],
        "chase": pa.array([chase.chase for _, chase in rows], pa.int32()),
        "movements": pa.array([chase.movements for _, chase in rows], pa.int16()),
        "reached": [chase.reached for _, chase in rows],
        "path_length_m": [chase.path_length_m for _, chase in rows],
    }
    return pa.table(columns)


def _movement_document(evaluations: Sequence[Evaluation]) -> Document:
    """What is needed to redo the chases."""
    return {
        "version": __version__,
        "command": _command(len(evaluations[0].chases), evaluations[0].seed),
        "weights_sha256": {
            Cell(one.controller, one.scenario.sampling_hz, one.scenario.spatial_correlation).name: weights_sha256(
                one.controller, one.scenario
            )
            for one in evaluations
        },
        "scenario": paper_scenario().to_dict(),
        "differs_by_row": ["sampling_hz", "spatial_correlation"],
    }


def read_evaluations(path: Path) -> list[Evaluation]:
    """The evaluations of a table that ``reproduce`` wrote; where their targets were is not in it.

    Raises:
        InputError: no such file, or not such a table.
    """
    return read_table(path, "reproduction table", _parsed_evaluations)


def _parsed_evaluations(rows: list[Row], _document: Document) -> list[Evaluation]:
    by_cell: dict[tuple[str, float, float], list[ChaseResult]] = {}
    nowhere = float("nan")
    for row in rows:
        key = (row.pop("controller"), row.pop("sampling_hz"), row.pop("spatial_correlation"))
        where = {"target_x_m": nowhere, "target_y_m": nowhere, "target_z_m": nowhere}
        by_cell.setdefault(key, []).append(checked_row(ChaseResult, where | row))
    return [Evaluation(Cell(*key).scenario, key[0], None, chases[0].seed, chases) for key, chases in by_cell.items()]


def fading_table(seed: int) -> "pa.Table":
    """Fig. 3: the fading of six trackers through one window, in two settings; time in seconds, fading in dB."""
    import pyarrow as pa

    rows = [row for setting in FADING_SETTINGS for row in _fading_rows(*setting, key=(seed, 0))]
    return pa.Table.from_pylist(rows)


def _fading_document(seed: int) -> Document:
    return {"version": __version__, "seed": seed, "scenario": paper_scenario().to_dict()}


def _fading_rows(sampling_hz: float, spatial_correlation: float, key: ChaseKey) -> Iterator[dict[str, Any]]:
    scenario = paper_scenario(sampling_hz=sampling_hz, spatial_correlation=spatial_correlation)
    fading = fading_db(first_window(scenario, [key]))[0].numpy().astype(np.float64)
    for tracker, trace in enumerate(fading):
        for sample, value in enumerate(trace):
            yield {
                "sampling_hz": sampling_hz,
                "spatial_correlation": spatial_correlation,
                "tracker": tracker,
                "time_s": sample / sampling_hz,
                "fading_db": float(value),
            }


def training_log() -> list[dict[str, Any]]:
    """The chases of the training that made ``paper-a3c`` for F = 10 Hz, rho = 0.9, as in a run's log: Fig. 4's data."""
    return read_rows(TRAINING_LOG, "training log")
