"""``swarmchase train a3c``: train the four networks as the paper does."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from .options import ScenarioOptions
from .terminal import CONSOLE, print_json, progress_bar

Schedule = Literal["processes", "deterministic"]
"""As in ``training.settings``, which is slow to import: it needs torch."""


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

    def run(self) -> None:
        """Train and report."""
        from ..training.a3c import train_a3c
        from ..training.run import TrainingStatus
        from ..training.settings import a3c_preset

        settings = dataclasses.replace(a3c_preset(self.preset), **self.changes())
        scenario = self.scenario()
        with progress_bar("updates", settings.max_updates, "steps/s") as show:

            def progress(status: TrainingStatus) -> None:
                show(status.updates, _rate(status.environment_steps, status.seconds), _news(status))

            result = train_a3c(scenario, settings, self.folder, self.schedule, self.resume, progress)
        CONSOLE.print(
            f"Training {result.stopped}: {result.updates} updates, {result.environment_steps} environment steps."
        )
        if result.best is not None:
            CONSOLE.print(
                f"Best, in {result.weights}: 90th percentile {result.best.movements_p90:g}, "
                f"mean {result.best.movements_mean:.1f} movements after {result.best.update} updates"
            )
            self._draw()
        if self.json:
            print_json({**dataclasses.asdict(result), "weights": str(result.weights)})

    def _draw(self) -> None:
        """The learning curves, from the run's log."""
        from ..figures import draw_training
        from ..training.run_folder import read_log

        picture = self.folder / "training.png"
        draw_training(read_log(self.folder, "chase"), read_log(self.folder, "evaluation"), picture)
        CONSOLE.print(f"Learning curves: {picture}", markup=False, soft_wrap=True)

    def changes(self) -> dict[str, Any]:
        """The settings that differ from the preset's."""
        given = {
            "learning_rate": self.learning_rate,
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


def _rate(environment_steps: int, seconds: float) -> str:
    return f"{environment_steps / seconds:.0f}" if seconds > 0 else "-"


def _news(status: Any) -> str:
    if status.last_evaluation is None:
        return "" if status.last_chase is None else f"last chase {status.last_chase.movements} movements"
    return f"90 %: {status.last_evaluation.movements_p90:g}, reached {100 * status.last_evaluation.success_rate:.0f} %"
