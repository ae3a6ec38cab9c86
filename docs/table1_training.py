"""The paper's own training: gathers its runs into results/table1-training.parquet and draws it.

    python docs/table1_training.py                # draws the table
    python docs/table1_training.py --runs FOLDER  # gathers it first

FOLDER holds the folder of each run: ``training.jsonl``, ``best.safetensors`` and every ``resume*.safetensors`` that was
kept. Their networks are evaluated with greedy actions, and with sampled ones where the log has no evaluation near, on
the chases of the training's own evaluations, which takes minutes for each; what the table has is not evaluated again.
"""

import argparse
import dataclasses
import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from swarmchase.batch.freed_memory import keep_freed_memory
from swarmchase.batch.tensor_files import load_tensors
from swarmchase.evaluation.statistics import nearest_rank_percentile
from swarmchase.evaluation.tables import checked_row, read_table, write_table
from swarmchase.networks.weights import load_weights
from swarmchase.reports.training import LearningPoint, draw_learning_curves
from swarmchase.scenario import Scenario
from swarmchase.training.evaluator import BEST_WEIGHTS, AuxiliaryEvaluation, measured
from swarmchase.training.global_agent import SharedParameters
from swarmchase.training.losses import LossSettings
from swarmchase.training.parameters import FlatNetworks
from swarmchase.training.run_folder import MOST_RESUME_BYTES, read_log
from swarmchase.training.settings import PRESETS, TrainingSettings

DOCS = Path(__file__).parent
TABLE = DOCS / "results" / "table1-training.parquet"
FIGURE = DOCS / "figures" / "table1-training.png"
SAME_LEARNING = {
    "seed",
    "max_updates",
    "checkpoint_interval",
    "evaluation_interval",
    "evaluation_chases",
    "action_choice",
    "stop_at_p90",
}
"""Settings that make no variant."""
PERIOD_UPDATES = 5_000
NEAR_UPDATES = 1_000
"""A sampled evaluation so near stands for the networks that were kept."""
LEAST_REACHED = 0.1
"""Networks that reach less with sampled actions are not evaluated with greedy ones."""


@dataclass(frozen=True)
class Run:
    """A training, as its folder says."""

    folder: Path
    scenario: Scenario
    settings: TrainingSettings

    @property
    def variant(self) -> str:
        """What is not as in Table I."""
        ours, table1 = _flat(self.settings), _flat(PRESETS["paper"])
        changed = {name: value for name, value in ours.items() if value != table1[name] and name not in SAME_LEARNING}
        return ", ".join(
            f"{name} = {Path(value).stem if isinstance(value, str) else value}" for name, value in changed.items()
        )

    def steps_at(self, update: int) -> int:
        """Environment steps made for so many updates. An update is of ``update_interval`` movements, or of what was
        left of a chase; what a log itself says of its evaluations is of their end, thousands of updates later."""
        interval = self.settings.update_interval
        ended: list[int] = [chase["movements"] for chase in self.chases if chase["update"] <= update]
        return interval * update - sum(-movements % interval for movements in ended)

    @functools.cached_property
    def chases(self) -> list[dict[str, Any]]:
        """Those of the training that ended."""
        return read_log(self.folder, "chase")

    def point(self, evaluation: AuxiliaryEvaluation, action_choice: str, hours: float | None) -> LearningPoint:
        """As a row of the table."""
        return LearningPoint(
            self.scenario.sampling_hz,
            self.scenario.spatial_correlation,
            self.variant,
            action_choice,
            evaluation.update,
            self.steps_at(evaluation.update),
            hours,
            evaluation.movements_mean,
            evaluation.movements_p90,
            evaluation.success_rate,
        )

    def sampled(self) -> list[LearningPoint]:
        """The training's own evaluations."""
        names = [field.name for field in dataclasses.fields(AuxiliaryEvaluation)]
        return [
            self.point(AuxiliaryEvaluation(**{name: line[name] for name in names}), "sampled", line["seconds"] / 3600)
            for line in read_log(self.folder, "evaluation")
        ]

    def training(self) -> list[LearningPoint]:
        """The chases of the training itself, those that ended in every ``PERIOD_UPDATES``; the last period may be
        shorter."""
        found = []
        last = max(chase["update"] for chase in self.chases)
        for start in range(0, last, PERIOD_UPDATES):
            end = min(start + PERIOD_UPDATES, last)
            ended = [chase for chase in self.chases if start < chase["update"] <= end]
            reached = [chase["reached"] for chase in ended]
            failed = self.scenario.max_movements + 1
            movements = [chase["movements"] if chase["reached"] else failed for chase in ended]
            mean, share = float(np.mean(movements)), float(np.mean(reached))
            evaluation = AuxiliaryEvaluation(end, mean, nearest_rank_percentile(movements, 90), share, [])
            found.append(self.point(evaluation, "training", None))
        return found

    def kept(self) -> Iterator[tuple[SharedParameters, float | None]]:
        """The networks that were kept, each with the hours it took to get there."""
        for path in sorted(self.folder.glob("resume*.safetensors")):
            tensors, document = load_tensors(path, "resume file", MOST_RESUME_BYTES)
            yield _shared(tensors["global.vector"], int(tensors["global.updates"])), document["seconds"] / 3600
        networks, configuration = load_weights(self.folder / BEST_WEIGHTS)
        hours = {point.update: point.hours for point in self.sampled()}
        yield _shared(FlatNetworks(networks).vector, configuration["update"]), hours[configuration["update"]]

    def of_kept(self, done: list[LearningPoint]) -> Iterator[LearningPoint]:
        """Evaluations of the networks that were kept, but for those that are done and greedy ones of networks that have
        not learned."""
        mine = [point for point in done if _place(point) == (*_setting(self.scenario), self.variant)]
        sampled = [point for point in mine if point.action_choice == "sampled"]
        greedy = {point.update for point in mine if point.action_choice == "greedy"}
        for shared, hours in self.kept():
            update = int(shared.updates)
            near = [point for point in sampled if abs(point.update - update) <= NEAR_UPDATES]
            if not near:
                near = [self.evaluated(shared, "sampled", hours)]
                sampled += near
                yield near[0]
            if update not in greedy and near[0].reached >= LEAST_REACHED:
                greedy.add(update)
                yield self.evaluated(shared, "greedy", hours)

    def evaluated(self, shared: SharedParameters, action_choice: str, hours: float | None) -> LearningPoint:
        """Of these networks, on the chases of the training's evaluations."""
        settings = dataclasses.replace(self.settings, action_choice=action_choice, initial_weights=None)
        return self.point(measured([self.scenario], settings, shared), action_choice, hours)


