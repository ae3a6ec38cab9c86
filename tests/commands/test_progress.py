"""How far a command is: a bar in a terminal, lines where there is none, one reading of time in either."""

import io
import re
from collections.abc import Callable
from typing import NoReturn

import pytest
from rich.console import Console

from swarmchase.commands import progress
from swarmchase.commands.progress import progress_bar, shown_duration, shown_time
from swarmchase.commands.train import _news
from swarmchase.training.agent import FinishedChase
from swarmchase.training.evaluator import AuxiliaryEvaluation
from swarmchase.training.run import TrainingStatus

LONG_NEWS = "evaluating: 37 of 200 chases, 90th percentile 240, reached 100 %"
NARROW = 80


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """A terminal of 80 columns."""
    shown = io.StringIO()
    monkeypatch.setattr(progress, "CONSOLE", Console(file=shown, force_terminal=True, width=NARROW))
    return shown


def plain(shown: io.StringIO) -> list[str]:
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown.getvalue()).replace("\r", "\n").splitlines()


def test_nothing_is_shown_before_the_work_has_begun(capsys: pytest.CaptureFixture[str], terminal: io.StringIO) -> None:
    with progress_bar("waiting", 10, "chases/s"):
        pass
    assert terminal.getvalue() == ""
    assert capsys.readouterr().err == ""


def test_a_bar_of_80_columns_has_room_for_all_that_it_says(terminal: io.StringIO) -> None:
    with progress_bar("working [bold]", 1_000_000, "chases/s") as show:
        show(0, "-", "")
        show(500_000, "12345.6", LONG_NEWS)
    lines = plain(terminal)
    assert any(line.startswith("working [bold]") for line in lines)  # a controller's path is no markup
    assert any(" 500000/1000000 12345.6 chases/s took 0:00" in line for line in lines)
    assert f"  {LONG_NEWS}" in [line.rstrip() for line in lines]
    assert max(map(len, lines)) <= NARROW
    assert "…" not in terminal.getvalue()


def test_without_a_terminal_a_line_now_and_then_says_what_is_going_on(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also while nobody tells anything new."""
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.02)
    with progress_bar("updates", 10, "steps/s") as show:
        show(0, "-", "")
        show(5, "3.0", LONG_NEWS)
        told = wait_for(lambda: capsys.readouterr().err, 3)
    lines = [line for line in told.splitlines() if line.startswith("updates: 5 of 10, 3.0 steps/s, ")]
    assert all(re.fullmatch(rf".*, \d:\d\d (left|so far), {LONG_NEWS}", line) for line in lines)
    assert capsys.readouterr().err.splitlines()[-1] == f"updates: 5 of 10, 3.0 steps/s, took 0:00, {LONG_NEWS}"


def wait_for(read: Callable[[], str], lines: int) -> str:
    """Until there are so many; the test's own limit ends it."""
    told = ""
    while told.count("\n") < lines:
        told += read()
    return told


@pytest.mark.parametrize(
    ("seconds", "shown"), [(0.4, "0:00"), (59.6, "1:00"), (61, "1:01"), (3599, "59:59"), (3723, "1:02:03")]
)
def test_durations(seconds: float | int, shown: str) -> None:
    assert shown_duration(float(seconds)) == shown


@pytest.mark.parametrize(
    ("left_s", "has_ended", "shown"),
    [
        (None, False, "1:15 so far"),
        (30.0, False, "0:30 left"),
        # All updates are made, and the last evaluation goes on.
        (0.0, False, "1:15 so far"),
        (0.0, True, "took 1:15"),
        (30.0, True, "took 1:15"),
    ],
)
def test_there_is_one_reading_of_time(left_s: float | None, has_ended: bool, shown: str) -> None:
    assert shown_time(75.0, left_s, has_ended) == shown


CHASE = FinishedChase(agent=0, chase=0, update=3, movements=17, reached=True, reward_m=(1.0, 1.0, 1.0, 1.0))
EVALUATION = AuxiliaryEvaluation(5, 20.5, 24.0, 0.995, [24.0])


@pytest.mark.parametrize(
    ("last_chase", "last_evaluation", "evaluating", "news"),
    [
        (None, None, None, ""),
        (CHASE, None, None, "last chase 17 movements"),
        (CHASE, None, (37, 200), "evaluating: 37 of 200 chases, last chase 17 movements"),
        (CHASE, EVALUATION, None, "90th percentile 24, reached 99.5 %"),
        (CHASE, EVALUATION, (0, 200), "evaluating: 0 of 200 chases, 90th percentile 24, reached 99.5 %"),
    ],
)
def test_news_of_a_training(
    last_chase: FinishedChase | None,
    last_evaluation: AuxiliaryEvaluation | None,
    evaluating: tuple[int, int] | None,
    news: str,
) -> None:
    assert _news(TrainingStatus(5, 10, 50, 1.0, last_chase, last_evaluation, evaluating)) == news


def test_what_is_interrupted_leaves_the_last_line_to_who_interrupts(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> NoReturn:
        with progress_bar("updates", 10, "") as show:
            show(5, "", "")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert capsys.readouterr().err == ""
