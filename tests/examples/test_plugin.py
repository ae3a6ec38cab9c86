"""A package beside this one is installed as its users would, and what it offers works in the commands."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from swarmchase.errors import InputError
from swarmchase.live.tracker.sources.address import open_source
from swarmchase.live.tracker.sources.kind import SourceDetails
from swarmchase.live.tracker.vehicles.address import open_vehicle
from swarmchase.live.tracker.vehicles.kind import VehicleDetails

PLUGIN = Path(__file__).parents[2] / "examples" / "plugin"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which it is installed."""
    folder = tmp_path_factory.mktemp("installed")
    words = ["install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--target", str(folder)]
    subprocess.run([sys.executable, "-m", "pip", *words, str(PLUGIN)], check=True, timeout=120)
    return folder


def command(words: str, installed: Path, folder: Path) -> "subprocess.CompletedProcess[str]":
    path = os.pathsep.join([str(installed), *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.run(
        [sys.executable, "-m", "swarmchase", *words.split()],
        env={**os.environ, "PYTHONPATH": path},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_its_controller_fading_and_behaviour_are_compared_with_ours(installed: Path, tmp_path: Path) -> None:
    world = "--scenario flight --continuity none --behaviour spiral --target-speed-mps 1 --start-distance-m 20"
    ran = command(f"compare --controllers loudest gradient {world} --episodes 3 --json", installed, tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert [(row["controller"], row["episodes"]) for row in json.loads(ran.stdout)] == [("loudest", 3), ("gradient", 3)]


def test_without_it_its_names_are_refused(tmp_path: Path) -> None:
    ran = command("evaluate --continuity none", tmp_path, tmp_path)
    assert ran.returncode == 2
    assert "continuity = 'none' is refused: allowed is 'independent' or 'continuous' or 'in_flight'" in ran.stderr


def test_its_source_and_vehicle_have_addresses_like_ours(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"^source 'beacon:2' is refused: allowed is one of replay:FILE"):
        open_source("beacon:2", SourceDetails())
    monkeypatch.syspath_prepend(installed)
    source = open_source("beacon:2", SourceDetails(sampling_hz=1.0))
    levels_dbm = [level_dbm for time_s in range(1, 9) for _, level_dbm in source.read(time_s * 10**9)]
    assert levels_dbm == [-50.0, -80.0, -80.0, -50.0, -50.0, -80.0, -80.0, -50.0]
    assert open_vehicle("tripod", VehicleDetails(position_m=(1.0, 2.0, 3.0))).position_m == (1.0, 2.0, 3.0)
    with pytest.raises(InputError, match="a tripod needs --position-m"):
        open_vehicle("tripod", VehicleDetails())
