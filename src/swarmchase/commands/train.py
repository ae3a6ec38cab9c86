"""``swarmchase train a3c | batched | windows | pursuit``: train the four networks as the paper does, or in one process
on large batches; or the network with which ``adaptive`` reads windows; or the one that chases in flight."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

from ..errors import InputError
from .options import ScenarioOptions, SettingsOptions
from .progress import progress_bar
from .terminal import CONSOLE, print_json, warn

Schedule = Literal["processes", "deterministic"]
Precision = Literal["float32", "bfloat16"]
"""As in ``training.settings``, which is slow to import: it needs torch."""
_Settings = TypeVar("_Settings")
"""A dataclass with the settings of a training."""


@dataclass(frozen=True, kw_only=True)
class _TrainOptions:
    """What both trainers can be told."""

    folder: Path
    """Folder of the run: best.safetensors, resume.safetensors, training.jsonl and TensorBoard events."""
    resume: bool = False
    """Go on with the run in the folder; give the same options as before. More updates make it longer, unless it has a
    final learning rate."""
    initial_weights: Path | None = None
    """Begin from this weights file instead of drawing the weights anew."""
    learning_rate: float | None = None
    """Adam's learning rate."""
    final_learning_rate: float | None = None
    """The rate falls linearly to this."""
    agents: int | None = None
    """Local agents; the batched trainer's take turns, so many for each setting."""
    chases_per_agent: int | None = None
    """Chases each local agent plays at a time; the paper's agents play one."""
    updates: int | None = None
    """Updates of the global networks."""
    seed: int | None = None
    """Seed of the training's chases, initial weights and actions."""
    evaluation_interval: int | None = None
    """Updates between two evaluations by the auxiliary agent."""
    evaluation_chases: int | None = None
    """Fixed chases of such an evaluation."""
    stop_at_p90: float | None = None
    """Stop when the 90th percentile of movements in an evaluation is at most this."""
    checkpoint_interval: int | None = None
    """Updates between two checkpoints."""
    json: bool = False
    """Print how the run ended as one JSON object on standard output."""

    def changes(self) -> dict[str, Any]:
        """The settings that differ from the preset's."""
        given = {
            "initial_weights": None if self.initial_weights is None else str(self.initial_weights),
            "learning_rate": self.learning_rate,
            "final_learning_rate": self.final_learning_rate,
            "num_agents": self.agents,
            "chases_per_agent": self.chases_per_agent,
            "max_updates": self.updates,
            "seed": self.seed,
            "evaluation_interval": self.evaluation_interval,
            "evaluation_chases": self.evaluation_chases,
            "stop_at_p90": self.stop_at_p90,
            "checkpoint_interval": self.checkpoint_interval,
        }
        return {name: value for name, value in given.items() if value is not None}

    def report(self, result: Any) -> None:
        """Say how the run ended, draw its learning curves."""
        CONSOLE.print(
            f"Training {result.stopped}: {result.updates} updates, {result.environment_steps} environment steps."
        )
        if result.best is not None:
            CONSOLE.print(
                f"Best, in {result.weights}: 90th percentile {result.best.movements_p90:g}, "
                f"mean {result.best.movements_mean:.1f} movements after {result.best.update} updates"
            )
        try:
            if self.json:
                print_json({**dataclasses.asdict(result), "weights": str(result.weights)})
        finally:
            if result.best is not None:
                self._draw()

    def _draw(self) -> None:
        """The learning curves, from the run's log."""
        from ..reports.training import draw_training
        from ..training.run_folder import read_log

        picture = self.folder / "training.png"
        draw_training(read_log(self.folder, "chase"), read_log(self.folder, "evaluation"), picture)
        CONSOLE.print(f"Learning curves: {picture}", markup=False, soft_wrap=True)

    def draw_staleness(self) -> None:
        """How stale the gradients were, from the log of a run on a cluster."""
        from ..reports.cluster import draw_staleness
        from ..training.run_folder import read_log

        gradients = read_log(self.folder, "gradient")
        if gradients:
            picture = self.folder / "staleness.png"
            draw_staleness(gradients, picture)
            CONSOLE.print(f"Staleness of the gradients: {picture}", markup=False, soft_wrap=True)


