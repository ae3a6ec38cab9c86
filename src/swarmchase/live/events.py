"""What has happened in a chase, moment by moment: the lines that terminal, page and log have of it."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .alarms import Alarm, Severity, TrackerCondition, condition_in_words, condition_of, severity_of
from .service.chase_state import ChaseState, Decision, Snapshot, TrackerLine, Transition

MOST_SHOWN = 100
"""So many of the newest events a page has, besides routine."""


@dataclass(frozen=True)
class Event:
    """One moment."""

    time_ns: int
    """By the service's clock."""
    severity: Severity
    text: str


EventTaker = Callable[[Event], None]


class Events:
    """Told every transition and every snapshot of a service, it tells what has happened.

    Args:
        alarms: decides what is wrong, as ``Alarms`` does: that it begins, changes or ends is an event.
        takers: are told every event.
        lines: what else has happened since it was last asked.
    """

    def __init__(
        self,
        alarms: Callable[[Snapshot], list[Alarm]],
        takers: Sequence[EventTaker] = (),
        lines: Callable[[], Sequence[str]] = lambda: (),
    ) -> None:
        self.alarms: list[Alarm] = []
        """What is wrong now."""
        self.newest: deque[Event] = deque(maxlen=MOST_SHOWN)
        """The newest of those that are not routine, oldest first."""
        self._find, self._takers, self._lines = alarms, takers, lines
        self._told: dict[str, Alarm] = {}
        """By cause."""
        self._conditions: dict[int, TrackerCondition] = {}
        self._notices: dict[int, Sequence[TrackerLine]] = {}

    def record(self, entry: Transition | Decision) -> None:
        """Take in what the service records."""
        if isinstance(entry, Transition):
            self._tell(entry.time_ns, _severity(entry), f"{entry.before.value} -> {entry.after.value}: {entry.reason}")

    def __call__(self, snapshot: Snapshot, decision_latency_s: float | None = None) -> None:
        """Take in the service as it is after a step."""
        self.alarms = self._find(snapshot)
        self._tell_trackers(snapshot)
        self._tell_alarms(snapshot.time_ns)
        for line in self._lines():
            self._tell(snapshot.time_ns, Severity.WARNING, line)

    def _tell_trackers(self, snapshot: Snapshot) -> None:
        """Who comes, or is well again, and what they say."""
        for number, tracker in enumerate(snapshot.trackers):
            condition = condition_of(tracker)
            before = self._conditions.get(number, TrackerCondition.EXPECTED)
            if condition is TrackerCondition.THERE and before is not condition:
                self._tell(snapshot.time_ns, Severity.INFO, condition_in_words(number, tracker))
            self._conditions[number] = condition
            for notice in tracker.notices:
                if notice not in self._notices.get(number, ()):
                    self._tell(snapshot.time_ns, severity_of(notice), f"tracker {number}: {notice.text}")
            self._notices[number] = tracker.notices

    def _tell_alarms(self, time_ns: int) -> None:
        now = {alarm.cause: alarm for alarm in self.alarms}
        for cause, alarm in now.items():
            if alarm.is_news and (cause not in self._told or _news(self._told[cause]) != _news(alarm)):
                self._tell(time_ns, alarm.severity, _news(alarm))
        for cause in self._told.keys() - now.keys():
            if self._told[cause].over:
                self._tell(time_ns, Severity.INFO, self._told[cause].over)
        self._told = now

    def _tell(self, time_ns: int, severity: Severity, text: str) -> None:
        event = Event(time_ns, severity, text)
        if severity is not Severity.ROUTINE:
            self.newest.append(event)
        for take in self._takers:
            take(event)


def _news(alarm: Alarm) -> str:
    return alarm.news or alarm.text


def _severity(transition: Transition) -> Severity:
    if transition.after in {ChaseState.REACHED, ChaseState.FOLLOWING}:
        return Severity.SUCCESS
    if transition.after in {ChaseState.LOST, ChaseState.ABORTED, ChaseState.SEARCHING}:
        return Severity.WARNING
    if transition.after is ChaseState.HOLDING and not transition.reason.startswith("the operator"):
        return Severity.CRITICAL
    flies = {transition.before, transition.after} == {ChaseState.SAMPLING, ChaseState.MOVING}
    if not flies:
        return Severity.INFO
    # What the safety filter makes of a movement is an alarm of its own.
    is_late = transition.after is ChaseState.SAMPLING and transition.reason != "arrived"
    return Severity.WARNING if is_late else Severity.ROUTINE
