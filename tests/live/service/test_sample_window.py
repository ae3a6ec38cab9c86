"""Samples by the time they were taken: whatever messages bring them, in which order, how often, how late."""

import math
import random
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from live_bench import FLYING
from swarmchase.levels import NoLevel
from swarmchase.live.link.messages import Heartbeat, PositionReport, RssiWindow, TrackerMode
from swarmchase.live.service.sample_window import ClockOffset, SampleWindow
from swarmchase.live.service.tracker_record import MOST_POSITIONS, TrackerRecord
from swarmchase.scenario import paper_scenario

S = 10**9
PERIOD_NS = S // 10
START_NS = 7 * S
SCENARIO = paper_scenario(sampling_hz=10, window_samples=10)


def taken_ns(number: int) -> int:
    return START_NS + number * PERIOD_NS


def level_dbm(number: int) -> float:
    return -60.0 - number


def message(first: int, last: int, start_ns: int = START_NS, tracker: int = 0) -> RssiWindow:
    """Samples number ``first`` to ``last``; sample i is -60 - i dBm."""
    levels = tuple(level_dbm(number) for number in range(first, last + 1))
    return RssiWindow(tracker, start_ns + last * PERIOD_NS, 10.0, levels)


def window_of(messages: Sequence[RssiWindow], since_ns: int = START_NS, samples: int = 10) -> np.ndarray:
    window = SampleWindow(paper_scenario(sampling_hz=10, window_samples=samples))
    for one in messages:
        window.add(one)
    return window.window(since_ns)[0]


def same(one: np.ndarray, other: np.ndarray) -> bool:
    return np.array_equal(one, other, equal_nan=True)


def test_by_hand() -> None:
    """Two messages that overlap, and a gap between them and a third."""
    window = SampleWindow(SCENARIO)
    window.add(message(0, 2))
    window.add(message(1, 4))
    window.add(message(7, 8))
    assert not window.is_complete(START_NS)
    levels, times = window.window(START_NS)
    nan = math.nan
    assert same(levels, np.array([-60.0, -61, -62, -63, -64, nan, nan, -67, -68, nan]))
    assert (times == [taken_ns(number) for number in range(10)]).all()
    assert same(window.window(taken_ns(7))[0], np.array([-67.0, -68] + 8 * [nan]))
    window.add(message(9, 9))
    assert window.is_complete(START_NS)
    assert not window.is_complete(START_NS + 1)
    assert same(window.last_window(), np.array([-60.0, -61, -62, -63, -64, nan, nan, -67, -68, -69]))


@settings(deadline=None)
@given(st.data())
def test_any_order_with_repetitions_and_losses_gives_the_same_window(data: st.DataObject) -> None:
    """What counts is which samples have come, not which messages brought them."""
    spans = data.draw(st.lists(st.tuples(st.integers(0, 25), st.integers(0, 9)), min_size=1, max_size=12))
    messages = [message(max(0, last - more), last) for last, more in spans]
    came = {number for last, more in spans for number in range(max(0, last - more), last + 1)}
    since = data.draw(st.integers(0, 20))
    expected = np.array([level_dbm(number) if number in came else math.nan for number in range(since, since + 10)])
    shuffled = data.draw(st.permutations(messages + data.draw(st.lists(st.sampled_from(messages)))))
    assert same(window_of(messages, taken_ns(since)), expected)
    assert same(window_of(shuffled, taken_ns(since)), expected)


@settings(deadline=None)
@given(st.data())
def test_even_contradictory_samples_give_the_same_window_in_any_order(data: st.DataObject) -> None:
    """Off the grid, at other rates, with other levels for the same moment."""
    level = st.one_of(st.just(math.nan), st.floats(-200, 50), st.sampled_from([0.0, 17.0, 31.0, math.inf]))
    drawn = data.draw(
        st.lists(
            st.tuples(
                st.integers(START_NS, START_NS + 2 * S),
                st.sampled_from([5.0, 10.0, 33.0]),
                st.lists(level, min_size=1, max_size=8),
            ),
            min_size=1,
            max_size=6,
        )
    )
    # Not in the strategy: the type checker draws random numbers.
    messages = [RssiWindow(0, time_ns, sampling_hz, tuple(levels)) for time_ns, sampling_hz, levels in drawn]
    shuffled = data.draw(st.permutations(messages))
    assert same(window_of(messages), window_of(shuffled))


