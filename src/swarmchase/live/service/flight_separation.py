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

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...scenario import NUM_TRACKERS
from .formation_estimate import TrackerNumbers
from .orders import Braking, Orders
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

_ONE, _OTHER = np.triu_indices(NUM_TRACKERS, 1)
BOTH = np.ones(len(_ONE), dtype=np.bool_), np.ones(len(_ONE), dtype=np.bool_)
_NUM_MOMENTS = round(AHEAD_S / MOMENT_S) + 1
_TRACKER = np.arange(NUM_TRACKERS)

Corners = npt.NDArray[np.float64]
"""Of lines, one behind another [corner, moment, tracker, xyz, set]: numpy is fast where much lies side by side."""


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
    axes = _along(seen.traffic.velocity_mps)
    placed_m, unheard_m = _places_m(seen, axes, orders, older, braking)
    low_m = np.minimum(placed_m.min(axis=0), unheard_m.min(axis=0))
    high_m = np.maximum(placed_m.max(axis=0), unheard_m.max(axis=0))
    gap_m = _gap_m(low_m, high_m, _ONE, _OTHER)
    least_m = np.where(np.isnan(gap_m), np.inf, gap_m)
    moments, pairs, sets = np.nonzero(gap_m < enough_m)
    if len(sets):
        lines_m = np.ascontiguousarray(_lines_m(placed_m, unheard_m).transpose(1, 2, 4, 0, 3))
        one_m, other_m = lines_m[moments, _ONE[pairs], sets], lines_m[moments, _OTHER[pairs], sets]
        least_m[moments, pairs, sets] = _lines_apart_m(one_m, other_m, enough_m)
    return np.asarray(np.minimum(least_m.min(axis=0).T, _instead_apart_m(seen, axes, placed_m, unheard_m)))


def _along(velocity_mps: Points) -> npt.NDArray[np.float64]:
    """Axes of which the first is the way that most fly [xyz, axis]: boxes along it are narrow."""
    known = [one for one in velocity_mps.tolist() if all(map(math.isfinite, one))]
    x, y, z = (sum(parts) for parts in zip(*known, strict=True)) if known else (0.0, 0.0, 0.0)
    speed, level = math.hypot(x, y, z), math.hypot(x, y)
    if level < 1e-9:  # straight up or down, or at rest
        return np.eye(3)
    along, beside = (x / speed, y / speed, z / speed), (-y / level, x / level, 0.0)
    above = (-along[2] * beside[1], along[2] * beside[0], level / speed)
    return np.array([along, beside, above]).T


def _gap_m(
    low_m: npt.NDArray[np.float64], high_m: npt.NDArray[np.float64], one: TrackerNumbers, other: TrackerNumbers
) -> npt.NDArray[np.float64]:
    """Between each two boxes [moment, box, 3, set], at most the distance of what is in them [moment, pair, set]; NaN
    where one is not known.
    """
    beside_m = np.maximum(low_m[:, one] - high_m[:, other], low_m[:, other] - high_m[:, one])
    beside_m = np.maximum(beside_m, 0.0)
    return np.asarray(np.sqrt((beside_m * beside_m).sum(axis=2)))


def _lines_apart_m(
    one_m: npt.NDArray[np.float64], other_m: npt.NDArray[np.float64], enough_m: float
) -> npt.NDArray[np.float64]:
    """The least distance of each two lines of corners [line, corner, 3]; as ``least_apart_m`` has it."""
    one_m, other_m = (np.ascontiguousarray(line_m.transpose(1, 2, 0)) for line_m in (one_m, other_m))
    apart_m = np.full(one_m.shape[2], enough_m)
    # Most pieces are farther than that from all of the other line.
    first, second, lines = np.nonzero(
        _is_near(one_m, other_m, enough_m)[:, None] & _is_near(other_m, one_m, enough_m)[None]
    )
    ends = one_m[first, :, lines], one_m[first + 1, :, lines], other_m[second, :, lines], other_m[second + 1, :, lines]
    np.minimum.at(apart_m, lines, segments_apart_m(*ends))
    return apart_m


def _is_near(line_m: Corners, other_m: Corners, enough_m: float) -> Flags:
    """Whether the pieces of lines [corner, 3, line] may be nearer than that to the others [piece, line]."""
    starts_m, ends_m = line_m[:-1], line_m[1:]
    beside_m = np.maximum(
        np.minimum(starts_m, ends_m) - other_m.max(axis=0), other_m.min(axis=0) - np.maximum(starts_m, ends_m)
    )
    beside_m = np.maximum(beside_m, 0.0)
    return np.asarray((beside_m * beside_m).sum(axis=1) < enough_m**2)


