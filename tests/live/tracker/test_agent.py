"""The tracker agent: what it says, which set-points it obeys, and what it does when nobody speaks to it."""

import math
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from live_bench import FLYING
from swarmchase.errors import InputError
from swarmchase.live.clock import VirtualClock
from swarmchase.live.link.mavlink import TrackerMavlinkLink
from swarmchase.live.link.messages import (
    FeedForward,
    Heartbeat,
    Message,
    Metres,
    Notice,
    PositionReport,
    RssiWindow,
    SetPoint,
    Severity,
    TrackerMode,
)
from swarmchase.live.tracker.agent import BRAKED_S, AgentSettings, SetPointRule, TrackerAgent
from swarmchase.live.tracker.loop import run_tracker
from swarmchase.live.tracker.sources import CalibratedSource, Rejected, Sample, SimulatedSource
from swarmchase.live.tracker.vehicles import SimulatedVehicle, Vehicle
from swarmchase.live.tracker.way_back import MOST_PLACES, STEP_M, WayBack
from swarmchase.processes.stop_request import StopRequest

HOLDING, FOLLOWING, MANUAL = TrackerMode.HOLDING, TrackerMode.FOLLOWING, TrackerMode.MANUAL
TRACKER = 3
START_S = 1000.0
CONTROLLER_AHEAD_S = 5555.0
"""The controller's clock is another one."""


class FakeLink:
    """Delivers what is put into it, at the next ``receive``."""

    def __init__(self) -> None:
        self.rejected: Counter[str] = Counter()
        self.sent: list[Message] = []
        self.waiting: list[Message] = []
        self.closed = False

    def send(self, message: Message) -> None:
        self.sent.append(message)

    def receive(self) -> Sequence[Message]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def close(self) -> None:
        self.closed = True


class FakeVehicle:
    """Writes down its orders, and is where and what the test says."""

    def __init__(self) -> None:
        self.position_m: Metres | None = (1.0, 2.0, 3.0)
        self.velocity_mps: Metres = (0.1, 0.2, 0.3)
        self.mode = HOLDING
        self.position_age_s = 0.0
        self.state = FLYING
        self.lines: list[tuple[Severity, str]] = []
        self.orders: list[Metres | str] = []

    def health(self, tracker: int) -> None:
        return None

    def said(self) -> list[tuple[Severity, str]]:
        lines, self.lines = self.lines, []
        return lines

    def go_to(self, position_m: Metres) -> None:
        self.orders.append(position_m)
        self.mode = FOLLOWING

    def hold(self) -> None:
        self.orders.append("hold")
        self.mode = HOLDING

    def update(self, now_ns: int) -> None:
        pass

    def close(self) -> None:
        self.orders.append("close")


class Situation:
    """An agent with fakes around it, and time that passes in steps of .05 s."""

    def __init__(self, vehicle: Vehicle | None = None, settings: AgentSettings | None = None) -> None:
        self.clock = VirtualClock(round(START_S * 1e9))
        self.link = FakeLink()
        self.fake = FakeVehicle()
        self.source = CalibratedSource(SimulatedSource(lambda time_ns: -60.0, 10.0), 1.5)
        self.agent = TrackerAgent(
            TRACKER, self.source, vehicle or self.fake, self.link, self.clock, sampling_hz=10.0, settings=settings
        )

    @property
    def now_s(self) -> float:
        return self.clock.now_ns() / 1e9 - START_S

    def go_on(self, seconds: float, step_s: float = 0.05) -> None:
        for _ in range(round(seconds / step_s)):
            self.clock.advance(step_s)
            self.agent.step()

    def hear(self, place: float, sent_s: float | None = None, epoch: int = 1, tracker: int = TRACKER) -> None:
        """A set-point at (place, 0, 0), sent at ``sent_s`` by the clock of ``now_s``, and one step."""
        time_ns = round((START_S + CONTROLLER_AHEAD_S + (self.now_s if sent_s is None else sent_s)) * 1e9)
        self.link.waiting.append(SetPoint(tracker, time_ns, epoch, (place, 0.0, 0.0)))
        self.agent.step()

    def hear_on_the_way(self, place: float, speed_mps: float, valid_s: float, sent_s: float | None = None) -> None:
        """A set-point at (place, 0, 0) that moves on eastwards, and one step."""
        time_ns = round((START_S + CONTROLLER_AHEAD_S + (self.now_s if sent_s is None else sent_s)) * 1e9)
        feed_forward = FeedForward((speed_mps, 0.0, 0.0), valid_s, 4.0)
        self.link.waiting.append(SetPoint(TRACKER, time_ns, 1, (place, 0.0, 0.0), feed_forward))
        self.agent.step()

    def places(self) -> list[float | str]:
        """The orders, the first coordinate standing for a position."""
        return [order if isinstance(order, str) else order[0] for order in self.fake.orders]

    def sent(self, kind: type[Message]) -> list[Message]:
        return [message for message in self.link.sent if isinstance(message, kind)]


