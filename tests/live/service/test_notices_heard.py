"""Lines for people from the tracker's end to the controller's, whatever gets lost on the way."""

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmchase.live.link.messages import (
    MOST_PIECES,
    MOST_WAITING_PIECES,
    NOTICE_PERIOD_S,
    NOTICE_TIMES,
    PIECE_CHARACTERS,
    Notice,
    Severity,
    printable,
)
from swarmchase.live.service.notices_heard import KEPT_LINES, MISSING, WAITED_S, NoticesHeard
from swarmchase.live.tracker.notices import Notices

LOOP_S = 0.06
LONG = "for 5 s no level among 41 records: 41 without the field rssi_dbm (seen: signal, ts)"


def sent(*texts: str) -> list[Notice]:
    """By a tracker, in the order of sending."""
    notices = Notices(2)
    for text in texts:
        notices.put(Severity.WARNING, text)
    found, now_ns = [], 0
    while (notice := notices.due(now_ns)) is not None:
        found.append(notice)
        now_ns += round(NOTICE_PERIOD_S * 1e9)
    return found


def heard(notices: list[Notice], after_s: float = 0.0) -> list[str]:
    """As the controller tells it so long after all have come, all at once."""
    hears = NoticesHeard()
    for notice in notices:
        hears.hear(notice, 0)
    return [line.text for line in hears.lines(round(after_s * 1e9))]


@given(st.lists(st.text(min_size=1, max_size=160), max_size=4), st.randoms(use_true_random=False))
def test_what_comes_in_any_order_at_least_once_is_each_line_once(texts: list[str], random: Random) -> None:
    lines = [line for text in texts if (line := printable(text))]
    notices = sent(*texts)
    kept = random.sample(notices, len(notices))
    assert sorted(heard(kept)) == sorted(lines)
    # One of each has come.
    assert sorted(heard(list(dict.fromkeys(kept)))) == sorted(lines)


@pytest.mark.parametrize("length", [49, 50, 51, 99, 100, 101, 398, 399, 400, 5000])
def test_a_text_that_fills_its_pieces_ends_and_one_that_is_too_long_is_cut(length: int) -> None:
    text = "abcdefghij" * (length // 10) + "k" * (length % 10)
    assert heard(sent(text)) == [text[: MOST_PIECES * PIECE_CHARACTERS]]


@pytest.mark.parametrize(
    ("lost", "shown"), [(0, MISSING + LONG[50:]), (1, LONG[:50] + MISSING)], ids=["the first", "the last"]
)
def test_a_line_without_one_of_its_pieces_is_waited_for_and_then_told_as_far_as_it_came(lost: int, shown: str) -> None:
    notices = [notice for notice in sent(LONG) if notice.piece != lost]
    assert len(notices) == NOTICE_TIMES
    assert heard(notices, WAITED_S - 0.1) == []
    assert heard(notices, WAITED_S) == [shown]


@pytest.mark.parametrize("lost", [[0], [7], [3, 4], list(range(8))])
def test_a_long_line_among_many_whose_pieces_get_lost_twice_is_told_once_and_whole(lost: list[int]) -> None:
    """As slowly as a tracker's loop has it, with all the pieces waiting that may."""
    notices, hears, told = Notices(2), NoticesHeard(), set[str]()
    whole = "abcdefgh" * 49
    notices.put(Severity.WARNING, whole)
    others = ["ABCDEFGH" * 49, "0123456789" * 19]
    for text in others:
        notices.put(Severity.INFO, text)
    notices.put(Severity.INFO, "no room for this one")
    assert notices.dropped == 1
    sent_times = dict.fromkeys(range(MOST_PIECES), 0)
    for step in range(round(30 / LOOP_S)):
        now_ns = round(step * LOOP_S * 1e9)
        if (notice := notices.due(now_ns)) is not None:
            is_long = notice.number == 1
            sent_times[notice.piece] += is_long
            if not (is_long and notice.piece in lost and sent_times[notice.piece] < NOTICE_TIMES):
                hears.hear(notice, now_ns)
        told |= {line.text for line in hears.lines(now_ns)}
    assert told == {whole, *others}


def test_a_tracker_that_begins_anew_says_other_lines_by_the_same_numbers() -> None:
    again = "hears nothing: the port is closed"
    assert heard([*sent(LONG), *sent(again)]) == [again]
    assert heard([*sent(again), *sent(LONG)]) == [LONG]


def test_only_the_newest_lines_are_kept() -> None:
    texts = [f"line {number}" for number in range(15)]
    assert heard(sent(*texts)) == texts[-KEPT_LINES:]


def test_lines_that_come_at_once_are_each_new_once_though_each_is_sent_again() -> None:
    """As an autopilot says when it starts, and as the events are made: what was not there a moment ago is new."""
    notices, hears, new, before = Notices(2), NoticesHeard(), list[str](), list[str]()
    texts = [f"line {number}" for number in range(MOST_WAITING_PIECES)]
    for text in texts:
        notices.put(Severity.INFO, text)
    for step in range(round(20 / NOTICE_PERIOD_S)):
        now_ns = round(step * NOTICE_PERIOD_S * 1e9)
        if (notice := notices.due(now_ns)) is not None:
            hears.hear(notice, now_ns)
        now = [line.text for line in hears.lines(now_ns)]
        new += [text for text in now if text not in before]
        before = now
    assert new == texts
    assert before == texts[-KEPT_LINES:]