def longest_free(
    before_m: Levels, after_m: Levels, separation_m: float, limited: tuple[Flags, Flags] = BOTH
) -> TrackerNumbers | None:
    """Of set-points that are valid for shorter and shorter, the number of the first set that each vehicle may be sent
    [tracker]; None where not even the last may be.

    Sent they may be where none comes too near, or at least not nearer than before.

    Args:
        before_m: The least distances with the set-points of before [pair],
        after_m: and with each set [set, pair].
        limited: Whether the first, and the second, of each two is to be sent no longer one than they may be [pair].
    """
    is_free = (after_m >= separation_m) | (after_m >= before_m - ROUNDING_M)
    # Who is sent a shorter one than the other of a pair gets no further than with that of the other.
    is_free = np.logical_and.accumulate(is_free[::-1])[::-1]
    if not is_free[-1].all():
        return None
    first = np.zeros(NUM_TRACKERS, dtype=np.int64)
    for vehicle, is_limited in zip((_ONE, _OTHER), limited, strict=True):
        np.maximum.at(first, vehicle, np.where(is_limited, is_free.argmax(axis=0), 0))
    return first


def those_behind(place_m: Points, velocity_mps: Point) -> tuple[Flags, Flags]:
    """Whether the first, and the second, of each two flies behind the other [pair]."""
    ahead_m = place_m @ velocity_mps
    is_behind = np.asarray(ahead_m[_ONE] < ahead_m[_OTHER])
    return is_behind, ~is_behind


def _places_m(
    seen: Seen, axes: npt.NDArray[np.float64], orders: Orders, older: Orders, braking: Braking
) -> tuple[Corners, Corners]:
    """Where each may be at each moment from now on, in a frame of these axes: corners of a line from the one that
    brakes first to the one that obeys these orders; and where it gets that has not heard them, by each older set.
    """
    traffic = seen.traffic
    age_s = np.minimum(np.maximum(np.nan_to_num(seen.age_s, nan=PLACES_AGE_S, posinf=PLACES_AGE_S), 0.0), PLACES_AGE_S)
    num_sets, told = len(orders.rest_m), orders.joined(older).turned(axes)
    is_free: Flags = np.asarray(~np.isfinite(told.rest_m).all(axis=2))
    # Nobody has told those that are not commanded anything before, either.
    stop_m = np.broadcast_to(traffic.stop_m @ axes, told.rest_m.shape).copy()
    stop_m[num_sets:] = np.nan
    # Of the vehicles' own time, which begins when each was last seen.
    num_moments = _NUM_MOMENTS + math.ceil(float(age_s.max()) / MOMENT_S)
    own_s: Levels = np.arange(float(num_moments + 1))[:, None] * MOMENT_S - age_s
    own_s[-1] = np.inf
    rest_m = np.where(is_free[..., None], stop_m, told.rest_at_m(own_s))
    way = _flown(traffic.position_m @ axes, traffic.velocity_mps @ axes, rest_m[:-1], braking)
    moment_s: Levels = np.arange(float(_NUM_MOMENTS))[:, None] * MOMENT_S + age_s
    flies_m = _at(way[..., :3, :], moment_s)
    # What it is told is where it gets, if later.
    flies_m[-1] = np.moveaxis(rest_m[-1], 0, -1)
    after_s = np.minimum(np.array(STOPS_AFTER_S)[:, None, None], moment_s)
    stops_m = _braked_m(way[..., :num_sets], after_s, moment_s)
    placed_m = np.concatenate([stops_m, flies_m[None, ..., :num_sets]])
    if is_free.any():
        placed_m = _of_the_free_m(placed_m, traffic, axes, is_free[:num_sets])
    unheard_m = np.moveaxis(flies_m[..., num_sets:], -1, 0)[..., None]
    return placed_m, np.where(np.isfinite(unheard_m), unheard_m, placed_m[:1, ..., :1])


def _lines_m(placed_m: Corners, unheard_m: Corners) -> Corners:
    """One line past each two next to one another of those that have not heard, and from each to the one that brakes."""
    oldest_m, *others_m = (np.broadcast_to(one_m, placed_m.shape[1:]) for one_m in unheard_m)
    return np.stack([others_m[0], oldest_m, placed_m[0], *others_m, *placed_m])


def _of_the_free_m(places_m: Corners, traffic: Traffic, axes: npt.NDArray[np.float64], is_free: Flags) -> Corners:
    """Who is not commanded may have begun to stop at any moment, as hard or as gently as vehicles do, and else flies no
    further than it says, or than it was told.
    """
    brakes_m = places_m[0]
    stop_m, gently_m = (
        np.broadcast_to((one_m @ axes)[..., None], brakes_m.shape)
        for one_m in (traffic.stop_m, traffic.position_m + stopping_m(traffic.velocity_mps))
    )
    straight_m = np.stack([brakes_m, gently_m, brakes_m, (brakes_m + stop_m) / 2, stop_m])
    return np.where(is_free.T[:, None], straight_m, places_m)