# What it says


def test_what_is_said_how_often() -> None:
    situation = Situation()
    situation.agent.step()
    assert [type(message) for message in situation.link.sent] == [RssiWindow, PositionReport, Heartbeat]
    situation.go_on(9.99, 0.01)
    counts = Counter(type(message) for message in situation.link.sent)
    assert counts == {RssiWindow: 100, PositionReport: 100, Heartbeat: 10}
    assert all(message.tracker == TRACKER for message in situation.link.sent)
    assert situation.sent(PositionReport)[-1] == PositionReport(
        TRACKER, situation.sent(PositionReport)[-1].time_ns, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3)
    )


def test_after_a_pause_nothing_is_made_up_for() -> None:
    situation = Situation()
    situation.agent.step()
    situation.clock.advance(60.0)
    situation.link.sent.clear()
    situation.agent.step()
    situation.agent.step()
    assert [type(message) for message in situation.link.sent] == [RssiWindow, PositionReport, Heartbeat]
    # And where the steps are rarer than the messages, each step has one of each.
    situation.link.sent.clear()
    situation.go_on(9, step_s=1.5)
    assert Counter(type(message) for message in situation.link.sent) == {RssiWindow: 6, PositionReport: 6, Heartbeat: 6}


def test_every_window_holds_the_last_fifty_samples() -> None:
    situation = Situation()
    situation.agent.step()
    situation.go_on(2)
    window = situation.sent(RssiWindow)[-1]
    assert isinstance(window, RssiWindow)
    assert (window.sampling_hz, window.time_ns) == (10.0, round((START_S + 2) * 1e9))
    assert window.rssi_dbm == (-58.5,) * 21
    situation.go_on(10)
    last = situation.sent(RssiWindow)[-1]
    assert isinstance(last, RssiWindow)
    assert last.rssi_dbm == (-58.5,) * 50


def test_a_silent_receiver_is_reported_as_missing_samples() -> None:
    situation = Situation()
    situation.agent.step()
    situation.go_on(1)
    situation.source._source = Silent()
    situation.go_on(1)
    window = situation.sent(RssiWindow)[-1]
    assert isinstance(window, RssiWindow)
    assert window.rssi_dbm[:11] == (-58.5,) * 11
    assert len(window.rssi_dbm) == 19
    assert all(map(math.isnan, window.rssi_dbm[11:]))


class Silent:
    """A receiver that hears nothing, or whose numbers are nonsense."""

    silence = "it never speaks"

    def __init__(self, *levels_dbm: float) -> None:
        self.rejected = Rejected()
        self.levels_dbm = levels_dbm

    def read(self, now_ns: int) -> list[Sample]:
        return [(now_ns, level_dbm) for level_dbm in self.levels_dbm]

    def close(self) -> None:
        pass


def test_a_receiver_that_never_speaks_keeps_nothing_else_from_being_said() -> None:
    for source in (Silent(), Silent(math.nan, math.inf, -math.inf, 1e300, -201.0, 51.0)):
        situation = Situation()
        situation.source._source = source
        situation.go_on(1)
        assert {type(message) for message in situation.link.sent} == {PositionReport, Heartbeat}


