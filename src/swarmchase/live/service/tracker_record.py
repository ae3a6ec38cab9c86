"""What the controller knows of one tracker: its samples, its positions, its mode, and how old each of them is."""

import bisect
import math

import numpy as np

from ...scenario import Scenario
from ..link.messages import (
    SPAN_MS,
    Health,
    Heartbeat,
    Notice,
    PositionReport,
    Report,
    RssiWindow,
    TrackerMode,
    VehicleState,
)
from .notices_heard import NoticesHeard
from .sample_window import KEPT_BEYOND_WINDOW_S, ClockOffset, Levels, Point, Points, SampleWindow, Times

SILENT_S = 1.0
"""A tracker without a valid sample for so long is silent: since the last one, or since it came."""
SILENT_SAMPLES = 3
"""Where sampling is slow, it is silent only after so many missing samples."""
LOST_S = 1.0
"""A tracker without a position for so long is lost."""
CAME_S = 2.0
"""Who has been in its place within so long has come to it, though it swings or its receiver of positions is noisy."""
LATEST_NS = 2**62
"""No clock is later than 146 years after its start; what is dated later is dropped."""
QUIET_S = 0.075
"""One that has said nothing for so long, a report and a half, is not waited for: what a gap in the link has swallowed
does not come."""
RATE_OVER_S = 2.0
"""The rate of its positions is that of so long."""
HEALTH_S = 10.0
"""What was said of a vehicle's health longer ago is not known any more."""
MOST_POSITIONS = 1000
"""No more than the newest of this many are kept, whatever a tracker sends."""


