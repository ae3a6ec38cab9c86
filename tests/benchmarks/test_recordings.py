"""Recordings as they are read, driven and flown over: by pencil, and with small files of the same kind."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmchase.benchmarks import recordings
from swarmchase.benchmarks.radio_map import RadioMap, read_map
from swarmchase.benchmarks.recorded_levels import fitted_path_loss, read_paths, surveys
from swarmchase.cli import main
from swarmchase.errors import InputError

DEGREE_M = 110_540.0
"""Of latitude."""


def written_path(folder: Path, seconds: int, gone_after: int) -> None:
    """A receiver goes 1 m north a second, the emitter stands 30 m north of its start and jumps by 50 m; the level is
    -40 - 20 lg d."""
    lines = []
    for second in range(seconds):
        emitter_m = 30.0 if second < gone_after else 80.0
        level_dbm = -40 - 20 * math.log10(max(1.0, abs(emitter_m - second)))
        lines.append(f"{second},{second / DEGREE_M},0,{emitter_m / DEGREE_M},0,{level_dbm}")
    text = "\n".join(["t_unix,rx_lat,rx_lon,drone_lat,drone_lon,rssi_dbm", *lines, ""])
    (folder / "walk.csv").write_text(text)


def written_map(folder: Path) -> None:
    """Nine places 8 m apart and one emitter in the middle, -40 - 20 lg d."""
    places = [(x, y, 1.0) for x in (0.0, 8.0, 16.0) for y in (0.0, 8.0, 16.0)]
    levels = [-40 - 20 * math.log10(max(1.0, math.hypot(x - 8, y - 8))) for x, y, _ in places]
    lines = [
        f"{x},{y},{z},one,{' '.join([f'{level:.2f}'] * 60)}" for (x, y, z), level in zip(places, levels, strict=True)
    ]
    (folder / "sensors.csv").write_text("sensor,x_m,y_m,z_m\none,8,8,1\n")
    (folder / "radio_map.csv").write_text("\n".join(["x_m,y_m,z_m,sensor,rssi_dbm", *lines, ""]))


def test_a_path_is_cut_where_the_emitter_has_gone(tmp_path: Path) -> None:
    written_path(tmp_path, seconds=52, gone_after=25)
    (tmp_path / "other.csv").write_text("rssi,noise\n1,2\n")
    first, second = read_paths(tmp_path)
    assert (first.name, second.name) == ("walk-0", "walk-5")
    assert first.rssi_dbm.shape == (5, 50, 6)
    assert second.rssi_dbm.shape == (5, 50, 6), "what is left over is no window"
    heard = np.isfinite(first.rssi_dbm)
    assert heard.sum() == 25
    assert not heard[..., 1:].any(), "one receiver"
    assert first.tracker_position_m[-1, -1].tolist() == pytest.approx(np.array([[0, 24, 0]] * 6), abs=1e-3)
    assert first.target_position_m[:, 1].tolist() == pytest.approx([30] * 5, abs=1e-3)
    assert second.target_position_m[:, 1].tolist() == pytest.approx([80 - 25] * 5, abs=1e-3)
    assert fitted_path_loss([first, second]) == pytest.approx((-40, 2), abs=0.01)


def test_json_of_a_path_is_read_alike(tmp_path: Path) -> None:
    records = {
        str(second): {"position": [second / DEGREE_M, 0], "drone_position": [0, 30 / DEGREE_M], "rssi": -60.0}
        for second in range(30)
    }
    (tmp_path / "walk.json").write_text(json.dumps(records))
    (recording,) = read_paths(tmp_path)
    assert recording.target_position_m[0].tolist() == pytest.approx([0, 30, 0], abs=1e-3)
    assert np.nanmax(recording.rssi_dbm) == -60


@pytest.mark.parametrize("content", [None, "[1]", '{"1": {}}', "{"])
def test_what_is_no_path_is_refused(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "walk.json").write_text(content)
    with pytest.raises(InputError, match="holds no recorded paths"):
        read_paths(tmp_path)


def test_a_swarm_hears_what_was_recorded_at_the_nearest_places(tmp_path: Path) -> None:
    written_map(tmp_path)
    over = RadioMap(*read_map(tmp_path))
    starts = [start_m.tolist() for start_m, _ in over.chases()]
    assert starts == [[0, 0, 1], [0, 16, 1], [16, 0, 1], [16, 16, 1]]
    rssi_dbm, place_m = over.heard(np.array([4.5, 0.0, 1.0]), 5.0, 0, 50, np.random.default_rng(0))
    # Five metres east, west, north, south, up and down of (4.5, 0).
    assert place_m[:, :2].tolist() == [[8, 0], [0, 0], [8, 8], [8, 0], [8, 0], [8, 0]]
    assert rssi_dbm.shape == (50, 6)
    assert rssi_dbm[0].tolist() == pytest.approx([-58.06, -61.07, -40, -58.06, -58.06, -58.06], abs=0.01)
    survey = surveys(over, 0, 3, 10.0, 50)[0]
    assert survey.tracker_position_m.shape == (3, 50, 6, 3)
    assert survey.target_position_m[0].tolist() == [8, 8, 0]


@pytest.mark.parametrize(
    ("moved_m", "angle_deg"), [((4, 0), 0), ((4, 4), 45), ((0, -2), 90), ((-4, 0), 180), ((0, 0), 180)]
)
def test_who_holds_still_goes_the_wrong_way(moved_m: tuple[float, float], angle_deg: float) -> None:
    assert recordings._angle_deg(np.array(moved_m, dtype=float), np.array([7.0, 0.0])) == pytest.approx(angle_deg)


def test_the_command_measures_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Levels without any fading: ``adaptive`` finds the emitter in the middle of a coarse map from most corners."""
    written_map(tmp_path)
    (tmp_path / "paths").mkdir()
    written_path(tmp_path / "paths", seconds=25, gone_after=25)
    words = ["benchmark", "recordings", "--map", str(tmp_path), "--paths", str(tmp_path / "paths"), "--draws", "1"]
    main([*words, "--json"])
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    (chases,) = result["chases"]
    assert chases["chases"] == 4
    assert chases["reached_share"] >= 0.5
    assert chases["sure_and_wrong"] == 0
    assert list(result["paths"]) == ["walk-0"]
    assert 0 <= result["paths"]["walk-0"]["coverage"] <= 1
    main([*words, "--controller", "gradient"])
    assert "gradient on recordings" in capsys.readouterr().err


def test_nothing_to_measure_is_refused() -> None:
    with pytest.raises(InputError, match="give a radio map or recorded paths"):
        recordings.measure("random", None, None, [0], False, lambda: None)