def test_an_unknown_or_impossible_position_is_not_said() -> None:
    situation = Situation()
    situation.fake.position_m = None
    situation.go_on(1)
    assert situation.sent(PositionReport) == []
    situation.fake.position_m = (math.nan, 0.0, 0.0)
    situation.go_on(1)
    assert situation.sent(PositionReport) == []
    assert situation.agent.ignored["impossible position"] == 10
    assert len(situation.sent(Heartbeat)) == 2


# What it obeys


def test_set_points_are_obeyed_in_their_order() -> None:
    situation = Situation()
    for place in (10.0, 11.0, 12.0):
        situation.go_on(0.2)
        situation.hear(place)
    assert situation.places() == [10, 11, 12]
    assert situation.agent.ignored == {}
    situation.go_on(1)
    modes = [message.mode for message in situation.sent(Heartbeat) if isinstance(message, Heartbeat)]
    # The change is told at once, and 20 times a second for a while.
    assert modes == [HOLDING] + [FOLLOWING] * 21 + [HOLDING]


def test_a_change_of_mode_is_told_at_once_and_again() -> None:
    """A pilot takes over between two heartbeats: any of 20 datagrams tells it, the first one in the same step."""
    situation = Situation()
    situation.go_on(10.3)
    situation.link.sent.clear()
    situation.fake.mode = MANUAL
    changed_s = situation.now_s
    situation.go_on(3.0)
    beats = [message for message in situation.sent(Heartbeat) if isinstance(message, Heartbeat)]
    assert {beat.mode for beat in beats} == {MANUAL}
    after_s = [beat.time_ns / 1e9 - START_S - changed_s for beat in beats]
    assert after_s[:20] == pytest.approx([0.05 * number for number in range(1, 21)])
    assert len(beats) == 20 + 2


@pytest.mark.parametrize(
    ("heard", "obeyed", "ignored"),
    [
        # (place, sent, heard at, epoch, tracker)
        ([(10, 0.0, 0.0, 1, 3), (11, 0.1, 0.1, 1, 3)], [10, 11], {}),
        # Repeated, or replayed.
        ([(10, 0.0, 0.0, 1, 3), (10, 0.0, 0.1, 1, 3), (10, 0.0, 0.2, 1, 3)], [10], {"not newer than the last": 2}),
        # Reordered.
        ([(10, 0.0, 0.0, 1, 3), (12, 0.2, 0.2, 1, 3), (11, 0.1, 0.2, 1, 3)], [10, 12], {"not newer than the last": 1}),
        # A new controller has the lease at once, whatever its clock says, and the old one never again.
        (
            [(10, 0.0, 0.0, 1, 3), (20, -50.0, 0.1, 2, 3), (11, 0.2, 0.2, 1, 3), (21, -49.8, 0.3, 2, 3)],
            [10, 20, 21],
            {"older epoch": 1},
        ),
        # Under way for too long: an outage of a link that keeps what it is given.
        (
            [(10, 0.0, 0.0, 1, 3), (11, 0.1, 3.0, 1, 3), (12, 0.2, 3.0, 1, 3), (13, 2.9, 3.0, 1, 3)],
            [10, "hold", 13],
            {"too long under way": 2},
        ),
        # Late, but not too late; and the next that was faster.
        ([(10, 0.0, 0.0, 1, 3), (11, 0.1, 0.8, 1, 3), (12, 0.85, 0.9, 1, 3)], [10, 11, 12], {}),
        # Not its own.
        ([(10, 0.0, 0.0, 1, 2), (11, 0.1, 0.1, 1, 3)], [11], {"for another tracker": 1}),
        # Not even the lease of another tracker's set-point counts.
        ([(10, 0.0, 0.0, 9, 2), (11, 0.1, 0.1, 1, 3)], [11], {"for another tracker": 1}),
    ],
)
def test_which_set_points_are_obeyed(
    heard: list[tuple[float, float, float, int, int]], obeyed: list[float | str], ignored: dict[str, int]
) -> None:
    situation = Situation()
    for place, sent_s, at_s, epoch, tracker in heard:
        situation.go_on(at_s - situation.now_s)
        situation.hear(float(place), sent_s, epoch, tracker)
    assert situation.places() == obeyed
    assert situation.agent.ignored == ignored


