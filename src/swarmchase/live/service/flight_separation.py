"""Whether vehicles that fly keep apart, whoever of them stops or hears nothing: what ``ListenInFlight`` asks before it
lets set-points out.

Vehicles that fly in formation follow one another more closely than they can stop in, so their ways as a whole, which
``separation`` compares, always cross. But none is on all of its way at once. A set-point says where its tracker comes
to rest if it brakes, and for how long that place moves on before it has to (``Onward``). So at every moment from now on
a vehicle is between

- where it gets if it brakes as hard as anything does, at any moment since it was last seen;
- where it gets if it obeys the set-point that is sent now, for as long as that is valid, and rests where it ends;
- where it gets if it has heard nothing since any older set-point, and obeys that for as long as it is valid.

These pieces, moment by moment, must not come nearer to one another than the least separation: then vehicles that hear
nothing more, or are stopped by a pilot or a failsafe, keep apart by themselves.
"""

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...scenario import NUM_TRACKERS
from .formation_estimate import TrackerNumbers
from .sample_window import Flags, Levels, Point, Points
from .separation import ROUNDING_M, Traffic, segments_apart_m, stopping_m

HARDEST_BRAKING_MPS2 = 6.0
"""No vehicle comes to rest in less than v^2 / 2 of this: a copter that leans by 30 degrees, with drag."""
AHEAD_S, MOMENT_S = 5.4, 0.2
"""So far ahead, and in such steps, vehicles are followed; then they rest or creep."""
STOPS_AFTER_S = (0.0, 0.4, 1.0, 2.0)
"""Since each was last seen: when it may begin to brake, besides never."""
GAIN_HZ = 2.0
"""Nearer to its set-point than it flies in 1 / this a vehicle slows down evenly."""
PLACES_AGE_S = 2.0
"""A place that is older counts as so old: following a vehicle for longer costs time, and it may be anywhere."""

LONGEST_VALID_S = 2.0
"""No set-point is valid for longer."""
NUM_UNHEARD = 3
"""So many of the set-points that may be the last that a vehicle has heard stand for all of them."""
KEPT_S = 3.0
"""What was sent longer ago nobody obeys any more: then trackers miss the controller (``AgentSettings``) and brake."""

_ONE, _OTHER = np.triu_indices(NUM_TRACKERS, 1)
_NUM_MOMENTS = round(AHEAD_S / MOMENT_S) + 1


@dataclass(frozen=True)
class Braking:
    """How the vehicles of a swarm brake and turn."""

    nominal_mps2: float
    """With which they brake before their set-points."""
    most_mps2: float
    """The most that their velocity changes in a second."""

    def rest_m(self, velocity_mps: Points) -> Points:
        """How far they get until they rest [..., 3]."""
        speed_mps = np.linalg.norm(velocity_mps, axis=-1, keepdims=True)
        return np.asarray(velocity_mps * speed_mps / (2 * self.nominal_mps2))


@dataclass(frozen=True, eq=False)
class Onward:
    """How those that fly go on from their set-points, which are where they come to rest if they brake now."""

    velocity_mps: Point
    """Of all."""
    valid_s: Levels
    """For so long their set-points move on, though they hear nothing more [tracker]; 0: they do not."""
    braking: Braking


@dataclass(frozen=True, eq=False)
class Orders:
    """Sets of set-points to fly by, each of all vehicles."""

    rest_m: Points
    """Where they come to rest if they brake when they are told [set, tracker, 3]; NaN for those that are not."""
    velocity_mps: Points
    """With which these places move on [set, tracker, 3],"""
    valid_s: Levels
    """for so long [set, tracker],"""
    since_s: Levels
    """and so long ago they were sent [set, tracker]."""

    def rest_at_m(self, after_s: Levels) -> Points:
        """Where these places are so long from now [tracker]."""
        moved_s = np.clip(after_s + self.since_s, 0.0, self.valid_s)
        return np.asarray(self.rest_m + self.velocity_mps * moved_s[..., None])

    def only(self, number: int) -> "Orders":
        """One of these sets."""
        sets = (self.rest_m, self.velocity_mps, self.valid_s, self.since_s)
        return Orders(*(one[number : number + 1] for one in sets))

    def joined(self, other: "Orders") -> "Orders":
        """These sets, then the others."""
        return Orders(
            np.concatenate([self.rest_m, other.rest_m]),
            np.concatenate([self.velocity_mps, other.velocity_mps]),
            np.concatenate([self.valid_s, other.valid_s]),
            np.concatenate([self.since_s, other.since_s]),
        )


