"""A chase under way as the Gymnasium environments show it: as an array, or in a window."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .errors import InputError
from .scenario import Scenario
from .world.environment import State

if TYPE_CHECKING:
    from .reports.flight_paths import FlightPaths


class Picture:
    """Of one chase: where centre and target have been so far."""

    def __init__(self, scenario: Scenario) -> None:
        self._is_told_in_seconds = scenario.is_told_in_seconds
        self._moments: list[tuple[float, NDArray[np.float64], NDArray[np.float64]]] = []
        self._window: Any = None

    def note(self, state: State, lane: int, anew: bool) -> None:
        """What it has come to; ``anew`` where another chase begins."""
        if anew:
            self._moments.clear()
        clock = state.time_s if self._is_told_in_seconds else state.movements
        place_m = (state.center_m[lane].numpy().copy(), state.target_position_m[lane].numpy().copy())
        self._moments.append((float(clock[lane]), *place_m))

    def draw(self) -> NDArray[np.uint8]:
        """[height, width, 3], red, green, blue."""
        from .reports.scene import draw_scene

        return draw_scene(self._paths())

    def show(self) -> None:
        """Draw it in its window.

        Raises:
            InputError: there is no screen.
        """
        import matplotlib.pyplot as plt

        from .reports.scene import DOTS_PER_INCH, SIZE_INCHES, draw_scene

        if self._window is None:
            if plt.get_backend().lower() == "agg":
                raise InputError("render_mode = 'human' is refused: there is no screen; rgb_array needs none")
            self._window = plt.figure("swarmchase", figsize=SIZE_INCHES, dpi=DOTS_PER_INCH)
            self._window.show()
        draw_scene(self._paths(), self._window)
        self._window.canvas.flush_events()

    def close(self) -> None:
        """Its window, if there is one."""
        if self._window is not None:
            import matplotlib.pyplot as plt

            plt.close(self._window)
            self._window = None

    def _paths(self) -> "FlightPaths":
        from .reports.flight_paths import FlightPaths

        clock, center_m, target_m = zip(*self._moments, strict=True)
        label = "time (s)" if self._is_told_in_seconds else "movement"
        return FlightPaths(np.array(clock), label, np.array(center_m), np.array(target_m))
