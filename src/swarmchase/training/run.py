"""A training run's books: how far it is, its log, its checkpoints, and why it ends."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch

from ..controllers.weights import save_weights
from ..networks import SwarmNetworks
from ..scenario import Scenario
from .agent import AgentSnapshot, FinishedChase
from .evaluator import BEST_WEIGHTS, LAST_WEIGHTS, Evaluation, weights_configuration
from .global_agent import SharedParameters
from .parameters import FlatNetworks
from .run_folder import ResumePoint, RunFolder, TrainingLog
from .settings import A3CSettings


@dataclass(frozen=True)
class TrainingStatus:
    """What a progress display shows."""

    updates: int
    max_updates: int
    environment_steps: int
    seconds: float
    last_chase: FinishedChase | None
    last_evaluation: Evaluation | None


@dataclass(frozen=True)
class TrainingResult:
    """How a run ended."""

    updates: int
    environment_steps: int
    seconds: float
    best: Evaluation | None
    stopped: str
    """"finished", "criterion met" or "interrupted"."""
    weights: Path
    """The best weights by evaluation, or the last where none was made."""


Progress = Callable[[TrainingStatus], None]
"""Is told how the run goes, several times a second."""


class TrainingRun:
    """The books of one run."""

    def __init__(
        self,
        scenario: Scenario,
        settings: A3CSettings,
        folder: RunFolder,
        point: ResumePoint,
        progress: Progress | None,
    ) -> None:
        self.scenario = scenario
        self.settings = settings
        self.folder = folder
        self.point = point
        self.shared = point.parameters.shared()
        self.best = point.best
        self.environment_steps = point.environment_steps
        self.stopped: str | None = None
        self._progress = progress
        self._began_s = time.monotonic() - point.seconds
        self._log = TrainingLog(folder.folder, int(self.shared.updates))
        self._last_chase: FinishedChase | None = None
        self._last_evaluation: Evaluation | None = None

    @property
    def seconds(self) -> float:
        """Wall time of the run, earlier sessions included."""
        return time.monotonic() - self._began_s

    def interrupt(self) -> None:
        """Ask the run to stop and be resumed later."""
        self.stopped = self.stopped or "interrupted"

    def chase_ended(self, chase: FinishedChase) -> None:
        """A local agent ended a chase."""
        self._last_chase = chase
        self._log.chase(chase)

    def evaluated(self, evaluation: Evaluation, best: Evaluation | None, meets_criterion: bool) -> None:
        """The auxiliary agent evaluated; the run stops where its criterion is met."""
        self._last_evaluation, self.best = evaluation, best
        self._log.evaluation(evaluation, self.seconds, self.environment_steps)
        if meets_criterion:
            self.stopped = self.stopped or "criterion met"

    def checkpoint(self, parameters: SharedParameters, agents: list[AgentSnapshot]) -> None:
        """Write the resume file."""
        self._log.flush()
        self.folder.save(ResumePoint(parameters, agents, self.best, self.environment_steps, self.seconds))

    def show(self) -> None:
        """Tell the progress display how far the run is."""
        if self._progress is None:
            return
        self._progress(
            TrainingStatus(
                int(self.shared.updates),
                self.settings.max_updates,
                self.environment_steps,
                self.seconds,
                self._last_chase,
                self._last_evaluation,
            )
        )

    def close(self) -> None:
        """End the log."""
        self._log.close()

    def result(self) -> TrainingResult:
        """How the run ended."""
        return TrainingResult(
            int(self.shared.updates),
            self.environment_steps,
            self.seconds,
            self.best,
            self.stopped or "finished",
            self.folder.folder / BEST_WEIGHTS if self.best is not None else self._last_weights(),
        )

    def _last_weights(self) -> Path:
        flat = FlatNetworks(SwarmNetworks())
        flat.vector.copy_(self.shared.vector)
        path = self.folder.folder / LAST_WEIGHTS
        configuration = weights_configuration(self.scenario, self.settings, int(self.shared.updates))
        save_weights(path, flat.networks, configuration, torch.float16)
        return path