@dataclass(frozen=True, eq=False)
class _Sent:
    time_ns: int
    rest_m: Points
    onward: Onward | None


class Told:
    """What was sent of late."""

    def __init__(self) -> None:
        self._sent: list[_Sent] = []

    def note(self, now_ns: int, rest_m: Points, onward: Onward | None) -> None:
        """It is sent now."""
        self._sent.append(_Sent(now_ns, rest_m, onward))
        while now_ns - self._sent[0].time_ns > KEPT_S * 1e9:
            del self._sent[0]

    def older(self, now_ns: int, obeyed_ns: Sequence[int | None]) -> Orders:
        """What each may have heard last instead of what is sent now: of all that was sent since it was last known to
        obey, those that differ most in where they stand and where they move on to. Every one counts: one that moves on
        may stand between two that do not.

        Args:
            obeyed_ns: When that was sent, of each; None where it is not known.
        """
        shape = NUM_UNHEARD, NUM_TRACKERS
        rest_m, velocity_mps = np.full((*shape, 3), np.nan), np.zeros((*shape, 3))
        valid_s, since_s = np.zeros(shape), np.zeros(shape)
        if not self._sent:
            return Orders(rest_m, velocity_mps, valid_s, since_s)
        age_s = np.array([(now_ns - sent.time_ns) / 1e9 for sent in self._sent])
        sent_rest_m = np.stack([sent.rest_m for sent in self._sent])
        sent_mps = np.stack([np.zeros(3) if sent.onward is None else sent.onward.velocity_mps for sent in self._sent])
        sent_s = np.stack(
            [np.zeros(NUM_TRACKERS) if sent.onward is None else sent.onward.valid_s for sent in self._sent]
        )
        ends_m = sent_rest_m + sent_mps[:, None] * sent_s[..., None]
        orders_m = np.concatenate([sent_rest_m, ends_m], axis=2)
        for tracker, time_ns in enumerate(obeyed_ns):
            first = 0 if time_ns is None else self._sent_before(time_ns)
            chosen = first + _most_different(orders_m[first:, tracker])
            rest_m[:, tracker], velocity_mps[:, tracker] = sent_rest_m[chosen, tracker], sent_mps[chosen]
            valid_s[:, tracker], since_s[:, tracker] = sent_s[chosen, tracker], age_s[chosen]
        return Orders(rest_m, velocity_mps, valid_s, since_s)

    def _sent_before(self, time_ns: int) -> int:
        """The number of the newest of what was sent up to this moment, or else of the oldest that is known."""
        number = bisect.bisect_right(self._sent, time_ns, key=lambda sent: sent.time_ns)
        return max(number - 1, 0)


def _most_different(orders_m: Points) -> TrackerNumbers:
    """Of set-points [set-point, feature], NaN where nothing was sent, the number of the oldest, then of the one that is
    farthest from the newest and all that are chosen (Gonzalez 1985, Clustering to minimize the maximum intercluster
    distance).
    """
    sent = np.flatnonzero(np.isfinite(orders_m).all(axis=1))
    if len(sent) == 0:
        return np.zeros(NUM_UNHEARD, dtype=np.int64)
    known_m, chosen = orders_m[sent], [0]
    apart_m = np.minimum(*(np.linalg.norm(known_m - known_m[number], axis=1) for number in (0, -1)))
    while len(chosen) < NUM_UNHEARD:
        chosen.append(int(apart_m.argmax()))
        apart_m = np.minimum(apart_m, np.linalg.norm(known_m - known_m[chosen[-1]], axis=1))
    return sent[chosen]


