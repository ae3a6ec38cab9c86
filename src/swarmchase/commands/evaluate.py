"""``swarmchase evaluate``: a controller over many chases."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from ..files import require_writable_file
from ..reports.intervals import shown_interval, shown_reached, shown_share
from ..scenario import Scenario
from .options import DEFAULT_CONTROLLER, ActionChoice, ClusterOptions, ControllerName, ScenarioOptions, explain_choice
from .progress import BLOCKS_ARE_KEPT, chases_progress
from .tables import print_table
from .terminal import print_json, refusals_held_back

NOTHING_IS_KEPT = "nothing is kept, since those that end first are the short ones"

if TYPE_CHECKING:
    from ..evaluation.blocks import Unkept
    from ..evaluation.table import Evaluation


@dataclass(frozen=True, kw_only=True)
class EvaluateCommand(ScenarioOptions, ClusterOptions):
    """Run a controller through many chases and print movements, tracking time and their confidence intervals."""

    controller: ControllerName = DEFAULT_CONTROLLER
    action_choice: ActionChoice | None = None
    """How a learned controller acts: sampled from its policies or greedy; default is what its weights file says."""
    episodes: int = 1000
    """Number of chases (the paper: 10,000)."""
    seed: int = 0
    """Seed of the chases; chase k of a seed is always the same chase."""
    batch_size: int = 128
    """Chases computed together by a process; changes the speed, never the result."""
    processes: int = 2
    """Processes that share the work where there is no cluster; changes the speed, never the result."""
    folder: Path = Path("evaluation")
    """On a cluster: finished blocks are kept here, and an evaluation that was interrupted goes on behind them."""
    table: Path | None = None
    """Write one row a chase to this Parquet file."""
    overwrite: bool = False
    """Replace the table if it is there already."""
    json: bool = False
    """Print one JSON object on standard output."""

    def run(self) -> None:
        """Evaluate, report and write."""
        scenario = self.world()
        explain_choice(self.controller, scenario)
        if self.table is not None:
            require_writable_file(self.table, replaces=self.overwrite)
        with refusals_held_back() as hold_back:
            if self.cluster is None:
                result = self._evaluated_here(scenario)
            else:
                result = self._evaluated_on_cluster(scenario, hold_back)
            try:
                self._report(result.summary())
            finally:
                if self.table is not None:
                    result.save_parquet(self.table)

    def _report(self, summary: dict[str, Any]) -> None:
        if self.json:
            print_json(summary)
        else:
            print_table(summary_table(summary))

    def _evaluated_here(self, scenario: Scenario) -> "Evaluation":
        from ..evaluation.table import evaluate

        with chases_progress(self.controller, self.episodes, NOTHING_IS_KEPT) as finished:
            return evaluate(
                scenario,
                self.controller,
                self.episodes,
                self.seed,
                self.action_choice,
                self.batch_size,
                self.processes,
                lambda chases: finished(chases, 0, ""),
            )

    def _evaluated_on_cluster(self, scenario: Scenario, unkept: "Unkept") -> "Evaluation":
        from ..controllers.shipped import setting_name
        from ..evaluation.blocks import Job, evaluate_jobs, file_name

        setting = setting_name(scenario.sampling_hz, scenario.spatial_correlation)
        name = f"{file_name(self.controller)}-{self.action_choice or 'filed'}-{setting}"
        job = Job(name, self.controller, scenario, scenario, self.episodes, self.action_choice)
        with (
            self.runner(self.batch_size) as runner,
            chases_progress(self.controller, self.episodes, BLOCKS_ARE_KEPT) as finished,
        ):
            return evaluate_jobs(self.folder, [job], self.seed, self.processes, finished, runner, unkept)[0]


def summary_table(summary: dict[str, Any]) -> Table:
    """The summary of an evaluation as people read it."""
    by_the_clock = "capture_s_mean" in summary
    failed = "the limit" if by_the_clock else "MAX_STEPS + 1 movements"
    table = Table(caption=f"in brackets: 95 % confidence interval; a failed chase counts as {failed}")
    choice = "" if summary["action_choice"] is None else f" ({summary['action_choice']})"
    table.add_column("controller", no_wrap=True)
    table.add_column(Text(summary["controller"] + choice, overflow="fold"), justify="right", overflow="fold")
    lines = _SHOWN | (_SHOWN_BY_THE_CLOCK if by_the_clock else _SHOWN_BY_MOVEMENTS)
    if "following_s_mean" in summary:
        lines |= _SHOWN_OF_FOLLOWING
    if "belief_coverage_95" in summary:
        lines |= _SHOWN_OF_BELIEF
    for name, shown in lines.items():
        table.add_row(name, Text(shown(summary)))
    unit = "s" if by_the_clock else "movements"
    for after, error_m in summary.get("belief_error_m_p50_after", {}).items():
        table.add_row(f"belief: error after {after} {unit}, median", Text(f"{error_m:.1f} m"))
    return table


_SHOWN: dict[str, Callable[[dict[str, Any]], str]] = {
    "F": lambda row: f"{row['sampling_hz']:g} Hz",
    "ρ": lambda row: f"{row['spatial_correlation']:g}",
    "chases": lambda row: f"{row['episodes']}",
    "reached": shown_reached,
}
_SHOWN_BY_MOVEMENTS: dict[str, Callable[[dict[str, Any]], str]] = {
    "movements, mean": lambda row: f"{row['movements_mean']:.1f}" + shown_interval(row["movements_mean_ci95"], 1),
    "movements, median": lambda row: f"{row['movements_p50']:g}" + shown_interval(row["movements_p50_ci95"], 0),
    "movements, 90th percentile": lambda row: (
        f"{row['movements_p90']:g}" + shown_interval(row["movements_p90_ci95"], 0)
    ),
    "movements, most": lambda row: f"{row['movements_max']}",
    "mean tracking time at 2 m/s": lambda row: f"{row['tracking_time_mean_s']['2']:.0f} s",
    "mean tracking time at 5 m/s": lambda row: f"{row['tracking_time_mean_s']['5']:.0f} s",
}
_SHOWN_BY_THE_CLOCK: dict[str, Callable[[dict[str, Any]], str]] = {
    "captured within 60 s": lambda row: _captured(row, "60"),
    "captured within 120 s": lambda row: _captured(row, "120"),
    "captured within 300 s": lambda row: _captured(row, "300"),
    "capture, mean": lambda row: f"{row['capture_s_mean']:.1f} s" + shown_interval(row["capture_s_mean_ci95"], 1),
    "capture, median": lambda row: f"{row['capture_s_p50']:.1f} s" + shown_interval(row["capture_s_p50_ci95"], 1),
    "capture, 90th percentile": lambda row: (
        f"{row['capture_s_p90']:.1f} s" + shown_interval(row["capture_s_p90_ci95"], 1)
    ),
    "least distance, mean": lambda row: f"{row['least_distance_m_mean']:.1f} m",
    "way of the centre, mean": lambda row: f"{row['path_length_m_mean']:.0f} m",
}


_SHOWN_OF_FOLLOWING: dict[str, Callable[[dict[str, Any]], str]] = {
    "longest within 10 m, mean": lambda row: (
        f"{row['following_s_mean']:.1f} s" + shown_interval(row["following_s_mean_ci95"], 1)
    ),
    "within 10 m for 30 s": lambda row: shown_share(row["followed_30_s"], row["followed_30_s_ci95"]),
}
_SHOWN_OF_BELIEF: dict[str, Callable[[dict[str, Any]], str]] = {
    "belief: target in its 95 % region": lambda row: shown_share(
        row["belief_coverage_95"], row["belief_coverage_95_ci95"]
    ),
    "belief: radius of the region, median": lambda row: f"{row['belief_radius_m_p50']:.1f} m",
    "belief: error, median": lambda row: f"{row['belief_error_m_p50']:.1f} m",
}


def _captured(row: dict[str, Any], limit: str) -> str:
    return shown_share(row["captured_within_s"][limit], row["captured_within_s_ci95"][limit])
