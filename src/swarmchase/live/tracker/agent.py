"""The tracker agent: beside a tracker's receiver and autopilot, it reports what they say and does what the controller
says, for as long as the controller says it.

    agent = TrackerAgent(tracker, source, vehicle, link, clock, sampling_hz)
    while running:
        agent.step()

It needs neither torch nor numpy: it runs on the smallest computer that flies.
"""

import math
from collections import Counter
from dataclasses import dataclass

from ...errors import InputError
from ...ranges import POSITIVE, ranged, require_ranges
from ..clock import Clock
from ..link.messages import (
    SPAN_MS,
    Heartbeat,
    Message,
    Metres,
    PositionReport,
    RssiWindow,
    SetPoint,
    Severity,
    TrackerMode,
)
from ..link.protocol import Link
from .notices import Notices
from .sources.complaint import Complaint
from .sources.protocol import RssiSource, Sample
from .sources.sample_buffer import SampleBuffer
from .sources.sender_clock import SenderClock
from .vehicles.protocol import LedVehicle, Vehicle
from .way_back import WayBack

CHANGE_TOLD_S, CHANGE_TOLD_HZ = 1.0, 20.0
"""A change of mode is told at once, and for so long so often: datagrams get lost."""
HEALTH_HZ = 0.5
BRAKED_S = 5.0
"""So long after it was told to hold every vehicle stands."""
LONGEST_PAUSE_S = 0.5
"""On the way back: a process that stood still for longer goes on where it was."""


@dataclass(frozen=True)
class AgentSettings:
    """How often the agent reports, and how long it waits for the controller.

    Raises:
        InputError: a rate or time that cannot be.
    """

    window_hz: float = ranged(10.0, POSITIVE)
    """RSSI messages a second; each holds up to 50 samples, so that any one that arrives restores them all."""
    position_hz: float = ranged(10.0, POSITIVE)
    heartbeat_hz: float = ranged(1.0, POSITIVE)
    hold_after_s: float = ranged(1.0, POSITIVE)
    """After the sending of the last set-point the vehicle holds (PX4's COM_OF_LOSS_T)."""
    return_after_s: float = 60.0
    """After it, the vehicle returns the way it came to where it was when it first followed; 0: it never does."""

    def __post_init__(self) -> None:
        require_ranges(self)
        if not (self.return_after_s == 0 or self.hold_after_s <= self.return_after_s < math.inf):
            allowed = f"0 or at least hold_after_s = {self.hold_after_s:g}"
            raise InputError(f"return_after_s = {self.return_after_s} is refused: allowed is {allowed}")


class SetPointRule:
    """Which set-points a tracker obeys: the controller of the newest epoch heard of holds the lease, and of its
    set-points only those sent after the last one obeyed count, if they have not been under way for too long.

    So what is repeated, reordered, replayed or delivered after an outage moves nothing.
    """

    def __init__(self, tracker: int, oldest_s: float) -> None:
        self._tracker = tracker
        self._oldest_s = oldest_s
        self._epoch = -1
        self._newest_ns = -1
        self._controller_clock = SenderClock()

    def refusal(self, set_point: SetPoint, now_ns: int) -> str | None:
        """Why it is not to be obeyed; None where it is, and then only later ones will be."""
        if set_point.tracker != self._tracker:
            return "for another tracker"
        if set_point.epoch < self._epoch:
            return "older epoch"
        if set_point.epoch > self._epoch:
            self._epoch, self._newest_ns, self._controller_clock = set_point.epoch, -1, SenderClock()
        if set_point.time_ns <= self._newest_ns:
            return "not newer than the last"
        if now_ns - self.sent_ns(set_point, now_ns) >= self._oldest_s * 1e9:
            return "too long under way"
        self._newest_ns = set_point.time_ns
        return None

    def sent_ns(self, set_point: SetPoint, now_ns: int) -> int:
        """When it was sent, on our clock."""
        return self._controller_clock.local_ns(set_point.time_ns, now_ns)