def test_what_a_tracker_would_say_is_not_obeyed() -> None:
    situation = Situation()
    situation.link.waiting = [Heartbeat(TRACKER, 1, MANUAL, FLYING), PositionReport(TRACKER, 1, (9.0, 9.0, 9.0))]
    situation.agent.step()
    assert situation.places() == []
    assert situation.agent.ignored == {"no set-point": 2}


def test_an_agent_that_was_stopped_for_an_hour_obeys_nothing_from_before() -> None:
    """Its socket has kept what came meanwhile; the controller speaks still, or has died long ago."""
    situation = Situation()
    situation.hear(10.0)
    situation.clock.advance(3600.0)
    for sent_s in (0.1, 1800.0, 3598.0):
        situation.hear(11.0, sent_s)
    assert situation.places() == [10, "hold", 1]  # and it returns: it was alone for an hour
    situation.hear(12.0, 3599.9)
    assert situation.places()[-1] == 12
    assert situation.agent.ignored == {"too long under way": 3}


SENT = st.builds(
    SetPoint,
    tracker=st.sampled_from([TRACKER, TRACKER, TRACKER, 0]),
    time_ns=st.integers(0, 20).map(lambda tenths: tenths * 100_000_000),
    epoch=st.integers(0, 4),
    position_m=st.just((0.0, 0.0, 0.0)),
)


@settings(deadline=None)
@given(st.lists(st.tuples(SENT, st.integers(0, 300)), max_size=40))
def test_whatever_comes_in_whatever_order_what_is_obeyed_goes_forward(heard: list[tuple[SetPoint, int]]) -> None:
    """Several controllers; losses, repeats, any order, any delay, times that mean nothing to one another."""
    rule = SetPointRule(TRACKER, oldest_s=1.0)
    clock = VirtualClock()
    obeyed: list[SetPoint] = []
    for set_point, milliseconds in heard:
        clock.advance(milliseconds / 1e3)
        if rule.refusal(set_point, clock.now_ns()) is None:
            obeyed.append(set_point)
    marks = [(set_point.epoch, set_point.time_ns) for set_point in obeyed]
    assert marks == sorted(set(marks))
    assert all(set_point.tracker == TRACKER for set_point in obeyed)
    # And not for being deaf: the first of the newest epoch is among them.
    epochs = [set_point.epoch for set_point, _ in heard if set_point.tracker == TRACKER]
    assert {set_point.epoch for set_point in obeyed} >= ({max(epochs)} if epochs else set())


@settings(deadline=None)
@given(st.permutations(range(12)), st.lists(st.integers(0, 11), max_size=10))
def test_the_last_word_is_the_same_in_any_order(order: list[int], repeats: list[int]) -> None:
    """Three controllers in turn, four set-points each, all heard within half a second."""
    situation = Situation()
    for number in [*order, *repeats]:
        epoch, place = divmod(number, 4)
        situation.clock.advance(0.02)
        situation.hear(float(number), sent_s=epoch * 77.0 + place * 0.01, epoch=epoch)
    assert situation.places()[-1] == 11
    assert situation.places() == sorted(set(situation.places()), key=float)


# On its way


def test_who_is_led_along_a_way_goes_on_through_a_gap_and_brakes_when_that_is_no_longer_well() -> None:
    situation = Situation()
    situation.go_on(1)
    situation.hear_on_the_way(20.0, speed_mps=8.0, valid_s=1.5)
    assert situation.places() == [20.0]
    situation.go_on(2.5)
    led_m = [min(20.0 + 8.0 * 0.05 * step, 32.0) for step in range(30)]
    *places, last = situation.places()
    assert (places, last) == (pytest.approx(led_m, abs=0.01), "hold")


def test_a_gap_that_ends_leaves_no_trace() -> None:
    """What was sent .3 s ago is taken as it is meant now."""
    situation = Situation()
    situation.hear_on_the_way(20.0, speed_mps=8.0, valid_s=1.5)
    situation.go_on(0.3)
    before = situation.places()[-1]
    situation.hear_on_the_way(20.8, speed_mps=8.0, valid_s=1.5, sent_s=situation.now_s - 0.2)
    assert before == pytest.approx(22.4, abs=0.01)
    assert situation.places()[-1] == pytest.approx(22.4, abs=0.01)
    # And where it is to rest it is told so once.
    situation.hear(30.0)
    situation.go_on(0.5)
    assert situation.places()[-1] == 30.0
    assert situation.places().count(30.0) == 1


