"""examples/pipeline.sh, from training to the picture, on a tiny setting."""

import os
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

SCRIPT = Path(__file__).parents[2] / "examples" / "pipeline.sh"


def pipeline(folder: Path, **settings: str) -> subprocess.CompletedProcess[str]:
    """The script with these variables; paths of pytest have no spaces."""
    return subprocess.run(
        [str(SCRIPT), str(folder)],
        env={**os.environ, "SWARMCHASE": f"{sys.executable} -m swarmchase", **settings},
        capture_output=True,
        text=True,
        check=False,
    )


def test_it_trains_evaluates_compares_and_draws(tmp_path: Path) -> None:
    folder, tiny = tmp_path / "pipeline", tmp_path / "tiny.toml"
    tiny.write_text("max_movements = 3\nwindow_samples = 3\n", encoding="utf-8")
    settings = {"UPDATES": "1", "EPISODES": "2", "SETTING": f"--scenario {tiny}"}
    ran = pipeline(folder, **settings)
    assert ran.returncode == 0, ran.stderr
    steps = [line for line in ran.stdout.splitlines() if line.startswith("== ")]
    assert [step.split()[1] for step in steps] == ["1.", "2.", "3.", "4.", "done."]
    assert pq.read_table(folder / "chases.parquet").num_rows == 2
    compared = (folder / "comparison" / "comparison.md").read_text(encoding="utf-8")
    for name in ("best.safetensors", "gradient", "oracle"):
        assert name in compared
    for picture in ("chase/chase.png", "comparison/movements.png"):
        assert (folder / picture).read_bytes().startswith(b"\x89PNG"), picture


def test_interrupted_it_goes_on_with_the_training_it_finds(tmp_path: Path) -> None:
    def words() -> list[str]:
        return pipeline(tmp_path, SWARMCHASE="echo").stdout.splitlines()

    assert not any("--resume" in line for line in words())
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "resume.safetensors").touch()
    assert [line.split()[:2] for line in words() if "--resume" in line] == [["train", "batched"]]


@pytest.mark.parametrize("command", ["false", "no-such-command"])
def test_a_step_that_fails_ends_it(tmp_path: Path, command: str) -> None:
    ran = pipeline(tmp_path, SWARMCHASE=command)
    assert ran.returncode != 0
    assert "== 2." not in ran.stdout
