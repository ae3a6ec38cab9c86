"""``swarmchase reproduce``: the paper's twelve settings and its Figures 3 to 7."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from .options import ClusterOptions
from .progress import BLOCKS_ARE_KEPT, chases_progress
from .tables import print_table
from .terminal import CONSOLE, print_json, refusals_held_back, tell_replaced, warn

if TYPE_CHECKING:
    from ..evaluation.blocks import Unkept
    from ..evaluation.table import Evaluation

QUICK_EPISODES = 100


@dataclass(frozen=True, kw_only=True)
class ReproduceCommand(ClusterOptions):
    """Evaluate the paper's twelve settings, draw its Figures 3 to 7. Interrupted, it goes on where it was."""

    folder: Path | None = None
    """Folder for the table, results.md and the figures in PNG and PDF (default: reproduction, reproduction-quick)."""
    episodes: int | None = None
    """Chases of each setting (default: the paper's 10,000)."""
    quick: bool = False
    """A minute's run: 100 chases of each setting."""
    seed: int = 0
    """Seed of the chases."""
    processes: int = 2
    """Processes that share the work where there is no cluster; changes the speed, never the result."""
    json: bool = False
    """Print the summaries as one JSON object on standard output."""

    def run(self) -> None:
        """Evaluate, report, write and draw."""
        from ..evaluation.paper_results import EPISODES

        if self.quick and self.episodes is not None:
            raise InputError(f"--quick is {QUICK_EPISODES} episodes: give one of --quick and --episodes")
        episodes = QUICK_EPISODES if self.quick else EPISODES if self.episodes is None else self.episodes
        folder = self.folder or Path("reproduction-quick" if self.quick else "reproduction")
        with refusals_held_back() as hold_back:
            evaluations = self._evaluations(folder, episodes, hold_back)
            summaries = [one.summary() for one in evaluations]
            _show(summaries)
            try:
                if self.json:
                    print_json({"folder": str(folder), "summaries": summaries})
            finally:
                _write(folder, evaluations, summaries)

    def _evaluations(self, folder: Path, episodes: int, unkept: "Unkept") -> "list[Evaluation]":
        from ..controllers.shipped import shipped_families
        from ..evaluation.reproduction import cells, reproduce

        for weights in shipped_families()["paper-a3c"]:
            if not weights.is_here:
                warn(f"Not reproduced: {weights.where_it_is}")
        total = sum(cell.episodes(episodes) for cell in cells())
        with self.runner() as runner, chases_progress("reproduce", total, BLOCKS_ARE_KEPT) as finished:
            return reproduce(folder, episodes, self.seed, self.processes, finished, runner, unkept)


def _show(summaries: list[dict[str, Any]]) -> None:
    from ..reports.paper_tables import oracle_line, report_tables

    for name, table in report_tables(summaries).items():
        print_table(table, name)
    CONSOLE.print(oracle_line(summaries), markup=False)


def _write(folder: Path, evaluations: "list[Evaluation]", summaries: list[dict[str, Any]]) -> None:
    from ..evaluation.reproduction import TABLE_FILE, save_evaluations
    from ..files import write_text_atomically
    from ..reports.paper_tables import report

    tell_replaced([folder / TABLE_FILE, folder / "results.md"])
    save_evaluations(folder, evaluations)
    write_text_atomically(folder / "results.md", report(summaries))
    for picture in draw_evaluations(folder, evaluations, summaries):
        CONSOLE.print(f"Figure: {picture}", markup=False, soft_wrap=True)


def draw_evaluations(folder: Path, evaluations: "list[Evaluation]", summaries: list[dict[str, Any]]) -> list[Path]:
    """Figures 3 to 7 into the folder, where the fading examples lie already; returns the PNG files."""
    from ..evaluation.reproduction import FADING_FILE, training_log
    from ..evaluation.tables import read_rows
    from ..reports.paper import draw_all

    movements = {
        (one.controller, one.scenario.sampling_hz, one.scenario.spatial_correlation): [
            chase.movements for chase in one.chases
        ]
        for one in evaluations
    }
    fading = read_rows(folder / FADING_FILE, "fading table")
    return draw_all(folder, fading, training_log(), movements, summaries)
