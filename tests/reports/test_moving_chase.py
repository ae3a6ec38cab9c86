"""The picture and the film of a chase by the clock, and the film of the paper's: from a log on disk, whole or not."""

import dataclasses
import errno
import itertools
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any, NoReturn

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image, ImageSequence

from figure_checks import require_tidy
from swarmchase.controllers import load_controller
from swarmchase.errors import InputError
from swarmchase.evaluation.chase_log import chase_log, run_chase, save_chase_log
from swarmchase.reports import animation
from swarmchase.reports.animation import draw_animation, num_frames
from swarmchase.reports.chase import draw_chase
from swarmchase.reports.flight_paths import flight_paths
from swarmchase.reports.style import COLUMN_WIDTH_INCHES, TRACKER_NAMES
from swarmchase.scenario import Scenario, load_scenario, paper_scenario

FLIGHT = dataclasses.replace(
    load_scenario("flight"), start_distance_m=12.0, farthest_start_m=16.0, behaviour="jink", target_speed_mps=3.0
)
SITUATIONS = {
    "captured": (FLIGHT, "oracle"),
    "not captured": (dataclasses.replace(FLIGHT, max_movements=5), "random"),
    # The only decision there is.
    "one movement": (dataclasses.replace(FLIGHT, max_movements=1), "oracle"),
    # Some trackers hear nothing at all, and every other sample is lost.
    "gaps": (dataclasses.replace(FLIGHT, silent_trackers=3, missing_sample_share=0.5, max_movements=9), "random"),
    "stop and listen": (paper_scenario(max_movements=4, behaviour="straight", target_speed_mps=3.0), "oracle"),
    # A belief, and after the capture 2 s more.
    "belief": (dataclasses.replace(FLIGHT, follow_s=2.0), "particle"),
    # Straight down on a target that stands below: neither path has a length from above.
    "one place": (dataclasses.replace(FLIGHT, behaviour="hover", target_speed_mps=0.0, max_movements=3), "oracle"),
}


def log_of(scenario: Scenario, controller: str, path: Path) -> dict[str, Any]:
    """As it comes back from the disk."""
    driver = load_controller(controller, scenario)
    save_chase_log(path, chase_log(scenario, driver, 1, 2, list(run_chase(scenario, driver, 1, 2))))
    return dict(json.loads(path.read_text()))


