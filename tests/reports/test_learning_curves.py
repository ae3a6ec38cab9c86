"""The learning curves of several trainings, gathered from the folders that they leave (docs/table1_training.py)."""

import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import torch
from PIL import Image

from swarmchase.networks.forms import new_networks
from swarmchase.scenario import paper_scenario
from swarmchase.training.evaluator import BEST_WEIGHTS, save_trained_weights, weights_configuration
from swarmchase.training.losses import LossSettings
from swarmchase.training.run_folder import LOG_FILE
from swarmchase.training.settings import TrainingSettings

DOCS = Path(__file__).parent.parent.parent / "docs"

CHASES = (
    # (update at its end, movements, reached), of at most 12 movements and T = 5.
    (3, 7, True),
    (6, 12, False),
    (9, 10, True),
)
EVALUATIONS = (
    # (update, share reached, seconds).
    (4, 0.5, 36.0),
    (9, 1.0, 72.0),
)


def test_the_figure_of_the_docs_is_drawn_from_their_table(tmp_path: Path) -> None:
    out = tmp_path / "table1-training.png"
    words = [sys.executable, "docs/table1_training.py", "--figure", str(out)]
    ran = subprocess.run(words, cwd=DOCS.parent, capture_output=True, text=True, check=False, timeout=300)
    assert (ran.returncode, ran.stderr) == (0, "")
    with Image.open(out) as drawn, Image.open(DOCS / "figures" / out.name) as shown:
        assert drawn.size == shown.size
        assert drawn.info["Title"] == shown.info["Title"]
        assert (np.asarray(drawn.convert("L")) < 200).mean() > 0.01


def test_curves_are_gathered_from_logs_and_kept_networks(tmp_path: Path) -> None:
    torch.manual_seed(0)
    settings = TrainingSettings(losses=LossSettings(discount=0.5), learning_rate=2e-4, evaluation_chases=1)
    scenario = paper_scenario(sampling_hz=20.0, spatial_correlation=0.5, start_distance_m=3.0, max_movements=12)
    folder = tmp_path / "runs" / "run"
    folder.mkdir(parents=True)
    networks = new_networks(settings)
    configuration = weights_configuration([scenario], settings, "processes", 9)
    save_trained_weights(folder / BEST_WEIGHTS, networks, configuration)
    lines = [
        {"kind": "chase", "update": update, "movements": movements, "reached": reached}
        for update, movements, reached in CHASES
    ]
    lines += [
        {
            "kind": "evaluation",
            "update": update,
            "movements_mean": 9.0,
            "movements_p90": 11.0,
            "success_rate": reached,
            "p90_by_scenario": [11.0],
            "seconds": seconds,
            "environment_steps": 1000,
        }
        for update, reached, seconds in EVALUATIONS
    ]
    (folder / LOG_FILE).write_text("".join(json.dumps(line) + "\n" for line in lines))
    script = importlib.util.spec_from_file_location("table1_training", DOCS / "table1_training.py")
    assert script is not None
    assert script.loader is not None
    table1_training = importlib.util.module_from_spec(script)
    script.loader.exec_module(table1_training)
    table = tmp_path / "curves.parquet"
    table1_training.gather(tmp_path / "runs", table)
    points = pq.read_table(table).to_pylist()
    assert {(point["sampling_hz"], point["spatial_correlation"], point["variant"]) for point in points} == {
        (20.0, 0.5, "learning_rate = 0.0002, discount = 0.5")
    }
    by_choice = {choice: [p for p in points if p["action_choice"] == choice] for choice in ("greedy", "sampled")}
    # Of 5 movements an update: 3 less for the chase of 7 movements, 3 less for that of 12, none for that of 10.
    steps = [(point["update"], point["environment_steps"], point["hours"]) for point in by_choice["sampled"]]
    assert steps == [(4, 20 - 3, 0.01), (9, 45 - 3 - 3, 0.02)]
    [greedy] = by_choice["greedy"]
    assert (greedy["update"], greedy["environment_steps"], greedy["hours"]) == (9, 39, 0.02)
    assert greedy["movements_mean"] == greedy["movements_p90"] <= 13
    [training] = [point for point in points if point["action_choice"] == "training"]
    assert (training["update"], training["movements_p90"], training["hours"]) == (9, 13.0, None)
    assert training["movements_mean"] == (7 + 13 + 10) / 3
    assert training["reached"] == 2 / 3
    shutil.rmtree(folder)  # what is known stays known
    table1_training.gather(tmp_path / "runs", table)
    assert pq.read_table(table).to_pylist() == by_choice["greedy"] + by_choice["sampled"]
