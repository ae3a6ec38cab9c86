"""The auxiliary agent: evaluates on fixed chases while training goes on, keeps the best weights, says when to stop."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ..chases import nearest_rank_percentile, run_chases
from ..controllers.learned import LearnedController
from ..controllers.weights import save_weights
from ..networks import SwarmNetworks
from ..scenario import Scenario
from .global_agent import SharedParameters
from .parameters import FlatNetworks
from .settings import A3CSettings, training_seed

BEST_WEIGHTS = "best.safetensors"
LAST_WEIGHTS = "last.safetensors"
"""Written in place of the best ones by a run that ended before its first evaluation."""


@dataclass(frozen=True)
class Evaluation:
    """What the networks can do after so many updates."""

    update: int
    movements_mean: float
    movements_p90: float
    success_rate: float

    @property
    def order(self) -> tuple[float, float]:
        """Smaller is better: the 90th percentile first, the mean between equals."""
        return self.movements_p90, self.movements_mean


def weights_configuration(scenario: Scenario, settings: A3CSettings, update: int) -> dict[str, Any]:
    """What a weights file says of its making."""
    return {"method": "a3c", "scenario": scenario.to_dict(), "settings": settings.to_dict(), "update": update}


class Evaluator:
    """Evaluates snapshots of the global parameters with sampled actions."""

    def __init__(self, scenario: Scenario, settings: A3CSettings, folder: Path, best: Evaluation | None) -> None:
        self._scenario = scenario
        self._settings = settings
        self._folder = folder
        self._flat = FlatNetworks(SwarmNetworks())
        self.best = best

    def evaluate(self, snapshot: SharedParameters) -> Evaluation:
        """Run the fixed chases; where the weights are the best so far, write them to the run's folder in float16."""
        self._flat.vector.copy_(snapshot.vector)
        controller = LearnedController(self._scenario, self._flat.networks, "in training")
        # The chases are fixed and of a seed of their own: neither the training's nor one that a person types.
        seed = training_seed(self._settings.seed) + (1 << 61)
        rows = list(run_chases(self._scenario, controller, seed, range(self._settings.evaluation_chases)))
        movements = [row.movements for row in rows]
        evaluation = Evaluation(
            update=int(snapshot.updates),
            movements_mean=sum(movements) / len(movements),
            movements_p90=nearest_rank_percentile(movements, 90),
            success_rate=sum(row.reached for row in rows) / len(rows),
        )
        if self.best is None or evaluation.order < self.best.order:
            self.best = evaluation
            configuration = weights_configuration(self._scenario, self._settings, evaluation.update)
            save_weights(self._folder / BEST_WEIGHTS, self._flat.networks, configuration, torch.float16)
        return evaluation

    def meets_criterion(self, evaluation: Evaluation) -> bool:
        """Whether training may stop early."""
        return self._settings.stop_at_p90 is not None and evaluation.movements_p90 <= self._settings.stop_at_p90
