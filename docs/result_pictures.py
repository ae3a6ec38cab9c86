"""Draws the figures of docs/results.md and docs/cluster.md from the tables beside them: python docs/result_pictures.py

As ``swarmchase reproduce``, ``compare`` and ``benchmark cluster`` draw theirs; nothing is simulated but Fig. 3's two
windows. The learning curves of the paper's own training have a command of their own: table1_training.py.
"""

import argparse
import json
import tempfile
from pathlib import Path

from swarmchase.commands.compare import draw_results
from swarmchase.commands.reproduce import draw_evaluations
from swarmchase.evaluation.comparison import read_results, summaries
from swarmchase.evaluation.reproduction import read_evaluations, save_fading
from swarmchase.files import atomic_path
from swarmchase.reports.cluster import draw_scaling

DOCS = Path(__file__).parent
RESULTS, FIGURES = DOCS / "results", DOCS / "figures"
CLUSTER = DOCS.parent / "benchmarks" / "cluster.json"
COMPARISONS = {
    # Table: what a comparison calls its figures, and what they are called here.
    "comparison": {"movements": "comparison-movements", "percentile": "comparison-percentile"},
    "robustness": {"worlds": "robustness"},
}
REPRODUCTION = ("fig3-fading", "fig4-training-reward", "fig5-movements", "fig6-percentile", "fig7-tracking-time")
SEED = 0


def main() -> None:
    """Draw all, or those that are named."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--folder", type=Path, default=FIGURES, help="where the pictures go")
    kinds = {"reproduction": draw_reproduction, "cluster": draw_cluster, **dict.fromkeys(COMPARISONS)}
    options.add_argument("--only", choices=kinds, help="the pictures of one table")
    chosen = options.parse_args()
    for kind in [chosen.only] if chosen.only else kinds:
        if kind in COMPARISONS:
            draw_comparison(kind, chosen.folder)
        else:
            kinds[kind](chosen.folder)


def draw_reproduction(folder: Path) -> None:
    """Figures 3 to 7."""
    evaluations = read_evaluations(RESULTS / "reproduction.parquet")
    with tempfile.TemporaryDirectory() as drawn:
        save_fading(Path(drawn), SEED)
        draw_evaluations(Path(drawn), evaluations, [one.summary() for one in evaluations])
        for name in REPRODUCTION:
            keep(Path(drawn) / f"{name}.png", folder / f"{name}.png")


def draw_comparison(table: str, folder: Path) -> None:
    """Of one table of chases."""
    results = read_results(RESULTS / f"{table}.parquet")
    with tempfile.TemporaryDirectory() as drawn:
        draw_results(Path(drawn), results, summaries(results))
        for name, name_here in COMPARISONS[table].items():
            keep(Path(drawn) / f"{name}.png", folder / f"{name_here}.png")


def draw_cluster(folder: Path) -> None:
    """The scaling of a cluster, from what the benchmark left."""
    draw_scaling(json.loads(CLUSTER.read_text(encoding="utf-8")), folder / "cluster-scaling.png")


def keep(drawn: Path, path: Path) -> None:
    """Whole, or the old one stays."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(drawn.read_bytes())


if __name__ == "__main__":
    main()
