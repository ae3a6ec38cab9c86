"""The controllers that come with the package: what their files hold, which is chosen, and that they reach targets."""

import json
import re
from pathlib import Path

import pytest
import torch
from safetensors import safe_open

from swarmchase.cli import main
from swarmchase.controllers import load_controller
from swarmchase.controllers.shipped import WEIGHTS_FOLDER, ShippedWeights, chosen_weights, shipped_families
from swarmchase.evaluation.chases import run_chases
from swarmchase.evaluation.paper_results import MOVEMENTS_P90, SAMPLING_HZ, SPATIAL_CORRELATION
from swarmchase.evaluation.reproduction import read_evaluations
from swarmchase.evaluation.statistics import nearest_rank_percentile
from swarmchase.evaluation.table import Evaluation
from swarmchase.networks.actor_critic import greedy_choice
from swarmchase.scenario import Scenario, paper_scenario

FAMILIES = shipped_families()
ALL = [weights for family in ("paper", "paper-a3c") for weights in FAMILIES[family]]
MODEL_CARD = (WEIGHTS_FOLDER / "README.md").read_text(encoding="utf-8")
SHIPPED_TABLE = Path(__file__).parents[2] / "docs" / "results" / "reproduction.parquet"


@pytest.fixture(scope="module")
def shipped_table() -> dict[str, Evaluation]:
    """What is in it of each file of weights."""
    evaluations = read_evaluations(SHIPPED_TABLE)
    return {str(one.weights): one for one in evaluations if one.controller != "oracle"}


def own_scenario(weights: ShippedWeights) -> Scenario:
    assert weights.setting is not None
    sampling_hz, spatial_correlation = weights.setting
    return paper_scenario(sampling_hz=sampling_hz, spatial_correlation=spatial_correlation)


def test_there_is_one_for_every_setting_of_the_paper_and_by_a3c_where_it_states_figures() -> None:
    settings = {name: {one.setting for one in FAMILIES[name]} for name in FAMILIES}
    assert settings["paper"] == {(hertz, rho) for hertz in SAMPLING_HZ for rho in SPATIAL_CORRELATION}
    assert settings["paper-a3c"] >= set(MOVEMENTS_P90)


@pytest.mark.parametrize("weights", ALL, ids=lambda weights: weights.name)
def test_a_file_is_small_and_says_what_made_it(weights: ShippedWeights) -> None:
    assert weights.path.stat().st_size <= 3_000_000
    with safe_open(weights.path, framework="pt") as file:
        document = json.loads(file.metadata()["swarmchase"])
        tensors = [file.get_tensor(name) for name in file.keys()]  # noqa: SIM118 (safe_open is no mapping)
    assert {tensor.dtype for tensor in tensors} == {torch.float16}
    assert sum(tensor.numel() for tensor in tensors) == 1_470_488
    assert own_scenario(weights) in [Scenario.from_dict(fields) for fields in document["scenarios"]]
    objective = document["settings"]["losses"]["objective"]
    if weights.family == "paper-a3c":
        assert (objective, document["schedule"]) == ("actor_critic", "processes")
        assert document["settings"]["initial_weights"] is None
    else:
        assert (objective, document["schedule"]) == ("counterfactual", "batched")


@pytest.mark.parametrize("weights", ALL, ids=lambda weights: weights.name)
def test_it_reaches_its_targets_and_the_shipped_table_is_of_it(
    weights: ShippedWeights, shipped_table: dict[str, Evaluation]
) -> None:
    """The first chases of the table, again: another controller would need other numbers of movements."""
    scenario = own_scenario(weights)
    table = shipped_table[weights.name]
    assert scenario == table.scenario
    controller = load_controller(weights.family, scenario)
    rows = sorted(run_chases(scenario, controller, table.seed, range(4)), key=lambda row: row.chase)
    assert all(row.reached for row in rows)
    assert [row.movements for row in rows] == [chase.movements for chase in table.chases[:4]]


def test_the_shipped_table_is_of_all_of_them_and_of_nobody_else(shipped_table: dict[str, Evaluation]) -> None:
    assert shipped_table.keys() == {weights.name for weights in ALL}


def test_the_easiest_setting_is_chased_nearly_as_fast_as_the_oracle_does() -> None:
    """25 movements at the 90th percentile of 10,000 chases; of 100 chases it may be one or two more."""
    scenario = paper_scenario(sampling_hz=10, spatial_correlation=0.9)
    rows = list(run_chases(scenario, load_controller("paper", scenario), 0, range(100)))
    assert all(row.reached for row in rows)
    assert nearest_rank_percentile([row.movements for row in rows], 90) <= 26


@pytest.mark.parametrize(
    ("family", "form", "objective", "parameters"),
    [("recurrent", "fading", "fading", 56_321), ("robust", "gated", "counterfactual", 277_924)],
)
def test_those_that_remember_are_one_file_for_all_settings(
    family: str, form: str, objective: str, parameters: int
) -> None:
    [weights] = FAMILIES[family]
    assert weights.name == f"{family}/all-settings"
    with safe_open(weights.path, framework="pt") as file:
        document = json.loads(file.metadata()["swarmchase"])
        tensors = [file.get_tensor(name) for name in file.keys()]  # noqa: SIM118 (safe_open is no mapping)
    assert {tensor.dtype for tensor in tensors} == {torch.float16}
    assert sum(tensor.numel() for tensor in tensors) == parameters
    settings = document["settings"]
    assert (settings["form"], settings["losses"]["objective"], document["schedule"]) == (form, objective, "batched")
    assert settings["varied_world"] == (family == "robust")
    told = {(one["sampling_hz"], one["spatial_correlation"]) for one in document["scenarios"]}
    assert told == {(hertz, rho) for hertz in SAMPLING_HZ for rho in SPATIAL_CORRELATION}
    between, outside = paper_scenario(sampling_hz=30.0, spatial_correlation=0.7), paper_scenario(sampling_hz=200.0)
    assert chosen_weights(family, between) == chosen_weights(family, outside) == weights
    assert weights.explanation(between) is None
    assert "F = 200 Hz, rho = 0.9 lies outside" in str(weights.explanation(outside))