@dataclass(frozen=True, kw_only=True)
class TrainA3CCommand(ScenarioOptions, _TrainOptions):
    """Train the paper's four networks by asynchronous advantage actor-critic (Algorithm 1). Ctrl-C stops it cleanly."""

    preset: str = "paper"
    """paper is Table I exactly; the options below change it."""
    schedule: Schedule = "processes"
    """Asynchronous processes, or the same agents in turn in one process, which is bit-reproducible."""
    cluster: str | None = None
    """HOST:PORT of a Ray cluster's head, or local for one on this machine: agents are actors there."""

    def run(self) -> None:
        """Train and report."""
        from ..training.a3c import train_a3c
        from ..training.settings import preset

        if self.cluster is not None and self.schedule != "processes":
            raise InputError(f"schedule = {self.schedule!r} is refused: agents on a cluster are asynchronous")
        settings = dataclasses.replace(preset(self.preset), **self.changes())
        scenario = self.world()
        with _progress(settings.max_updates) as progress:
            if self.cluster is None:
                result = train_a3c(scenario, settings, self.folder, self.schedule, self.resume, progress)
            else:
                from ..cluster.training import train_on_cluster

                result = train_on_cluster(scenario, settings, self.folder, self.cluster, self.resume, progress, warn)
        self.report(result)
        if self.cluster is not None:
            self.draw_staleness()


