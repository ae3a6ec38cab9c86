"""docs/method.md states what the code holds: every table is checked against the code itself, every name resolved."""

import dataclasses
import functools
import importlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

import swarmchase
from swarmchase.controllers import weights_sha256
from swarmchase.evaluation.comparison import Result, read_results, summaries
from swarmchase.evaluation.reproduction import read_evaluations
from swarmchase.networks import actor_critic
from swarmchase.reports.comparison_tables import comparison_tables
from swarmchase.reports.paper_tables import oracle_line, report_tables
from swarmchase.scenario import Scenario
from swarmchase.training.losses import LossSettings
from swarmchase.training.settings import PRESETS, TrainingSettings

ROOT = Path(__file__).parent.parent
METHOD = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")

UNITS = {"dbm": "dBm", "db": "dB", "m": "m", "mps": "m/s", "hz": "Hz", "s": "s"}

PAPER_TABLE_I = {
    # Symbol and value as Table I prints them.
    "num_agents": ("N", 8),
    "update_interval": ("T", 5),
    "learning_rate": ("lr", 1e-5),
    "discount": ("gamma", 0.99),
    "entropy_coefficient": ("beta", 0.01),
}
PAPER_NETWORK = {"NUM_LSTM_LAYERS": 3, "HIDDEN_FEATURES": 128}


def section(heading: str) -> str:
    found = re.search(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", METHOD, flags=re.DOTALL | re.MULTILINE)
    assert found, f"docs/method.md has no section {heading!r}"
    return found[1]


def rows(heading: str) -> list[list[str]]:
    """The cells of a section's table, without its head."""
    lines = [line for line in section(heading).splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[2:]]


def shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(shown(entry) for entry in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def unit(name: str) -> str:
    return UNITS.get(name.rsplit("_", 1)[-1], "-")


def scenario_row(field: "dataclasses.Field[Any]") -> list[str]:
    about = field.metadata
    symbol = f"`{about['symbol']}`" if about["symbol"] != "-" else "-"
    return [symbol, f"`{field.name}`", unit(field.name), shown(field.default), about["source"], about["help"]]


def test_every_field_of_the_scenario_stands_in_its_table() -> None:
    expected = [scenario_row(field) for field in dataclasses.fields(Scenario)]
    assert rows("The world: every field of a scenario") == [
        [cell.replace("|O_0 - U|", "dist(O_0, U)") for cell in row] for row in expected
    ]  # a bar would end the cell


def training_rows() -> Iterator[list[str]]:
    for owner, settings in (("TrainingSettings", PRESETS["paper"]), ("LossSettings", PRESETS["paper"].losses)):
        for field in dataclasses.fields(settings):
            value = getattr(settings, field.name)
            if not dataclasses.is_dataclass(value):
                symbol, _ = PAPER_TABLE_I.get(field.name, ("", None))
                source = "Table I" if symbol else "choice"
                yield [f"`{symbol}`" if symbol else "-", f"`{owner}.{field.name}`", "-", shown(value), source]
    for name, value in vars(actor_critic).items():
        if name.isupper() and name not in ("NETWORK_NAMES", "NUM_TRACKERS", "PAPER_WINDOW_SAMPLES"):
            source = "Table I" if name in PAPER_NETWORK else "Section III.A" if name == "NUM_CHOICES" else "choice"
            yield ["-", f"`networks.actor_critic.{name}`", unit(name.lower()), shown(value), source]


def test_every_constant_of_the_training_stands_in_its_table() -> None:
    assert rows("Training: every constant") == list(training_rows())


def test_the_paper_preset_is_table_one() -> None:
    """What the document calls Table I is what Table I prints."""
    settings = PRESETS["paper"]
    values = dataclasses.asdict(settings) | dataclasses.asdict(settings.losses)
    assert {name: values[name] for name in PAPER_TABLE_I} == {name: value for name, (_, value) in PAPER_TABLE_I.items()}
    assert {name: getattr(actor_critic, name) for name in PAPER_NETWORK} == PAPER_NETWORK
    assert settings == TrainingSettings()
    assert settings.losses == LossSettings()


CODE_NAME = re.compile(r"`((?:[A-Za-z_0-9]+\.)*[A-Za-z_][A-Za-z_0-9]*\.[A-Za-z_][A-Za-z_0-9]*)(?:\(\))?`")
HOMES = {"Scenario": "scenario", "TrainingSettings": "training.settings", "LossSettings": "training.losses"}
"""Classes that the text calls by their own name."""


def resolved(name: str) -> Any:
    """The object of ``module.name``, ``module.Class.field`` or ``Class.field`` in this package."""
    parts = name.split(".")
    parts = [*HOMES.get(parts[0], "").split("."), *parts] if parts[0] in HOMES else parts
    found: Any = swarmchase
    for number, part in enumerate(parts):
        if dataclasses.is_dataclass(found) and part in {field.name for field in dataclasses.fields(found)}:
            return part
        if not hasattr(found, part) or found is swarmchase:
            found = importlib.import_module(".".join(["swarmchase", *parts[: number + 1]]))
        else:
            found = getattr(found, part)
    return found


@pytest.mark.parametrize("name", sorted({name for name in CODE_NAME.findall(METHOD) if not name.endswith(".py")}))
def test_names_in_the_text_exist_in_the_code(name: str) -> None:
    assert resolved(name) is not None


def test_every_ambiguity_names_its_setting() -> None:
    ambiguities = rows("Where the paper leaves a choice")
    assert len(ambiguities) >= 20
    for where, paper, choice, setting, effect in ambiguities:
        assert all((where, paper, choice, effect))
        assert "`" in setting, f"{where}: name where the choice is made"


DOCUMENTS = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "src/swarmchase/weights").rglob("README.md")),
    ROOT / "tracker/README.md",
]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_and_pictures_lead_somewhere(document: Path) -> None:
    for link in re.findall(r"\]\(([^)#]+)\)", document.read_text(encoding="utf-8")):
        assert (document.parent / link).exists(), link


