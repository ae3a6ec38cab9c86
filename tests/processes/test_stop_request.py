"""What signals ask for: real ones, sent to this process."""

import importlib
import signal
import threading
import time
from pathlib import Path

import pytest

from swarmchase.processes.stop_request import (
    STOP_SIGNALS,
    Interrupted,
    kept_handlers,
    stop_request,
    stopped_at_once,
)

INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP


@pytest.mark.parametrize(
    ("numbers", "forces"),
    [
        ([INT], False),
        ([TERM], False),
        ([HUP], False),
        ([TERM, TERM, HUP, HUP, TERM], False),
        ([TERM, INT], False),
        ([INT, TERM, HUP], False),
        ([INT, INT], True),
        ([TERM, INT, HUP, INT], True),
    ],
    ids=lambda value: "-".join(one.name for one in value) if isinstance(value, list) else None,
)
def test_the_first_makes_the_request_and_only_a_second_sigint_forces(numbers: list[int], forces: bool) -> None:
    with stop_request() as request:
        assert not request.made
        for number in numbers[:-1]:
            signal.raise_signal(number)
        if forces:
            with pytest.raises(Interrupted) as forced:
                signal.raise_signal(numbers[-1])
            assert forced.value.number == INT
        else:
            signal.raise_signal(numbers[-1])
        assert (request.made, request.number) == (True, numbers[0])


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_work_without_a_loop_ends_at_once(number: int) -> None:
    with stopped_at_once():
        with pytest.raises(Interrupted) as ended:
            signal.raise_signal(number)
        assert ended.value.number == number
        signal.raise_signal(TERM)  # it is cleaning up already
        signal.raise_signal(HUP)
        if number == INT:
            with pytest.raises(Interrupted):
                signal.raise_signal(INT)


def test_what_came_while_a_loop_looked_counts_when_it_has_ended() -> None:
    """The result is still to be printed: a second SIGTERM must not stop that."""
    with stopped_at_once():
        with stop_request() as request:
            signal.raise_signal(TERM)
        assert request.made
        signal.raise_signal(TERM)
        signal.raise_signal(INT)
        with pytest.raises(Interrupted):
            signal.raise_signal(INT)


def test_what_nobody_took_notice_of_makes_the_next_request() -> None:
    """An exception is lost where Python lets none through, such as in __del__."""
    with stopped_at_once():
        with pytest.raises(Interrupted):
            signal.raise_signal(HUP)
        with stop_request() as request:
            assert (request.made, request.number) == (True, HUP)
    with stop_request() as request:
        assert not request.made  # a new command in the same process


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_what_is_ignored_stays_so(number: signal.Signals) -> None:
    """As nohup has SIGHUP, and a script's background job SIGINT."""
    before = signal.signal(number, signal.SIG_IGN)
    try:
        with stopped_at_once(), stop_request() as request:
            signal.raise_signal(number)
            signal.raise_signal(number)
            assert not request.made
        assert signal.getsignal(number) is signal.SIG_IGN
    finally:
        signal.signal(number, before)


def test_handlers_are_those_of_before() -> None:
    before = [signal.getsignal(number) for number in STOP_SIGNALS]
    with kept_handlers():
        signal.signal(TERM, lambda _number, _frame: None)
    with stopped_at_once(), stop_request():
        inside = [signal.getsignal(number) for number in STOP_SIGNALS]
    assert [signal.getsignal(number) for number in STOP_SIGNALS] == before
    assert all(one not in before for one in inside)


def test_another_thread_may_ask_though_no_signal_comes_there() -> None:
    made: list[bool] = []

    def work() -> None:
        with stop_request() as request:
            made.append(request.made)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert made == [False]


def test_an_import_is_let_finish_before_the_work_is_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is raised in the midst of one leaves half a module behind, upon which others fail in their own way."""
    (tmp_path / "half_made.py").write_text(
        "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(0.05)\nWHOLE = True\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with stopped_at_once():
        assert importlib.import_module("half_made").WHOLE
        with pytest.raises(Interrupted) as interrupted:
            time.sleep(10)
    assert interrupted.value.number == INT