@dataclass(frozen=True, eq=False)
class Seen:
    """What is known of the vehicles now. NaN where nothing is."""

    traffic: Traffic
    age_s: Levels
    """Of what each said [tracker]."""


def least_apart_m(seen: Seen, orders: Orders, older: Orders, braking: Braking, enough_m: float) -> Levels:
    """The least distance of each two vehicles from now on, whoever of them stops or hears nothing [set, pair]; infinite
    where one is not known.

    Args:
        orders: Sets to compare, of which one is to be sent now.
        older: What was sent before and may be the last that was heard.
        enough_m: Where it is more, the distance is not told exactly: some that is as much, and not above it.
    """
    places_m = _places_m(seen, orders, older, braking)
    turned_m = places_m @ _along(seen.traffic.velocity_mps)
    gap_m = _gap_m(turned_m.min(axis=3), turned_m.max(axis=3), _ONE, _OTHER)
    least_m = np.where(np.isnan(gap_m), np.inf, gap_m)
    sets, moments, pairs = np.nonzero(gap_m < enough_m)
    one_m, other_m = turned_m[sets, moments, _ONE[pairs]], turned_m[sets, moments, _OTHER[pairs]]
    least_m[sets, moments, pairs] = _lines_apart_m(one_m, other_m, enough_m)
    return np.asarray(np.minimum(least_m.min(axis=1), _instead_apart_m(seen, places_m)))


def _along(velocity_mps: Points) -> npt.NDArray[np.float64]:
    """Axes of which the first is the way that most fly [xyz, axis]: boxes along it are narrow."""
    known = velocity_mps[np.isfinite(velocity_mps).all(axis=1)]
    way = known.mean(axis=0) if len(known) else np.zeros(3)
    return np.asarray(np.linalg.qr(np.column_stack([way, np.eye(3)]))[0])


def _gap_m(
    low_m: npt.NDArray[np.float64], high_m: npt.NDArray[np.float64], one: TrackerNumbers, other: TrackerNumbers
) -> npt.NDArray[np.float64]:
    """Between each two boxes [..., box, 3], at most the distance of what is in them [..., pair]; NaN where one is not
    known.
    """
    squared = []
    # Axis by axis: it takes half the time.
    for axis in range(3):
        low, high = low_m[..., axis], high_m[..., axis]
        beside_m = np.maximum(low[..., one] - high[..., other], low[..., other] - high[..., one])
        squared.append(np.maximum(beside_m, 0.0) ** 2)
    return np.asarray(np.sqrt(squared[0] + squared[1] + squared[2]))


def _lines_apart_m(
    one_m: npt.NDArray[np.float64], other_m: npt.NDArray[np.float64], enough_m: float
) -> npt.NDArray[np.float64]:
    """The least distance of each two lines of corners [line, corner, 3]; as ``least_apart_m`` has it."""
    starts_m, ends_m = (
        np.concatenate([one_m[:, part], other_m[:, part]], axis=1) for part in (slice(-1), slice(1, None))
    )
    num_pieces = one_m.shape[1] - 1
    first, second = (piece.ravel() for piece in np.indices((num_pieces, num_pieces)))
    second = second + num_pieces
    apart_m = _gap_m(np.minimum(starts_m, ends_m), np.maximum(starts_m, ends_m), first, second)
    lines, pieces = np.nonzero(apart_m < enough_m)
    ends = [which[lines, piece[pieces]] for piece in (first, second) for which in (starts_m, ends_m)]
    apart_m[lines, pieces] = segments_apart_m(*ends)
    return np.asarray(apart_m.min(axis=1))


def longest_free(before_m: Levels, after_m: Levels, separation_m: float) -> TrackerNumbers | None:
    """Of set-points that are valid for shorter and shorter, the number of the first set that each vehicle may be sent
    [tracker]; None where not even the last may be.

    Sent they may be where none comes too near, or at least not nearer than before.

    Args:
        before_m: The least distances with the set-points of before [pair],
        after_m: and with each set [set, pair].
    """
    is_free = (after_m >= separation_m) | (after_m >= before_m - ROUNDING_M)
    # Who is sent a shorter one than the other of a pair gets no further than with that of the other.
    is_free = np.logical_and.accumulate(is_free[::-1])[::-1]
    if not is_free[-1].all():
        return None
    first = np.zeros(NUM_TRACKERS, dtype=np.int64)
    for vehicle in (_ONE, _OTHER):
        np.maximum.at(first, vehicle, is_free.argmax(axis=0))
    return first