def test_a_short_way_on_does_not_shorten_the_time_until_it_holds() -> None:
    situation = Situation()
    situation.hear_on_the_way(20.0, speed_mps=8.0, valid_s=0.2)
    situation.go_on(0.95)
    assert situation.places()[-1] == pytest.approx(21.6, abs=0.01)
    situation.go_on(0.05)
    assert situation.places()[-1] == "hold"


def test_whom_a_pilot_takes_is_not_led_on() -> None:
    situation = Situation()
    situation.hear_on_the_way(20.0, speed_mps=8.0, valid_s=1.5)
    situation.fake.mode = MANUAL
    situation.go_on(1.0)
    assert situation.places() == [20.0]
    situation.fake.mode = HOLDING
    situation.go_on(0.3)
    assert situation.places() == [20.0]


def test_it_says_which_set_point_it_has_obeyed_last() -> None:
    situation = Situation()
    situation.agent.step()
    assert [message.obeyed_ms for message in situation.sent(RssiWindow) if isinstance(message, RssiWindow)] == [None]
    situation.hear(10.0, sent_s=0.0)
    situation.hear(10.0, epoch=0)  # an older controller's, which it does not obey
    situation.go_on(0.2)
    window = situation.sent(RssiWindow)[-1]
    assert isinstance(window, RssiWindow)
    assert window.obeyed_ms == round((START_S + CONTROLLER_AHEAD_S) * 1e3) % 2**32


# What it says of its vehicle


def test_a_position_is_dated_by_when_it_was_true() -> None:
    """Telemetry twice a second: what was true .4 s ago is not news."""
    situation = Situation()
    situation.fake.position_age_s = 0.4
    situation.go_on(1)
    reports = [message for message in situation.sent(PositionReport) if isinstance(message, PositionReport)]
    beats = [message for message in situation.sent(Heartbeat) if isinstance(message, Heartbeat)]
    assert reports[0].time_ns == beats[0].time_ns - 400_000_000
    assert {beat.vehicle for beat in beats} == {FLYING}


def test_lines_for_people_are_cut_repeated_and_bounded() -> None:
    situation = Situation()
    situation.fake.lines = [
        (Severity.CRITICAL, "PreArm: Compass not calibrated \u00e9 and the battery is at 21.6 V already")
    ]
    situation.go_on(3)
    said = [message for message in situation.link.sent if isinstance(message, Notice)]
    assert [(one.number, one.piece, one.severity, one.text) for one in said] == 3 * [
        (1, 0, Severity.CRITICAL, "PreArm: Compass not calibrated ? and the battery i"),
        (1, 1, Severity.CRITICAL, "s at 21.6 V already"),
    ]
    situation.link.sent.clear()
    situation.fake.lines = [(Severity.INFO, f"line {number}") for number in range(1000)]
    situation.go_on(60)
    said = [message for message in situation.link.sent if isinstance(message, Notice)]
    assert {one.text for one in said} == {f"line {number}" for number in range(20)}
    assert len(said) == 3 * 20


# When nobody speaks


def test_set_points_expire_and_then_it_returns_the_way_it_came() -> None:
    """Led 4 m aside in half a second, 60 s later it goes back there as slowly."""
    situation = Situation()
    situation.go_on(1)
    situation.hear(10.0)
    for step in range(1, 11):
        situation.fake.position_m = (1.0 + 0.4 * step, 2.0, 3.0)
        situation.go_on(0.05)
    situation.hear(11.0)
    situation.go_on(0.95)
    assert situation.places() == [10, 11]
    situation.go_on(0.05)
    assert situation.places() == [10, 11, "hold"]
    situation.go_on(58.95)
    assert situation.places() == [10, 11, "hold"]
    situation.go_on(0.1)
    assert situation.fake.orders[3:] == [(5.0, 2.0, 3.0)]
    situation.link.sent.clear()
    # A second of silence and five of braking are part of the way.
    situation.go_on(1.0 + BRAKED_S - 0.1)
    assert len(situation.fake.orders) == 4
    situation.go_on(0.6)
    back_m = situation.places()[3:]
    assert back_m == pytest.approx([5.0 - 0.4 * step for step in range(11)], abs=0.01)
    assert situation.fake.orders[-1] == (1.0, 2.0, 3.0)
    situation.go_on(100)
    assert len(situation.fake.orders) == 3 + 11
    # While it returns by itself, it follows nobody, and would follow the next one.
    assert {message.mode for message in situation.sent(Heartbeat) if isinstance(message, Heartbeat)} == {HOLDING}
    situation.hear(12.0)
    assert situation.places()[14:] == [12]
    situation.go_on(1)
    assert situation.places()[14:] == [12, "hold"]