def test_citation_names_this_version_and_the_paper() -> None:
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    fields = dict(re.findall(r"^([a-z-]+): \"?([^\"\n]+)\"?$", citation, flags=re.MULTILINE))
    assert (fields["version"], fields["license"]) == (swarmchase.__version__, "Apache-2.0")
    assert fields["cff-version"] == "1.2.0"
    assert "title: Multidimensional Swarm Flight Approach For Chasing Unauthorized UAVs" in citation.replace('"', "")
    assert [*re.findall(r"family-names: (\S+)", citation)] == ["Ban", "Kang", "Jung"]


DOCS = ROOT / "docs"
SHIPPED_TABLE = DOCS / "results" / "reproduction.parquet"


def test_the_tables_of_the_results_are_those_of_the_shipped_table() -> None:
    text = (DOCS / "results.md").read_text(encoding="utf-8")
    summaries = [one.summary() for one in read_evaluations(SHIPPED_TABLE)]
    for name, table in report_tables(summaries).items():
        assert table.markdown() in text, name
    assert oracle_line(summaries) in text


def test_the_results_were_made_by_the_command_they_name() -> None:
    origin = json.loads(pq.read_schema(SHIPPED_TABLE).metadata[b"swarmchase"])
    assert origin["command"] == "swarmchase reproduce --episodes 10000 --seed 0"
    text = (DOCS / "results.md").read_text(encoding="utf-8")
    assert origin["command"] in text
    assert f"version {origin['version']}" in text


def learning_cells(point: dict[str, Any]) -> list[str]:
    """A row of the learning curves as the page shows it."""
    return [
        f"{point['spatial_correlation']:g}",
        f"{point['sampling_hz']:g}",
        point["variant"] or "-",
        point["action_choice"],
        f"{point['update']:,}",
        f"{point['environment_steps'] / 1000:.0f}",
        "-" if point["hours"] is None else f"{point['hours']:.2f}",
        f"{100 * point['reached']:.1f} %",
        f"{point['movements_mean']:.1f}",
        f"{point['movements_p90']:.0f}",
    ]