@pytest.fixture(scope="module", params=list(SITUATIONS))
def log(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    log = log_of(*SITUATIONS[request.param], tmp_path_factory.mktemp("log") / "chase.json")
    if request.param == "one place":
        for moment in log["moments"]:
            moment["center_m"][:2] = moment["target_position_m"][:2] = [0.0, 0.0]
        log["target_position_m"][:2] = [0.0, 0.0]
    return log


@pytest.fixture(scope="module")
def captured(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return log_of(*SITUATIONS["captured"], tmp_path_factory.mktemp("log") / "chase.json")


def test_the_picture_is_a_column_wide_and_nothing_lies_outside_its_panel(
    log: dict[str, Any], tmp_path: Path, figures: list[Figure]
) -> None:
    draw_chase(log, tmp_path / "chase.png")
    image = matplotlib.image.imread(tmp_path / "chase.png")
    assert image.shape[1] == COLUMN_WIDTH_INCHES * 200
    assert (image[..., :3] != 1).any(axis=-1).mean() > 0.02
    (figure,) = figures
    labels = ["north (m)", "level (dBm)", "height (m)", "distance (m)"]
    assert [axes.get_ylabel() for axes in figure.axes] == [
        *labels,
        *(["belief (m)"] if log["controller"] == "particle" else []),
    ]
    require_tidy(figure)


def test_the_picture_says_what_the_log_says(captured: dict[str, Any], tmp_path: Path, figures: list[Figure]) -> None:
    draw_chase(captured, tmp_path / "chase.pdf")
    (figure,) = figures
    plan, levels, height, distance = figure.axes
    assert figure.get_suptitle().startswith("Controller oracle, target (jink, 3 m/s) reached in ")
    paths = flight_paths(captured)
    ways = [np.asarray(line.get_xydata()) for line in plan.lines]
    for place_m, other in ((paths.center_m, 0), (paths.target_m, 1)):
        assert any(way.shape == place_m[:, :2].shape and np.allclose(way, place_m[:, :2]) for way in ways)
        assert np.allclose(np.asarray(height.lines[other].get_ydata()), place_m[:, 2])
    (way,) = [line for line in distance.lines if len(np.asarray(line.get_xdata())) == len(paths)]
    assert np.allclose(np.asarray(way.get_ydata())[:-1], paths.distance_m[:-1])
    assert np.asarray(way.get_xydata())[-1].tolist() == [captured["capture_s"], 2.0]
    means = {str(line.get_label()): line for line in levels.lines if line.get_label() in TRACKER_NAMES}
    heard = np.array([moment["rssi_dbm"] for moment in captured["moments"]])
    assert list(means) == list(TRACKER_NAMES)
    windows = -(-len(heard) // 42)
    assert np.asarray(means["+x"].get_ydata())[0] == pytest.approx(heard[:windows, :, 0].mean())
    # Told apart without colour: a shape an axis, filled or hollow, and no marker on another one.
    looks = {(line.get_marker(), line.get_markerfacecolor() == "white") for line in means.values()}
    assert len(looks) == 6
    assert len({line.get_markevery() for line in means.values()}) == 6


def test_the_picture_shows_the_belief_and_a_chase_that_goes_on(tmp_path: Path, figures: list[Figure]) -> None:
    log = log_of(*SITUATIONS["belief"], tmp_path / "chase.json")
    moments = log["moments"]
    assert moments[-1]["time_s"] >= log["capture_s"] + 2
    draw_chase(log, tmp_path / "chase.png")
    *_, distance, belief = figures[0].axes
    (star,) = [line for line in distance.lines if line.get_marker() == "*"]
    assert np.asarray(star.get_xydata()).tolist() == [[log["capture_s"], 2.0]]
    way = np.asarray(max(distance.lines, key=lambda line: len(np.asarray(line.get_xdata()))).get_xydata())
    assert way[-1].tolist() == pytest.approx([moments[-1]["time_s"], moments[-1]["distance_m"]])
    assert [log["capture_s"], 2.0] in way.tolist()
    radius, error, missed = (np.asarray(line.get_xydata()) for line in belief.lines)
    assert moments[0]["belief"] is None  # nothing was decided yet
    for number, (before, after) in enumerate(itertools.pairwise(moments)):
        apart_m = np.linalg.norm(np.array(after["belief"]["mean_m"]) - before["target_position_m"])
        assert error[number].tolist() == pytest.approx([before["time_s"], apart_m])
        assert radius[number].tolist() == [before["time_s"], after["belief"]["radius_m"]]
    assert len(missed) == sum(not moment["belief"]["is_held"] for moment in moments[1:])


def test_a_metre_is_as_long_to_the_north_as_to_the_east_and_the_scale_is_as_long_as_it_says(
    log: dict[str, Any], tmp_path: Path, figures: list[Figure]
) -> None:
    draw_chase(log, tmp_path / "chase.png")
    plan = figures[0].axes[0]
    frame = plan.get_window_extent()
    (west_m, east_m), (south_m, north_m) = plan.get_xlim(), plan.get_ylim()
    dots_per_metre = frame.width / (east_m - west_m)
    assert frame.height / (north_m - south_m) == pytest.approx(dots_per_metre, rel=1e-3)
    (scale,) = [line for line in plan.lines if line.get_transform() == plan.transAxes]
    begin, end = np.asarray(scale.get_xdata())
    (words,) = [text.get_text() for text in plan.texts if text.get_text().endswith(" m")]
    assert float(words.removesuffix(" m")) == pytest.approx((end - begin) * (east_m - west_m))


def test_a_film_has_a_frame_for_the_beginning_and_every_moment_and_they_grow(
    captured: dict[str, Any], tmp_path: Path
) -> None:
    told: list[int] = []
    draw_animation(captured, tmp_path / "film.gif", told.append)
    # The beginning, the first decision and one after every movement.
    frames = captured["movements"] + 2
    assert told == list(range(1, frames + 1))
    assert [path.name for path in tmp_path.iterdir()] == ["film.gif"]
    with Image.open(tmp_path / "film.gif") as film:
        assert (film.n_frames, num_frames(captured)) == (frames, frames)  # type: ignore[attr-defined]
        durations = [frame.info["duration"] for frame in ImageSequence.Iterator(film)]
        dark = [(np.asarray(frame.convert("L"))[80:] < 128).sum() for frame in ImageSequence.Iterator(film)]
    assert sum(durations) <= 15_000
    assert durations[-1] > 3 * durations[0]  # the end stays
    assert min(dark) > 500
    assert dark[-1] > dark[0] + 50


def test_the_papers_chase_is_a_frame_a_movement(tmp_path: Path) -> None:
    log = log_of(paper_scenario(start_distance_m=10.0), "oracle", tmp_path / "chase.json")
    draw_animation(log, tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == log["movements"] + 1  # type: ignore[attr-defined]


def test_a_long_chase_is_short_and_small(
    captured: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thousand moments; ten frames stand for the most there may be, and their size for its share."""
    long = captured | {"moments": [captured["moments"][k % len(captured["moments"])] for k in range(1000)]}
    assert num_frames(long) == animation.MOST_FRAMES
    assert animation.MOST_FRAMES / animation.FRAMES_HZ[1] + animation.END_FRAMES_S <= 15
    monkeypatch.setattr(animation, "MOST_FRAMES", 10)
    draw_animation(long, tmp_path / "film.gif")
    assert (tmp_path / "film.gif").stat().st_size / 10 * 140 < 5_000_000


def test_every_frame_is_tidy(log: dict[str, Any], tmp_path: Path, figures: list[Figure]) -> None:
    draw_animation(log, tmp_path / "film.gif", lambda _frames: require_tidy(figures[-1]))


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("film.webm", r"animation film\.webm is refused: allowed is a file that ends in \.gif or \.mp4"),
        ("film", r"animation film is refused: allowed is a file that ends in \.gif or \.mp4"),
        ("film.mp4", r"animation film\.mp4 is refused: \.mp4 needs ffmpeg, which is not there; \.gif needs nothing"),
    ],
)
def test_a_film_that_cannot_be_made_is_refused(
    name: str, line: str, captured: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=f"^{line}$"):
        draw_animation(captured, Path(name))
    assert list(tmp_path.iterdir()) == []


def test_an_mp4_is_one(captured: dict[str, Any], tmp_path: Path) -> None:
    if shutil.which("ffmpeg") is None:
        pytest.skip("there is no ffmpeg (Debian: apt-get install ffmpeg)")
    draw_animation(captured, tmp_path / "film.mp4")
    assert (tmp_path / "film.mp4").read_bytes()[4:8] == b"ftyp"
    ran = subprocess.run(
        ["ffmpeg", "-i", str(tmp_path / "film.mp4"), "-f", "null", "-"], check=False, capture_output=True, text=True
    )
    assert "480x620" in ran.stderr


def test_an_ffmpeg_that_fails_is_one_line_and_leaves_nothing(
    captured: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that reads all frames and then finds that it cannot encode them."""
    (tmp_path / "bin").mkdir()
    ffmpeg = tmp_path / "bin" / "ffmpeg"
    ffmpeg.write_text("#!/bin/sh\ncat > /dev/null\nexit 187\n")
    ffmpeg.chmod(0o755)
    monkeypatch.setenv("PATH", str(ffmpeg.parent), prepend=":")
    with pytest.raises(InputError, match=r"cannot write .*film\.mp4: ffmpeg ended with exit code 187"):
        draw_animation(captured, tmp_path / "films" / "film.mp4")
    assert list((tmp_path / "films").iterdir()) == []


@pytest.mark.parametrize("when", ["before the first frame", "after a frame", "at the end"])
def test_a_film_is_there_whole_or_not_at_all(
    when: str, captured: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> NoReturn:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if when == "before the first frame":
        monkeypatch.setattr(animation._Scene, "show", full)
    if when == "at the end":
        monkeypatch.setattr("os.fsync", full)
    with pytest.raises(InputError, match=r"cannot write .*film\.gif: No space left on device"):
        draw_animation(captured, tmp_path / "film.gif", full if when == "after a frame" else lambda _frames: None)
    assert list(tmp_path.iterdir()) == []
