"""Figures are drawn from a log on disk, whole or not at all, and say what the log says."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NoReturn

import matplotlib.image
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure

from swarmchase.controllers import load_controller
from swarmchase.errors import InputError
from swarmchase.evaluation.chase_log import chase_log, run_chase, save_chase_log
from swarmchase.reports.chase import draw_chase
from swarmchase.reports.style import PAGE_WIDTH_INCHES, TRACKER_COLORS, TRACKER_NAMES
from swarmchase.reports.training import draw_training
from swarmchase.scenario import paper_scenario


@pytest.fixture(scope="module")
def log_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scenario = paper_scenario(start_distance_m=30.0)
    driver = load_controller("oracle", scenario)
    path = tmp_path_factory.mktemp("log") / "chase.json"
    save_chase_log(path, chase_log(scenario, driver, 1, 2, list(run_chase(scenario, driver, 1, 2))))
    return path


@pytest.fixture
def log(log_path: Path) -> dict[str, Any]:
    return dict(json.loads(log_path.read_text()))


def drawn(log: dict[str, Any], path: Path, monkeypatch: pytest.MonkeyPatch) -> Figure:
    """The figure itself, as it is saved."""
    figures: list[Figure] = []
    save = Figure.savefig

    def remember(figure: Figure, *arguments: Any, **options: Any) -> None:
        figures.append(figure)
        save(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", remember)
    draw_chase(log, path)
    return figures[0]


def test_png_is_a_page_wide_and_shows_something(log: dict[str, Any], tmp_path: Path) -> None:
    draw_chase(log, tmp_path / "chase.png")
    image = matplotlib.image.imread(tmp_path / "chase.png")
    assert image.shape[1] == round(PAGE_WIDTH_INCHES * 200)
    white = (image[..., :3] == 1).all(axis=-1)
    assert white[:2].all()  # nothing is cut off at the edges
    assert white[-2:].all()
    assert white[:, :2].all()
    assert white[:, -2:].all()
    for left in (0, image.shape[1] // 2):  # the path on the left, the traces on the right
        assert (~white[:, left : left + image.shape[1] // 2]).mean() > 0.02


def test_pdf_is_a_pdf_with_real_fonts(log: dict[str, Any], tmp_path: Path) -> None:
    draw_chase(log, tmp_path / "chase.pdf")
    content = (tmp_path / "chase.pdf").read_bytes()
    assert content.startswith(b"%PDF-")
    assert content.rstrip().endswith(b"%%EOF")
    assert b"/FontFile2" in content  # TrueType, which publishers ask for
    assert b"/Type3" not in content


@pytest.mark.parametrize("name", ["chase.png", "chase.pdf"])
def test_a_figure_is_a_function_of_its_log(log: dict[str, Any], tmp_path: Path, name: str) -> None:
    pictures = []
    for folder, seen in (("a", log), ("b", log), ("c", log | {"moments": log["moments"][:-1]})):
        draw_chase(seen, tmp_path / folder / name)
        pictures.append((tmp_path / folder / name).read_bytes())
    assert pictures[0] == pictures[1]
    assert pictures[0] != pictures[2]


def test_the_figure_says_what_the_log_says(
    log: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figure = drawn(log, tmp_path / "chase.png", monkeypatch)
    path_axes, rssi_axes, distance_axes, spacing_axes = figure.axes
    assert figure.get_suptitle().startswith("Controller oracle, F = 10 Hz, ρ = 0.9, seed 1, chase 2: reached in ")
    assert [axes.get_ylabel() for axes in figure.axes] == ["y (m)", "RSSI (dBm)", "distance (m)", "spacing (m)"]
    legend = rssi_axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == list(TRACKER_NAMES)
    windows = np.array([moment["rssi_dbm"] for moment in log["moments"]])
    means = [line for line in rssi_axes.lines if line.get_label() in TRACKER_NAMES]
    assert np.allclose([line.get_ydata() for line in means], windows.mean(axis=1).T)
    distance = distance_axes.lines[0].get_ydata()
    assert list(np.asarray(distance)) == [moment["distance_m"] for moment in log["moments"]]
    assert list(np.asarray(spacing_axes.lines[0].get_ydata()))[:-1] == [m["spacing_m"] for m in log["moments"]]
    way: Any = next(line for line in path_axes.lines if line.get_label() == "centre of the swarm")
    assert np.array(way.get_data_3d()).T.tolist() == [moment["center_m"] for moment in log["moments"]]


def test_legends_lie_outside_the_data(log: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figure = drawn(log, tmp_path / "chase.png", monkeypatch)
    for axes in figure.axes[1:]:
        legend = axes.get_legend()
        if legend is not None:
            assert legend.get_window_extent().y0 >= axes.get_window_extent().y1 - 1


def test_every_tracker_differs_from_its_opposite_in_grey() -> None:
    red, green, blue = np.array([[int(color[k : k + 2], 16) for k in (1, 3, 5)] for color in TRACKER_COLORS]).T / 255
    lightness = 0.2126 * red**2.2 + 0.7152 * green**2.2 + 0.0722 * blue**2.2
    assert (lightness[1::2] - lightness[0::2] > 0.1).all()
    assert len(set(TRACKER_COLORS)) == 6


def test_drawing_needs_neither_simulator_nor_torch(log_path: Path, tmp_path: Path) -> None:
    program = (
        "import json, sys\n"
        "from pathlib import Path\n"
        "from swarmchase.reports.chase import draw_chase\n"
        "draw_chase(json.loads(Path(sys.argv[1]).read_text()), Path(sys.argv[2]))\n"
        "print(sorted(name for name in sys.modules if name == 'torch' or name.startswith('swarmchase.')))\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program, str(log_path), str(tmp_path / "chase.png")],
        capture_output=True,
        text=True,
        check=True,
    )
    own = ["errors", "files", "locks", "reports"]
    own += [f"reports.{name}" for name in ("chase", "flight_paths", "moving_chase", "plan_view", "style")]
    assert ran.stdout == f"{[f'swarmchase.{name}' for name in own]}\n"
    assert (tmp_path / "chase.png").stat().st_size > 10_000


def test_a_full_disk_leaves_no_picture(log: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_descriptor: int) -> NoReturn:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(InputError, match=r"cannot write .*chase\.png: No space left on device"):
        draw_chase(log, tmp_path / "chase.png")
    assert list(tmp_path.iterdir()) == []


def test_drawing_leaves_the_style_of_others_alone(log: dict[str, Any], tmp_path: Path) -> None:
    before = dict(plt.rcParams)
    draw_chase(log, tmp_path / "chase.png")
    assert dict(plt.rcParams) == before
    assert plt.get_fignums() == []


def test_training_curves_are_rewards_per_movement_of_the_last_hundred_chases(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """150 chases of 2 movements: the first 50 win 1 m on every axis and 2 m in all, the others 3 m and 4 m."""
    chases = [
        {"update": update, "movements": 2, "reward_m": [2, 1, 1, 1] if update < 50 else [4, 3, 3, 3]}
        for update in range(150)
    ]
    evaluations = [{"update": 50, "movements_p90": 90.0, "movements_mean": 40.0}]
    figures: list[Figure] = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda figure, *a, **o: (figures.append(figure), save(figure, *a, **o))[1])
    draw_training(chases, evaluations, tmp_path / "training.png")
    reward_axes, movement_axes = figures[0].axes
    theta_d, theta_x, theta_y, theta_z = (np.asarray(line.get_ydata()) for line in reward_axes.get_lines())
    assert (theta_d[0], theta_d[-1]) == (1.5, 2.0)  # (50 x 2 m + 50 x 4 m) / 200 movements; 100 x 4 m / 200
    for theta in (theta_x, theta_y, theta_z):
        assert (theta[0], theta[-1]) == (1.0, 1.5)
    assert [np.asarray(line.get_ydata()).tolist() for line in movement_axes.get_lines()] == [[90.0], [40.0]]
    assert (tmp_path / "training.png").stat().st_size > 10_000
    draw_training(chases[:3], evaluations, tmp_path / "short.png")
    assert np.asarray(figures[1].axes[0].get_lines()[0].get_ydata()).tolist() == [1.0]