def test_the_learning_curves_of_the_results_are_those_of_their_table() -> None:
    """Every row of the page is one of the table, and of the table it has all greedy ones and the last of each curve."""
    points = pq.read_table(DOCS / "results" / "table1-training.parquet").to_pylist()
    text = (DOCS / "results.md").read_text(encoding="utf-8")
    text = text.partition("## The paper's own training\n")[2].partition("\n## ")[0]
    lines = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in text.splitlines() if line[:1] == "|"]
    found = [cells for cells in lines if cells[3:4] in (["sampled"], ["greedy"], ["training"])]
    assert [cells for cells in found if cells not in [learning_cells(point) for point in points]] == []
    sampled = [point for point in points if point["action_choice"] == "sampled"]
    last = {(point["sampling_hz"], point["spatial_correlation"], point["variant"]): point for point in sampled}
    greedy = [point for point in points if point["action_choice"] == "greedy"]
    assert [cells for cells in map(learning_cells, [*last.values(), *greedy]) if cells not in found] == []
    flat = [
        point
        for point in points
        if (point["sampling_hz"], point["spatial_correlation"], point["variant"]) == (10, 0.9, "")
        and point["action_choice"] == "training"
        and point["update"] > 20_000
    ]
    p90, mean = ([point[name] for point in flat] for name in ("movements_p90", "movements_mean"))
    stated = f"is between {min(p90):.0f} and {max(p90):.0f}, the mean between {min(mean):.1f} and {max(mean):.1f}."
    assert stated in re.sub(r"\s+", " ", text)


COMPARISONS = {
    # Table: (episodes, what of it the page shows).
    "comparison": (500, ("90th percentile of movements", "mean movements", "reached")),
    "comparison-10000": (
        10_000,
        (
            "90th percentile of movements",
            "mean movements",
            "difference of the 90th percentile from recurrent",
            "difference of the mean from recurrent",
        ),
    ),
    "adaptive": (
        300,
        (
            "mean movements",
            "90th percentile of movements",
            "reached",
            "belief: target in its 95 % region",
            "belief: radius of the region, median in m",
            "belief: error, median in m",
        ),
    ),
    "adaptive-settings": (
        300,
        ("mean movements", "90th percentile of movements", "difference of the mean from recurrent"),
    ),
    "robustness": (300, ("mean movements", "reached", "difference of the mean from adaptive")),
}


@functools.cache
def comparison_results(name: str) -> list[Result]:
    return read_results(DOCS / "results" / f"{name}.parquet")


@pytest.mark.parametrize("name", COMPARISONS)
def test_the_comparisons_of_the_results_are_those_of_their_tables(name: str) -> None:
    text = (DOCS / "results.md").read_text(encoding="utf-8")
    path = DOCS / "results" / f"{name}.parquet"
    results = comparison_results(name)
    episodes, shown_tables = COMPARISONS[name]
    assert {len(result.evaluation.chases) for result in results} == {episodes}
    tables = comparison_tables(summaries(results))
    for table in shown_tables:
        assert tables[table].markdown() in text, table
    version = json.loads(pq.read_schema(path).metadata[b"swarmchase"])["version"]
    assert f"{name}.parquet) (version {version}" in text
    controllers = " ".join(dict.fromkeys(result.evaluation.controller for result in results))
    assert f"swarmchase compare --controllers {controllers} " in re.sub(r"\\\n +", "", text)


@pytest.mark.parametrize("name", COMPARISONS)
def test_the_comparisons_are_of_the_shipped_controllers(name: str) -> None:
    origins = json.loads(pq.read_schema(DOCS / "results" / f"{name}.parquet").metadata[b"swarmchase"])["results"]
    for origin in origins:
        told = Scenario.from_dict(origin["told"])
        assert origin["weights_sha256"] == weights_sha256(origin["controller"], told), origin["controller"]


@pytest.mark.parametrize(
    ("name", "rows", "heading"),
    [("live", "rows", "## How well it works"), ("liars", "liar_rows", "## Trackers that lie or fail")],
)
def test_live_figures_are_the_measured_ones(name: str, rows: str, heading: str) -> None:
    pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")
    measured = importlib.import_module(f"swarmchase.benchmarks.{name}")
    result = json.loads((ROOT / "benchmarks" / f"{name}.json").read_text())
    text = (ROOT / "docs" / "live.md").read_text(encoding="utf-8").partition(heading)[2].partition("\n## ")[0]
    lines = [line for line in text.splitlines() if line.startswith("|")]
    found = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[2:]]
    assert found == getattr(measured, rows)(result)
    command = f"swarmchase benchmark {name} --episodes {result['chases']} --sampling-hz {result['sampling_hz']:g}"
    assert f"{command} --spatial-correlation {result['spatial_correlation']:g}" in text
