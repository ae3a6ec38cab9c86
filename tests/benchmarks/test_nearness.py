"""Where the live service says "reached" over a real hall: near the emitter, and hardly ever far from it."""

import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from swarmchase.benchmarks import nearness
from swarmchase.errors import InputError

HALL = Path(__file__).parents[3] / "shared" / "data" / "ble-hall"
NEEDS_THE_HALL = pytest.mark.skipif(not HALL.is_dir(), reason="the radio map lies beside the project, not in it")


@NEEDS_THE_HALL
def test_over_a_real_hall_few_distant_places_are_called_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two windows at each place. The whole is ``swarmchase benchmark nearness``."""
    monkeypatch.setattr(nearness, "MOST_WINDOWS", 2)
    result = nearness.measure(HALL)
    assert (result["places"], result["emitters"]) == (81, 12)
    assert result["deviation_db"] == pytest.approx(4.5, abs=0.5)
    assert result["no_levels_share"] <= 0.002, "what an emitter beside the place gives is more than the fitted one can"
    for row in result["called_reached"]:
        assert row["beyond 4 m"] <= 0.05
        assert row["beyond 7 m"] <= 0.01
    near = {row["spacing_m"]: row["within 2 m"] for row in result["called_reached"]}
    assert min(near[1], near[2], near[3]) >= 0.6


def test_the_path_loss_that_is_told_is_the_best_fit(tmp_path: Path) -> None:
    """Levels made of -40 dBm at 1 m and an exponent of 2, read from such a folder."""
    places = [(1.0, 0.0, 0.0), (10.0, 0.0, 0.0), (100.0, 0.0, 0.0)]
    lines = [f"{x},{y},{z},only,{' '.join([str(-40 - 20 * math.log10(x))] * 100)}" for x, y, z in places]
    (tmp_path / "sensors.csv").write_text("sensor,x_m,y_m,z_m\nonly,0,0,0\n")
    (tmp_path / "radio_map.csv").write_text("\n".join(["x_m,y_m,z_m,sensor,rssi_dbm", *lines, ""]))
    emitter_m, place_m, rssi_dbm = nearness.read_map(tmp_path)
    assert rssi_dbm.shape == (3, 1, 100)
    scenario, deviation_db = nearness.fitted_scenario(np.linalg.norm(place_m[:, None] - emitter_m, axis=2), rssi_dbm)
    assert scenario.transmit_power_dbm - scenario.reference_path_loss_db == pytest.approx(-40)
    assert scenario.path_loss_exponent == pytest.approx(2)
    assert deviation_db == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("content", [None, "", "x_m,y_m,z_m,sensor,rssi_dbm\n1,2,three,only,-60\n"])
def test_what_is_no_map_is_refused(tmp_path: Path, content: str | None) -> None:
    (tmp_path / "sensors.csv").write_text("sensor,x_m,y_m,z_m\nonly,0,0,0\n")
    if content is not None:
        (tmp_path / "radio_map.csv").write_text(content)
    with pytest.raises(InputError, match="holds no radio map"):
        nearness.measure(tmp_path)