def test_who_is_led_again_on_its_way_back_follows_at_once() -> None:
    situation = Situation(settings=AgentSettings(return_after_s=2.0))
    situation.hear(10.0)
    for step in range(1, 41):
        situation.fake.position_m = (1.0 + 0.2 * step, 2.0, 3.0)
        situation.go_on(0.05)
        situation.hear(10.0)
    situation.go_on(2.0 + 2.0 + 1.0)
    assert 1 < situation.fake.orders[-1][0] < 9  # type: ignore[operator]
    situation.hear(77.0)
    assert situation.places()[-1] == 77
    situation.go_on(1.5)
    assert situation.places()[-2:] == [77, "hold"]


def test_a_pilot_on_the_way_back_is_left_alone() -> None:
    situation = Situation(settings=AgentSettings(return_after_s=2.0))
    situation.hear(10.0)
    situation.fake.position_m = (5.0, 2.0, 3.0)
    situation.go_on(2.1)
    assert situation.places() == [10, "hold", 5]
    situation.fake.mode = MANUAL
    situation.go_on(0.1)
    situation.fake.mode = HOLDING
    situation.go_on(100)
    assert situation.places() == [10, "hold", 5]


def test_the_time_of_expiry_counts_from_the_sending() -> None:
    situation = Situation()
    situation.hear(10.0, sent_s=0.0)
    situation.go_on(0.5)
    situation.hear(11.0, sent_s=0.1)
    situation.go_on(0.55)
    assert situation.places() == [10, 11]
    situation.go_on(0.1)
    assert situation.places() == [10, 11, "hold"]


def test_a_new_controller_s_clock_is_another_one() -> None:
    """It runs .15 s behind the last one's: its set-points are not taken for late."""
    situation = Situation()
    situation.hear(10.0, sent_s=0.0, epoch=1)
    situation.go_on(0.1)
    situation.hear(20.0, sent_s=-0.05, epoch=2)
    situation.go_on(0.95)
    assert situation.places() == [10, 20]
    situation.go_on(0.05)
    assert situation.places() == [10, 20, "hold"]


def test_repeats_of_an_old_one_keep_nothing_alive() -> None:
    situation = Situation()
    situation.hear(10.0, sent_s=0.0)
    for _ in range(30):
        situation.go_on(0.05)
        situation.hear(10.0, sent_s=0.0)
    assert situation.places() == [10, "hold"]


@pytest.mark.parametrize(
    ("return_after_s", "orders"), [(0.0, [10, "hold"]), (2.0, [10, "hold", 1]), (1.0, [10, "hold", 1])]
)
def test_whether_it_returns(return_after_s: float, orders: list[float | str]) -> None:
    situation = Situation(settings=AgentSettings(return_after_s=return_after_s))
    situation.hear(10.0)
    situation.go_on(300, step_s=0.1)
    assert situation.places() == orders


def test_nobody_ever_spoke() -> None:
    situation = Situation()
    situation.go_on(100, step_s=0.1)
    assert situation.places() == []


def test_without_a_known_start_it_stays() -> None:
    situation = Situation()
    situation.fake.position_m = None
    situation.hear(10.0)
    situation.fake.position_m = (5.0, 5.0, 5.0)
    situation.go_on(100, step_s=0.1)
    assert situation.places() == [10, "hold"]


