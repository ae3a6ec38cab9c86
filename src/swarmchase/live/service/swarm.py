"""The six trackers as the controller knows them and commands them."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ...scenario import NUM_TRACKERS, Scenario
from ..link.messages import FeedForward, Message, Metres, SetPoint
from .chase_state import TrackerSnapshot
from .formation_estimate import ASTRAY_M, FormationEstimate, fitted_formation
from .level_consistency import LevelConsistency
from .reliability import Reliability
from .safety import SafetyLimits, formation_m
from .sample_window import Flags, Levels, Point, Points
from .separation import Traffic, stopping_m
from .set_point_stream import SetPointStream
from .tracker_record import LOST_S, TrackerRecord

PLACES_OF_A_RELEASED_TRACKER = 11
STILL_OBEYS_S = 2.0
"""So long a tracker that is commanded no more may fly on to its last set-point, before it misses the controller."""
FLOWN_MPS = 20.0
"""No tracker is faster, whoever flies it."""
ASTRAY_IN_FLIGHT_M = 2 * ASTRAY_M
"""Who has heard nothing for a moment while the others turned is further off than ``ASTRAY_M``, and catches up."""
RETURN_SHARE = 0.5
"""Of what the channel lends: who is left out for its level has to hear better than who is not."""


class Swarm:
    """A record and a set-point of each. Metres are of the shared frame, times of the controller's clock."""

    def __init__(self, scenario: Scenario, limits: SafetyLimits) -> None:
        self._window_samples = scenario.samples_a_decision
        self._records = [TrackerRecord(scenario) for _ in range(NUM_TRACKERS)]
        self._left_m: Points = np.full((NUM_TRACKERS, 3), np.nan)
        """The last set-point of each tracker that is commanded no more: there it holds, if it has heard it."""
        self._released_ns = [0] * NUM_TRACKERS
        self._seen_m: Points = np.full((NUM_TRACKERS, 3), np.nan)
        """Where each was when it was last commanded,"""
        self._seen_ns = [0] * NUM_TRACKERS
        """and when that was."""
        self._now_ns = 0
        heard = replace(scenario, window_samples=scenario.samples_a_decision)
        self._reliability, self._levels = Reliability(), LevelConsistency(heard)
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
        """Leave alone who is lost, left behind or flown by somebody else; command the others, from where they are. One
        that comes back from where it cannot have flown to has another frame than before: it is left behind.
        """
        for tracker, record in enumerate(self._records):
            was_commanded, is_led = self.stream.commanded[tracker], self._reliability.may_be_commanded[tracker]
            may_be_commanded = is_led and record.may_be_commanded(self._now_ns)
            if was_commanded and not may_be_commanded:
                self._left_m[tracker], self._released_ns[tracker] = self.stream.last_m(tracker), self._now_ns
                self.stream.release(tracker)
            elif was_commanded and record.position_m is not None:
                seen_ns = self._now_ns - round(1e9 * record.position_age_s(self._now_ns))
                self._seen_m[tracker], self._seen_ns[tracker] = record.position_m, seen_ns
            elif may_join and may_be_commanded and record.position_m is not None:
                self._join(tracker, record.position_m, record.velocity_mps)

    def _join(self, tracker: int, position_m: Point, velocity_mps: Point) -> None:
        jump_m = float(np.linalg.norm(position_m - self._seen_m[tracker]))
        flown_m = FLOWN_MPS * (self._now_ns - self._seen_ns[tracker]) / 1e9
        if jump_m > ASTRAY_M + flown_m:
            self._left_m[tracker] = self._seen_m[tracker]
            self._reliability.leave_out_jump(tracker, jump_m)
        else:
            self._left_m[tracker] = np.nan
            self.stream.hold(tracker, self._rest_m(position_m, velocity_mps))

    def _rest_m(self, seen_m: Point, velocity_mps: Point) -> Point:
        """Where one that was seen there, so fast, can come to rest: to call it back would be to have it turn round. No
        faster than permitted, and no further out of the fence than it is, whatever it says.
        """
        share = min(1.0, self._limits.highest_speed_mps / max(float(np.linalg.norm(velocity_mps)), 1e-9))
        rest_m = seen_m + stopping_m(share * velocity_mps[None])[0]
        low_m, high_m = np.minimum(self._limits.low_m, seen_m), np.maximum(self._limits.high_m, seen_m)
        return np.asarray(np.clip(rest_m, low_m, high_m))

    @property
    def now_ns(self) -> int:
        """When what had come in was last taken in."""
        return self._now_ns

    def commanded(self) -> list[int]:
        """The trackers that have a set-point."""
        return [int(tracker) for tracker in np.flatnonzero(self.stream.commanded)]

    def counted(self) -> list[int]:
        """The trackers that are commanded and not left out."""
        return [int(tracker) for tracker in np.flatnonzero(self.stream.commanded & self._reliability.counts)]

    def usable(self) -> list[int]:
        """The trackers that are counted and heard."""
        return self.awaited(patience_s=0.0)

    def awaited(self, patience_s: float) -> list[int]:
        """The trackers that are counted, and of whose receivers more may be on its way."""
        return [tracker for tracker in self.counted() if self._records[tracker].is_heard(self._now_ns, patience_s)]

    def left_out_words(self) -> str:
        """Who is left out, as the end of a sentence; empty where nobody is."""
        numbers = ", ".join(map(str, np.flatnonzero(~self._reliability.counts).tolist()))
        return f"; left out: {numbers}" if numbers else ""

    def there(self) -> Flags:
        """Who could be commanded and is heard, left out or not [tracker]."""
        return np.array([one.may_be_commanded(self._now_ns) and one.is_heard(self._now_ns) for one in self._records])

    def positions_m(self) -> Points:
        """Where each tracker was last seen [tracker, 3]; NaN where it never was."""
        nowhere = np.full(3, np.nan)
        return np.stack([nowhere if record.position_m is None else record.position_m for record in self._records])

    def traffic(self) -> Traffic:
        """What is known of all vehicles, commanded or not."""
        position_m = self.positions_m()
        velocity_mps = np.stack([record.velocity_mps for record in self._records])
        stop_m, instead_m = self._stop_m(position_m, velocity_mps)
        return Traffic(position_m, velocity_mps, stop_m, instead_m)

    def _stop_m(self, seen_m: Points, velocity_mps: Points) -> tuple[Points, Points]:
        """Where those come to rest that are not commanded, and where they may stand instead, NaN for nowhere else
        [tracker, 3].

        One that is lost flew to its last set-point. Whoever else is seen is where it can stop, but at first, whichever
        is further, may still fly to its last set-point, too. One that was left behind may stand at either end, whatever
        it says, and later nowhere between: that it flies from the one to the other would show in what it says.
        """
        stops_m = stopping_m(velocity_mps)
        age_s = np.array([record.position_age_s(self._now_ns) for record in self._records])
        is_lost = np.array([record.is_lost(self._now_ns) for record in self._records])
        is_behind = ~self._reliability.may_be_commanded
        still_obeyed = (self._now_ns - np.array(self._released_ns)) / 1e9 - age_s < STILL_OBEYS_S
        is_further = np.linalg.norm(self._left_m - seen_m, axis=1) > np.linalg.norm(stops_m, axis=1)
        was_told = np.isfinite(self._left_m).all(axis=1)
        flies_there = was_told & ((is_lost & ~is_behind) | (still_obeyed & is_further))
        return (
            np.where(flies_there[:, None], self._left_m, seen_m + stops_m),
            np.where((was_told & is_behind)[:, None], self._left_m, np.nan),
        )

    def obstacles_m(self) -> Points:
        """Where those may be that are not commanded [obstacle, 3]: anywhere from where they were last seen to where
        they come to rest, or where they may stand instead.
        """
        traffic = self.traffic()
        places_m = np.linspace(traffic.position_m, traffic.stop_m, PLACES_OF_A_RELEASED_TRACKER)
        may_be_m = np.concatenate([places_m, traffic.instead_m[None]])[:, ~self.stream.commanded].reshape(-1, 3)
        return np.asarray(may_be_m[np.isfinite(may_be_m).all(axis=1)])

    def formation_estimate(self) -> FormationEstimate:
        """The formation next to where most of those that are there say that they are."""
        return fitted_formation(np.where(self.there()[:, None], self.positions_m(), np.nan))

    def begin_with(self, estimate: FormationEstimate) -> None:
        """Leave out who contradicts this formation; who agrees counts."""
        there, position_m = self.there(), self.positions_m()
        place_m = formation_m(estimate.center_m, estimate.spacing_m)
        self._reliability.take_start(there, estimate.agrees, np.linalg.norm(position_m - place_m, axis=1))
        for tracker in np.flatnonzero(there & ~estimate.agrees).tolist():
            self._left_m[tracker] = place_m[tracker]
            self.stream.release(tracker)

    def forgive(self) -> None:
        """Count everybody again but who is not where it was last told to be."""
        self._reliability.forgive(self.positions_m(), self._left_m)

    def arrived_ns(self, tolerance_m: float, told_ns: int) -> list[int | None]:
        """Since when each counted tracker has been reporting, after it was told, to be at its set-point, or None."""
        return [
            self._records[tracker].arrived_ns(self.stream.set_point_m[tracker], tolerance_m, told_ns)
            for tracker in self.counted()
        ]

    def end_movement(self, tolerance_m: float) -> None:
        """A movement has ended: who has not come to its set-point?"""
        set_point_m, commanded = self.stream.set_point_m, self.commanded()
        came = [one for one in commanded if self._records[one].came_to(set_point_m[one], tolerance_m)]
        self._reliability.take_movement(commanded, came)

    def first_valid_ns(self, since_ns: int) -> int | None:
        """When, from this moment on, the first valid sample of all trackers was taken; None before that."""
        found_ns = [self._records[tracker].first_valid_ns(since_ns) for tracker in self.counted()]
        return min((one_ns for one_ns in found_ns if one_ns is not None), default=None)

    def has_window(self, since_ns: int, patience_s: float) -> bool:
        """Whether all trackers have taken the window that begins at this moment; who is silent for longer than it
        takes to be called so, and this long, is not waited for.
        """
        return all(self._records[tracker].has_window(since_ns) for tracker in self.awaited(patience_s))

    def heard(self, since_ns: int) -> tuple[Levels, Points]:
        """The window [sample, tracker] in dBm, NaN where nothing valid came, and where each says that it was taken
        [sample, tracker, 3]; NaN where a tracker is not commanded. Who was not where it must be is left behind.
        """
        rssi_dbm = np.full((self._window_samples, NUM_TRACKERS), np.nan)
        position_m = np.full((*rssi_dbm.shape, 3), np.nan)
        for tracker in self.commanded():
            rssi_dbm[:, tracker], position_m[:, tracker] = self._records[tracker].window(since_ns)
        set_point_m = self.stream.set_point_m
        worst = np.nan_to_num(np.linalg.norm(position_m - set_point_m, axis=2)).argmax(axis=0)
        said_m = np.where(self.stream.commanded[:, None], position_m[worst, range(NUM_TRACKERS)], self.positions_m())
        self._reliability.take_positions(set_point_m, said_m, self._left_m)
        return rssi_dbm, position_m

    def awaits_flown_window(self, since_ns: int) -> bool:
        """Whether of any tracker that hears more is to be expected of the window that begins at this moment."""
        return any(self._records[tracker].awaits_flown_window(since_ns, self._now_ns) for tracker in self.usable())

    def flown(self, since_ns: int, told_m: Points, rest_m: Points, excused_m: Levels) -> tuple[Levels, Points, Levels]:
        """The window [sample, tracker] as ``heard`` has it, where each sample was taken, and how many seconds after
        this moment [sample, tracker]; NaN where a tracker is not commanded. Who does not come to rest where it is told
        to is left behind.

        Args:
            told_m: Where each is told to come to rest, as far as it has heard it [tracker, 3].
            rest_m: Where it does, as it flies now [tracker, 3].
            excused_m: By so much more than ``ASTRAY_IN_FLIGHT_M`` it may be off [tracker].
        """
        rssi_dbm = np.full((self._window_samples, NUM_TRACKERS), np.nan)
        after_s, position_m = rssi_dbm.copy(), np.full((*rssi_dbm.shape, 3), np.nan)
        for tracker in self.commanded():
            rssi_dbm[:, tracker], position_m[:, tracker], time_ns = self._records[tracker].flown_window(since_ns)
            after_s[:, tracker] = (time_ns - since_ns) / 1e9
        self._reliability.take_positions(told_m, rest_m, self._left_m, ASTRAY_IN_FLIGHT_M + excused_m)
        return rssi_dbm, position_m, after_s

    def places_now_m(self) -> Points:
        """Where each tracker is if it flies on as it was last seen [tracker, 3]; NaN where it never was."""
        velocity_mps = np.stack([record.velocity_mps for record in self._records])
        return np.asarray(self.positions_m() + np.clip(self.position_ages_s(), 0.0, LOST_S)[:, None] * velocity_mps)

    def position_ages_s(self) -> Levels:
        """How old the newest position of each is [tracker]; infinite without any."""
        return np.array([record.position_age_s(self._now_ns) for record in self._records])

    def obeyed_ns(self) -> list[int | None]:
        """When the newest set-point was sent that each is known to have obeyed; None of who has not said so."""
        return [record.obeyed_ns(self._now_ns) for record in self._records]

    def newest_sample_ns(self) -> int | None:
        """When the newest valid sample of those that count was taken; None before the first."""
        found_ns = [self._records[tracker].newest_sample_ns for tracker in self.counted()]
        return max((one_ns for one_ns in found_ns if one_ns is not None), default=None)

    def counted_positions_m(self, position_m: Points) -> Points:
        """These [..., tracker, 3], NaN where a tracker is left out."""
        return np.where(self._reliability.counts[:, None], position_m, np.nan)

    def window(self, rssi_dbm: Levels, position_m: Points, place_m: Points) -> tuple[Levels, Points]:
        """What counts of what was ``heard``, in the same arrays' form without NaN in places.

        A tracker that is left out or not in its place [sample, tracker, 3] has heard nothing, there where it should be:
        the mean of all positions thus is the centre, wherever a single one says that it is.
        """
        off_m = np.linalg.norm(position_m - place_m, axis=2).max(axis=0)
        rssi_dbm = np.where(off_m <= ASTRAY_M, rssi_dbm, np.nan)
        last_m = np.where(np.isfinite(position_m[-1]), position_m[-1], place_m[-1])
        counts = self._reliability.counts
        contradicts = self._levels.contradicts(rssi_dbm, last_m, counts)
        is_doubtful = self._levels.contradicts(rssi_dbm, last_m, counts, RETURN_SHARE)
        is_heard = np.asarray(np.isfinite(rssi_dbm).any(axis=0))
        self._reliability.take_levels(is_heard, contradicts, is_doubtful)
        counts = self._reliability.counts
        is_in_place = counts & (off_m <= ASTRAY_M)
        return (
            np.where(counts & ~contradicts, rssi_dbm, np.nan),
            np.where(is_in_place[:, None], position_m, place_m),
        )

    def set_points(self, epoch: int, now_ns: int) -> list[SetPoint]:
        """What is to be sent now."""
        return [SetPoint(tracker, now_ns, epoch, *self._led(tracker)) for tracker in self.commanded()]

    def _led(self, tracker: int) -> tuple[Metres, FeedForward | None]:
        """Where to come to rest, and how that moves on."""
        rest_m, onward = metres(self.stream.set_point_m[tracker]), self.stream.onward
        if onward is None or onward.valid_s[tracker] == 0:
            return rest_m, None
        braking_mps2, valid_s = onward.braking.nominal_mps2, float(onward.valid_s[tracker])
        return rest_m, FeedForward(metres(onward.velocity_mps), valid_s, braking_mps2)

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
            left_out=self._reliability.reasons[tracker],
            vehicle=record.vehicle,
            position_hz=record.position_hz,
            notices=record.notices.lines(self.now_ns),
            dropped=record.dropped,
            health=record.health(self._now_ns),
        )


def metres(point_m: Point) -> Metres:
    """As messages carry it."""
    x_m, y_m, z_m = point_m.tolist()
    return x_m, y_m, z_m
