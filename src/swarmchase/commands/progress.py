"""How far a command is: a bar in a terminal, and a line every half minute where there is none."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..processes.stop_request import Interrupted, stop_request
from .terminal import CONSOLE

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

LINE_EVERY_S = 30.0
BAR_WIDTH = 12
BLOCKS_ARE_KEPT = "finished blocks are kept, and the same command goes on behind them"

Show = Callable[[int, str, str], None]
"""Is told the count, the rate and the news."""


def shown_duration(seconds: float) -> str:
    """``1:02:03``, or ``2:03`` below an hour."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def shown_time(elapsed_s: float, left_s: float | None, has_ended: bool) -> str:
    """The one reading of time: what is left; what has passed, where nobody knows or all is counted but goes on, as a
    last evaluation does; in the end what it took.
    """
    if has_ended:
        return f"took {shown_duration(elapsed_s)}"
    return f"{shown_duration(left_s)} left" if left_s else f"{shown_duration(elapsed_s)} so far"


@contextlib.contextmanager
def progress_bar(task: str, total: int, unit: str) -> Iterator[Show]:
    """A count, the rate in ``unit``, the time left and news; a bar in a terminal, else lines.

    Gives a function to be told the count, the rate and the news. It shows nothing before that is first called: the
    work has not begun.
    """
    with (_bar if CONSOLE.is_terminal else _lines)(task, total, unit) as show:
        yield show


@contextlib.contextmanager
def _bar(task: str, total: int, unit: str) -> Iterator[Show]:
    from rich.console import RenderableType
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.text import Text

    class BarAndNews(Progress):
        """The news are a line below the bar: so there is room for both."""

        def get_renderables(self) -> Iterator[RenderableType]:
            yield from super().get_renderables()
            for one in self.tasks:
                if one.fields["news"]:
                    yield Text(f"  {one.fields['news']}", overflow="fold")

    ended = threading.Event()
    bar = BarAndNews(
        TextColumn("{task.description}", markup=False),
        BarColumn(BAR_WIDTH),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]} " + unit) if unit else "",
        _time_column(ended),
        console=CONSOLE,
        speed_estimate_period=10 * LINE_EVERY_S,
    )
    number = bar.add_task(task, total=total, start=False, rate="-", news="")

    def show(completed: int, rate: str, news: str) -> None:
        if not bar.live.is_started:
            bar.start()
            bar.start_task(number)
        bar.update(number, completed=completed, rate=rate, news=news)

    try:
        yield show
    finally:
        ended.set()
        if bar.live.is_started:
            bar.stop()


def _time_column(ended: threading.Event) -> "ProgressColumn":
    from rich.progress import ProgressColumn, Task
    from rich.text import Text

    class TimeColumn(ProgressColumn):
        def render(self, task: Task) -> Text:
            elapsed_s = 0.0 if task.start_time is None else task.get_time() - task.start_time
            return Text(shown_time(elapsed_s, task.time_remaining, ended.is_set()))

    return TimeColumn()


@dataclass
class _Lines:
    """What is to be told, every half minute and at the end."""

    task: str
    total: int
    unit: str
    began_s: float | None = None
    first: int = 0
    latest: tuple[int, str, str] = (0, "", "")
    has_ended: threading.Event = field(default_factory=threading.Event)

    def show(self, completed: int, rate: str, news: str) -> None:
        if self.began_s is None:
            self.began_s, self.first = time.monotonic(), completed
        self.latest = completed, rate, news

    def tell_now_and_then(self) -> None:
        while not self.has_ended.wait(LINE_EVERY_S):
            self.tell()

    def tell(self) -> None:
        if self.began_s is None:
            return
        (completed, rate, news), elapsed_s = self.latest, time.monotonic() - self.began_s
        made = completed - self.first
        left_s = elapsed_s * (self.total - completed) / made if made > 0 else None
        parts = [
            f"{self.task}: {completed} of {self.total}",
            f"{rate} {self.unit}" if self.unit and rate else "",
            shown_time(elapsed_s, left_s, self.has_ended.is_set()),
            news,
        ]
        CONSOLE.print(", ".join(part for part in parts if part), markup=False, soft_wrap=True)


@contextlib.contextmanager
def _lines(task: str, total: int, unit: str) -> Iterator[Show]:
    lines = _Lines(task, total, unit)
    teller = threading.Thread(target=lines.tell_now_and_then, name="progress lines", daemon=True)
    teller.start()
    try:
        yield lines.show
    finally:
        lines.has_ended.set()
        teller.join()
    # What did not come to its end says so in a line of its own.
    lines.tell()


@contextlib.contextmanager
def chases_progress(task: str, total: int, kept: str) -> Iterator[Callable[[int, int, str], None]]:
    """The bar of an evaluation. Gives what ``evaluation.blocks.Finished`` is.

    Args:
        kept: what is left of the chases that have ended when a signal stops the rest.

    Raises:
        Interrupted: out of the function that it gives, after a signal.
    """
    began_s = time.monotonic()
    with stop_request() as request, progress_bar(task, total, "chases/s") as show:

        def finished(chases: int, found: int, job: str) -> None:
            show(chases, f"{(chases - found) / (time.monotonic() - began_s):.1f}", job)
            if request.made:
                raise Interrupted(request.number, f"after {chases} of {total} chases: {kept}")

        yield finished