def test_a_vehicle_in_other_hands_is_given_no_orders() -> None:
    situation = Situation()
    situation.hear(10.0)
    situation.fake.mode = MANUAL
    situation.go_on(0.5)
    situation.hear(11.0)
    situation.go_on(100, step_s=0.1)
    assert situation.places() == [10]
    assert situation.agent.ignored == {"manual": 1}
    modes = [message.mode for message in situation.sent(Heartbeat) if isinstance(message, Heartbeat)]
    assert modes[1:] == [MANUAL] * (len(modes) - 1)
    # Given back: it stays there, and does not return, until the controller speaks; an old word moves nothing.
    situation.fake.mode = HOLDING
    situation.go_on(100, step_s=0.1)
    situation.hear(11.0, sent_s=0.5)
    assert situation.places() == [10]
    situation.hear(12.0)
    assert situation.places() == [10, 12]


def test_a_chase_with_a_simulated_vehicle() -> None:
    vehicle = SimulatedVehicle((0.0, 0.0, 0.0))
    situation = Situation(vehicle)
    situation.agent.step()
    for _ in range(50):
        situation.go_on(0.1)
        situation.hear(4.0)
    assert vehicle.position_m == (4, 0, 0)
    vehicle.take_over()
    situation.go_on(1)
    situation.hear(0.0)
    situation.go_on(1)
    assert vehicle.position_m == (4, 0, 0)
    vehicle.give_back()
    situation.hear(100.0)
    situation.go_on(2.5)
    assert 5 < vehicle.position_m[0] < 15
    assert (vehicle.velocity_mps, vehicle.mode) == ((0, 0, 0), HOLDING)
    situation.go_on(65 + 20)
    assert vehicle.position_m == (0, 0, 0)


def test_at_the_end_it_holds_and_gives_everything_back() -> None:
    situation = Situation()
    situation.hear(10.0)
    situation.agent.close()
    assert situation.places() == [10, "hold", "close"]
    assert situation.link.closed


# Settings and size