def _flown(position_m: Points, velocity_mps: Points, rest_m: npt.NDArray[np.float64], braking: Braking) -> Corners:
    """Where vehicles are, and how fast, that fly towards set-points that move on [moment, set, tracker, 3], as fast as
    they can brake from: v^2 = 2 b d. [moment, tracker, place and velocity, set]
    """
    num_moments, num_sets = rest_m.shape[:2]
    # Axis by axis, all vehicles and sets behind one another: it takes half the time.
    goal_m = np.ascontiguousarray(rest_m.transpose(0, 3, 2, 1)).reshape(num_moments, 3, -1)
    way = np.empty((num_moments + 1, 2, 3, goal_m.shape[2]))
    at_m, flown_mps = (one.T[..., None].repeat(num_sets, axis=2).reshape(3, -1) for one in (position_m, velocity_mps))
    way[0] = at_m, flown_mps
    for moment in range(num_moments):
        way_m = goal_m[moment] - at_m
        distance_m = np.sqrt(np.add.reduce(way_m * way_m))
        speed_mps = np.sqrt(np.add.reduce(flown_mps * flown_mps))
        # In the midst of the moment: at its beginning it would brake too late.
        left_m = np.maximum(distance_m - speed_mps * (MOMENT_S / 2), 0.0)
        wanted_mps = np.minimum(np.sqrt(2 * braking.nominal_mps2 * left_m), GAIN_HZ * left_m)
        change_mps = way_m * (wanted_mps / np.maximum(distance_m, 1e-9)) - flown_mps
        length_mps = np.sqrt(np.add.reduce(change_mps * change_mps))
        change_mps *= np.minimum(1.0, braking.most_mps2 * MOMENT_S / np.maximum(length_mps, 1e-9))
        at_m = at_m + (flown_mps + change_mps / 2) * MOMENT_S
        flown_mps = flown_mps + change_mps
        way[moment + 1] = at_m, flown_mps
    by_axis = way.reshape(num_moments + 1, 6, NUM_TRACKERS, num_sets)
    return np.ascontiguousarray(by_axis.transpose(0, 2, 1, 3))


def _at(values: Corners, moment_s: Levels) -> Corners:
    """Of values [own moment, tracker, axis, set], those at these own times [..., tracker]: straight between."""
    place = np.minimum(np.maximum(moment_s / MOMENT_S, 0.0), len(values) - 1)
    index = np.minimum(place.astype(np.int64), len(values) - 2)
    share = (place - index)[..., None, None]
    before = values[index, _TRACKER]
    return np.asarray(before + share * (values[index + 1, _TRACKER] - before))


def _braked_m(way: Corners, after_s: Levels, moment_s: Levels) -> Corners:
    """Where those are at these own times that began to brake hardest at those [..., tracker, 3, set]."""
    then = _at(way, after_s)
    position_m, velocity_mps = then[..., :3, :], then[..., 3:, :]
    speed_mps = np.sqrt((velocity_mps * velocity_mps).sum(axis=-2))
    braked_s = np.minimum((moment_s - after_s)[..., None], speed_mps / HARDEST_BRAKING_MPS2)
    share_s = braked_s - HARDEST_BRAKING_MPS2 * braked_s**2 / (2 * np.maximum(speed_mps, 1e-9))
    return np.asarray(position_m + share_s[..., None, :] * velocity_mps)


def _instead_apart_m(seen: Seen, axes: npt.NDArray[np.float64], placed_m: Corners, unheard_m: Corners) -> Levels:
    """From where vehicles may stand instead of where they say, to where the other of each two may be [set, pair]."""
    instead_m = seen.traffic.instead_m @ axes
    found = np.full((placed_m.shape[-1], len(_ONE)), np.inf)
    if not np.isfinite(instead_m).all(axis=1).any():
        return found
    lines_m = _lines_m(placed_m, unheard_m)
    for pair, (one, other) in enumerate(zip(_ONE, _OTHER, strict=True)):
        for stands, flies in ((one, other), (other, one)):
            if not np.isfinite(instead_m[stands]).all():
                continue
            way_m = np.moveaxis(lines_m[:, :, flies], -1, 0)
            starts_m, ends_m = way_m[:, :-1].reshape(-1, 3), way_m[:, 1:].reshape(-1, 3)
            at_m = np.broadcast_to(instead_m[stands], starts_m.shape)
            apart_m = segments_apart_m(at_m, at_m, starts_m, ends_m).reshape(len(found), -1)
            found[:, pair] = np.minimum(found[:, pair], np.where(np.isnan(apart_m), np.inf, apart_m).min(axis=1))
    return found
