"""What is wrong with a chase, for as long as it lasts. Here it is decided for terminal, page and log alike, from every
snapshot of the service; ``events`` tells when it begins and ends.

A tracker that has not come yet is no alarm: before it is flown with, everybody waits for it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

from ..controllers.condition import Condition
from ..scenario import NUM_TRACKERS
from .link import messages as link_messages
from .link.mavlink import ControllerMavlinkLink
from .link.messages import TrackerMode
from .rates import SPAN_S, Rates, in_words
from .service.chase_state import (
    LED,
    NOT_ONE_TRANSMITTER,
    UNDER_WAY,
    ChaseState,
    Snapshot,
    TrackerLine,
    TrackerSnapshot,
)
from .service.preflight import in_words as preflight_in_words
from .service.second_look import LOOK_S, RADIUS_M
from .standing import Standing

READY_S = 2.0
"""So long trackers that have just come may take until the preflight passes."""


class Severity(StrEnum):
    """How much something matters, from the least on."""

    ROUTINE = "routine"
    """A step of every chase."""
    INFO = "info"
    SUCCESS = "success"
    WARNING = "warning"
    """The chase goes on, worse than it could."""
    CRITICAL = "critical"
    """It does not, or nobody knows where a vehicle is."""


@dataclass(frozen=True)
class Alarm:
    """One thing that is wrong now."""

    cause: str
    """What it is about: there is one alarm of a cause at a time."""
    text: str
    severity: Severity = Severity.WARNING
    tracker: int | None = None
    news: str = ""
    """What of it is worth telling again once it changes; empty: the text."""
    over: str = ""
    """What is told when there is none of this cause any more; empty: nothing."""
    is_news: bool = True
    """Whether its beginning is an event; a transition tells of it otherwise."""


class TrackerCondition(StrEnum):
    """How a tracker is, in a word; the worst of what holds."""

    EXPECTED = "expected"
    """It has never said where it is."""
    LOST = "lost"
    MANUAL = "manual"
    LEFT_OUT = "left out"
    SILENT = "silent"
    THERE = "there"


_IN_WORDS = {
    TrackerCondition.EXPECTED: "has not come",
    TrackerCondition.LOST: "is lost",
    TrackerCondition.MANUAL: "is flown by somebody else, or cannot be commanded",
    TrackerCondition.LEFT_OUT: "is left out",
    TrackerCondition.SILENT: "is silent",
    TrackerCondition.THERE: "is there",
}
WITH_SIX = LED | {ChaseState.HOLDING}
"""In these states a tracker that has not come is missed."""


def severity_of(notice: TrackerLine) -> Severity:
    """What a tracker's line is to the operator of all."""
    if notice.severity <= link_messages.Severity.ERROR:
        return Severity.CRITICAL
    return Severity.WARNING if notice.severity == link_messages.Severity.WARNING else Severity.INFO


def condition_of(tracker: TrackerSnapshot) -> TrackerCondition:
    """How this tracker is."""
    if tracker.position_m is None:
        return TrackerCondition.EXPECTED
    if tracker.is_lost:
        return TrackerCondition.LOST
    if tracker.mode is TrackerMode.MANUAL:
        return TrackerCondition.MANUAL
    if tracker.left_out:
        return TrackerCondition.LEFT_OUT
    return TrackerCondition.SILENT if tracker.is_silent else TrackerCondition.THERE


def condition_in_words(number: int, tracker: TrackerSnapshot) -> str:
    """``tracker 3 is silent``."""
    condition = condition_of(tracker)
    because = f": {tracker.left_out}" if condition is TrackerCondition.LEFT_OUT else ""
    return f"tracker {number} {_IN_WORDS[condition]}{because}"


