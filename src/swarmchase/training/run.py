"""A training run's books: how far it is, its log, its checkpoints, and why it ends."""

import contextlib
import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from ..controllers import require_fit
from ..errors import InputError
from ..networks.forms import FORMS, continued_networks, new_networks
from ..networks.weights import load_weights
from ..processes.stop_request import StopRequest, stop_request
from ..scenario import Scenario
from ..world.environment import require_world
from .agent import AgentSnapshot, FinishedChase
from .evaluator import BEST_WEIGHTS, LAST_WEIGHTS, AuxiliaryEvaluation, save_trained_weights, weights_configuration
from .global_agent import SharedParameters
from .parameters import FlatNetworks
from .run_folder import ResumePoint, RunFolder, TrainingLog, holds_run
from .settings import Schedule, TrainingSettings, training_seed


@dataclass(frozen=True)
class TrainingStatus:
    """What a progress display shows."""

    updates: int
    max_updates: int
    environment_steps: int
    seconds: float
    last_chase: FinishedChase | None
    last_evaluation: AuxiliaryEvaluation | None
    evaluating: tuple[int, int] | None = None
    """Chases that have ended of the evaluation under way, and all of them; None where none is, or nobody says."""


@dataclass(frozen=True)
class TrainingResult:
    """How a run ended."""

    updates: int
    environment_steps: int
    seconds: float
    best: AuxiliaryEvaluation | None
    stopped: str
    """"finished", "criterion met" or "interrupted"."""
    weights: Path
    """The best weights by evaluation, or the last where none was made."""


TellStatus = Callable[[TrainingStatus], None]
"""Is told how the run goes, several times a second."""


def next_multiple(updates: int, interval: int) -> int:
    """The first multiple of the interval behind so many updates."""
    return (updates // interval + 1) * interval


def next_evaluation(updates: int, settings: TrainingSettings) -> int:
    """At every interval, and after the last update."""
    following = next_multiple(updates, settings.evaluation_interval)
    return min(following, settings.max_updates) if updates < settings.max_updates else following


class TrainingRun:
    """The books of one run."""

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        settings: TrainingSettings,
        schedule: Schedule,
        folder: RunFolder,
        point: ResumePoint,
        progress: TellStatus | None,
        request: StopRequest,
        device: str = "cpu",
    ) -> None:
        self.scenarios = scenarios
        self.settings = settings
        self.schedule = schedule
        self.folder = folder
        self.point = point
        self.shared = point.parameters.on(device)
        self.best = point.best
        self.environment_steps = point.environment_steps
        self.request = request
        self._criterion_met = False
        self._progress = progress
        self._began_s = time.monotonic() - point.seconds
        self._log = TrainingLog(folder.folder, int(self.shared.updates))
        self._last_chase: FinishedChase | None = None
        self._last_evaluation: AuxiliaryEvaluation | None = None
        self._evaluating: tuple[int, int] | None = None

    @property
    def seconds(self) -> float:
        """Wall time of the run, earlier sessions included."""
        return time.monotonic() - self._began_s

    @property
    def stopped(self) -> str | None:
        """Why the run is to stop before its last update, if it is."""
        return "criterion met" if self._criterion_met else "interrupted" if self.request.made else None

    def chase_ended(self, chase: FinishedChase) -> None:
        """A local agent ended a chase."""
        self._last_chase = chase
        self._log.chase(chase)

    def evaluating(self, ended: int, chases: int) -> None:
        """So many chases of the evaluation under way have ended."""
        self._evaluating = (ended, chases)
        self.show()

    def evaluated(
        self, evaluation: AuxiliaryEvaluation, best: AuxiliaryEvaluation | None, meets_criterion: bool
    ) -> None:
        """The auxiliary agent evaluated; the run stops where its criterion is met."""
        self._last_evaluation, self.best, self._evaluating = evaluation, best, None
        self._log.evaluation(evaluation, self.seconds, self.environment_steps)
        self._criterion_met |= meets_criterion

    def checkpoint(self, parameters: SharedParameters, agents: list[AgentSnapshot]) -> None:
        """Write the resume file."""
        self._log.flush()
        self.folder.save(ResumePoint(parameters, agents, self.best, self.environment_steps, self.seconds))

    def gradient_applied(self, update: int, agent: int, updates_behind: int) -> None:
        """A local agent's gradient made this update, so many updates after the agent had fetched the parameters."""
        self._log.gradient(update, agent, updates_behind)

    def fault(self, what: str) -> None:
        """Something went wrong that the run has got over."""
        self._log.fault(int(self.shared.updates), what)

    def take(self, parameters: SharedParameters) -> None:
        """Make these the run's parameters."""
        for part in dataclasses.fields(SharedParameters):
            getattr(self.shared, part.name).copy_(getattr(parameters, part.name))

    def go_back(self) -> ResumePoint:
        """Forget all since the last checkpoint, as a run does that is resumed."""
        point = self.folder.load()
        self.take(point.parameters)
        self.best, self.environment_steps = point.best, point.environment_steps
        self._log.close()
        self._log = TrainingLog(self.folder.folder, int(self.shared.updates))
        return point

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
                self._evaluating,
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
        flat = FlatNetworks(new_networks(self.settings))
        flat.vector.copy_(self.shared.vector)
        path = self.folder.folder / LAST_WEIGHTS
        updates = int(self.shared.updates)
        configuration = weights_configuration(self.scenarios, self.settings, self.schedule, updates)
        save_trained_weights(path, flat.networks, configuration)
        return path


@contextlib.contextmanager
def open_run(
    scenarios: Sequence[Scenario],
    settings: TrainingSettings,
    schedule: Schedule,
    folder: Path,
    resume: bool,
    progress: TellStatus | None,
    device: str = "cpu",
) -> Iterator[TrainingRun]:
    """A new run, or the one in ``folder`` gone on with; a signal asks it to stop instead of tearing it down.

    Raises:
        InputError: a scenario that the networks cannot decide in; the folder cannot be written, holds a run and
            ``resume`` is false, or holds no run and it is true; or another training is at work in it.
    """
    for scenario in scenarios:
        require_world(scenario)
        require_fit(FORMS[settings.form], scenario, f"the form {settings.form}")
    start = None if resume else _start(settings)  # before the folder is made: its weights file may be missing
    if resume and not holds_run(folder):
        raise InputError(f"folder {folder} holds no run to resume")
    with contextlib.closing(RunFolder(folder, scenarios, settings)) as run_folder, stop_request() as request:
        if holds_run(folder) and not resume:
            raise InputError(f"folder {folder} holds a run already: resume it, or choose another folder")
        point = run_folder.load() if start is None else start
        run = TrainingRun(scenarios, settings, schedule, run_folder, point, progress, request, device)
        with contextlib.closing(run):
            yield run


def _start(settings: TrainingSettings) -> ResumePoint:
    if settings.initial_weights is None:
        generator = torch.Generator().manual_seed(training_seed(settings.seed))
        networks = new_networks(settings, generator)
    else:
        networks = continued_networks(settings, load_weights(Path(settings.initial_weights))[0])
    parameters = SharedParameters.start(FlatNetworks(networks).vector)
    return ResumePoint(parameters, agents=[], best=None, environment_steps=0, seconds=0.0)