class TrackerAgent:
    """One tracker. ``ignored`` counts, by reason, what it heard and did not obey and what it could not report.

    While the vehicle is MANUAL nothing is obeyed, and what came before is forgotten: given back, the vehicle stays
    where it is until the next set-point.

    Raises:
        InputError: a tracker or a sampling rate that cannot be.
    """

    def __init__(
        self,
        tracker: int,
        source: RssiSource,
        vehicle: Vehicle,
        link: Link,
        clock: Clock,
        sampling_hz: float,
        settings: AgentSettings | None = None,
    ) -> None:
        SetPoint(tracker, 0, 0, (0.0, 0.0, 0.0))  # refuses what is no tracker
        self.ignored: Counter[str] = Counter()
        self.levels = 0
        """So many it has taken up."""
        self.source_failure: str | None = None
        """Why the receiver is not asked any more."""
        self._tracker = tracker
        self._source = source
        self._vehicle = vehicle
        self._link = link
        self._clock = clock
        self._sampling_hz = sampling_hz
        self._settings = settings or AgentSettings()
        self._samples = SampleBuffer(sampling_hz)
        self._notices = Notices(tracker)
        self._complaint = Complaint(source)
        self._complains = False
        self._rule = SetPointRule(tracker, self._settings.hold_after_s)
        self._sent_ns: int | None = None
        self._set_point: SetPoint | None = None
        """The newest that is obeyed, where it leads along a way."""
        self._obeyed_ms: int | None = None
        """When that was sent, by the controller's clock."""
        self._obeying = False
        self._way_back = WayBack()
        self._back_ns: int | None = None
        """While it returns: the moment of its way at which it is again."""
        self._back_step_ns = 0
        """When it came to be there."""
        self._back_m: Metres | None = None
        self._told_mode: TrackerMode | None = None
        self._changed_ns: int | None = None
        self._due_ns: dict[str, int] = {}

    def step(self) -> None:
        """Do what is due now; never blocks. To be called ten times a second or more often."""
        now_ns = self._clock.now_ns()
        heard = [self._samples.add(sample, now_ns) for sample in self._sampled(now_ns)]
        self.levels += sum(heard)
        self._complaint.listened(any(heard), self.dropped, now_ns)
        for message in self._link.receive():
            self._hear(message, now_ns)
        self._miss_the_controller(now_ns)
        self._go_on(now_ns)
        self._vehicle.update(now_ns)
        self._report(now_ns)

    @property
    def dropped(self) -> Counter[str]:
        """Samples that were no levels, or too old or too new, by reason."""
        return self._samples.dropped

    @property
    def source_complaint(self) -> str | None:
        """What came of the receiver instead of levels, for people; None where levels come."""
        return self.source_failure or self._complaint.text(self.dropped, self._clock.now_ns())

    def close(self) -> None:
        """Hold, and give back what the source, the vehicle and the link hold."""
        self._vehicle.hold()
        self._vehicle.update(self._clock.now_ns())
        self._source.close()
        self._vehicle.close()
        self._link.close()

    def _sampled(self, now_ns: int) -> list[Sample]:
        """What the receiver has heard. A source that fails is asked no more; the vehicle is flown on: to the controller
        it is a silent tracker, which goes where it is told with the others.
        """
        if self.source_failure is not None:
            return []
        try:
            return self._source.read(now_ns)
        except Exception as error:
            self.source_failure = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
            self.ignored["source failed"] += 1
            return []

    def _hear(self, message: Message, now_ns: int) -> None:
        if not isinstance(message, SetPoint):
            self.ignored["no set-point"] += 1
            return
        refusal = self._rule.refusal(message, now_ns)
        if refusal is None and self._vehicle.mode == TrackerMode.MANUAL:
            refusal = "manual"
        if refusal is not None:
            self.ignored[refusal] += 1
            return
        if not self._way_back.has_begun and self._vehicle.position_m is not None:
            self._way_back.note(now_ns, self._vehicle.position_m)
        self._sent_ns, self._obeying, self._back_ns = self._rule.sent_ns(message, now_ns), True, None
        self._obeyed_ms = message.time_ns // 10**6 % SPAN_MS
        self._set_point = None if message.feed_forward is None else message
        if self._set_point is None:
            self._vehicle.go_to(message.position_m)

    def _go_on(self, now_ns: int) -> None:
        """Along the way it is led, also while nothing is heard for as long as that was said to be well."""
        if not self._obeying or self._sent_ns is None or self._set_point is None:
            return
        rest_m, feed_forward = self._set_point.rest_m((now_ns - self._sent_ns) / 1e9), self._set_point.feed_forward
        if feed_forward is not None and isinstance(self._vehicle, LedVehicle):
            self._vehicle.lead(rest_m, feed_forward.braking_mps2)
        else:
            self._vehicle.go_to(rest_m)

    def _is_sent_on(self, silent_s: float) -> bool:
        """Whether the controller has said that it may go on for longer than this without news."""
        return self._set_point is not None and self._set_point.moves_on(silent_s)

    def _miss_the_controller(self, now_ns: int) -> None:
        """Hold, and later return, when it has fallen silent."""
        if self._vehicle.mode == TrackerMode.MANUAL:
            self._sent_ns, self._obeying, self._back_ns = None, False, None
        if self._back_ns is not None:
            self._go_back(self._back_ns, now_ns)
        elif self._way_back.has_begun and self._vehicle.position_m is not None:
            self._way_back.note(now_ns, self._vehicle.position_m)
        if self._sent_ns is None:
            return
        silent_s = (now_ns - self._sent_ns) / 1e9
        if self._obeying and silent_s >= self._settings.hold_after_s and not self._is_sent_on(silent_s):
            self._obeying = False
            self._vehicle.hold()
        if 0 < self._settings.return_after_s <= silent_s and self._way_back.has_begun:
            # All that lost it together begin at the same moment, and with the same moment of their ways.
            stood_s = min(self._settings.return_after_s, self._settings.hold_after_s + BRAKED_S)
            self._back_ns = self._sent_ns + round(stood_s * 1e9)
            self._back_step_ns = self._sent_ns + round(self._settings.return_after_s * 1e9)
            self._sent_ns = self._back_m = None

    def _go_back(self, back_ns: int, now_ns: int) -> None:
        """Fly to where it was as long before this moment as has passed; after a pause it does not make up for it."""
        self._back_ns = back_ns - min(now_ns - self._back_step_ns, round(LONGEST_PAUSE_S * 1e9))
        self._back_step_ns = now_ns
        back_m, is_home = self._way_back.back_at(self._back_ns)
        if back_m != self._back_m:
            self._back_m = back_m
            self._vehicle.go_to(back_m)
        if is_home:
            self._back_ns = None

    def _report(self, now_ns: int) -> None:
        if self._is_due("window", self._settings.window_hz, now_ns):
            window = self._samples.window(now_ns)
            if window is not None:
                time_ns, rssi_dbm = window
                self._link.send(RssiWindow(self._tracker, time_ns, self._sampling_hz, rssi_dbm, self._obeyed_ms))
        position_m = self._vehicle.position_m
        if position_m is not None and self._is_due("position", self._settings.position_hz, now_ns):
            try:
                taken_ns = max(now_ns - round(self._vehicle.position_age_s * 1e9), 0)
                self._link.send(PositionReport(self._tracker, taken_ns, position_m, self._vehicle.velocity_mps))
            except InputError:
                self.ignored["impossible position"] += 1
        self._report_notices(now_ns)
        mode = self._mode()
        if mode is not self._told_mode:
            self._changed_ns = None if self._told_mode is None else now_ns
            self._told_mode = mode
            self._due_ns.pop("heartbeat", None)
        if self._is_due("heartbeat", self._heartbeat_hz(now_ns), now_ns):
            self._link.send(Heartbeat(self._tracker, now_ns, mode, self._vehicle.state))
        health = self._vehicle.health(self._tracker)
        if health is not None and self._is_due("health", HEALTH_HZ, now_ns):
            self._link.send(health)

    def _heartbeat_hz(self, now_ns: int) -> float:
        has_changed = self._changed_ns is not None and now_ns - self._changed_ns < CHANGE_TOLD_S * 1e9
        return max(CHANGE_TOLD_HZ, self._settings.heartbeat_hz) if has_changed else self._settings.heartbeat_hz

    def _report_notices(self, now_ns: int) -> None:
        complaint = self.source_complaint
        if (complaint is None) is self._complains:
            self._complains = complaint is not None
            said = (
                (Severity.INFO, "hears again")
                if complaint is None
                else (Severity.WARNING, f"hears nothing: {complaint}")
            )
            self._notices.put(*said)
        for severity, text in self._vehicle.said():
            self._notices.put(severity, text)
        notice = self._notices.due(now_ns)
        if notice is not None:
            self._link.send(notice)

    def _mode(self) -> TrackerMode:
        """A vehicle that returns by itself follows nobody."""
        mode = self._vehicle.mode
        return TrackerMode.HOLDING if mode == TrackerMode.FOLLOWING and not self._obeying else mode

    def _is_due(self, what: str, rate_hz: float, now_ns: int) -> bool:
        """After a pause once, not as often as was missed."""
        period_ns = round(1e9 / rate_hz)
        due_ns = self._due_ns.get(what, now_ns)
        if now_ns < due_ns:
            return False
        self._due_ns[what] = due_ns + period_ns if due_ns + period_ns > now_ns else now_ns + period_ns
        return True