def test_a_number_replaces_a_missing_sample_and_never_the_other_way_round() -> None:
    missing = RssiWindow(0, START_NS, 10.0, (math.nan,))
    for order in ([missing, message(0, 0)], [message(0, 0), missing]):
        assert window_of(order)[0] == -60


def test_of_two_levels_for_one_moment_the_one_that_was_sent_later_stays() -> None:
    """A receiver faster than F: its tracker puts a later sample in the place of an earlier one, and sends both."""
    early = RssiWindow(0, taken_ns(1), 10.0, (-60.0, -61.0))
    later = RssiWindow(0, taken_ns(2), 10.0, (-60.0, -66.0, -62.0))
    for order in ([early, later], [later, early], [early, later, early]):
        assert window_of(order)[:3].tolist() == [-60, -66, -62]


def test_what_is_no_level_of_the_transmitter_is_missing_and_counts_once_however_often_it_is_repeated() -> None:
    window = SampleWindow(SCENARIO)
    garbage = (-60.0, 0.0, 17.0, -62.0, math.inf, 121.0, -63.0, -40.5, -64.0, math.nan)
    for last in range(1, 11):
        window.add(RssiWindow(0, taken_ns(last - 1), 10.0, garbage[:last]))
        window.add(RssiWindow(0, taken_ns(last - 1), 10.0, garbage[:last]))
    nan = math.nan
    assert same(window.window(START_NS)[0], np.array([-60, nan, nan, -62, nan, nan, -63, -40.5, -64, nan]))
    assert window.dropped == {NoLevel.ERROR_VALUE: 1, NoLevel.TOO_STRONG: 1, NoLevel.OUT_OF_RANGE: 2}
    assert window.newest_valid_ns == taken_ns(8)


def test_a_wild_sample_is_missing_and_counts_once_however_often_the_window_is_asked_for() -> None:
    window = SampleWindow(SCENARIO)
    window.add(RssiWindow(0, taken_ns(9), 10.0, (-60.0, -61.0, -20.0, -62.0, *(-60.0,) * 6)))
    for _ in range(3):
        assert np.flatnonzero(np.isnan(window.window(START_NS)[0])).tolist() == [2]
    assert window.dropped == {NoLevel.WILD: 1}
    window.add(RssiWindow(0, taken_ns(11), 10.0, (-15.0, -61.0)))
    assert np.flatnonzero(np.isnan(window.window(taken_ns(2))[0])).tolist() == [0, 8]
    assert window.dropped == {NoLevel.WILD: 2}


@pytest.mark.parametrize("phase_ns", [0, 1, 30_000_000, 49_999_999, 50_000_000, 70_000_000, 99_999_999])
def test_the_window_begins_with_the_first_sample_at_or_after_the_moment(phase_ns: int) -> None:
    """Wherever in its cell a tracker's grid lies."""
    start_ns = START_NS + phase_ns
    heard = [message(0, 19, start_ns)]
    for since_ns, first in [(start_ns, 0), (start_ns + 1, 1), (start_ns + PERIOD_NS, 1), (start_ns - 1, 0)]:
        assert window_of(heard, since_ns)[0] == level_dbm(first), since_ns - start_ns


def test_a_tracker_that_samples_faster_is_thinned_out() -> None:
    """At 20 Hz every other sample lies in the middle of a cell."""
    levels = tuple(-60.0 - number for number in range(21))
    heard = window_of([RssiWindow(0, START_NS + S, 20.0, levels)])
    assert same(heard, np.array([-60.0 - 2 * number for number in range(10)]))


def test_samples_that_come_too_late_do_not_harm_those_that_took_their_place() -> None:
    window = SampleWindow(SCENARIO)
    room = 2 * 10 + 50
    window.add(message(room, room + 9))
    window.add(message(0, 9))
    assert same(window.window(taken_ns(room))[0], np.array([level_dbm(room + number) for number in range(10)]))


# The clock's offset


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 7 * S), st.integers(0, 2 * S)), min_size=1, max_size=30),
    st.integers(-(10**15), 10**15),
)
def test_the_offset_is_that_of_the_fastest_message(sent: list[tuple[int, int]], ahead_ns: int) -> None:
    offset = ClockOffset()
    for sender_ns, delay_ns in sorted(sent, key=sum):
        offset.heard(sender_ns, sender_ns + ahead_ns + delay_ns)
    assert offset.offset_ns == ahead_ns + min(delay_ns for _, delay_ns in sent)