@dataclass(frozen=True, kw_only=True)
class TrainBatchedCommand(SettingsOptions, _TrainOptions):
    """Train the four networks in one process, on many chases at a time, for one setting or for several at once."""

    preset: str = "counterfactual"
    """a2c, ppo, all-actions, counterfactual, recurrent, gated or robust; the options below change it."""
    symmetric: bool | None = None
    """x, y and z are one network that learns from all three views of a window."""
    mirrored: bool | None = None
    """Each axis of each rollout is learned from as it was or in a mirror, at random."""
    varied_start: bool | None = None
    """Half of the chases begin nearer to their target."""
    precision: Precision | None = None
    """Of the networks' products; parameters and Adam are float32 either way."""
    threads: int = 2
    """Threads of the networks' products."""
    device: str = "cpu"
    """cpu, or cuda where PyTorch sees a GPU."""

    def run(self) -> None:
        """Train and report."""
        from ..training.batched import train_batched
        from ..training.settings import preset

        settings = dataclasses.replace(preset(self.preset), **self.changes())
        with _progress(settings.max_updates) as progress:
            result = train_batched(
                self.scenarios(), settings, self.folder, self.resume, progress, self.threads, self.device
            )
        self.report(result)

    def changes(self) -> dict[str, Any]:
        """The settings that differ from the preset's."""
        given = {
            "symmetric": self.symmetric,
            "mirrored": self.mirrored,
            "varied_start": self.varied_start,
            "precision": self.precision,
        }
        return super().changes() | {name: value for name, value in given.items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class _LearnerOptions:
    """Of trainings that one process makes (``training.learner``)."""

    folder: Path
    """Folder of the run: best.safetensors and resume.safetensors."""
    resume: bool = False
    """Go on with the run in the folder; give the same options as before."""
    updates: int | None = None
    """Updates of the network."""
    learning_rate: float | None = None
    """Adam's learning rate at first."""
    seed: int | None = None
    """Seed of all that is drawn, initial weights included."""
    device: str = "cpu"
    """cpu, or cuda where PyTorch sees a GPU."""
    json: bool = False
    """Print how the run ended as one JSON object on standard output."""

    def _settings(self, kind: Callable[..., _Settings], **own: Any) -> _Settings:
        """The settings that were given, others as they are by themselves."""
        given = {
            "max_updates": self.updates,
            "learning_rate": self.learning_rate,
            "seed": self.seed,
            **own,
        }
        return kind(**{name: value for name, value in given.items() if value is not None})


@dataclass(frozen=True, kw_only=True)
class TrainWindowsCommand(_LearnerOptions):
    """Train the network with which adaptive reads windows, on fading drawn for it. Ctrl-C stops it cleanly."""

    worlds: int | None = None
    """Worlds of fading in an update."""

    def run(self) -> None:
        """Train and report."""
        from ..training.windows import WindowsSettings
        from ..training.windows_run import train_windows

        settings = self._settings(WindowsSettings, worlds=self.worlds)
        with _loss_shown(settings.max_updates) as progress:
            result = train_windows(settings, self.folder, self.resume, self.device, progress)
        _tell(result, "loss_nats", self.json)


@dataclass(frozen=True, kw_only=True)
class TrainPursuitCommand(_LearnerOptions):
    """Train pursuit, the network that chases in flight, in its own flights. Ctrl-C stops it cleanly."""

    lessons: tuple[str, ...] | None = None
    """What is flown, side by side: scenario:behaviour:target_speed_mps:sampling_hz each."""
    start: Path | None = None
    """A weights file to begin with, of an earlier run."""
    flights: int | None = None
    """Flights side by side, of all lessons."""
    intervals: int | None = None
    """Decisions of each flight in an update."""
    exploration: float | None = None
    """Standard deviation of what is tried out, in full speeds."""
    supervised_share: float | None = None
    """Of the updates, the first ones, in which nothing is reinforced."""
    slow_share: float | None = None
    """Of the updates, the first ones, in which targets fly at half their speed."""

    def run(self) -> None:
        """Train and report."""
        from ..training.pursuit import PursuitSettings
        from ..training.pursuit_run import train_pursuit

        own = ("lessons", "flights", "intervals", "exploration", "supervised_share", "slow_share")
        settings = self._settings(PursuitSettings, **{name: getattr(self, name) for name in own})
        with _loss_shown(settings.max_updates) as progress:
            result = train_pursuit(settings, self.folder, self.start, self.resume, self.device, progress)
        _tell(result, "loss", self.json)


@contextlib.contextmanager
def _loss_shown(max_updates: int) -> "Iterator[Callable[[int, float], None]]":
    with progress_bar("updates", max_updates, "loss") as show:

        def progress(update: int, loss: float) -> None:
            show(update, f"{loss:.3f}", "")

        yield progress


def _tell(result: Any, loss_name: str, as_json: bool) -> None:
    """How a learner's training ended."""
    CONSOLE.print(
        f"Training {result.stopped}: {result.updates} updates, in {result.weights}", markup=False, soft_wrap=True
    )
    if as_json:
        print_json(
            {
                "updates": result.updates,
                loss_name: result.loss,
                "weights": str(result.weights),
                "stopped": result.stopped,
            }
        )


@contextlib.contextmanager
def _progress(max_updates: int) -> "Iterator[Callable[[Any], None]]":
    with progress_bar("updates", max_updates, "steps/s") as show:

        def progress(status: Any) -> None:
            show(status.updates, _rate(status.environment_steps, status.seconds), _news(status))

        yield progress


def _rate(environment_steps: int, seconds: float) -> str:
    return f"{environment_steps / seconds:.0f}" if seconds > 0 else "-"


def _news(status: Any) -> str:
    """What is going on: the evaluation under way, and the last one; before the first, the last chase."""
    evaluating = "" if status.evaluating is None else "evaluating: {} of {} chases".format(*status.evaluating)
    if status.last_evaluation is not None:
        known = (
            f"90th percentile {status.last_evaluation.movements_p90:g}, "
            f"reached {100 * status.last_evaluation.success_rate:.1f} %"
        )
    else:
        known = "" if status.last_chase is None else f"last chase {status.last_chase.movements} movements"
    return ", ".join(part for part in (evaluating, known) if part)
