"""The controller that comes with the package: what its file holds, and that it reaches its targets."""

import json
import re
from pathlib import Path

import torch
from safetensors import safe_open

from swarmchase.chases import nearest_rank_percentile, run_chases
from swarmchase.controllers import load_controller, shipped_weights
from swarmchase.scenario import paper_scenario
from swarmchase.training.settings import PRESETS

WEIGHTS = shipped_weights()["paper"]
MODEL_CARD = (WEIGHTS.parent / "README.md").read_text(encoding="utf-8")


def test_the_file_is_small_and_says_what_made_it() -> None:
    assert WEIGHTS.stat().st_size <= 3_000_000
    with safe_open(WEIGHTS, framework="pt") as file:
        document = json.loads(file.metadata()["swarmchase"])
        tensors = [file.get_tensor(name) for name in file.keys()]  # noqa: SIM118 (safe_open is no mapping)
    assert {tensor.dtype for tensor in tensors} == {torch.float16}
    assert sum(tensor.numel() for tensor in tensors) == 1_470_488
    assert document["method"] == "a3c"
    assert document["scenario"] == paper_scenario(sampling_hz=10, spatial_correlation=0.9).to_dict()
    assert document["settings"] == json.loads(json.dumps(PRESETS["fast"].to_dict()))
    assert f"after {document['update']:,} updates" in MODEL_CARD


def test_it_reaches_every_target_nearly_as_fast_as_the_oracle() -> None:
    """The card says 25 movements at the 90th percentile of 10,000 chases; of 150 chases it may be one or two more."""
    said = re.search(r"\| sampled \| 100 % \|.*\| (\d+) \[", MODEL_CARD)
    assert said is not None
    assert said.group(1) == "25"
    scenario = paper_scenario(sampling_hz=10, spatial_correlation=0.9)
    rows = list(run_chases(scenario, load_controller("paper", scenario), 0, range(150)))
    assert all(row.reached for row in rows)
    assert nearest_rank_percentile([row.movements for row in rows], 90) <= 27


def test_the_card_and_the_readme_show_pictures_that_are_there() -> None:
    for document in (WEIGHTS.parent / "README.md", Path(__file__).parent.parent / "README.md"):
        for link in re.findall(r"\]\(([^)#]+)\)", document.read_text(encoding="utf-8")):
            assert (document.parent / link).exists(), link