def test_adaptive_is_told_nothing_and_has_one_file_for_all_channels() -> None:
    [weights] = FAMILIES["adaptive"]
    assert weights.name == "adaptive/all-channels"
    with safe_open(weights.path, framework="pt") as file:
        document = json.loads(file.metadata()["swarmchase"])
        tensors = [file.get_tensor(name) for name in file.keys()]  # noqa: SIM118 (safe_open is no mapping)
    assert {tensor.dtype for tensor in tensors} == {torch.float16}
    assert sum(tensor.numel() for tensor in tensors) == 62_819
    assert document["update"] == document["settings"]["max_updates"]
    assert "scenarios" not in document
    anywhere = paper_scenario(sampling_hz=400.0, spatial_correlation=0.0)
    assert chosen_weights("adaptive", anywhere) == weights
    assert weights.explanation(anywhere) is None


def test_those_that_remember_pass_the_filter_where_a_window_says_least() -> None:
    """F = 100 Hz, rho = 0.1: 27.4 movements on average with ``particle``, 24.0 with ``recurrent``; 100 chases."""
    scenario = paper_scenario(sampling_hz=100, spatial_correlation=0.1)
    movements = {}
    for name in ("particle", "recurrent", "robust"):
        rows = list(run_chases(scenario, load_controller(name, scenario), 3, range(100)))
        assert all(row.reached for row in rows)
        movements[name] = sum(row.movements for row in rows) / 100
    assert movements["recurrent"] < 0.93 * movements["particle"]
    assert movements["robust"] < 1.05 * movements["particle"]


@pytest.mark.parametrize(
    ("sampling_hz", "rho", "chosen"),
    [
        (10, 0.9, "paper/F10-rho0.9"),
        (100, 0.1, "paper/F100-rho0.1"),
        # A factor of 1.25 is a third of a step, 1.6 two thirds.
        (12.5, 0.9, "paper/F10-rho0.9"),
        (16, 0.9, "paper/F20-rho0.9"),
        # Nearer than any other, however far.
        (1, 1.0, "paper/F10-rho0.9"),
        (1000, 0.0, "paper/F100-rho0.1"),
        (50, 0.69, "paper/F50-rho0.5"),
        (50, 0.71, "paper/F50-rho0.9"),
        # Of two as near the one of the harder setting.
        (50, 0.7, "paper/F50-rho0.5"),
        (200**0.5, 0.9, "paper/F20-rho0.9"),
    ],
)
def test_the_nearest_is_chosen(sampling_hz: float, rho: float, chosen: str) -> None:
    scenario = paper_scenario(sampling_hz=float(sampling_hz), spatial_correlation=rho)
    weights = chosen_weights("paper", scenario)
    assert weights is not None
    assert weights.name == chosen
    assert weights.setting is not None
    own = weights.setting == (sampling_hz, rho)
    explanation = weights.explanation(scenario)
    assert (explanation is None) == own
    assert own or "that of F = {:g} Hz, rho = {:g}".format(*weights.setting) in str(explanation)


def test_the_controller_is_the_chosen_file_and_the_command_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    between = paper_scenario(sampling_hz=70.0, spatial_correlation=0.6)
    chosen = chosen_weights("paper", between)
    assert chosen is not None
    by_name, by_path = load_controller("paper", between), load_controller(chosen.path, between)
    window_dbm = -60 + torch.randn(8, 50, 6, generator=torch.Generator().manual_seed(0))
    assert torch.equal(
        greedy_choice(by_name._networks.policy_logits(window_dbm)),  # type: ignore[attr-defined]
        greedy_choice(by_path._networks.policy_logits(window_dbm)),  # type: ignore[attr-defined]
    )
    words = "evaluate --controller paper --sampling-hz 70 --spatial-correlation 0.6 --episodes 2 --processes 1 --json"
    main(words.split())
    output = capsys.readouterr()
    assert json.loads(output.out)["weights"] == chosen.name == "paper/F50-rho0.5"
    assert "none was trained for F = 70 Hz, rho = 0.6; using that of F = 50 Hz, rho = 0.5" in output.err
    main(words.replace("70", "50").replace("0.6", "0.5").split())
    assert "none was trained" not in capsys.readouterr().err


def test_no_family_is_chosen_for_another_controller() -> None:
    assert chosen_weights("oracle", paper_scenario()) is None
    assert chosen_weights("somewhere/best.safetensors", paper_scenario()) is None


def test_the_card_and_the_readme_show_pictures_that_are_there() -> None:
    for document in (WEIGHTS_FOLDER / "README.md", Path(__file__).parents[2] / "README.md"):
        for link in re.findall(r"\]\(([^)#]+)\)", document.read_text(encoding="utf-8")):
            assert (document.parent / link).exists(), link


def test_the_card_names_every_family() -> None:
    for name in FAMILIES:
        assert f"`{name}`" in MODEL_CARD
