"""``swarmchase compare``: controllers beside one another on the same chases."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..scenario import Scenario
from .options import ClusterOptions, SettingsOptions
from .progress import BLOCKS_ARE_KEPT, chases_progress
from .tables import fits, print_table
from .terminal import CONSOLE, print_json, refusals_held_back, tell_replaced

if TYPE_CHECKING:
    from ..evaluation.blocks import Job, Unkept
    from ..evaluation.chases import ChaseResult
    from ..evaluation.comparison import Place, Result

DEFAULT_CONTROLLERS = ("adaptive", "recurrent", "robust", "particle", "multilateration", "gradient", "paper", "oracle")


@dataclass(frozen=True, kw_only=True)
class CompareCommand(SettingsOptions, ClusterOptions):
    """Run any controllers through the same chases, in one or several settings. Interrupted, it goes on where it was."""

    controllers: tuple[str, ...] = DEFAULT_CONTROLLERS
    """Names or paths of weights files; differences are from the first."""
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
        """Compare, report, write and draw."""
        from ..evaluation.comparison import comparison_jobs, places, summaries

        jobs = comparison_jobs(self.controllers, places(self.told(), self.departures), self.episodes)
        with refusals_held_back() as hold_back:
            results = self._compared(jobs, hold_back)
            rows = summaries(results, self._decision_ms())
            _show(rows)
            try:
                if self.json:
                    print_json(rows)
            finally:
                _write(self.folder, results, rows)

    def _compared(self, jobs: "Sequence[tuple[Place, Job]]", unkept: "Unkept") -> "list[Result]":
        from ..evaluation.comparison import compare

        total = sum(job.episodes for _, job in jobs)
        with self.runner() as runner, chases_progress("compare", total, BLOCKS_ARE_KEPT) as finished:
            return compare(self.folder, jobs, self.seed, self.processes, finished, runner, unkept)

    def told(self) -> list[Scenario]:
        """What the controllers are told: every pair of F and rho.

        Raises:
            InputError: a value or file that is refused.
        """
        from ..evaluation.paper_results import SAMPLING_HZ, SPATIAL_CORRELATION

        if self.paper_settings and (self.sampling_hz or self.spatial_correlation):
            raise InputError("--paper-settings are twelve: give them, or --sampling-hz and --spatial-correlation")
        if self.paper_settings:
            return self._of_settings(SAMPLING_HZ, tuple(reversed(SPATIAL_CORRELATION)))
        return self.scenarios()

    def _decision_ms(self) -> dict[tuple[str, str], tuple[float, float]]:
        from ..controllers.shipped import setting_name
        from ..evaluation.comparison import timed_decisions_ms

        CONSOLE.print("Timing decisions, one chase at a time ...")
        return {
            (name, setting_name(told.sampling_hz, told.spatial_correlation)): timed_decisions_ms(name, told)
            for told in self.told()
            for name in self.controllers
        }


def _show(rows: list[dict[str, Any]]) -> None:
    """Of one setting and world one line a controller; else a table for each measure, a controller in a column of its
    own where they fit and in a line of its own where they do not.
    """
    from ..reports.comparison_tables import by_controller, by_place, in_one_place, measures, num_places, place_name

    if num_places(rows) == 1:
        print_table(in_one_place(rows), place_name(rows[0]))
        return
    for name, measure in measures(rows).items():
        wide = by_place(measure)
        print_table(wide if fits(wide) else by_controller(measure), name)


def _write(folder: Path, results: "list[Result]", rows: list[dict[str, Any]]) -> None:
    from ..evaluation.comparison import TABLE_FILE, save_results
    from ..files import write_text_atomically
    from ..reports.comparison_tables import report

    tell_replaced([folder / TABLE_FILE, folder / "comparison.md"])
    save_results(folder, results)
    write_text_atomically(folder / "comparison.md", report(rows))
    for picture in draw_results(folder, results, rows):
        CONSOLE.print(f"Figure: {picture}", markup=False, soft_wrap=True)


def draw_results(folder: Path, results: "list[Result]", rows: list[dict[str, Any]]) -> list[Path]:
    """The figures of a comparison into the folder; returns the PNG files. ``rows`` are the results' summaries."""
    from ..reports.comparison import draw_comparison

    def by_place(
        measure: "Callable[[ChaseResult], float | int | None]",
    ) -> dict[tuple[str, float, float, str], list[float | int]]:
        """Of those that have it."""
        values = {
            (row["controller"], row["sampling_hz"], row["spatial_correlation"], row["world"]): [
                value for chase in result.evaluation.chases if (value := measure(chase)) is not None
            ]
            for result, row in zip(results, rows, strict=True)
        }
        return {place: of_place for place, of_place in values.items() if of_place}

    return draw_comparison(
        folder,
        by_place(lambda chase: chase.movements if chase.capture_s is None else chase.capture_s),
        rows,
        by_place(lambda chase: chase.following_s),
        by_place(lambda chase: chase.belief_error_m),
    )