def blocked(least_m: Levels, separation_m: float) -> Flags:
    """Which vehicles come too near to another, by the least distances [pair], if all fly on [tracker]."""
    found = np.zeros(NUM_TRACKERS, dtype=np.bool_)
    pairs = least_m < separation_m
    found[_ONE[pairs]] = found[_OTHER[pairs]] = True
    return found


def _places_m(seen: Seen, orders: Orders, older: Orders, braking: Braking) -> npt.NDArray[np.float64]:
    """Where each may be at each moment from now on: corners of a line, from what it does that has not heard these
    orders past the one that brakes first to the one that obeys them [set, moment, tracker, corner, 3].
    """
    traffic = seen.traffic
    age_s = np.clip(np.nan_to_num(seen.age_s, nan=PLACES_AGE_S, posinf=PLACES_AGE_S), 0.0, PLACES_AGE_S)
    flown = orders.joined(older)
    shape = flown.rest_m.shape
    is_free: Flags = np.asarray(~np.isfinite(flown.rest_m).all(axis=2))
    position_m, velocity_mps = (np.broadcast_to(one, shape) for one in (traffic.position_m, traffic.velocity_mps))
    # Nobody has told those that are not commanded anything before, either.
    stop_m = np.broadcast_to(traffic.stop_m, shape).copy()
    stop_m[len(orders.rest_m) :] = np.nan
    # Of the vehicles' own time, which begins when each was last seen.
    flown_m, flown_mps = [position_m], [velocity_mps]
    for moment in range(_NUM_MOMENTS + math.ceil(float(age_s.max()) / MOMENT_S)):
        rest_m = np.where(is_free[..., None], stop_m, flown.rest_at_m(moment * MOMENT_S - age_s))
        position_m, velocity_mps = _flown(position_m, velocity_mps, rest_m, braking)
        flown_m.append(position_m)
        flown_mps.append(velocity_mps)
    way_m, speed_mps = np.stack(flown_m), np.stack(flown_mps)
    moment_s = np.arange(_NUM_MOMENTS)[:, None] * MOMENT_S + age_s
    flies_m = _at(way_m, moment_s)
    # What it is told is where it gets, if later.
    flies_m[-1] = np.where(is_free[..., None], stop_m, flown.rest_at_m(np.full(NUM_TRACKERS, np.inf)))
    stops = [_braked_m(way_m, speed_mps, np.minimum(after_s, moment_s), moment_s) for after_s in STOPS_AFTER_S]
    placed_m, unheard_m = np.split(np.stack([*stops, flies_m], axis=-2), [len(orders.rest_m)], axis=1)
    placed_m = _of_the_free_m(placed_m, traffic, is_free[: len(orders.rest_m)])
    brakes_m = placed_m[..., :1, :]
    # One line past each two next to one another of those that have not heard, and from each to the one that brakes.
    unheard_m = np.where(np.isfinite(unheard_m[..., -1:, :]), unheard_m[..., -1:, :], brakes_m[:, :1])
    oldest_m, *others_m = (
        one_m.repeat(len(orders.rest_m), 1) for one_m in np.split(unheard_m, len(older.rest_m), axis=1)
    )
    line_m = [others_m[0], oldest_m, brakes_m, *others_m, placed_m]
    return np.moveaxis(np.concatenate(line_m, axis=-2), 0, 1)


