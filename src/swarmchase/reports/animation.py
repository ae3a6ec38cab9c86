"""One chase as a film, from its log on disk: both paths grow, from above and in height, with distance and time."""

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from PIL.Image import Image

from ..errors import InputError
from ..files import atomic_path
from .flight_paths import FlightPaths, flight_paths, is_told_in_seconds
from .plan_view import CENTER_STYLE, TARGET_STYLE, PathStyle, draw_end, draw_path, draw_start, plan_and_height
from .style import STYLE

FORMATS = (".gif", ".mp4")
MOST_FRAMES = 140
FRAMES_HZ = (4, 10)
"""Frames a second at least and at most: few frames are shown slowly."""
USUAL_LENGTH_S = 12
END_FRAMES_S = 1.0
"""So long the end stays on the screen."""
SIZE_INCHES = (4.8, 6.2)
DOTS_PER_INCH = 100
"""Both sides are even numbers of dots, as MP4 needs."""


def require_animation_format(path: Path) -> None:
    """Prove that a film of this name can be made, before there is anything to show.

    Raises:
        InputError: another suffix than ``FORMATS``, or no ffmpeg where it is needed.
    """
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"animation {path} is refused: allowed is a file that ends in {' or '.join(FORMATS)}")
    if path.suffix.lower() == ".mp4" and not FFMpegWriter.isAvailable():
        raise InputError(f"animation {path} is refused: .mp4 needs ffmpeg, which is not there; .gif needs nothing")


def num_frames(log: dict[str, Any]) -> int:
    """One for the beginning and one for every moment after it, but no more than ``MOST_FRAMES``."""
    return len(_shown_moments(len(flight_paths(log))))


def draw_animation(log: dict[str, Any], path: Path, drawn: Callable[[int], None] = lambda _frames: None) -> None:
    """A GIF or MP4 of a chase of either format, whole or not at all.

    Args:
        drawn: is told the number of frames drawn so far; what it raises ends the work.

    Raises:
        InputError: a suffix that is refused, the file cannot be written, or ffmpeg fails.
    """
    require_animation_format(path)
    paths = flight_paths(log)
    shown = _shown_moments(len(paths))
    frames_hz = int(np.clip(len(shown) / USUAL_LENGTH_S, *FRAMES_HZ))
    writer: AbstractMovieWriter
    if path.suffix.lower() == ".gif":
        writer = _GifWriter(fps=frames_hz)
    else:
        writer = FFMpegWriter(fps=frames_hz, extra_args=["-f", "mp4"])
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=SIZE_INCHES, layout="constrained")
        FigureCanvasAgg(figure)
        scene = _Scene(figure, log, paths)
        try:
            with atomic_path(path) as temporary, writer.saving(figure, str(temporary), DOTS_PER_INCH):
                for frames, moment in enumerate(shown, start=1):
                    scene.show(moment)
                    writer.grab_frame()
                    drawn(frames)
                for _ in range(round(END_FRAMES_S * frames_hz)):
                    writer.grab_frame()
        except subprocess.CalledProcessError as error:
            raise InputError(f"cannot write {path}: ffmpeg ended with exit code {error.returncode}") from error


def _shown_moments(number: int) -> list[int]:
    """All, or so many as there may be, evenly; the first and the last are among them."""
    return [round(moment) for moment in np.linspace(0, number - 1, min(number, MOST_FRAMES)).tolist()]


class _GifWriter(PillowWriter):
    """For a temporary file, whose name does not say what it is. Equal frames after one another become one, shown for
    as long as all of them.
    """

    _frames: list[Image]
    """PillowWriter's own."""

    def finish(self) -> None:
        if not self._frames:  # something has failed before the first: that is to be told
            return
        first, *others = self._frames
        duration_ms = round(1000 / self.fps)
        first.save(self.outfile, format="gif", save_all=True, append_images=others, duration=duration_ms, loop=0)


class _Scene:
    """The figure whose contents change from frame to frame; its layout does not."""

    def __init__(self, figure: Figure, log: dict[str, Any], paths: FlightPaths) -> None:
        self._log, self._paths = log, paths
        plan_axes, height_axes = plan_and_height(figure, paths)
        self._growing = [
            _GrowingPath(axes, style, place_m)
            for style, where_m in ((CENTER_STYLE, paths.center_m), (TARGET_STYLE, paths.target_m))
            for axes, place_m in (
                (plan_axes, where_m[:, :2]),
                (height_axes, np.column_stack([paths.clock, where_m[:, 2]])),
            )
        ]
        self._text = figure.suptitle(self._words(0), fontsize=10, family="monospace")
        # Once: a layout that follows every frame would tremble.
        figure.draw_without_rendering()
        figure.set_layout_engine("none")

    def show(self, moment: int) -> None:
        for path in self._growing:
            path.show(moment)
        self._text.set_text(self._words(moment))

    def _words(self, moment: int) -> str:
        clock, is_timed = self._paths.clock[moment], is_told_in_seconds(self._log)
        is_last = moment == len(self._paths) - 1
        is_reached = self._log["reached"] and (clock >= self._log["capture_s"] if is_timed else is_last)
        goes_on = self._log["scenario"].get("follow_s", 0) > 0
        if is_reached and is_timed and not goes_on:  # some time before this moment
            return f"{self._log['capture_s']:5.1f} s  reached: within {self._log['scenario']['success_radius_m']:g} m"
        when = f"{clock:5.1f} s" if is_timed else f"movement {clock:3.0f}"
        return f"{when}  distance {self._paths.distance_m[moment]:5.1f} m" + (
            self._ending(is_timed) if is_reached else ""
        )

    def _ending(self, is_timed: bool) -> str:
        return f"  reached at {self._log['capture_s']:.1f} s" if is_timed else "  reached"


class _GrowingPath:
    """Up to a moment: where it began, the way since, and where it is."""

    def __init__(self, axes: Axes, style: PathStyle, place_m: NDArray[np.float64]) -> None:
        self._place_m = place_m
        # The whole way first: the axes take its limits.
        self._way: Line2D = draw_path(axes, style, place_m)
        draw_start(axes, style, place_m)
        self._end: Line2D = draw_end(axes, style, place_m)

    def show(self, moment: int) -> None:
        self._way.set_data(*self._place_m[: moment + 1].T)
        self._end.set_data(*self._place_m[moment : moment + 1].T)
