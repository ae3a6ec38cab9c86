"""Whether vehicles that fly keep apart, whoever of them stops: what ``ListenInFlight`` asks before it lets set-points
out.

Vehicles that fly in formation follow one another more closely than they can stop in, so their ways as a whole, which
``separation`` compares, always cross. But none is on all of its way at once: at every moment from now on it is between
where it gets if it brakes as hard as anything does, at any moment since it was last seen, and where it gets if it flies
on to its set-point and rests there. These pieces, moment by moment, must not come nearer to one another than the least
separation: then vehicles that hear nothing more, or are stopped by a pilot or a failsafe, keep apart by themselves.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...scenario import NUM_TRACKERS
from .sample_window import Flags, Levels, Points
from .separation import ROUNDING_M, Traffic, segments_apart_m

HARDEST_BRAKING_MPS2 = 6.0
"""No vehicle comes to rest in less than v^2 / 2 of this: a copter that leans by 30 degrees, with drag."""
AHEAD_S, MOMENT_S = 3.4, 0.2
"""So far ahead, and in such steps, vehicles are followed; then they rest or creep."""
STOPS_AFTER_S = (0.0, 0.4, 1.0, 2.0)
"""Since each was last seen: when it may begin to brake, besides never."""
GAIN_HZ = 2.0
"""Nearer to its set-point than it flies in 1 / this a vehicle slows down evenly."""
PLACES_AGE_S = 1.0
"""What is older than this is lost."""

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
class Seen:
    """What is known of the vehicles now. NaN where nothing is."""

    traffic: Traffic
    age_s: Levels
    """Of what each said [tracker]."""


def least_apart_m(seen: Seen, set_point_m: Points, braking: Braking) -> Levels:
    """The least distance of each two vehicles from now on, whoever of them stops [set-points, pair]; infinite where one
    is not known.

    Args:
        set_point_m: Several sets of them to compare [set-points, tracker, 3]; NaN for none.
    """
    places_m = _places_m(seen, set_point_m, braking)
    starts_m, ends_m = places_m[..., :-1, :], places_m[..., 1:, :]
    num_pieces = starts_m.shape[-2]
    one, other = (piece.ravel() for piece in np.indices((num_pieces, num_pieces)))
    pieces = [
        which[:, :, vehicle][..., piece, :].reshape(-1, 3)
        for vehicle, piece in ((_ONE, one), (_OTHER, other))
        for which in (starts_m, ends_m)
    ]
    apart_m = segments_apart_m(*pieces).reshape(len(set_point_m), _NUM_MOMENTS, len(_ONE), num_pieces**2)
    least_m = np.where(np.isnan(apart_m), np.inf, apart_m).min(axis=(1, 3))
    return np.asarray(np.minimum(least_m, _instead_apart_m(seen, places_m)))


def may_become(before_m: Levels, after_m: Levels, separation_m: float) -> bool:
    """Whether set-points may give way to others, by the least distances [pair] with each: none too near, or at least
    not nearer than before.
    """
    return bool(((after_m >= separation_m) | (after_m >= before_m - ROUNDING_M)).all())


def blocked(least_m: Levels, separation_m: float) -> Flags:
    """Which vehicles come too near to another, by the least distances [pair], if all fly on [tracker]."""
    found = np.zeros(NUM_TRACKERS, dtype=np.bool_)
    pairs = least_m < separation_m
    found[_ONE[pairs]] = found[_OTHER[pairs]] = True
    return found


def _places_m(seen: Seen, set_point_m: Points, braking: Braking) -> npt.NDArray[np.float64]:
    """Where each may be at each moment from now on: corners of a line, from the one that brakes first to the one that
    flies on [set-points, moment, tracker, corner, 3].
    """
    traffic = seen.traffic
    age_s = np.clip(np.nan_to_num(seen.age_s, nan=PLACES_AGE_S, posinf=PLACES_AGE_S), 0.0, PLACES_AGE_S)
    goal_m = np.where(np.isfinite(set_point_m), set_point_m, traffic.stop_m)
    shape = set_point_m.shape
    position_m, velocity_mps = (np.broadcast_to(one, shape) for one in (traffic.position_m, traffic.velocity_mps))
    # Of the vehicles' own time, which begins when each was last seen.
    flown_m, flown_mps = [position_m], [velocity_mps]
    for _ in range(_NUM_MOMENTS + round(PLACES_AGE_S / MOMENT_S)):
        position_m, velocity_mps = _flown(position_m, velocity_mps, goal_m, braking)
        flown_m.append(position_m)
        flown_mps.append(velocity_mps)
    way_m, speed_mps = np.stack(flown_m), np.stack(flown_mps)
    moment_s = np.arange(_NUM_MOMENTS)[:, None] * MOMENT_S + age_s
    places = [_braked_m(way_m, speed_mps, np.minimum(after_s, moment_s), moment_s) for after_s in STOPS_AFTER_S]
    flies_m = _at(way_m, moment_s)
    # What it is told is where it gets, if later.
    flies_m[-1] = goal_m
    places.append(flies_m)
    places_m = np.stack(places, axis=-2)
    # Who is not commanded may have begun to stop at any moment, and flies no further than it says.
    free: Flags = np.asarray(~np.isfinite(set_point_m).all(axis=2))
    stop_m = np.broadcast_to(traffic.stop_m[:, None], places_m.shape[2:])
    share = np.linspace(0.0, 1.0, places_m.shape[-2])[:, None]
    straight_m = places_m[..., :1, :] + share * (stop_m - places_m[..., :1, :])
    placed_m: npt.NDArray[np.float64] = np.where(free[None, ..., None, None], straight_m, places_m)
    return np.moveaxis(placed_m, 0, 1)


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