@pytest.mark.parametrize(
    "wrong",
    [
        {"window_hz": 0.0},
        {"position_hz": -1.0},
        {"heartbeat_hz": math.nan},
        {"hold_after_s": math.inf},
        {"return_after_s": -1.0},
        {"return_after_s": 0.5},
        {"return_after_s": math.nan},
    ],
)
def test_refused_settings(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        AgentSettings(**wrong)


@pytest.mark.parametrize(("tracker", "sampling_hz"), [(6, 10.0), (-1, 10.0), (0, 0.0), (0, math.nan)])
def test_refused_agents(tracker: int, sampling_hz: float) -> None:
    with pytest.raises(InputError, match="is refused"):
        TrackerAgent(tracker, Silent(), FakeVehicle(), FakeLink(), VirtualClock(), sampling_hz)


AGENT_ALONE = """
import sys
from collections import Counter
import swarmchase.live.link.mavlink, swarmchase.live.tracker.loop
import swarmchase.live.tracker.sources.address, swarmchase.live.tracker.vehicles.address
from swarmchase.live.tracker.agent import TrackerAgent
from swarmchase.live.clock import VirtualClock
from swarmchase.live.link.messages import SetPoint
from swarmchase.live.tracker.sources import CalibratedSource, JsonDatagramSource, KismetSource, SimulatedSource
from swarmchase.live.tracker.vehicles import AutopilotVehicle, SimulatedVehicle, UdpTransport

class Link:
    rejected = Counter()
    sent = 0
    def send(self, message): self.sent += 1
    def receive(self): return [SetPoint(0, clock.now_ns(), 1, (5.0, 0.0, 0.0))]
    def close(self): pass

clock, link = VirtualClock(), Link()
datagrams, kismet = JsonDatagramSource(0), KismetSource("http://127.0.0.1:9", "02:00:00:00:00:07", interval_s=0.01)
autopilot = AutopilotVehicle(UdpTransport(0))
vehicle = SimulatedVehicle((0.0, 0.0, 0.0))
source = CalibratedSource(SimulatedSource(lambda time_ns: -60.0, 100.0), 1.0)
agent = TrackerAgent(0, source, vehicle, link, clock, 100.0)
for _ in range(500):
    clock.advance(0.02)
    agent.step()
    datagrams.read(clock.now_ns())
    kismet.read(clock.now_ns())
    autopilot.update(clock.now_ns())
kismet.close()
heavy = [name for name in ("torch", "numpy", "scipy") if name in sys.modules]
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(link.sent, vehicle.position_m[0], heavy, int(status["VmHWM"].split()[0]) // 1024)
"""


def test_the_agent_is_small() -> None:
    """10 s of steps with everything that a tracker may need, in a process of its own.

    The most memory it ever held is read from /proc: getrusage would count what this process, its parent, holds.
    """
    if not Path("/proc/self/status").exists():
        pytest.skip("no /proc here to read the memory from")
    pytest.importorskip("pymavlink")
    ran = subprocess.run([sys.executable, "-c", AGENT_ALONE], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    sent, position_m, heavy, mebibytes = ran.stdout.split()
    assert (sent, position_m, heavy) == ("210", "5.0", "[]")
    assert int(mebibytes) < 80


# A source that fails


class BrokenSource:
    """Fails at its third read."""

    silence = "it has failed"

    def __init__(self, error: Exception) -> None:
        self.error, self.reads, self.closed = error, 0, False
        self.rejected = Rejected()

    def read(self, now_ns: int) -> list[Sample]:
        self.reads += 1
        if self.reads == 3:
            raise self.error
        return [(now_ns, -60.0)]

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize(
    ("error", "failure"),
    [
        (InputError("pcapng is refused"), "pcapng is refused"),
        (ZeroDivisionError("of course"), "ZeroDivisionError: of course"),
    ],
)
def test_when_its_source_fails_the_vehicle_stays_commandable(error: Exception, failure: str) -> None:
    """It goes on to report where it is and that it lives, its samples are missing, and it flies where it is told."""
    situation = Situation()
    source = BrokenSource(error)
    situation.agent = TrackerAgent(TRACKER, source, situation.fake, situation.link, situation.clock, sampling_hz=10.0)
    situation.go_on(0.1)
    assert situation.agent.source_failure is None
    situation.go_on(0.9)
    assert (situation.agent.source_failure, source.reads) == (failure, 3)
    assert situation.agent.ignored == {"source failed": 1}
    situation.link.sent.clear()
    situation.go_on(7.0)
    situation.hear(5.0)
    assert situation.places() == [5.0]
    # The change of mode is told besides.
    assert [len(situation.sent(kind)) for kind in (PositionReport, Heartbeat)] == [70, 8]
    last = situation.sent(RssiWindow)[-1]
    assert isinstance(last, RssiWindow)
    assert all(map(math.isnan, last.rssi_dbm))
    situation.agent.close()
    assert source.closed


def test_what_happened_to_the_source_is_told_once() -> None:
    situation = Situation()
    source = BrokenSource(InputError("link type 1 is refused: allowed is 127, radiotap"))
    link = TrackerMavlinkLink(TRACKER, "127.0.0.1", 1, unsigned=True)
    agent = TrackerAgent(TRACKER, source, situation.fake, link, situation.clock, sampling_hz=10.0)
    told: list[str] = []
    request = StopRequest()
    reads: list[int] = []
    step = agent.step

    def ten_steps() -> None:
        step()
        reads.append(source.reads)
        request.made = len(reads) == 10

    agent.step = ten_steps  # type: ignore[method-assign]
    summary = run_tracker(TRACKER, agent, source, situation.fake, link, request, told.append)
    assert reads == [1, 2, *[3] * 8]
    assert told == [
        "tracker 3 holds, at (1.00, 2.00, 3.00) m",
        "tracker 3 hears nothing, and flies on: link type 1 is refused: allowed is 127, radiotap",
    ]
    assert summary.ignored == {"source failed": 1}
    assert situation.fake.orders == ["hold", "close"]


def test_a_way_too_long_to_be_remembered_begins_later() -> None:
    way = WayBack()
    for step in range(MOST_PLACES + 1):
        way.note(step * 10, (step * STEP_M * 1.01, 0.0, 0.0))
    last_m = MOST_PLACES * STEP_M * 1.01
    assert way.back_at(MOST_PLACES * 10) == ((last_m, 0, 0), False)
    assert way.back_at(0) == ((last_m / 2, 0, 0), True)
