"""A chase under way as a picture in memory: what ``render`` of the Gymnasium environments shows."""

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from .flight_paths import FlightPaths
from .plan_view import CENTER_STYLE, TARGET_STYLE, draw_end, draw_path, draw_start, plan_and_height
from .style import STYLE

SIZE_INCHES = (4.8, 6.0)
DOTS_PER_INCH = 100
"""Both sides are even numbers of dots, as films need."""
MARGINS = {"left": 0.14, "right": 0.96, "bottom": 0.09, "top": 0.9, "hspace": 0.28}
"""Fixed: a layout that followed the contents would tremble from frame to frame."""


def draw_scene(paths: FlightPaths, figure: Figure | None = None) -> NDArray[np.uint8]:
    """Both paths so far, from above and in height, and how far apart they are now.

    Args:
        paths: of the chase from its start until now.
        figure: drawn on this one, which a window may show, instead of a new one.

    Returns:
        [600, 480, 3], red, green, blue.
    """
    with mpl.rc_context(STYLE):
        if figure is None:
            figure = Figure(figsize=SIZE_INCHES, dpi=DOTS_PER_INCH)
            FigureCanvasAgg(figure)
        figure.clear()
        plan_axes, height_axes = plan_and_height(figure, paths, MARGINS)
        for style, place_m in ((CENTER_STYLE, paths.center_m), (TARGET_STYLE, paths.target_m)):
            for axes, way in (
                (plan_axes, place_m[:, :2]),
                (height_axes, np.column_stack([paths.clock, place_m[:, 2]])),
            ):
                draw_path(axes, style, way)
                draw_start(axes, style, way)
                draw_end(axes, style, way)
        height_axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        figure.suptitle(f"{paths.clock_label} {paths.clock[-1]:g}  distance {paths.distance_m[-1]:.1f} m", fontsize=10)
        canvas = figure.canvas
        assert isinstance(canvas, FigureCanvasAgg)
        canvas.draw()  # type: ignore[no-untyped-call]
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]
