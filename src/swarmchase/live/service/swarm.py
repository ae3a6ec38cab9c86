"""The six trackers as the controller knows them and commands them."""

from collections.abc import Iterable

import numpy as np

from ...scenario import NUM_TRACKERS, Scenario
from ..link.messages import Message, Metres, SetPoint
from .chase_state import TrackerSnapshot
from .safety import TRACKER_DIRECTION, SafetyLimits
from .sample_window import Levels, Point, Points
from .separation import Traffic, stopping_m
from .set_point_stream import SetPointStream
from .tracker_record import TrackerRecord

PLACES_OF_A_RELEASED_TRACKER = 11
STILL_OBEYS_S = 2.0
"""So long a tracker that is commanded no more may fly on to its last set-point, before it misses the controller."""
ASTRAY_M = 30.0
"""No movement leaves a tracker this far from its place: what says so has a broken receiver of positions, or lies."""


class Swarm:
    """A record and a set-point of each. Metres are of the shared frame, times of the controller's clock."""

    def __init__(self, scenario: Scenario, limits: SafetyLimits) -> None:
        self._window_samples = scenario.window_samples
        self._records = [TrackerRecord(scenario) for _ in range(NUM_TRACKERS)]
        self._left_m: Points = np.full((NUM_TRACKERS, 3), np.nan)
        """The last set-point of each tracker that is commanded no more: there it holds, if it has heard it."""
        self._released_ns = [0] * NUM_TRACKERS
        self._now_ns = 0
        self._limits = limits
        self.stream = SetPointStream(limits)
        """The set-points."""

    def listen(self, messages: Iterable[Message], now_ns: int) -> None:
        """Take in what has come in by now."""
        self._now_ns = now_ns
        for message in messages:
            if not isinstance(message, SetPoint):
                self._records[message.tracker].hear(message, now_ns)

    def take_stock(self, may_join: bool) -> None:
        """Leave alone who is lost or flown by somebody else; command the others, from where they are."""
        for tracker, record in enumerate(self._records):
            was_commanded = self.stream.commanded[tracker]
            may_be_commanded = record.may_be_commanded(self._now_ns)
            if was_commanded and not may_be_commanded:
                self._left_m[tracker], self._released_ns[tracker] = self.stream.set_point_m[tracker], self._now_ns
                self.stream.release(tracker)
            elif may_join and may_be_commanded and not was_commanded and record.position_m is not None:
                self._left_m[tracker] = np.nan
                self.stream.hold(tracker, self._rest_m(record.position_m, record.velocity_mps))

    def _rest_m(self, seen_m: Point, velocity_mps: Point) -> Point:
        """Where one that was seen there, so fast, can come to rest: to call it back would be to have it turn round. No
        faster than permitted, and no further out of the fence than it is, whatever it says.
        """
        share = min(1.0, self._limits.highest_speed_mps / max(float(np.linalg.norm(velocity_mps)), 1e-9))
        rest_m = seen_m + stopping_m(share * velocity_mps[None])[0]
        low_m, high_m = np.minimum(self._limits.low_m, seen_m), np.maximum(self._limits.high_m, seen_m)
        return np.asarray(np.clip(rest_m, low_m, high_m))

    def commanded(self) -> list[int]:
        """The trackers that have a set-point."""
        return [int(tracker) for tracker in np.flatnonzero(self.stream.commanded)]

    def usable(self) -> list[int]:
        """The trackers that are commanded and heard."""
        return [tracker for tracker in self.commanded() if not self._records[tracker].is_silent(self._now_ns)]

    def awaited(self, patience_s: float) -> list[int]:
        """The trackers that are commanded, and of whose receivers more may be on its way."""
        return [
            tracker for tracker in self.commanded() if not self._records[tracker].is_silent(self._now_ns, patience_s)
        ]

    def positions_m(self) -> Points:
        """Where each tracker was last seen [tracker, 3]; NaN where it never was."""
        nowhere = np.full(3, np.nan)
        return np.stack([nowhere if record.position_m is None else record.position_m for record in self._records])

    def traffic(self) -> Traffic:
        """What is known of all vehicles, commanded or not."""
        position_m = self.positions_m()
        velocity_mps = np.stack([record.velocity_mps for record in self._records])
        return Traffic(position_m, velocity_mps, self._stop_m(position_m, velocity_mps))

    def _stop_m(self, seen_m: Points, velocity_mps: Points) -> Points:
        """Where those come to rest that are not commanded [tracker, 3].

        One that is lost flew to its last set-point; whoever is seen is where it can stop, but at first, whichever is
        further, may still fly to its last set-point, too.
        """
        stops_m = stopping_m(velocity_mps)
        is_lost = np.array([record.is_lost(self._now_ns) for record in self._records])
        still_obeys = self._now_ns - np.array(self._released_ns) < STILL_OBEYS_S * 1e9
        is_further = np.linalg.norm(self._left_m - seen_m, axis=1) > np.linalg.norm(stops_m, axis=1)
        flies_there = np.isfinite(self._left_m).all(axis=1) & (is_lost | (still_obeys & is_further))
        return np.where(flies_there[:, None], self._left_m, seen_m + stops_m)

    def obstacles_m(self) -> Points:
        """Where those may be that are not commanded [obstacle, 3]: anywhere from where they were last seen to where
        they come to rest.
        """
        traffic = self.traffic()
        places_m = np.linspace(traffic.position_m, traffic.stop_m, PLACES_OF_A_RELEASED_TRACKER)
        between_m = places_m[:, ~self.stream.commanded].reshape(-1, 3)
        return np.asarray(between_m[np.isfinite(between_m).all(axis=1)])

    def center_and_spacing_m(self) -> tuple[Point, float]:
        """The formation next to where the usable trackers are (least squares). With all six its centre is the mean."""
        usable = self.usable()
        position_m, direction = self.positions_m()[usable], TRACKER_DIRECTION[usable]
        mean_m, mean_direction = position_m.mean(axis=0), direction.mean(axis=0)
        spread = direction - mean_direction
        squared = max(float((spread**2).sum()), 1e-9)
        spacing_m = max(float((spread * (position_m - mean_m)).sum()) / squared, 0.0)
        return mean_m - spacing_m * mean_direction, spacing_m

    def arrived_ns(self, tolerance_m: float, told_ns: int) -> list[int | None]:
        """Since when each commanded tracker has been reporting, after it was told, to be at its set-point, or None."""
        return [
            self._records[tracker].arrived_ns(self.stream.set_point_m[tracker], tolerance_m, told_ns)
            for tracker in self.commanded()
        ]

    def first_valid_ns(self, since_ns: int) -> int | None:
        """When, from this moment on, the first valid sample of all trackers was taken; None before that."""
        found_ns = [self._records[tracker].first_valid_ns(since_ns) for tracker in self.commanded()]
        return min((one_ns for one_ns in found_ns if one_ns is not None), default=None)

    def has_window(self, since_ns: int, patience_s: float) -> bool:
        """Whether all trackers have taken the window that begins at this moment; who is silent for longer than it
        takes to be called so, and this long, is not waited for.
        """
        return all(self._records[tracker].has_window(since_ns) for tracker in self.awaited(patience_s))

    def window(self, since_ns: int, place_m: Points) -> tuple[Levels, Points]:
        """The window [sample, tracker] in dBm, NaN where nothing valid came, and where it was taken
        [sample, tracker, 3].

        A tracker that is not commanded, or is astray, has heard nothing, in the place where it should be [tracker, 3]:
        the mean of all positions thus is the centre, wherever a single one says that it is.
        """
        rssi_dbm = np.full((self._window_samples, NUM_TRACKERS), np.nan)
        position_m = np.broadcast_to(place_m, (*rssi_dbm.shape, 3)).copy()
        for tracker in self.commanded():
            heard_dbm, taken_at_m = self._records[tracker].window(since_ns)
            if np.linalg.norm(taken_at_m - place_m[tracker], axis=1).max() <= ASTRAY_M:
                rssi_dbm[:, tracker], position_m[:, tracker] = heard_dbm, taken_at_m
        return rssi_dbm, position_m

    def set_points(self, epoch: int, now_ns: int) -> list[SetPoint]:
        """What is to be sent now."""
        return [
            SetPoint(tracker, now_ns, epoch, metres(self.stream.set_point_m[tracker])) for tracker in self.commanded()
        ]

    def snapshots(self) -> tuple[TrackerSnapshot, ...]:
        """All six as a page shows them."""
        return tuple(self._snapshot(tracker) for tracker in range(NUM_TRACKERS))

    def _snapshot(self, tracker: int) -> TrackerSnapshot:
        record = self._records[tracker]
        window = record.last_window()
        return TrackerSnapshot(
            position_m=None if record.position_m is None else metres(record.position_m),
            set_point_m=metres(self.stream.set_point_m[tracker]) if self.stream.commanded[tracker] else None,
            mode=record.mode,
            position_age_s=record.position_age_s(self._now_ns),
            rssi_age_s=record.rssi_age_s(self._now_ns),
            is_lost=record.is_lost(self._now_ns),
            is_silent=record.is_silent(self._now_ns),
            missing_share=float(np.isnan(window).mean()),
            rssi_dbm=tuple(window.tolist()),
        )


def metres(point_m: Point) -> Metres:
    """As messages carry it."""
    x_m, y_m, z_m = point_m.tolist()
    return x_m, y_m, z_m