class TrackerRecord:
    """One tracker as its messages tell it. Times given and returned are of the controller's clock unless said."""

    def __init__(self, scenario: Scenario) -> None:
        self._kept_ns = round((2 * scenario.window_s + KEPT_BEYOND_WINDOW_S) * 1e9)
        self._silent_s = max(SILENT_S, SILENT_SAMPLES / scenario.sampling_hz)
        self._offset = ClockOffset()
        self._samples = SampleWindow(scenario)
        self.position_m: Point | None = None
        """Where it was last seen, in metres of the shared frame; a restart does not move it."""
        self.notices = NoticesHeard()
        self._health: Health | None = None
        self._health_ns = 0
        """When that came."""
        self.velocity_mps: Point = np.zeros(3)
        """How fast it was there."""
        self._forget()

    def _forget(self) -> None:
        self._offset.forget()
        self._samples.forget()
        self._came_ns: int | None = None
        """When its first message arrived, since its clock began; None before that."""
        self._newest_ns = 0
        """When the newest did."""
        # Sender times, rising, and the positions at them.
        self._position_ns: list[int] = []
        self._position_m: list[Point] = []
        self._obeyed_ms: int | None = None
        self._obeyed_told_ns = -1
        self._heartbeat_ns = -1
        self.mode: TrackerMode | None = None
        """Of the newest heartbeat; None before the first."""
        self.vehicle: VehicleState | None = None
        """Of the same."""

    def obeyed_ns(self, now_ns: int) -> int | None:
        """When the newest set-point that it is known to have obeyed was sent; None where it has not said so."""
        if self._obeyed_ms is None:
            return None
        return now_ns - (now_ns // 10**6 - self._obeyed_ms) % SPAN_MS * 10**6

    def hear(self, message: Report, now_ns: int) -> None:
        """Take in what has just arrived. A heartbeat that tells of a restart empties everything first."""
        if isinstance(message, Notice):
            self.notices.hear(message, now_ns)
            return
        if isinstance(message, Health):
            self._health, self._health_ns = message, now_ns
            return
        if message.time_ns > LATEST_NS:
            return
        if isinstance(message, Heartbeat) and self._offset.contradicts(message.time_ns, now_ns):
            self._forget()
        self._offset.heard(message.time_ns, now_ns)
        self._came_ns = now_ns if self._came_ns is None else self._came_ns
        self._newest_ns = now_ns
        if isinstance(message, RssiWindow):
            self._samples.add(message)
            self._take_obeyed(message)
        elif isinstance(message, PositionReport):
            self._add_position(message)
        elif message.time_ns > self._heartbeat_ns:
            self._heartbeat_ns, self.mode, self.vehicle = message.time_ns, message.mode, message.vehicle

    def _take_obeyed(self, message: RssiWindow) -> None:
        """Of the newest window; messages may overtake one another."""
        if message.obeyed_ms is not None and message.time_ns >= self._obeyed_told_ns:
            self._obeyed_ms, self._obeyed_told_ns = message.obeyed_ms, message.time_ns

    def _add_position(self, message: PositionReport) -> None:
        place = bisect.bisect_left(self._position_ns, message.time_ns)
        if self._position_ns[place : place + 1] == [message.time_ns]:
            return
        self._position_ns.insert(place, message.time_ns)
        self._position_m.insert(place, np.array(message.position_m, dtype=np.float64))
        if place == len(self._position_ns) - 1:
            self.velocity_mps = np.array(message.velocity_mps, dtype=np.float64)
        old = bisect.bisect_left(self._position_ns, self._position_ns[-1] - self._kept_ns)
        old = max(old, len(self._position_ns) - MOST_POSITIONS)
        del self._position_ns[:old], self._position_m[:old]
        self.position_m = self._position_m[-1]

    @property
    def position_hz(self) -> float | None:
        """How often it said where it was, of late; None of fewer than two positions."""
        if len(self._position_ns) < 2:
            return None
        newest_ns = self._position_ns[-1]
        times_ns = self._position_ns[bisect.bisect_left(self._position_ns, newest_ns - round(RATE_OVER_S * 1e9)) :]
        # Two of one moment do not make a rate.
        return (len(times_ns) - 1) / max((newest_ns - times_ns[0]) / 1e9, RATE_OVER_S / 4)

    def health(self, now_ns: int) -> Health | None:
        """What its autopilot has said of battery, satellites and heading of late."""
        return self._health if now_ns - self._health_ns <= HEALTH_S * 1e9 else None

    def position_age_s(self, now_ns: int) -> float:
        """Of its newest position; infinite without any."""
        return self._age_s(self._position_ns[-1] if self._position_ns else None, now_ns)

    def rssi_age_s(self, now_ns: int) -> float:
        """Of its newest valid sample; infinite without any."""
        return self._age_s(self._samples.newest_valid_ns, now_ns)

    def _age_s(self, sender_ns: int | None, now_ns: int) -> float:
        if sender_ns is None or self._offset.offset_ns is None:
            return math.inf
        return (now_ns - sender_ns - self._offset.offset_ns) / 1e9

    def is_lost(self, now_ns: int) -> bool:
        """Whether nobody knows where it is."""
        return self.position_age_s(now_ns) > LOST_S

    def is_heard(self, now_ns: int, patience_s: float = 0.0) -> bool:
        """Whether something valid of what it hears has arrived, not longer ago than makes it silent, and so much."""
        return self.rssi_age_s(now_ns) <= self._silent_s + patience_s

    def is_silent(self, now_ns: int) -> bool:
        """Whether it hears nothing, or nothing of what it hears arrives. One that has just come is not yet heard, and
        not silent either: its receiver may not have taken a sample. One that has never come is.
        """
        has_just_come = self._came_ns is not None and (now_ns - self._came_ns) / 1e9 <= self._silent_s
        may_begin = self._samples.newest_valid_ns is None and has_just_come
        return not self.is_heard(now_ns) and not may_begin

    def may_be_commanded(self, now_ns: int) -> bool:
        """Whether it is known where it is and that no one else flies it."""
        return self.mode not in {None, TrackerMode.MANUAL} and not self.is_lost(now_ns)

    def arrived_ns(self, at_m: Point, tolerance_m: float, told_ns: int) -> int | None:
        """Since when it has been reporting to be there without a break, after it was told to; None if it is elsewhere
        or has not reported since.
        """
        since_ns = None
        if self._offset.offset_ns is not None:
            for time_ns, position_m in zip(reversed(self._position_ns), reversed(self._position_m), strict=True):
                arrived_ns = time_ns + self._offset.offset_ns
                if arrived_ns <= told_ns or np.linalg.norm(position_m - at_m) > tolerance_m:
                    break
                since_ns = arrived_ns
        return since_ns

    def came_to(self, at_m: Point, tolerance_m: float) -> bool:
        """Whether it has reported to be there at any moment of the last ``CAME_S``."""
        if not self._position_ns:
            return False
        recent = bisect.bisect_left(self._position_ns, self._position_ns[-1] - round(CAME_S * 1e9))
        return bool((np.linalg.norm(np.array(self._position_m[recent:]) - at_m, axis=1) <= tolerance_m).any())

    def first_valid_ns(self, since_ns: int) -> int | None:
        """When the first valid sample from this moment on was taken; None before there is one."""
        if self._offset.offset_ns is None:
            return None
        own_ns = self._samples.first_valid_ns(since_ns - self._offset.offset_ns)
        return None if own_ns is None else own_ns + self._offset.offset_ns

    def has_window(self, since_ns: int) -> bool:
        """Whether all samples of the window that begins at this moment were taken."""
        return self._offset.offset_ns is not None and self._samples.is_complete(since_ns - self._offset.offset_ns)

    def awaits_flown_window(self, since_ns: int, now_ns: int) -> bool:
        """Whether more of the window that begins at this moment is still to be expected: a sample, or where it was at
        the last of them.
        """
        if now_ns - self._newest_ns > QUIET_S * 1e9:
            return False
        if not self.has_window(since_ns) or self._offset.offset_ns is None:
            return True
        _, time_ns = self._samples.window(since_ns - self._offset.offset_ns)
        return not self._position_ns or self._position_ns[-1] < int(time_ns[-1])

    @property
    def newest_sample_ns(self) -> int | None:
        """When its newest valid sample was taken; None before the first."""
        newest_ns, offset_ns = self._samples.newest_valid_ns, self._offset.offset_ns
        return None if newest_ns is None or offset_ns is None else newest_ns + offset_ns

    def window(self, since_ns: int) -> tuple[Levels, Points]:
        """The first samples since this moment: levels in dBm [sample], NaN where none has come, and where each was
        taken [sample, 3] in metres of the shared frame.

        Raises:
            ValueError: it has never said where it is.
        """
        if not self._position_ns or self._offset.offset_ns is None:
            raise ValueError("a tracker without a position has no window")
        rssi_dbm, time_ns = self._samples.window(since_ns - self._offset.offset_ns)
        # Relative to the newest: nanoseconds since boot are too many for a float64.
        return rssi_dbm, self._places_m((time_ns - self._position_ns[-1]) / 1e9)

    def flown_window(self, since_ns: int) -> tuple[Levels, Points, Times]:
        """The same of a tracker that flies, and when each sample was taken [sample]. After its newest position it has
        flown on as fast as it was there.

        Raises:
            ValueError: it has never said where it is.
        """
        if not self._position_ns or self._offset.offset_ns is None:
            raise ValueError("a tracker without a position has no window")
        rssi_dbm, time_ns = self._samples.window(since_ns - self._offset.offset_ns)
        at_s = (time_ns - self._position_ns[-1]) / 1e9
        flown_on_m = np.clip(at_s, 0.0, LOST_S)[:, None] * self.velocity_mps
        return rssi_dbm, self._places_m(at_s) + flown_on_m, time_ns + self._offset.offset_ns

    def _places_m(self, at_s: Levels) -> Points:
        """Where it was, so long after its newest position [moment, 3]; after that one nowhere else."""
        known_s = (np.array(self._position_ns) - self._position_ns[-1]) / 1e9
        known_m = np.array(self._position_m)
        return np.stack([np.interp(at_s, known_s, known_m[:, axis]) for axis in range(3)], axis=1)

    @property
    def dropped(self) -> dict[str, int]:
        """Samples that were reported and are no levels, by reason."""
        return {str(reason): count for reason, count in sorted(self._samples.dropped.items())}

    def last_window(self) -> Levels:
        """Its newest samples, oldest first, in dBm."""
        return self._samples.last_window()
