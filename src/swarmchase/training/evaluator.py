"""The auxiliary agent: evaluates on fixed chases while training goes on, keeps the best weights, says when to stop."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ..controllers import network_controller
from ..evaluation.chases import ChaseResult, run_chases
from ..evaluation.statistics import nearest_rank_percentile
from ..networks.forms import deployed, new_networks
from ..networks.protocol import HearingNetworks
from ..networks.weights import save_weights
from ..scenario import Scenario
from ..world.departures import drawn_world
from .global_agent import SharedParameters
from .parameters import FlatNetworks
from .settings import Schedule, TrainingSettings, training_seed

BEST_WEIGHTS = "best.safetensors"
EVALUATION_WORLDS = 4
"""Worlds for each scenario in an evaluation of a training in varied worlds."""
LAST_WEIGHTS = "last.safetensors"
"""Written in place of the best ones by a run that ended before its first evaluation."""


TellEvaluating = Callable[[int, int], None]
"""Is told how many chases of an evaluation have ended, and how many there are."""


@dataclass(frozen=True)
class AuxiliaryEvaluation:
    """What the networks can do after so many updates; of several scenarios each figure is their mean."""

    update: int
    movements_mean: float
    movements_p90: float
    success_rate: float
    p90_by_scenario: Sequence[float]
    """The 90th percentile in each scenario, or in each world of each."""

    @property
    def order(self) -> tuple[float, float, float]:
        """Smaller is better: fewer failures first, then the 90th percentile, then the mean."""
        return 1 - self.success_rate, self.movements_p90, self.movements_mean


def weights_configuration(
    scenarios: Sequence[Scenario], settings: TrainingSettings, schedule: Schedule, update: int
) -> dict[str, Any]:
    """What a weights file says of its making."""
    return {
        "scenarios": [scenario.to_dict() for scenario in scenarios],
        "settings": settings.to_dict(),
        "schedule": schedule,
        "action_choice": settings.action_choice,
        "update": update,
    }


def save_trained_weights(path: Path, networks: HearingNetworks, configuration: dict[str, Any]) -> None:
    """Write the trained networks in float16, those of the paper's form as its four."""
    save_weights(path, deployed(networks), configuration, torch.float16)


class Evaluator:
    """Evaluates snapshots of the global parameters."""

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        settings: TrainingSettings,
        schedule: Schedule,
        folder: Path,
        best: AuxiliaryEvaluation | None,
    ) -> None:
        self._scenarios = scenarios
        self._settings = settings
        self._schedule = schedule
        self._folder = folder
        self._flat = FlatNetworks(new_networks(settings))
        self.best = best

    def evaluate(self, snapshot: SharedParameters, tell: TellEvaluating | None = None) -> AuxiliaryEvaluation:
        """Run the fixed chases; where the weights are the best so far, write them to the run's folder in float16."""
        evaluation = measured(self._scenarios, self._settings, snapshot, tell)
        self.keep(evaluation, snapshot)
        return evaluation

    def keep(self, evaluation: AuxiliaryEvaluation, snapshot: SharedParameters) -> None:
        """Write the weights of this evaluation to the run's folder in float16, where they are the best so far."""
        if self.best is None or evaluation.order < self.best.order:
            self.best = evaluation
            self._flat.vector.copy_(snapshot.vector)
            configuration = weights_configuration(self._scenarios, self._settings, self._schedule, evaluation.update)
            save_trained_weights(self._folder / BEST_WEIGHTS, self._flat.networks, configuration)

    def meets_criterion(self, evaluation: AuxiliaryEvaluation) -> bool:
        """Whether training may stop early."""
        return self._settings.stop_at_p90 is not None and evaluation.movements_p90 <= self._settings.stop_at_p90


def measured(
    scenarios: Sequence[Scenario],
    settings: TrainingSettings,
    snapshot: SharedParameters,
    tell: TellEvaluating | None = None,
) -> AuxiliaryEvaluation:
    """The fixed chases of a training, with these parameters; ``tell`` hears of each that ends."""
    flat = FlatNetworks(new_networks(settings))
    flat.vector.copy_(snapshot.vector)
    networks = deployed(flat.networks)
    worlds = _worlds(scenarios, settings)
    tables: list[list[ChaseResult]] = []
    ended, total = 0, len(worlds) * settings.evaluation_chases
    if tell is not None:
        tell(ended, total)
    for told, world in worlds:
        rows: list[ChaseResult] = []
        for row in _chases(told, world, networks, settings):
            rows.append(row)
            ended += 1
            if tell is not None:
                tell(ended, total)
        tables.append(rows)
    movements = [[float(row.movements) for row in rows] for rows in tables]
    percentiles = [nearest_rank_percentile(values, 90) for values in movements]
    return AuxiliaryEvaluation(
        update=int(snapshot.updates),
        movements_mean=_mean([_mean(values) for values in movements]),
        movements_p90=_mean(percentiles),
        success_rate=_mean([_mean([float(row.reached) for row in rows]) for rows in tables]),
        p90_by_scenario=percentiles,
    )


def _evaluation_seed(settings: TrainingSettings) -> int:
    """The chases are fixed and of a seed of their own: neither the training's nor one that a person types."""
    return training_seed(settings.seed) + (1 << 61)


def _worlds(scenarios: Sequence[Scenario], settings: TrainingSettings) -> list[tuple[Scenario, Scenario]]:
    """What the networks are told, and the world they are in."""
    if not settings.varied_world:
        return [(scenario, scenario) for scenario in scenarios]
    told = [scenario for scenario in scenarios for _ in range(EVALUATION_WORLDS)]
    seed = _evaluation_seed(settings)
    return [(scenario, drawn_world(scenario, seed, number)) for number, scenario in enumerate(told)]


def _chases(
    told: Scenario, world: Scenario, networks: HearingNetworks, settings: TrainingSettings
) -> Iterator[ChaseResult]:
    controller = network_controller(told, networks, "in training", settings.action_choice)
    return run_chases(world, controller, _evaluation_seed(settings), range(settings.evaluation_chases))


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)