class Alarms:
    """Told every snapshot of a service, it says what is wrong.

    Args:
        link: What it rejects is an alarm, too.
        more: What else is wrong, asked for each time: a log that cannot be written.
    """

    def __init__(self, link: ControllerMavlinkLink, more: Callable[[], Sequence[Alarm]] = lambda: ()) -> None:
        self._link, self._more = link, more
        self._rejected = Rates()
        self._unready_since_ns: int | None = None
        """Since when the preflight has been holding up the start."""
        self._dropped = [Rates() for _ in range(NUM_TRACKERS)]
        self._standing = Standing()
        self._stands_because = ""
        """What was said of it when the swarm began to stand."""

    def __call__(self, snapshot: Snapshot) -> list[Alarm]:
        """All that is wrong at this moment, the worst first."""
        found = [
            *_of_state(snapshot),
            *(alarm for number, one in enumerate(snapshot.trackers) for alarm in _of_tracker(number, one, snapshot)),
            *_of_controller(snapshot),
            *_of_transmitters(snapshot),
            *_of_receivers(snapshot),
            *_of_safety_filter(snapshot),
            *self._of_standing(snapshot),
            *self._of_preflight(snapshot),
            *self._of_rejections(snapshot.time_ns),
            *self._of_samples(snapshot),
            *self._of_records(snapshot),
        ]
        return sorted(found, key=lambda alarm: alarm.severity is not Severity.CRITICAL)

    def _of_preflight(self, snapshot: Snapshot) -> Iterator[Alarm]:
        """Once the operator has started; before that it is a list to be gone through."""
        failed = [one for one in snapshot.preflight if one.passed is False]
        if not failed or snapshot.state is not ChaseState.CONNECTING:
            self._unready_since_ns = None
            return
        if self._unready_since_ns is None:
            self._unready_since_ns = snapshot.time_ns
        if snapshot.time_ns - self._unready_since_ns >= READY_S * 1e9:
            text = f"the preflight has not passed: {preflight_in_words(failed)}"
            yield Alarm("preflight", f"{text}; the word override begins all the same", news=text)

    def _of_standing(self, snapshot: Snapshot) -> Iterator[Alarm]:
        self._standing.take(snapshot)
        seconds, decision = self._standing.swarm_s, snapshot.last_decision
        because = f": {decision.changed}" if decision is not None and decision.changed else ""
        self._stands_because = "" if seconds is None else self._stands_because or because
        if seconds is not None:
            yield Alarm(
                "standing",
                f"the swarm has not moved for {seconds:.0f} s, and is to fly on{because}",
                Severity.CRITICAL,
                news=f"the swarm does not move, and is to fly on{self._stands_because}",
                over="the swarm is kept in one place no more",
            )
        for number, tracker_s in enumerate(self._standing.tracker_s):
            if tracker_s is not None:
                yield Alarm(
                    f"standing of {number}",
                    f"tracker {number} has not moved for {tracker_s:.0f} s, and is told to be elsewhere",
                    tracker=number,
                    news=f"tracker {number} does not move, and is told to be elsewhere",
                    over=f"tracker {number} stands no more where it is not to be",
                )

    def _of_rejections(self, time_ns: int) -> Iterator[Alarm]:
        """How many a second; ``LinkNews`` tells whose they are and why."""
        self._rejected.take(self._link.rejected, time_ns)
        if per_second := self._rejected.per_second:
            over = f"no datagram has been rejected for {SPAN_S:g} s"
            yield Alarm("rejected", f"datagrams are rejected: {in_words(per_second)}", over=over, is_news=False)

    def _of_samples(self, snapshot: Snapshot) -> Iterator[Alarm]:
        for number, (tracker, rates) in enumerate(zip(snapshot.trackers, self._dropped, strict=True)):
            rates.take(tracker.dropped, snapshot.time_ns)
            if rates.per_second:
                yield Alarm(
                    f"samples of {number}",
                    f"samples of tracker {number} are dropped: {in_words(rates.per_second)}",
                    tracker=number,
                    news=f"samples of tracker {number} are dropped: {', '.join(rates.per_second)}",
                    over=f"no sample of tracker {number} has been dropped for {SPAN_S:g} s",
                )

    def _of_records(self, snapshot: Snapshot) -> Iterator[Alarm]:
        yield from self._more()
        if number := snapshot.recorder_failures:
            # Of a recorder that raises: one that only fails to write tells of it by itself.
            yield Alarm("recorder", f"{number} entries could not be recorded", news="entries could not be recorded")
        if self._link.state_errors:
            yield Alarm(
                "timestamps",
                "the link's timestamps cannot be written: after a restart, recorded packets could be accepted",
                is_news=False,
            )


def _of_state(snapshot: Snapshot) -> Iterator[Alarm]:
    if snapshot.state is ChaseState.SEARCHING:
        yield Alarm("target", snapshot.reason, is_news=False)
    if snapshot.state is ChaseState.HOLDING and not snapshot.reason.startswith("the operator"):
        yield Alarm("holding", f"all hold: {snapshot.reason}", Severity.CRITICAL, is_news=False)


def _of_tracker(number: int, tracker: TrackerSnapshot, snapshot: Snapshot) -> Iterator[Alarm]:
    condition = condition_of(tracker)
    is_missed = condition is not TrackerCondition.EXPECTED or snapshot.state in WITH_SIX
    if condition is not TrackerCondition.THERE and is_missed:
        severity = Severity.CRITICAL if condition is TrackerCondition.LOST else Severity.WARNING
        yield Alarm(f"tracker {number}", condition_in_words(number, tracker), severity, number)


def _of_controller(snapshot: Snapshot) -> Iterator[Alarm]:
    if snapshot.state not in UNDER_WAY:
        return
    if snapshot.condition is Condition.LOST:
        text = "the controller has begun anew: what was heard contradicted its estimate"
        yield Alarm("controller", text, over="the controller has an estimate again")
    elif snapshot.condition is Condition.DEAF:
        text = "the controller has heard nothing in the last window"
        yield Alarm("controller", text, over="the controller hears the target again")


def _of_transmitters(snapshot: Snapshot) -> Iterator[Alarm]:
    if snapshot.hears_two and snapshot.state in UNDER_WAY:
        text = f"{NOT_ONE_TRANSMITTER}: it fades as two do whose powers add up, and the service calls neither reached"
        yield Alarm("transmitters", f"{text}; the word reached does", news=text)
    if snapshot.looks_again and snapshot.state in UNDER_WAY:
        text = (
            f"the swarm flies around the target, {RADIUS_M:g} m away, to hear whether two transmit: up to {LOOK_S:g} s"
        )
        yield Alarm("second look", text, over="the swarm flies around the target no more")


def _of_receivers(snapshot: Snapshot) -> Iterator[Alarm]:
    """Who counts for nothing with the controller, though it reports; a silent one is told of otherwise."""
    found = None if snapshot.explanation is None else snapshot.explanation.found
    if found is None or snapshot.state not in UNDER_WAY:
        return
    for number, reason in enumerate(found.left_out):
        if reason not in (None, "silent"):
            yield Alarm(
                f"receiver of {number}",
                f"the controller leaves out what tracker {number} hears: its receiver is {reason}",
                tracker=number,
                over=f"the controller counts what tracker {number} hears again",
            )


def _of_safety_filter(snapshot: Snapshot) -> Iterator[Alarm]:
    decision = snapshot.last_decision
    if snapshot.state in UNDER_WAY and decision is not None and decision.movement and decision.changed:
        yield Alarm(
            "safety filter",
            f"the safety filter changed movement {decision.movement}: {decision.changed}",
            news="the safety filter changes what the controller wants",
            over="the safety filter changes nothing any more",
        )
