"""Who stands still though it is to fly: the swarm where limits or vehicles that are in each other's way keep all where
they are, and a tracker that does not go where it is told.
"""

import numpy as np

from ..scenario import NUM_TRACKERS
from .link.messages import Metres
from .service.chase_state import LED, ChaseState, Snapshot, TrackerSnapshot
from .service.sample_window import Point

STANDS_S = 10.0
"""Who stands for so long is told of: twice as long as any wait of the service in flight."""
MOVED_M = 1.0
"""Who is further from where it stood has moved."""
ASKED_M = 5.0
"""So far decisions must have led the centre before it counts: who hovers beside its target is asked for steps that
cancel out.
"""
OFF_M = 1.5
"""A tracker must be told to be further from where it is; vehicles arrive within 1 m."""


class _Still:
    """Where something is, and since when."""

    def __init__(self) -> None:
        self._at_m: Point | None = None
        self._since_ns = 0

    def take(self, place_m: Metres | None, time_ns: int) -> bool:
        """Where it is now, or None where it may stand; returns whether it stays where it was."""
        at_m = None if place_m is None else np.array(place_m)
        if at_m is not None and self._at_m is not None and np.linalg.norm(at_m - self._at_m) <= MOVED_M:
            return True
        self._at_m, self._since_ns = at_m, time_ns
        return False

    def seconds(self, time_ns: int) -> float:
        """For so long it has been there."""
        return 0.0 if self._at_m is None else (time_ns - self._since_ns) / 1e9


class Standing:
    """Told every snapshot of a service."""

    def __init__(self) -> None:
        self._center, self._trackers = _Still(), [_Still() for _ in range(NUM_TRACKERS)]
        self._asked_m, self._newest_m = np.zeros(3), np.zeros(3)
        """What was asked for since the swarm is here, without and by the newest decision."""
        self._movements = 0
        self._asked_ns: int | None = None
        """Since when it is more than ``ASKED_M``."""
        self.swarm_s: float | None = None
        """For so long the swarm has stood, since ``STANDS_S``; None where it has not."""
        self.tracker_s: list[float | None] = [None] * NUM_TRACKERS
        """The same of each tracker."""

    def take(self, snapshot: Snapshot) -> None:
        """The service as it is now."""
        self._take_center(snapshot)
        for number, (still, tracker) in enumerate(zip(self._trackers, snapshot.trackers, strict=True)):
            still.take(tracker.position_m if _is_led(snapshot, tracker) else None, snapshot.time_ns)
            self.tracker_s[number] = _long(still.seconds(snapshot.time_ns))

    def _take_center(self, snapshot: Snapshot) -> None:
        if not self._center.take(snapshot.center_m if _is_to_fly(snapshot) else None, snapshot.time_ns):
            self._asked_m, self._newest_m = np.zeros(3), np.zeros(3)
        if snapshot.movements != self._movements:
            # The newest has yet to be flown.
            self._asked_m = self._asked_m + self._newest_m
            self._newest_m = np.array(snapshot.asked_m)
        self._movements = snapshot.movements
        if np.linalg.norm(self._asked_m) <= ASKED_M:
            self._asked_ns = None
        elif self._asked_ns is None:
            self._asked_ns = snapshot.time_ns
        self.swarm_s = None if self._asked_ns is None else _long((snapshot.time_ns - self._asked_ns) / 1e9)


def _is_to_fly(snapshot: Snapshot) -> bool:
    """Whether the swarm is led, and not where it is to be: it is beside a target that it follows, though limits may
    keep it from coming nearer to one on the ground.
    """
    stays = snapshot.state is ChaseState.FOLLOWING and snapshot.following is not None and snapshot.following.is_near
    return snapshot.state in LED and not stays


def _is_led(snapshot: Snapshot, tracker: TrackerSnapshot) -> bool:
    """Whether a tracker that counts is told to be elsewhere."""
    if snapshot.state not in LED or tracker.set_point_m is None or tracker.position_m is None:
        return False
    off_m = np.linalg.norm(np.subtract(tracker.set_point_m, tracker.position_m))
    return not tracker.is_lost and not tracker.left_out and bool(off_m > OFF_M)


def _long(seconds: float) -> float | None:
    return seconds if seconds >= STANDS_S else None
