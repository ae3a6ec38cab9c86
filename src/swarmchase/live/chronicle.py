"""What is shown and kept of a chase while it runs: the snapshots become frames, for a page, a log or both."""

from collections import deque
from collections.abc import Callable, Sequence

from .events import Events
from .frame import Frame, TrackPoint, frame_of, track_point
from .link.mavlink import ControllerMavlinkLink
from .link.messages import Metres
from .service.chase_state import ENDED, Snapshot
from .ticker import next_moment_ns

FRAMES_HZ = 10.0
LONGEST_PATH = 500
"""Movements that a frame has the centres of: all of a chase in the paper, and the newest of an endless one."""
TRACK_S = 60.0
"""In flight a frame tells of so long."""

FrameTaker = Callable[[Frame], None]
"""Never blocks and never raises."""


class Chronicle:
    """Told every snapshot of a service, it gives out frames at ``FRAMES_HZ`` and whenever the state changes.

    Args:
        takers: are given every frame.
        events: has been told the same snapshots before.
        target_m: where the target is, if somebody knows: a simulation does.
    """

    def __init__(
        self,
        link: ControllerMavlinkLink,
        began_ns: int,
        takers: Sequence[FrameTaker],
        events: Events,
        target_m: Callable[[], Metres | None] = lambda: None,
    ) -> None:
        self._link, self._began_ns, self._takers = link, began_ns, takers
        self._events, self._target_m = events, target_m
        self._ended_ns: int | None = None
        self._path_m: deque[Metres] = deque(maxlen=LONGEST_PATH + 1)
        self._moved_ns: deque[int] = deque(maxlen=LONGEST_PATH + 1)
        """When they were there."""
        self._track: deque[TrackPoint] = deque()
        self._movements = -1
        self._shown_ns = began_ns
        self._shown: Snapshot | None = None
        self._latency_s: float | None = None

    def __call__(self, snapshot: Snapshot, decision_latency_s: float | None) -> None:
        """Take in the service as it is after a step, and how long its decision took where it made one."""
        self._latency_s = self._latency_s if decision_latency_s is None else decision_latency_s
        if snapshot.center_m is not None and snapshot.movements > self._movements:
            self._movements = snapshot.movements
            self._path_m.append(snapshot.center_m)
            self._moved_ns.append(snapshot.time_ns)
            self._note_flight(snapshot)
        self._note_end(snapshot)
        if not self._is_due(snapshot):
            return
        self._shown = snapshot
        frame = frame_of(
            snapshot,
            self._began_ns,
            self._path_m,
            self._link.loss_share(),
            self._link.rejected,
            self._latency_s,
            self._events,
            self._ended_ns,
            self._target_m(),
            self._track,
        )
        for take in self._takers:
            take(frame)

    def _note_flight(self, snapshot: Snapshot) -> None:
        """Of a target that flies what it did more than a minute ago tells nothing."""
        if snapshot.last_decision is None or snapshot.last_decision.time_s is None:
            return
        self._track.append(track_point(snapshot))
        oldest_ns = snapshot.time_ns - round(TRACK_S * 1e9)
        while self._track[0].time_ns < oldest_ns:
            self._track.popleft()
        while self._moved_ns[0] < oldest_ns:
            self._moved_ns.popleft()
            self._path_m.popleft()

    def _note_end(self, snapshot: Snapshot) -> None:
        has_ended = snapshot.state in ENDED
        if not has_ended:
            self._ended_ns = None
        elif self._ended_ns is None:
            self._ended_ns = snapshot.time_ns

    def _is_due(self, snapshot: Snapshot) -> bool:
        next_ns = next_moment_ns(self._shown_ns, round(1e9 / FRAMES_HZ), snapshot.time_ns)
        has_changed = self._shown is None or self._shown.state is not snapshot.state
        if not has_changed and next_ns > snapshot.time_ns:
            return False
        self._shown_ns = min(next_ns, snapshot.time_ns)
        return True
