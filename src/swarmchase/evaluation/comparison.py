"""Controllers beside one another on the same chases: who needs fewer movements, and by how much.

Every controller of a comparison chases the same targets through the same fading, so that differences are taken chase by
chase. A world may differ from what the controllers are told (``world.departures``).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from .. import __version__
from ..controllers import load_controller, weights_sha256
from ..controllers.oracle import ORACLES
from ..controllers.shipped import setting_name
from ..errors import InputError
from ..scenario import Scenario
from ..world.departures import DEPARTURES, departed
from .blocks import Finished, Job, Runner, Unkept, evaluate_jobs, file_name
from .chases import ChaseResult, chase_columns
from .play import play
from .statistics import TAIL, mean_interval, nearest_rank_percentile, nearest_rank_percentiles
from .table import Evaluation
from .tables import Document, Row, checked_row, read_table, write_table

if TYPE_CHECKING:
    import pyarrow as pa

AS_TOLD = "as told"
"""The world that is what the controllers are told."""
TABLE_FILE = "comparison.parquet"
RESAMPLES = 1_000
"""Of the bootstrap for the difference of two percentiles."""
RESAMPLING_SEED = 0
TIMED_DECISIONS = 300
TIMING_SEED = 1 << 60
"""Of the chases in which decisions are timed."""
WARM_UP_DECISIONS = 10
_OPTIONAL_COLUMNS = [field.name for field in fields(ChaseResult) if field.default is None]


@dataclass(frozen=True)
class Place:
    """What controllers are told, and the world they are in."""

    told: Scenario
    world_name: str
    world: Scenario

    @property
    def name(self) -> str:
        """In messages and file names."""
        setting = setting_name(self.told.sampling_hz, self.told.spatial_correlation)
        return setting if self.world_name == AS_TOLD else f"{setting}-{file_name(self.world_name)}"


@dataclass(frozen=True)
class Result:
    """One controller in one place."""

    place: Place
    evaluation: Evaluation


def places(told: Sequence[Scenario], departures: bool) -> list[Place]:
    """Each scenario as told; with ``departures`` also in every other world of the robustness table."""
    names = DEPARTURES if departures else [AS_TOLD]
    every = [Place(one, name, departed(one, name)) for one in told for name in names]
    return [place for place in every if place.world_name == AS_TOLD or place.world != place.told]


def comparison_jobs(controllers: Sequence[str], where: Sequence[Place], episodes: int) -> list[tuple[Place, Job]]:
    """Every controller in every place.

    Raises:
        InputError: no controller, or one of them twice.
    """
    if not controllers:
        raise InputError("no controllers to compare: give at least one")
    for number, controller in enumerate(controllers):
        if controller in controllers[:number]:
            raise InputError(f"controller {controller!r} is given twice")
    return [
        (
            place,
            Job(f"{file_name(controller)}-{place.name}", controller, _told(controller, place), place.world, episodes),
        )
        for place in where
        for controller in controllers
    ]


def compare(
    folder: Path,
    jobs: Sequence[tuple[Place, Job]],
    seed: int,
    processes: int,
    finished: Finished | None = None,
    runner: Runner | None = None,
    unkept: Unkept | None = None,
) -> list[Result]:
    """Run all chases, those of an earlier run excepted: their blocks lie in ``folder``, and ``save_results`` makes a
    table.

    They run in processes of this machine, or by ``runner`` where that is given.

    Raises:
        InputError: no episodes, a folder that cannot be written, or a controller that is refused.
        WorkerDiedError: a process was killed.
    """
    evaluations = evaluate_jobs(folder, [job for _, job in jobs], seed, processes, finished, runner, unkept)
    return [Result(place, evaluation) for (place, _), evaluation in zip(jobs, evaluations, strict=True)]


def save_results(folder: Path, results: Sequence[Result]) -> None:
    """Write the table, one row a chase.

    Raises:
        InputError: it cannot be written.
    """
    write_table(folder / TABLE_FILE, _comparison_table(results), _comparison_document(results))


def _told(controller: str, place: Place) -> Scenario:
    """An oracle knows the target of the world; the others what they are told."""
    return place.world if controller in ORACLES else place.told


def summaries(
    results: Sequence[Result], decision_ms: "dict[tuple[str, str], tuple[float, float]] | None" = None
) -> list[dict[str, Any]]:
    """The summary of each result, its world and its difference from the first controller in the same place.

    ``decision_ms`` are the median and the 99th percentile by controller and setting (``Place.name`` as told).
    """
    first = {result.place.name: result.evaluation for result in reversed(results)}
    rows = []
    for result in results:
        told = result.place.told
        setting = setting_name(told.sampling_hz, told.spatial_correlation)
        times = (decision_ms or {}).get((result.evaluation.controller, setting), (None, None))
        rows.append(
            {
                **result.evaluation.summary(),
                "sampling_hz": told.sampling_hz,
                "spatial_correlation": told.spatial_correlation,
                "world": result.place.world_name,
                **paired_difference(_movements(first[result.place.name]), _movements(result.evaluation)),
                "decision_ms_p50": times[0],
                "decision_ms_p99": times[1],
            }
        )
    return rows


def paired_difference(first: NDArray[Any], other: NDArray[Any]) -> dict[str, Any]:
    """Movements of ``other`` less those of ``first`` on the same chases: mean and 90th percentile with intervals.

    The mean's interval is that of the differences chase by chase; the percentile's is a bootstrap over the chases.
    """
    difference = other - first
    resampled = resampled_differences_p90(first, other)
    return {
        "movements_mean_difference": float(difference.mean()),
        "movements_mean_difference_ci95": mean_interval(difference),
        "movements_p90_difference": nearest_rank_percentile(other, 90) - nearest_rank_percentile(first, 90),
        "movements_p90_difference_ci95": [float(value) for value in np.quantile(resampled, [TAIL, 1 - TAIL])],
    }


def resampled_differences_p90(first: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    """The difference of the 90th percentiles in ``RESAMPLES`` draws of as many chases, the same for both."""
    generator = np.random.default_rng(RESAMPLING_SEED)
    draws = []
    for _ in range(0, RESAMPLES, 10):  # more at once of ten thousand chases do not fit a core's cache
        chase = generator.integers(len(first), size=(10, len(first)))
        draws.append(nearest_rank_percentiles(other[chase], 90) - nearest_rank_percentiles(first[chase], 90))
    return np.concatenate(draws)


def _movements(evaluation: Evaluation) -> NDArray[Any]:
    return np.array([chase.movements for chase in evaluation.chases], dtype=np.int64)


def timed_decisions_ms(controller_name: str, scenario: Scenario) -> tuple[float, float]:
    """Median and 99th percentile of the time a decision takes: a batch of one on one thread, chase after chase."""
    controller = load_controller(controller_name, scenario)
    # Every chase has a decision at least.
    chases = range(WARM_UP_DECISIONS + TIMED_DECISIONS)
    with torch.inference_mode():
        timed = itertools.islice(play(scenario, controller, TIMING_SEED, chases, 1), len(chases))
        times_ms = [1000 * step.decision_s for step in timed]
    p50, p99 = np.quantile(times_ms[WARM_UP_DECISIONS:], [0.5, 0.99])
    return float(p50), float(p99)


def _comparison_table(results: Sequence[Result]) -> "pa.Table":
    """One row a chase of every result."""
    import pyarrow as pa

    rows = [(number, chase) for number, result in enumerate(results) for chase in result.evaluation.chases]
    columns = {
        "result": pa.array([number for number, _ in rows], pa.int16()),
        "chase": pa.array([chase.chase for _, chase in rows], pa.int32()),
        "movements": pa.array([chase.movements for _, chase in rows], pa.int16()),
        "reached": [chase.reached for _, chase in rows],
        "path_length_m": pa.array([chase.path_length_m for _, chase in rows], pa.float32()),
    }
    # What only some controllers or worlds have something to say of.
    others = chase_columns([chase for _, chase in rows])
    return pa.table(columns | {name: others[name] for name in others if name in _OPTIONAL_COLUMNS})


def _comparison_document(results: Sequence[Result]) -> Document:
    """What is needed to redo the chases."""
    return {"version": __version__, "results": [_origin(result) for result in results]}


def _origin(result: Result) -> dict[str, Any]:
    """What the chases of a result are a function of."""
    evaluation = result.evaluation
    return {
        "controller": evaluation.controller,
        "weights_sha256": weights_sha256(evaluation.controller, evaluation.scenario),
        "told": result.place.told.to_dict(),
        "world_name": result.place.world_name,
        "world": result.place.world.to_dict(),
        "seed": evaluation.seed,
    }


def read_results(path: Path) -> list[Result]:
    """The results of a table that ``compare`` wrote; where their targets were is not in it.

    Raises:
        InputError: no such file, or not such a table.
    """
    return read_table(path, "comparison table", _parsed_results)


def _parsed_results(rows: list[Row], document: Document) -> list[Result]:
    origins = document["results"]
    chases: list[list[ChaseResult]] = [[] for _ in origins]
    nowhere = float("nan")
    for row in rows:
        number = row.pop("result")
        seed = origins[number]["seed"]
        where = {"seed": seed, "target_x_m": nowhere, "target_y_m": nowhere, "target_z_m": nowhere}
        chases[number].append(checked_row(ChaseResult, where | row))
    return [_read_result(origin, its) for origin, its in zip(origins, chases, strict=True)]


def _read_result(origin: dict[str, Any], chases: list[ChaseResult]) -> Result:
    told, world = Scenario.from_dict(origin["told"]), Scenario.from_dict(origin["world"])
    place = Place(told, origin["world_name"], world)
    controller = origin["controller"]
    return Result(place, Evaluation(_told(controller, place), controller, None, origin["seed"], chases, world))
