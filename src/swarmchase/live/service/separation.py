"""Whether vehicles keep apart, wherever they stop: what ``SetPointStream`` asks before it lets a set-point out.

A vehicle flies straight from its place to its set-point, faster or slower than the others, and may be stopped anywhere
on this *way*: by its pilot, by a failsafe, by a process or a link that dies. Its last report may be late, too: then it
is further along. So no two ways, whole as they are, may come nearer than the least separation and what the vehicles
may stray from them. Ways that keep to this stay safe if nobody hears or says anything any more, since each vehicle
then stops on its own.
"""

from dataclasses import dataclass

import numpy as np

from ...scenario import NUM_TRACKERS
from .sample_window import Flags, Levels, Points

BRAKING_MPS2 = 2.0
"""Every vehicle brakes at least as hard as this."""
REACTION_S = 0.3
"""From what a vehicle does until another obeys a set-point that answers it: report, link, step, link, and the same once
more, since a datagram gets lost."""
POSITION_ERROR_M = 0.5
"""So far from the truth a vehicle's own idea of its place may be, wherever it is: GNSS."""
STRAYING_M = 0.4
"""So much nearer than their ways two vehicles may come because they lag, swing and are blown off."""
MARGIN_M = 2 * POSITION_ERROR_M + STRAYING_M
"""The true separation is at least the operator's limit less this: what nobody at the controller can know."""

ROUNDING_M = 1e-9
"""Distances are compared with so much tolerance, lest rounding stops a flight."""

_VEHICLE = np.tile(np.arange(NUM_TRACKERS), 2)
"""Whose way it is: first where each says that it is, then where it may be instead."""
_ONE, _OTHER = np.argwhere(np.triu(_VEHICLE[:, None] != _VEHICLE[None])).T


@dataclass(frozen=True, eq=False)
class Traffic:
    """What is known of the six vehicles, commanded or not. NaN where nothing is."""

    position_m: Points
    """Where each was last seen [tracker, 3]."""
    velocity_mps: Points
    """How fast it was there [tracker, 3]."""
    stop_m: Points
    """Where it comes to rest at the latest if it is not commanded [tracker, 3]."""
    instead_m: Points
    """Where it may stand instead, if what it says of itself is wrong [tracker, 3]; NaN where it is believed."""

    def ways(self, set_point_m: Points) -> "Ways":
        """Where each may be until it hears something new, told these set-points [tracker, 3], NaN for none."""
        end_m = np.where(np.isfinite(set_point_m), set_point_m, self.stop_m)
        stray_m = _stray_m(end_m - self.position_m, self.velocity_mps)
        return Ways(
            np.concatenate([self.position_m, self.instead_m]),
            np.concatenate([end_m, self.instead_m]),
            np.concatenate([stray_m, np.zeros(NUM_TRACKERS)]),
        )


@dataclass(frozen=True, eq=False)
class Ways:
    """One of each vehicle, then one of each where it may be instead; NaN for none."""

    start_m: Points
    """[way, 3]"""
    end_m: Points
    """[way, 3]"""
    stray_m: Levels
    """How far from it the vehicle may get, since it does not yet fly along it [way]."""

    def apart_m(self) -> Levels:
        """The least distance of each two [pair]; infinite where one is not known."""
        found_m = segments_apart_m(self.start_m[_ONE], self.end_m[_ONE], self.start_m[_OTHER], self.end_m[_OTHER])
        return np.asarray(np.where(np.isnan(found_m), np.inf, found_m))

    def needed_m(self, separation_m: float) -> Levels:
        """How far each two have to be apart [pair]."""
        return np.asarray(separation_m + np.nan_to_num(self.stray_m[_ONE] + self.stray_m[_OTHER]))

    def ends_apart_m(self) -> Levels:
        """How far each of two ends from the whole other way [2, pair]."""
        return np.stack(
            [
                segments_apart_m(self.end_m[one], self.end_m[one], self.start_m[other], self.end_m[other])
                for one, other in ((_ONE, _OTHER), (_OTHER, _ONE))
            ]
        )

    def may_become(self, other: "Ways", separation_m: float) -> bool:
        """Whether these ways may give way to others: none too near, or at least neither nearer than before nor ending
        nearer, lest two that are driven together by the wind are led together by and by.
        """
        apart_m = other.apart_m()
        too_near = apart_m < other.needed_m(separation_m)
        if not too_near.any():
            return True
        is_nearer = apart_m < self.apart_m() - ROUNDING_M
        ends_nearer = (other.ends_apart_m() < self.ends_apart_m() - ROUNDING_M).any(axis=0)
        return not bool((too_near & (is_nearer | ends_nearer)).any())

    def blocked(self, separation_m: float) -> Flags:
        """Which of the vehicles would come too near to another if both went on, and nearer than they are [tracker]."""
        apart_m = self.apart_m()
        now_m = np.linalg.norm(self.start_m[_ONE] - self.start_m[_OTHER], axis=1)
        pairs = (apart_m < separation_m) & (apart_m < now_m - ROUNDING_M)
        found = np.zeros(NUM_TRACKERS, dtype=np.bool_)
        found[_VEHICLE[_ONE[pairs]]] = found[_VEHICLE[_OTHER[pairs]]] = True
        return found


def stopping_m(velocity_mps: Points) -> Points:
    """How far vehicles get that are to stop [tracker, 3]."""
    speed_mps = np.linalg.norm(velocity_mps, axis=1, keepdims=True)
    return np.asarray(velocity_mps * (REACTION_S + speed_mps / (2 * BRAKING_MPS2)))


def _stray_m(way_m: Points, velocity_mps: Points) -> Levels:
    """What it takes to stop flying beside the way, or against it: v^2 / 2a."""
    length_m = np.linalg.norm(way_m, axis=1, keepdims=True)
    direction = way_m / np.where(length_m > 0, length_m, 1.0)
    along_mps = (velocity_mps * direction).sum(axis=1, keepdims=True)
    beside_mps = velocity_mps - np.maximum(along_mps, 0.0) * direction
    return np.asarray((beside_mps**2).sum(axis=1) / (2 * BRAKING_MPS2))


def segments_apart_m(one_m: Points, one_end_m: Points, other_m: Points, other_end_m: Points) -> Levels:
    """The least distance of each two segments (Ericson, Real-Time Collision Detection, 5.1.9)."""
    # Axis by axis: it takes half the time.
    one_m, one_end_m, other_m, other_end_m = (
        np.ascontiguousarray(ends_m.T) for ends_m in (one_m, one_end_m, other_m, other_end_m)
    )
    one_way_m, other_way_m, between_m = one_end_m - one_m, other_end_m - other_m, one_m - other_m
    a, e = (one_way_m * one_way_m).sum(axis=0), (other_way_m * other_way_m).sum(axis=0)
    b, c, f = (
        (x * y).sum(axis=0) for x, y in ((one_way_m, other_way_m), (one_way_m, between_m), (other_way_m, between_m))
    )
    determinant = a * e - b * b
    is_skew = determinant > 1e-12 * a * e
    s = np.where(is_skew, (b * f - c * e) / np.where(is_skew, determinant, 1.0), 0.0)
    s = np.minimum(np.maximum(s, 0.0), 1.0)
    t = np.minimum(np.maximum((b * s + f) / np.where(e > 0, e, 1.0), 0.0), 1.0)
    s = np.minimum(np.maximum((b * t - c) / np.where(a > 0, a, 1.0), 0.0), 1.0)
    apart_m = between_m + s * one_way_m - t * other_way_m
    return np.asarray(np.sqrt((apart_m * apart_m).sum(axis=0)))
