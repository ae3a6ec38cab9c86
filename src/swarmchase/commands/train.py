"""``swarmchase train a3c``: train the four networks as the paper does."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from ..training.a3c import train_a3c
from ..training.run import TrainingStatus
from ..training.settings import A3CSettings, Schedule, a3c_preset
from .options import ScenarioOptions
from .terminal import CONSOLE, print_json, progress_bar


@dataclass(frozen=True, kw_only=True)
class TrainA3CCommand(ScenarioOptions):
    """Train the paper's four networks by asynchronous advantage actor-critic (Algorithm 1). Ctrl-C stops it cleanly."""

    folder: Path
    """Folder of the run: best.safetensors, resume.safetensors, training.jsonl and TensorBoard events."""
    preset: str = "paper"
    """paper is Table I exactly; the options below change it."""
    resume: bool = False
    """Go on with the run in the folder; give the same options as before."""
    schedule: Schedule = "processes"
    """Asynchronous processes, or the same agents in turn in one process, which is bit-reproducible."""
    learning_rate: float | None = None
    """Adam's learning rate."""
    agents: int | None = None
    """Local agents."""
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

    def run(self) -> None:
        """Train and report."""
        settings = self.settings()
        scenario = self.scenario()
        with progress_bar("steps/s") as bar:
            task = bar.add_task("updates", total=settings.max_updates, rate="-", news="")
            result = train_a3c(
                scenario,
                settings,
                self.folder,
                self.schedule,
                self.resume,
                lambda status: bar.update(task, completed=status.updates, rate=_rate(status), news=_news(status)),
            )
        CONSOLE.print(
            f"Training {result.stopped}: {result.updates} updates, {result.environment_steps} environment steps."
        )
        if result.best is not None:
            CONSOLE.print(
                f"Best, in {result.weights}: 90th percentile {result.best.movements_p90:g}, "
                f"mean {result.best.movements_mean:.1f} movements after {result.best.update} updates"
            )
        if self.json:
            print_json({**dataclasses.asdict(result), "weights": str(result.weights)})

    def settings(self) -> A3CSettings:
        """The preset with the given changes.

        Raises:
            InputError: no such preset, or a number that is refused.
        """
        given = {
            "learning_rate": self.learning_rate,
            "num_agents": self.agents,
            "max_updates": self.updates,
            "seed": self.seed,
            "evaluation_interval": self.evaluation_interval,
            "evaluation_chases": self.evaluation_chases,
            "stop_at_p90": self.stop_at_p90,
            "checkpoint_interval": self.checkpoint_interval,
        }
        changes = {name: value for name, value in given.items() if value is not None}
        return dataclasses.replace(a3c_preset(self.preset), **changes)  # type: ignore[arg-type]


def _rate(status: TrainingStatus) -> str:
    return f"{status.environment_steps / status.seconds:.0f}" if status.seconds > 0 else "-"


def _news(status: TrainingStatus) -> str:
    if status.last_evaluation is None:
        return "" if status.last_chase is None else f"last chase {status.last_chase.movements} movements"
    return f"90 %: {status.last_evaluation.movements_p90:g}, reached {100 * status.last_evaluation.success_rate:.0f} %"
