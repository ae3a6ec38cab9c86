"""The safety filter: from what a controller wants to way-points that keep to the operator's limits.

``SafetyFilter.move`` turns a wanted centre and spacing into legs: straight lines that all trackers fly at the same
share of their way. Fence and altitudes move the centre and keep the shape; a spacing that is too narrow is widened; a
way on which two trackers, or a tracker and one that is not commanded, would come nearer than the least separation is
flown in turns or by a detour, or with another spacing, or beside the wanted centre, or not at all. ``SetPointStream``
then streams the legs at the permitted speed and checks at every step where the vehicles are and may get.

Set-points are planned ``ROOM_M`` further apart than the vehicles' ways must be, so that vehicles need not be exactly
where they should: without room nobody who flies behind another could ever set out first.

Where the trackers are outside the limits already, nothing may get worse: none gets further out on any axis, and no pair
that is too near comes nearer.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ...ranges import require_ranges
from ..link.messages import FARTHEST_M
from .limit_values import LimitValues
from .sample_window import Point, Points
from .separation import ROUNDING_M

Legs = tuple[Points, ...]

TRACKER_DIRECTION = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
"""As in ``swarmchase.formation``, which needs torch."""
NEIGHBOUR_DISTANCE = math.sqrt(2)
"""Of two trackers on different axes, per metre of spacing: the nearest of any two in the formation."""
ROOM_M = 0.4
"""So much further than the least separation set-points are planned apart. The paper's narrowest formation has it at the
default limit: sqrt(2) m between neighbours."""
PLANNING_MARGIN_M = 1e-6
"""Lest rounding stops a flight, they are planned so much further apart again."""
DETOURS = (2.0, 4.0)
"""Ways around an obstacle lead aside by so many separations."""


@dataclass(frozen=True)
class SafetyLimits(LimitValues):
    """The operator's limits, checked.

    Raises:
        InputError: a limit that cannot be, or an empty room.
    """

    def __post_init__(self) -> None:
        require_ranges(self)
        if not (self.low_m < self.high_m).all():
            raise InputError(f"the fence is refused: between {self.low_m} and {self.high_m} there is no room")

    @property
    def low_m(self) -> Point:
        """The lowest x, y and z."""
        return np.array([self.fence_west_m, self.fence_south_m, self.lowest_altitude_m])

    @property
    def high_m(self) -> Point:
        """The highest x, y and z."""
        return np.array([self.fence_east_m, self.fence_north_m, self.highest_altitude_m])


@dataclass(frozen=True)
class Move:
    """What the filter made of an action."""

    center_m: Point
    """Centre of the formation after it, in the shared frame."""
    spacing_m: float
    """Spacing of the formation after it."""
    legs: Legs
    """Way-points [tracker, 3] one after another, NaN where a tracker is not commanded; none if all stay."""
    reason: str
    """Where it differs from what was wanted: how and why; else empty."""


def formation_m(center_m: Point, spacing_m: float, turned_rad: float = 0.0) -> Points:
    """Where the six trackers are around their centre, their cross having turned so far."""
    return center_m + spacing_m * cross(turned_rad)


def cross(turned_rad: float = 0.0) -> Points:
    """Which way each tracker is from the centre [tracker, 3]: ``formation.turned_direction``."""
    cos, sin = math.cos(turned_rad), math.sin(turned_rad)
    return np.asarray(TRACKER_DIRECTION @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]))


def is_clear(start_m: Points, end_m: Points, obstacles_m: Points, separation_m: float, room_m: float = 0.0) -> bool:
    """Whether trackers on straight synchronous ways keep their separation, and the room beyond it, from one another and
    from the obstacles. A pair that begins without the room keeps the separation; one that is too near already must not
    come nearer.

    Rows of NaN are trackers that do not count.
    """
    counts = np.isfinite(start_m).all(axis=1) & np.isfinite(end_m).all(axis=1)
    start_m, end_m = start_m[counts], end_m[counts]
    one, other = np.triu_indices(len(start_m), 1)
    apart_m = np.concatenate([start_m[one] - start_m[other], (start_m[:, None] - obstacles_m).reshape(-1, 3)])
    apart_at_end_m = np.concatenate([end_m[one] - end_m[other], (end_m[:, None] - obstacles_m).reshape(-1, 3)])
    change_m = apart_at_end_m - apart_m
    squared = (change_m**2).sum(axis=1)
    share = np.clip(-(apart_m * change_m).sum(axis=1) / np.where(squared > 0, squared, 1.0), 0.0, 1.0)
    least_m = np.linalg.norm(apart_m + share[:, None] * change_m, axis=1)
    begins_m = np.linalg.norm(apart_m, axis=1)
    whole_m = separation_m + room_m
    needed_m = np.where(begins_m >= whole_m, whole_m, np.minimum(separation_m, begins_m))
    return bool((least_m >= needed_m - ROUNDING_M).all())


def is_inside(limits: SafetyLimits, start_m: Points, end_m: Points) -> bool:
    """Whether trackers that go from start to end end inside the fence, or no further out than they are."""
    out = (end_m < np.minimum(limits.low_m, start_m)) | (end_m > np.maximum(limits.high_m, start_m))
    return not bool(out.any())


class SafetyFilter:
    """After every controller: nothing outside the limits gets through, whatever the controller wants."""

    def __init__(self, limits: SafetyLimits, spacing_choices_m: tuple[float, ...]) -> None:
        self.limits = limits
        self._spacing_choices_m = sorted(spacing_choices_m)
        self._separation_m = limits.minimum_separation_m + ROOM_M + PLANNING_MARGIN_M

    def move(
        self,
        present: Move,
        wanted_center_m: Point,
        wanted_spacing_m: float,
        set_point_m: Points,
        position_m: Points,
        obstacles_m: Points,
    ) -> Move:
        """The nearest permitted thing to the wanted move.

        Args:
            present: What the trackers hold now: its centre and spacing remain if they must stay.
            wanted_center_m: Any three numbers, finite or not.
            wanted_spacing_m: Any number.
            set_point_m: Where each tracker is told to be now [tracker, 3]; NaN where it is not commanded.
            position_m: Where each is [tracker, 3].
            obstacles_m: Where those are that are not commanded [obstacle, 3].
        """
        if not (np.isfinite(wanted_center_m).all() and math.isfinite(wanted_spacing_m)):
            return self._stay(present, "the wanted move is no number")
        # Squares of what is left are finite.
        wanted_center_m = np.clip(wanted_center_m, -2 * FARTHEST_M, 2 * FARTHEST_M)
        wanted_spacing_m = min(max(wanted_spacing_m, 0.0), FARTHEST_M)
        least_m, most_m = self.spacing_range_m()
        if least_m > most_m:
            return self._stay(present, "the fence has no room for the formation")
        spacing_m = min(max(wanted_spacing_m, least_m), most_m)
        center_m = self._fenced_m(wanted_center_m, spacing_m)
        limited = _differences(wanted_center_m, wanted_spacing_m, center_m, spacing_m)
        limited = [f"{one}{_limits_met(wanted_center_m, center_m)}" if "centre" in one else one for one in limited]
        starts_m = (set_point_m, position_m)
        for other_center_m, other_spacing_m in self._alternatives(center_m, spacing_m, least_m, most_m):
            end_m = np.where(np.isfinite(set_point_m), formation_m(other_center_m, other_spacing_m), np.nan)
            found = self._way(starts_m, end_m, obstacles_m)
            if found is not None:
                legs, how = found
                changed = _differences(center_m, spacing_m, other_center_m, other_spacing_m)
                evaded = [f"{reason} to keep the separation" for reason in (*changed, *how)]
                return Move(other_center_m, other_spacing_m, legs, "; ".join([*limited, *evaded]))
        return self._stay(present, "every way would come too near to another tracker")

    def _stay(self, present: Move, why: str) -> Move:
        return Move(present.center_m, present.spacing_m, (), f"all stay where they are: {why}")

    def spacing_range_m(self) -> tuple[float, float]:
        """The narrowest formation that keeps the separation and the widest that has room inside the fence."""
        room_m = float((self.limits.high_m - self.limits.low_m).min())
        return self._separation_m / NEIGHBOUR_DISTANCE + PLANNING_MARGIN_M, room_m / 2 - PLANNING_MARGIN_M

    def _fenced_m(self, center_m: Point, spacing_m: float) -> Point:
        """The nearest centre from which the whole formation is inside the fence."""
        reach_m = spacing_m + ROUNDING_M
        return np.clip(center_m, self.limits.low_m + reach_m, self.limits.high_m - reach_m)

    def _alternatives(
        self, center_m: Point, spacing_m: float, least_m: float, most_m: float
    ) -> Iterator[tuple[Point, float]]:
        """The wanted centre and spacing, then other spacings there, wider ones first, then centres beside it."""
        yield center_m, spacing_m
        choices_m = [choice_m for choice_m in self._spacing_choices_m if least_m <= choice_m <= most_m]
        wider_m = [choice_m for choice_m in choices_m if choice_m > spacing_m]
        narrower_m = [choice_m for choice_m in reversed(choices_m) if choice_m < spacing_m]
        for choice_m in wider_m + narrower_m:
            if np.array_equal(self._fenced_m(center_m, choice_m), center_m):
                yield center_m, choice_m
        for aside_m in self._aside_m():
            yield self._fenced_m(center_m + aside_m, spacing_m), spacing_m

    def _aside_m(self) -> Iterator[Point]:
        for separations in DETOURS:
            yield from separations * self._separation_m * TRACKER_DIRECTION

    def _way(
        self, starts_m: tuple[Points, Points], end_m: Points, obstacles_m: Points
    ) -> tuple[Legs, tuple[str, ...]] | None:
        """Legs to this end, and how they differ from a straight way; None if there are none."""
        set_point_m, _ = starts_m
        if self._is_too_near(end_m, obstacles_m):
            return None
        if self._is_permitted(starts_m, (end_m,), obstacles_m):
            return (end_m,), ()
        legs = self._turns(starts_m, end_m, obstacles_m)
        if legs is not None:
            return legs, ("in turns",)
        for aside_m in self._aside_m():
            legs = (set_point_m + aside_m, end_m + aside_m, end_m)
            if self._is_permitted(starts_m, legs, obstacles_m):
                return legs, ("by a detour",)
        return None

    def _is_too_near(self, end_m: Points, obstacles_m: Points) -> bool:
        """Whether an end is nearer to an obstacle than the separation."""
        apart_m = np.linalg.norm(end_m[:, None] - obstacles_m[None], axis=2)
        return bool((apart_m < self._separation_m).any())

    def _is_permitted(self, starts_m: tuple[Points, Points], legs: Legs, obstacles_m: Points) -> bool:
        """Whether all legs keep to the limits, the first one both from the set-points and from the positions."""
        starts = [starts_m, *((leg_m,) for leg_m in legs[:-1])]
        return all(
            is_inside(self.limits, start_m, leg_m)
            and is_clear(start_m, leg_m, obstacles_m, self.limits.minimum_separation_m, ROOM_M + PLANNING_MARGIN_M)
            for leg_starts_m, leg_m in zip(starts, legs, strict=True)
            for start_m in leg_starts_m
        )

    def _turns(self, starts_m: tuple[Points, Points], end_m: Points, obstacles_m: Points) -> Legs | None:
        """One tracker flies after another, whichever has a clear way; None if none has."""
        legs: list[Points] = []
        at_m, really_at_m = (start_m.copy() for start_m in starts_m)
        waiting = np.flatnonzero(np.isfinite(end_m).all(axis=1)).tolist()
        while waiting:
            for tracker in waiting:
                to_m, really_to_m = at_m.copy(), really_at_m.copy()
                to_m[tracker] = really_to_m[tracker] = end_m[tracker]
                if self._is_permitted((at_m, at_m), (to_m,), obstacles_m) and self._is_permitted(
                    (really_at_m, really_at_m), (really_to_m,), obstacles_m
                ):
                    break
            else:
                return None
            waiting.remove(tracker)
            legs.append(to_m)
            at_m, really_at_m = to_m, really_to_m
        return tuple(legs)


def _limits_met(wanted_m: Point, center_m: Point) -> str:
    """Which limits keep a centre from where it is wanted."""
    east_m, north_m, up_m = (center_m - wanted_m).tolist()
    met = ["the fence"] * bool(east_m or north_m) + ["the lowest altitude"] * (up_m > 0)
    return f" to keep {' and '.join(met + ['the highest altitude'] * (up_m < 0))}"


def _differences(one_center_m: Point, one_spacing_m: float, center_m: Point, spacing_m: float) -> list[str]:
    changes = []
    if spacing_m != one_spacing_m:
        changes.append(f"spacing {spacing_m:.3g} m instead of {one_spacing_m:.3g} m")
    if not np.array_equal(center_m, one_center_m):
        changes.append(f"centre moved by {np.linalg.norm(center_m - one_center_m):.3g} m")
    return changes
