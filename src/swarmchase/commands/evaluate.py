"""``swarmchase evaluate``: a controller over many chases."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from ..controllers import ActionChoice
from ..evaluation import evaluate
from ..files import require_writable_folder
from .options import ScenarioOptions
from .terminal import CONSOLE, print_json, progress_bar


@dataclass(frozen=True, kw_only=True)
class EvaluateCommand(ScenarioOptions):
    """Run a controller through many chases and print movements, tracking time and their confidence intervals."""

    controller: str = "paper"
    """paper, random, oracle, another controller that comes with the package, or the path of a weights file."""
    action_choice: ActionChoice | None = None
    """How a learned controller acts: sampled from its policies or greedy; default is what its weights file says."""
    episodes: int = 1000
    """Number of chases (the paper: 10,000)."""
    seed: int = 0
    """Seed of the chases; chase k of a seed is always the same chase."""
    batch_size: int = 128
    """Chases computed together by a process; changes the speed, never the result."""
    processes: int = 2
    """Processes that share the work; changes the speed, never the result."""
    table: Path | None = None
    """Write one row a chase to this Parquet file."""
    json: bool = False
    """Print one JSON object on standard output."""

    def run(self) -> None:
        """Evaluate and report."""
        if self.table is not None:
            require_writable_folder(self.table.parent)
        scenario = self.scenario()
        began_s = time.monotonic()
        with progress_bar("chases/s") as bar:
            task = bar.add_task(f"{self.controller}", total=self.episodes, rate="-", news="")

            def finished(chases: int) -> None:
                bar.update(task, completed=chases, rate=f"{chases / (time.monotonic() - began_s):.1f}")

            result = evaluate(
                scenario,
                self.controller,
                self.episodes,
                self.seed,
                self.action_choice,
                self.batch_size,
                self.processes,
                finished,
            )
        if self.table is not None:
            result.save_parquet(self.table)
        summary = result.summary()
        if self.json:
            print_json(summary)
        else:
            CONSOLE.print(summary_table([summary]))


def summary_table(summaries: list[dict[str, Any]]) -> Table:
    """Summaries of evaluations as people read them."""
    table = Table(caption="[lo, hi] is a 95 % confidence interval; failed chases count as MAX_STEPS + 1 movements")
    for heading in (
        "controller",
        "F (Hz)",
        "ρ",
        "chases",
        "reached",
        "mean",
        "median",
        "90 %",
        "most",
        "time at 2 m/s",
        "time at 5 m/s",
    ):
        table.add_column(heading, justify="left" if heading == "controller" else "right")
    for row in summaries:
        low, high = row["movements_mean_ci95"]
        p90_low, p90_high = row["movements_p90_ci95"]
        table.add_row(
            row["controller"] + ("" if row["action_choice"] is None else f" ({row['action_choice']})"),
            f"{row['sampling_hz']:g}",
            f"{row['spatial_correlation']:g}",
            f"{row['episodes']}",
            f"{100 * row['success_rate']:.2f} %",
            f"{row['movements_mean']:.1f} [{low:.1f}, {high:.1f}]",
            f"{row['movements_p50']:g}",
            f"{row['movements_p90']:g} [{p90_low:g}, {p90_high:g}]",
            f"{row['movements_max']}",
            *(f"{seconds:.0f} s" for seconds in row["tracking_time_mean_s"].values()),
        )
    return table