def _of_the_free_m(places_m: npt.NDArray[np.float64], traffic: Traffic, is_free: Flags) -> npt.NDArray[np.float64]:
    """Who is not commanded may have begun to stop at any moment, as hard or as gently as vehicles do, and else flies no
    further than it says, or than it was told.
    """
    brakes_m = places_m[..., :1, :]
    shape = brakes_m.shape
    stop_m = np.broadcast_to(traffic.stop_m[:, None], shape)
    gently_m = np.broadcast_to((traffic.position_m + stopping_m(traffic.velocity_mps))[:, None], shape)
    straight_m = np.concatenate([brakes_m, gently_m, brakes_m, (brakes_m + stop_m) / 2, stop_m], axis=-2)
    return np.asarray(np.where(is_free[None, ..., None, None], straight_m, places_m))


def _flown(position_m: Points, velocity_mps: Points, goal_m: Points, braking: Braking) -> tuple[Points, Points]:
    """After a moment of flying towards a set-point, as fast as it can brake from: v^2 = 2 b d."""
    way_m = goal_m - position_m
    distance_m = np.linalg.norm(way_m, axis=-1, keepdims=True)
    # In the midst of the moment: at its beginning it would brake too late.
    left_m = np.maximum(distance_m - np.linalg.norm(velocity_mps, axis=-1, keepdims=True) * MOMENT_S / 2, 0.0)
    wanted_mps = np.minimum(np.sqrt(2 * braking.nominal_mps2 * left_m), GAIN_HZ * left_m)
    change_mps = way_m / np.maximum(distance_m, 1e-9) * wanted_mps - velocity_mps
    length_mps = np.linalg.norm(change_mps, axis=-1, keepdims=True)
    change_mps = change_mps * np.minimum(1.0, braking.most_mps2 * MOMENT_S / np.maximum(length_mps, 1e-9))
    return position_m + (velocity_mps + change_mps / 2) * MOMENT_S, velocity_mps + change_mps


def _at(values: npt.NDArray[np.float64], moment_s: Levels) -> npt.NDArray[np.float64]:
    """Of values [own moment, set-points, tracker, 3], those at these own times [moment, tracker]: straight between."""
    place = np.clip(moment_s / MOMENT_S, 0, len(values) - 1)
    index = np.minimum(place.astype(np.int64), len(values) - 2)
    share = (place - index)[:, None, :, None]
    tracker = np.arange(values.shape[2])
    before, after = (np.swapaxes(values[step, :, tracker], 1, 2) for step in (index, index + 1))
    return np.asarray(before + share * (after - before))


def _braked_m(
    way_m: npt.NDArray[np.float64], flown_mps: npt.NDArray[np.float64], after_s: Levels, moment_s: Levels
) -> npt.NDArray[np.float64]:
    """Where those are at these own times that began to brake hardest at those [moment, set-points, tracker, 3]."""
    velocity_mps = _at(flown_mps, after_s)
    speed_mps = np.linalg.norm(velocity_mps, axis=-1)
    braked_s = np.minimum((moment_s - after_s)[:, None], speed_mps / HARDEST_BRAKING_MPS2)
    share_s = braked_s - HARDEST_BRAKING_MPS2 * braked_s**2 / (2 * np.maximum(speed_mps, 1e-9))
    return np.asarray(_at(way_m, after_s) + share_s[..., None] * velocity_mps)


def _instead_apart_m(seen: Seen, places_m: npt.NDArray[np.float64]) -> Levels:
    """From where vehicles may stand instead of where they say, to where the other of each two may be [set-points,
    pair].
    """
    instead_m = seen.traffic.instead_m
    found = np.full((len(places_m), len(_ONE)), np.inf)
    for pair, (one, other) in enumerate(zip(_ONE, _OTHER, strict=True)):
        for stands, flies in ((one, other), (other, one)):
            if not np.isfinite(instead_m[stands]).all():
                continue
            starts_m = places_m[:, :, flies, :-1].reshape(-1, 3)
            ends_m = places_m[:, :, flies, 1:].reshape(-1, 3)
            at_m = np.broadcast_to(instead_m[stands], starts_m.shape)
            apart_m = segments_apart_m(at_m, at_m, starts_m, ends_m).reshape(len(places_m), -1)
            found[:, pair] = np.minimum(found[:, pair], np.where(np.isnan(apart_m), np.inf, apart_m).min(axis=1))
    return found