def main() -> None:
    """Gather where there are runs, and draw."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--runs", type=Path, help="the folder of the runs' folders; without it the table is drawn")
    options.add_argument("--table", type=Path, default=TABLE, help="the table of the learning curves")
    options.add_argument("--figure", type=Path, default=FIGURE, help="where the figure goes")
    chosen = options.parse_args()
    if chosen.runs is not None:
        torch.set_num_threads(1)
        keep_freed_memory()
        gather(chosen.runs, chosen.table)
    draw_learning_curves(read_points(chosen.table), chosen.figure)


def gather(folder: Path, table: Path) -> None:
    """Write what the runs' logs say and what their kept networks do; the table is whole after every evaluation."""
    runs = [run_of(path.parent) for path in sorted(folder.glob(f"*/{BEST_WEIGHTS}"))]
    training = [point for run in runs for point in run.training()]
    known = [point for point in read_points(table) if point.action_choice != "training"] if table.exists() else []
    evaluations = list(dict.fromkeys([*known, *(point for run in runs for point in run.sampled())]))
    save(table, evaluations + training)
    for run in runs:
        for point in run.of_kept(evaluations):
            evaluations.append(point)
            save(table, evaluations + training)


def run_of(folder: Path) -> Run:
    """The run in this folder."""
    _, configuration = load_weights(folder / BEST_WEIGHTS)
    settings = configuration["settings"]
    losses = LossSettings(**settings["losses"])
    scenario = Scenario.from_dict(configuration["scenarios"][0])
    return Run(folder, scenario, TrainingSettings(**{**settings, "losses": losses}))


def read_points(table: Path) -> list[LearningPoint]:
    """The evaluations in a table of learning curves."""
    return read_table(table, "table of learning curves", lambda rows, _: [checked_row(LearningPoint, r) for r in rows])


def save(table: Path, points: list[LearningPoint]) -> None:
    """Write the table, in the order of settings, variants and updates."""
    import pyarrow as pa

    ordered = sorted(points, key=lambda point: (*_place(point), point.action_choice, point.update))
    chases = PRESETS["paper"].evaluation_chases
    rows = [dataclasses.asdict(point) for point in ordered]
    write_table(table, pa.Table.from_pylist(rows), {"command": "swarmchase train a3c --preset paper", "chases": chases})


def _shared(vector: torch.Tensor, update: int) -> SharedParameters:
    shared = SharedParameters.start(vector)
    shared.updates.fill_(update)
    return shared


def _setting(scenario: Scenario) -> tuple[float, float]:
    return scenario.sampling_hz, scenario.spatial_correlation


def _place(point: LearningPoint) -> tuple[float, float, str]:
    return point.sampling_hz, point.spatial_correlation, point.variant


def _flat(settings: TrainingSettings) -> dict[str, Any]:
    form = settings.to_dict()
    losses: dict[str, Any] = form.pop("losses")
    return form | losses


if __name__ == "__main__":
    main()
