"""The pictures in the docs are made by commands from real runs."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from swarmchase.scenario import SHIPPED_SCENARIOS
from swarmchase.world.behaviours import behaviour_names

ROOT = Path(__file__).parent.parent


def test_the_picture_of_the_page_is_taken_of_a_chase(tmp_path: Path) -> None:
    """At small size, after one movement. That of the docs has the size that the command gives it."""
    pytest.importorskip("playwright", reason="playwright is not installed: pip install -e '.[dev]'")
    if shutil.which("chromium") is None:
        pytest.skip("there is no chromium (Debian: apt-get install chromium)")
    out = tmp_path / "page.png"
    words = [sys.executable, "docs/pictures.py", "--out", str(out), "--movements", "1", "--size", "640", "480"]
    ran = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert [path.name for path in tmp_path.iterdir()] == ["page.png"]
    picture = Image.open(out).convert("HSV")
    assert picture.size == (640, 480)
    with Image.open(ROOT / "docs" / "live-page.png") as shown:
        assert shown.size == (1280, 800)
    hues, saturations, _ = np.moveaxis(np.asarray(picture, dtype=np.int64), 2, 0)
    teal_or_blue = (hues > 118) & (hues < 155) & (saturations > 150)  # the name of a state that is under way
    assert np.count_nonzero(teal_or_blue) > 200


def test_the_picture_of_a_flying_target_is_drawn_from_the_chase_that_the_docs_name(tmp_path: Path) -> None:
    """Its title, which the file keeps, says what was chased and when it was reached."""
    out = tmp_path / "moving-chase.png"
    words = [sys.executable, "docs/moving_picture.py", "--out", str(out)]
    ran = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert [path.name for path in tmp_path.iterdir()] == ["moving-chase.png"]
    with Image.open(out) as drawn, Image.open(ROOT / "docs" / "figures" / "moving-chase.png") as shown:
        assert drawn.size == shown.size
        assert drawn.info["Title"] == shown.info["Title"]
        assert "target (jink, 8 m/s) reached in" in drawn.info["Title"]
    chase = re.search(r'^CHASE = "(.*)"$', (ROOT / "docs" / "moving_picture.py").read_text(), re.MULTILINE)
    assert chase is not None
    assert f"    swarmchase {chase[1]}\n" in (ROOT / "docs" / "moving.md").read_text(encoding="utf-8")


def test_scenarios_and_behaviours_are_drawn_from_the_chases_that_the_docs_name(tmp_path: Path) -> None:
    """Of a picture the title, which the file keeps, says of what it is; the text knows every one that is drawn."""
    words = [sys.executable, "docs/scenario_pictures.py", "--folder", str(tmp_path)]
    ran = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)
    assert (ran.returncode, ran.stderr) == (0, "")
    titles = {
        "behaviours.png": "Behaviours at 5 m/s: chase 12 of seed 0 by oracle",
        "scenarios.png": f"{', '.join(SHIPPED_SCENARIOS)}: chases 0 to 7 of seed 0 by oracle",
    }
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(titles)
    for name, title in titles.items():
        with Image.open(tmp_path / name) as drawn, Image.open(ROOT / "docs" / "figures" / name) as shown:
            assert drawn.size == shown.size
            assert drawn.info["Title"] == shown.info["Title"] == title
            assert (np.asarray(drawn.convert("L")) < 200).mean() > 0.01


def test_the_docs_name_every_scenario_and_every_behaviour_and_no_other() -> None:
    text = (ROOT / "docs" / "moving.md").read_text(encoding="utf-8")
    named = re.search(r"What the target does is `--behaviour`: (.*?), or\n", text, re.DOTALL)
    assert named is not None
    assert re.findall(r"`([a-z-]+)`", named[1]) == behaviour_names()
    assert re.findall(r"^\| `([a-z]+)` \|", text, re.MULTILINE) == list(SHIPPED_SCENARIOS)
