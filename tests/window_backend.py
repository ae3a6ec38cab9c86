"""A backend of matplotlib for windows that nobody sees: it remembers what would be seen."""

from matplotlib.backend_bases import FigureManagerBase
from matplotlib.backends.backend_agg import FigureCanvasAgg

SHOWN: list[str] = []


class FigureManager(FigureManagerBase):
    """One window."""

    def show(self) -> None:
        SHOWN.append("shown")


class FigureCanvas(FigureCanvasAgg):
    """What is in it."""

    manager_class = FigureManager

    def flush_events(self) -> None:
        SHOWN.append("drawn")