def test_the_offset_follows_a_clock_that_drifts() -> None:
    """100 ppm for an hour, delays of 20 to 500 ms: never off by more than the drift over its horizon and a delay."""
    offset, delays = ClockOffset(), random.Random(1)
    for step in range(36_000):
        now_ns = step * S // 10
        sender_ns = round(now_ns * 0.9999)
        arrival_ns = now_ns + round(delays.uniform(0.02, 0.5) * S)
        offset.heard(sender_ns, arrival_ns)
        assert not offset.contradicts(sender_ns, arrival_ns)
    assert offset.offset_ns is not None
    assert now_ns - sender_ns - 0.001 * S < offset.offset_ns < now_ns - sender_ns + 0.05 * S


# One tracker's record


class Tracker:
    """Sends its reports to a record, with a delay, by a clock of its own."""

    def __init__(self, record: TrackerRecord, clock_ns: int, delay_ns: int = 0) -> None:
        self.record, self.clock_ns, self.delay_ns = record, clock_ns, delay_ns
        self.now_ns = 0

    def at(self, now_s: float) -> "Tracker":
        self.now_ns = round(now_s * S)
        return self

    @property
    def own_ns(self) -> int:
        return self.clock_ns + self.now_ns

    def says(self, *messages: Heartbeat | PositionReport | RssiWindow) -> None:
        for one in messages:
            self.record.hear(one, self.now_ns + self.delay_ns)

    def lives(self, mode: TrackerMode = TrackerMode.FOLLOWING) -> Heartbeat:
        return Heartbeat(0, self.own_ns, mode, FLYING)

    def is_at(self, *position_m: float | int) -> PositionReport:
        x_m, y_m, z_m = map(float, position_m)
        return PositionReport(0, self.own_ns, (x_m, y_m, z_m))

    def hears(self, *rssi_dbm: float) -> RssiWindow:
        return RssiWindow(0, self.own_ns, 10.0, rssi_dbm)


