"""Who is left out for its level, and when it counts again: windows one after another, told by pencil."""

import numpy as np
import pytest

from swarmchase.live.service.reliability import FORGIVEN_WINDOWS, LONGEST_BACK_WINDOWS, Reliability

TRACKER = 2
WINDOWS = {
    "agrees": (True, False, False),
    "contradicts": (True, True, True),
    "nearly contradicts": (True, False, True),
    "is not heard": (False, False, False),
}
"""Heard, contradicts, doubtful."""


def after(reliability: Reliability, *windows: tuple[str, int]) -> bool:
    """Whether the tracker counts after so many windows of each kind; the others agree in all of them."""
    for kind, number in windows:
        is_heard, contradicts, is_doubtful = np.full(6, True), np.full(6, False), np.full(6, False)
        is_heard[TRACKER], contradicts[TRACKER], is_doubtful[TRACKER] = WINDOWS[kind]
        for _ in range(number):
            reliability.take_levels(is_heard, contradicts, is_doubtful)
    others = np.delete(reliability.counts, TRACKER)
    assert others.all()
    return bool(reliability.counts[TRACKER])


LEFT_OUT = ("contradicts", 3)


@pytest.mark.parametrize(
    ("windows", "counts"),
    [
        ([("contradicts", 2)], True),
        ([("contradicts", 2), ("agrees", 1), ("contradicts", 2)], True),
        ([LEFT_OUT], False),
        ([LEFT_OUT, ("agrees", 2)], False),
        ([LEFT_OUT, ("agrees", 3)], True),
        ([LEFT_OUT, ("agrees", 2), ("nearly contradicts", 1), ("agrees", 2)], False),
        # What is not heard says nothing, for it or against it.
        ([LEFT_OUT, ("agrees", 2), ("is not heard", 9), ("agrees", 1)], True),
        ([LEFT_OUT, ("is not heard", 99)], False),
        # The second time it takes twice as long, the third time four times,
        ([LEFT_OUT, ("agrees", 3), LEFT_OUT, ("agrees", 5)], False),
        ([LEFT_OUT, ("agrees", 3), LEFT_OUT, ("agrees", 6)], True),
        ([LEFT_OUT, ("agrees", 3), LEFT_OUT, ("agrees", 6), LEFT_OUT, ("agrees", 11)], False),
        # and after it has counted for long half of that again.
        ([LEFT_OUT, ("agrees", 3), ("agrees", FORGIVEN_WINDOWS), LEFT_OUT, ("agrees", 3)], True),
        ([LEFT_OUT, ("agrees", 3), ("agrees", FORGIVEN_WINDOWS - 4), LEFT_OUT, ("agrees", 3)], False),
    ],
)
def test_who_is_left_out_counts_again_when_it_has_agreed_for_long_enough(
    windows: list[tuple[str, int]], counts: bool
) -> None:
    assert after(Reliability(), *windows) is counts


def test_somebody_left_out_now_and_then_comes_back_as_quickly_after_an_hour() -> None:
    """Every two minutes, at two windows a second."""
    reliability = Reliability()
    for _ in range(30):
        assert not after(reliability, LEFT_OUT)
        assert after(reliability, ("agrees", 6))
        assert after(reliability, ("agrees", 231))


def test_who_contradicts_again_and_again_stays_out_for_longer_and_longer() -> None:
    reliability, took = Reliability(), 3
    for _ in range(12):
        assert not after(reliability, LEFT_OUT, ("agrees", took - 1))
        assert after(reliability, ("agrees", 1))
        took = min(2 * took, LONGEST_BACK_WINDOWS)
