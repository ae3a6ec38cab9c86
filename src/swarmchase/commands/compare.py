"""``swarmchase compare``: controllers beside one another on the same chases."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.markdown import Markdown

from ..errors import InputError
from ..scenario import Scenario
from .options import ClusterOptions, ScenarioOptions
from .terminal import BLOCKS_ARE_KEPT, CONSOLE, chases_progress, print_json

DEFAULT_CONTROLLERS = ("recurrent", "robust", "particle", "multilateration", "gradient", "paper", "oracle")


@dataclass(frozen=True, kw_only=True)
class CompareCommand(ClusterOptions):
    """Run any controllers through the same chases, in one or several settings. Interrupted, it goes on where it was."""

    controllers: tuple[str, ...] = DEFAULT_CONTROLLERS
    """Names or paths of weights files; differences are from the first."""
    sampling_hz: tuple[float, ...] = ()
    """F, RSSI samples a second (default 10)."""
    spatial_correlation: tuple[float, ...] = ()
    """rho, correlation between trackers (default 0.9); with several of both, every pair."""
    scenario_file: Path | None = None
    """A TOML file with any other fields of the scenario; what it does not name is Table I."""
    paper_settings: bool = False
    """The twelve settings of the paper."""
    departures: bool = False
    """Also in worlds that differ from what the controllers are told: the robustness table."""
    episodes: int = 1000
    """Chases of each controller in each setting and world."""
    seed: int = 0
    """Seed of the chases."""
    processes: int = 2
    """Processes that share the work where there is no cluster; changes the speed, never the result."""
    folder: Path = Path("comparison")
    """Folder for the table, comparison.md and the figures in PNG and PDF."""
    json: bool = False
    """Print a list of summaries, one for each controller in each place, as JSON on standard output."""

    def run(self) -> None:
        """Compare, write, draw and report."""
        from ..evaluation.comparison import compare, comparison_jobs, places, summaries

        jobs = comparison_jobs(self.controllers, places(self.told(), self.departures), self.episodes)
        total = sum(job.episodes for _, job in jobs)
        with self.runner() as runner, chases_progress("compare", total, BLOCKS_ARE_KEPT) as finished:
            results = compare(self.folder, jobs, self.seed, self.processes, finished, runner)
        rows = summaries(results, self._decision_ms())
        for picture in _draw(self.folder, results, rows):
            CONSOLE.print(f"Figure: {picture}", markup=False, soft_wrap=True)
        _report(self.folder, rows)
        if self.json:
            print_json(rows)

    def told(self) -> list[Scenario]:
        """What the controllers are told: every pair of F and rho.

        Raises:
            InputError: a value or file that is refused.
        """
        from ..evaluation.paper_results import SAMPLING_HZ, SPATIAL_CORRELATION

        if self.paper_settings and (self.sampling_hz or self.spatial_correlation):
            raise InputError("--paper-settings are twelve: give them, or --sampling-hz and --spatial-correlation")
        correlations = tuple(reversed(SPATIAL_CORRELATION)) if self.paper_settings else self.spatial_correlation
        return [
            ScenarioOptions(
                sampling_hz=sampling_hz, spatial_correlation=correlation, scenario_file=self.scenario_file
            ).scenario()
            for correlation in correlations or (None,)
            for sampling_hz in (SAMPLING_HZ if self.paper_settings else self.sampling_hz) or (None,)
        ]

    def _decision_ms(self) -> dict[tuple[str, str], tuple[float, float]]:
        from ..controllers.shipped import setting_name
        from ..evaluation.comparison import timed_decisions_ms

        CONSOLE.print("Timing decisions, one chase at a time ...")
        return {
            (name, setting_name(told.sampling_hz, told.spatial_correlation)): timed_decisions_ms(name, told)
            for told in self.told()
            for name in self.controllers
        }


def _draw(folder: Path, results: list[Any], rows: list[dict[str, Any]]) -> list[Path]:
    from ..reports.comparison import draw_comparison

    movements = {
        (
            row["controller"],
            row["sampling_hz"],
            row["spatial_correlation"],
            row["world"],
        ): [chase.movements for chase in result.evaluation.chases]
        for result, row in zip(results, rows, strict=True)
    }
    return draw_comparison(folder, movements, rows)


def _report(folder: Path, rows: list[dict[str, Any]]) -> None:
    from ..files import write_text_atomically
    from ..reports.comparison_tables import comparison_tables

    text = "\n\n".join(f"## {name}\n\n{table}" for name, table in comparison_tables(rows).items()) + "\n"
    write_text_atomically(folder / "comparison.md", text)
    CONSOLE.print(Markdown(text))