def test_ages_count_from_when_things_were_measured() -> None:
    record = TrackerRecord(SCENARIO)
    assert record.position_age_s(0) == record.rssi_age_s(0) == math.inf
    assert record.is_lost(0)
    assert record.is_silent(0)
    tracker = Tracker(record, clock_ns=500 * S, delay_ns=S // 50)
    tracker.at(1).says(tracker.lives(), tracker.is_at(1, 2, 3), tracker.hears(-50.0))
    assert record.position_age_s(round(1.52 * S)) == pytest.approx(0.5)
    # The newest sample is missing: what counts is the last valid one.
    tracker.at(1.5).says(tracker.hears(-50.0, math.nan, math.nan))
    assert record.rssi_age_s(round(2.02 * S)) == pytest.approx(0.7)
    assert not record.is_silent(round(2.02 * S))
    assert record.is_silent(round(2.33 * S))
    assert record.is_lost(round(2.03 * S))


@pytest.mark.parametrize(("sampling_hz", "silent_after_s"), [(100.0, 1.0), (10.0, 1.0), (1.0, 3.0)])
def test_slow_sampling_is_not_silence(sampling_hz: float, silent_after_s: float) -> None:
    record = TrackerRecord(paper_scenario(sampling_hz=sampling_hz))
    record.hear(RssiWindow(0, 0, sampling_hz, (-50.0,)), 0)
    assert not record.is_silent(round(silent_after_s * S))
    assert record.is_silent(round(silent_after_s * S) + 1)


def test_who_has_just_come_is_not_heard_and_silent_only_after_as_long_as_anybody() -> None:
    """So it is after a restart, until something comes."""
    record = TrackerRecord(SCENARIO)
    tracker = Tracker(record, clock_ns=3600 * S)
    tracker.at(2).says(tracker.lives(), tracker.is_at(1, 2, 3), tracker.hears(math.nan))
    tracker.at(3).says(tracker.lives(), tracker.is_at(1, 2, 3), tracker.hears(math.nan))
    assert not record.is_heard(tracker.now_ns)
    assert not record.is_silent(tracker.now_ns)
    assert record.is_silent(tracker.now_ns + 1)
    tracker.says(tracker.hears(-50.0))
    assert record.is_heard(tracker.now_ns)
    tracker.clock_ns = 0
    tracker.at(9).says(tracker.lives(), tracker.is_at(1, 2, 3))
    assert (record.is_heard(tracker.now_ns), record.is_silent(tracker.now_ns)) == (False, False)
    assert record.is_silent(round(10.1 * S))
    tracker.says(tracker.hears(-50.0))
    assert not record.is_silent(tracker.now_ns)


def test_old_samples_do_not_make_one_that_has_just_come_heard() -> None:
    record = TrackerRecord(SCENARIO)
    tracker = Tracker(record, clock_ns=3600 * S).at(5)
    tracker.says(tracker.lives(), tracker.is_at(1, 2, 3), tracker.hears(-50.0, *[math.nan] * 15))
    assert (record.is_heard(tracker.now_ns), record.is_silent(tracker.now_ns)) == (False, True)


def test_a_restart_empties_the_record() -> None:
    """The clock jumps back from an hour to a second: what is dated by the old clock is void."""
    record = TrackerRecord(SCENARIO)
    tracker = Tracker(record, clock_ns=3600 * S)
    tracker.at(1).says(tracker.lives(), tracker.is_at(1, 2, 3), tracker.hears(-50.0, -51.0))
    tracker.clock_ns = 0
    tracker.at(2).says(tracker.lives(TrackerMode.MANUAL))
    assert record.is_lost(tracker.now_ns)
    assert np.isnan(record.last_window()).all()
    assert record.mode is TrackerMode.MANUAL
    tracker.at(2.1).says(tracker.is_at(4, 5, 6), tracker.hears(-70.0))
    assert record.rssi_age_s(tracker.now_ns) == record.position_age_s(tracker.now_ns) == 0
    assert record.window(tracker.now_ns)[0][0] == -70


def test_old_windows_are_no_restart() -> None:
    """A receiver that has died: its last window is repeated for a minute while the tracker lives on."""
    record = TrackerRecord(SCENARIO)
    tracker = Tracker(record, clock_ns=0)
    tracker.at(1)
    last = tracker.hears(-50.0, -51.0)
    for step in range(600):
        tracker.at(1 + step / 10).says(tracker.lives(), tracker.is_at(step, 0, 0), last)
    assert record.rssi_age_s(tracker.now_ns) == pytest.approx(59.9)
    assert record.position_age_s(tracker.now_ns) == 0
    assert record.position_m is not None
    assert record.position_m[0] == 599


def test_the_newest_mode_counts_whatever_comes_after_it() -> None:
    record = TrackerRecord(SCENARIO)
    tracker = Tracker(record, clock_ns=0)
    following = tracker.at(1).lives()
    tracker.at(2).says(tracker.lives(TrackerMode.MANUAL), following)
    assert record.mode is TrackerMode.MANUAL


def test_who_may_be_commanded() -> None:
    record = TrackerRecord(SCENARIO)
    tracker = Tracker(record, clock_ns=0)
    tracker.at(1).says(tracker.is_at(0, 0, 0))
    assert not record.may_be_commanded(tracker.now_ns)  # no mode yet
    tracker.says(tracker.lives())
    assert record.may_be_commanded(tracker.now_ns)
    assert not record.may_be_commanded(tracker.now_ns + S + 1)  # lost
    tracker.at(1.5).says(tracker.lives(TrackerMode.MANUAL), tracker.is_at(0, 0, 0))
    assert not record.may_be_commanded(tracker.now_ns)


@pytest.mark.parametrize(
    ("said_s", "delay_s", "now_s", "is_awaited"),
    [
        # A window of ten samples, 0.1 s apart, the last at 1.9 s, from one that reports 20 times a second.
        ((1.8, 1.85), 0.0, 1.90, True),
        ((1.8, 1.85), 0.0, 1.92, True),
        ((1.8, 1.85), 0.0, 1.93, False),  # quiet: what a gap has swallowed does not come
        ((1.85, 1.9), 0.0, 1.90, False),  # all of it is there
        # The same over a link that is 0.3 s late: while anything comes the rest will.
        ((1.7, 1.75, 1.8), 0.3, 2.15, True),
        ((1.7, 1.75, 1.8), 0.3, 2.18, False),
        ((1.7, 1.75, 1.8, 1.85, 1.9), 0.3, 2.2, False),
    ],
)
def test_the_rest_of_a_window_is_awaited_while_anything_comes(
    said_s: tuple[float, ...], delay_s: float, now_s: float, is_awaited: bool
) -> None:
    record = TrackerRecord(SCENARIO)
    tracker = Tracker(record, clock_ns=0, delay_ns=round(delay_s * S))
    tracker.at(0).says(tracker.lives())
    for time_s in said_s:
        tracker.at(math.floor(10 * time_s + 1e-6) / 10)
        heard = tracker.hears(*[-50.0] * 10)
        tracker.at(time_s).says(heard, tracker.is_at(0, 0, 0))
    # By the controller's clock, on which a late tracker's moments are as late.
    since_ns = round((0.95 + delay_s) * S)
    assert record.awaits_flown_window(since_ns, round(now_s * S)) == is_awaited


def test_each_sample_has_the_place_where_it_was_taken() -> None:
    """Positions at 1 s and 2 s, half way in between at 1.5 s, by a clock an age ahead."""
    record = TrackerRecord(SCENARIO)
    tracker = Tracker(record, clock_ns=10**17)
    tracker.at(1)
    early = tracker.is_at(10, 0, -4)
    tracker.at(2).says(tracker.is_at(20, 2, -4), early, tracker.hears(*(-60.0 for _ in range(11))))
    levels, places_m = record.window(S)
    assert (levels == -60).all()
    assert places_m[0].tolist() == [10, 0, -4]
    assert places_m[5] == pytest.approx(np.array([15, 1, -4]))


def test_arrival_counts_from_the_first_report_of_the_last_stay() -> None:
    record = TrackerRecord(SCENARIO)
    tracker = Tracker(record, clock_ns=0)
    there_m = np.array([5.0, 0, 0])
    assert record.arrived_ns(there_m, 0.3, 0) is None
    for now_s, x_m in [(1.0, 5.0), (2.0, 7.0), (3.0, 5.2), (4.0, 4.9)]:
        tracker.at(now_s).says(tracker.is_at(x_m, 0, 0))
    assert record.arrived_ns(there_m, 0.3, 0) == 3 * S
    # Told at 3 s: what it reported until then does not count.
    assert record.arrived_ns(there_m, 0.3, 3 * S) == 4 * S
    assert record.arrived_ns(there_m, 0.3, 4 * S) is None
    tracker.at(5).says(tracker.is_at(4, 0, 0))
    assert record.arrived_ns(there_m, 0.3, 0) is None


def test_a_flood_of_positions_is_forgotten_again() -> None:
    record = TrackerRecord(SCENARIO)
    for number in range(3 * MOST_POSITIONS):
        record.hear(PositionReport(0, S + number, (float(number), 0.0, 0.0)), S + number)
    _, places_m = record.window(S)
    assert places_m[-1, 0] == 3 * MOST_POSITIONS - 1
    assert len(record._position_ns) == MOST_POSITIONS


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(
            st.one_of(st.integers(0, 2**63 - 1), st.integers(0, 100 * S)),
            st.integers(0, 100 * S),
            st.sampled_from(["rssi", "position", "heartbeat"]),
        ),
        max_size=30,
    )
)
def test_no_dates_break_a_record(said: list[tuple[int, int, str]]) -> None:
    """Hostile or absurd sender times cost a tracker its own column and nothing else."""
    record = TrackerRecord(SCENARIO)
    now_ns = 0
    for sender_ns, later_ns, kind in said:
        now_ns += later_ns
        record.hear(
            {
                "rssi": RssiWindow(0, sender_ns, 0.1, (-50.0, math.nan, -51.0)),
                "position": PositionReport(0, sender_ns, (1.0, 2.0, 3.0)),
                "heartbeat": Heartbeat(0, sender_ns, TrackerMode.FOLLOWING, FLYING),
            }[kind],
            now_ns,
        )
        if record.has_window(now_ns) and not record.is_lost(now_ns):
            levels, places_m = record.window(now_ns)
            assert set(levels[np.isfinite(levels)]) <= {-50.0, -51.0}
            assert (places_m == [1, 2, 3]).all()
    # Twelve seconds of sense, and all is well again.
    tracker = Tracker(record, clock_ns=0)
    start_s = now_ns / 1e9
    for step in range(121):
        tracker.at(start_s + step / 10).says(tracker.lives(), tracker.is_at(4, 5, 6), tracker.hears(-70.0))
    assert record.position_m is not None
    assert record.may_be_commanded(tracker.now_ns)
    assert not record.is_silent(tracker.now_ns)
