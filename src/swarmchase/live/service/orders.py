"""What vehicles that fly are told: where they come to rest if they brake now, and for how long that place moves on; and
what each may have heard last of all that was sent.
"""

import bisect
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...scenario import NUM_TRACKERS
from .sample_window import Levels, Point, Points

LONGEST_VALID_S = 2.0
"""No set-point is valid for longer."""
NUM_UNHEARD = 3
"""So many of the set-points that may be the last that a vehicle has heard stand for all of them."""
KEPT_S = 3.0
"""What was sent longer ago nobody obeys any more: then trackers miss the controller (``AgentSettings``) and brake."""


@dataclass(frozen=True)
class Braking:
    """How the vehicles of a swarm brake and turn."""

    nominal_mps2: float
    """With which they brake before their set-points."""
    most_mps2: float
    """The most that their velocity changes in a second."""

    def rest_m(self, velocity_mps: Points) -> Points:
        """How far they get until they rest [..., 3]."""
        speed_mps = np.sqrt((velocity_mps * velocity_mps).sum(axis=-1, keepdims=True))
        return np.asarray(velocity_mps * (speed_mps / (2 * self.nominal_mps2)))


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
        """Where these places are so long from now [..., set, tracker, 3], the moments being [..., tracker]."""
        moved_s = np.minimum(np.maximum(after_s[..., None, :] + self.since_s, 0.0), self.valid_s)
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

    def turned(self, axes: npt.NDArray[np.float64]) -> "Orders":
        """The same in a frame of these axes [xyz, axis]."""
        return Orders(self.rest_m @ axes, self.velocity_mps @ axes, self.valid_s, self.since_s)


@dataclass(frozen=True, eq=False)
class _Sent:
    time_ns: int
    rest_m: Points
    velocity_mps: Point
    valid_s: Levels


class Told:
    """What was sent of late."""

    def __init__(self) -> None:
        self._sent: list[_Sent] = []

    def note(self, now_ns: int, rest_m: Points, onward: Onward | None) -> None:
        """It is sent now."""
        moves_on = (np.zeros(3), np.zeros(NUM_TRACKERS)) if onward is None else (onward.velocity_mps, onward.valid_s)
        self._sent.append(_Sent(now_ns, rest_m, *moves_on))
        while now_ns - self._sent[0].time_ns > KEPT_S * 1e9:
            del self._sent[0]

    def older(self, now_ns: int, obeyed_ns: Sequence[int | None]) -> Orders:
        """What each may have heard last instead of what is sent now: of all that was sent since it was last known to
        obey, those that differ most in where they stand and where they move on to. Every one counts: one that moves on
        may stand between two that do not.

        The oldest is chosen, then the one that is farthest from the newest and all that are chosen (Gonzalez 1985,
        Clustering to minimize the maximum intercluster distance).

        Args:
            obeyed_ns: When that was sent, of each; None where it is not known.
        """
        if not self._sent:
            shape = NUM_UNHEARD, NUM_TRACKERS
            return Orders(np.full((*shape, 3), np.nan), np.zeros((*shape, 3)), np.zeros(shape), np.zeros(shape))
        sent, is_possible = self._since(now_ns, obeyed_ns)
        rest_m, tracker = sent.rest_m, np.arange(NUM_TRACKERS)
        end_m = rest_m + sent.velocity_mps * sent.valid_s[..., None]
        oldest = is_possible.argmax(axis=0)
        newest = len(rest_m) - 1 - is_possible[::-1].argmax(axis=0)

        def apart_m2(number: npt.NDArray[np.int64]) -> Levels:
            """Squared, from these set-points to all [set-point, tracker]; below 0 to those that cannot be."""
            square_m2 = ((rest_m - rest_m[number, tracker]) ** 2 + (end_m - end_m[number, tracker]) ** 2).sum(axis=2)
            return np.where(is_possible, square_m2, -1.0)

        chosen = [oldest]
        left_m2 = np.minimum(apart_m2(oldest), apart_m2(newest))
        while len(chosen) < NUM_UNHEARD:
            chosen.append(left_m2.argmax(axis=0))
            left_m2 = np.minimum(left_m2, apart_m2(chosen[-1]))
        of_each = np.array(chosen)
        return Orders(
            *(one[of_each, tracker] for one in (sent.rest_m, sent.velocity_mps, sent.valid_s, sent.since_s)),
        )

    def nearest_m(self, now_ns: int, obeyed_ns: Sequence[int | None], place_m: Points) -> Points:
        """Of all that each may have heard last, where those set-points are now, the one next to this place [tracker,
        3]; NaN where nothing was sent, or the place is not known.

        Args:
            obeyed_ns: As of ``older``.
        """
        if not self._sent:
            return np.full((NUM_TRACKERS, 3), np.nan)
        sent, is_possible = self._since(now_ns, obeyed_ns)
        now_m = sent.rest_at_m(np.zeros(NUM_TRACKERS))
        off_m2 = np.where(is_possible, ((now_m - place_m) ** 2).sum(axis=2), np.inf)
        off_m2 = np.nan_to_num(off_m2, nan=np.inf)
        nearest_m = now_m[off_m2.argmin(axis=0), np.arange(NUM_TRACKERS)]
        return np.where(np.isfinite(off_m2.min(axis=0))[:, None], nearest_m, np.nan)

    def _since(self, now_ns: int, obeyed_ns: Sequence[int | None]) -> tuple[Orders, npt.NDArray[np.bool_]]:
        """What was sent since the first of them was last known to obey, and which of it each may have heard last
        [set-point, tracker].
        """
        first = np.array([0 if time_ns is None else self._sent_before(time_ns) for time_ns in obeyed_ns])
        skipped = int(first.min())
        sent = self._sent[skipped:]
        rest_m, age_s = np.array([one.rest_m for one in sent]), np.array([(now_ns - one.time_ns) / 1e9 for one in sent])
        orders = Orders(
            rest_m,
            np.repeat(np.array([one.velocity_mps for one in sent])[:, None], NUM_TRACKERS, axis=1),
            np.array([one.valid_s for one in sent]),
            np.repeat(age_s[:, None], NUM_TRACKERS, axis=1),
        )
        return orders, (np.arange(len(sent))[:, None] >= first - skipped) & np.isfinite(rest_m[..., 0])

    def _sent_before(self, time_ns: int) -> int:
        """The number of the newest of what was sent up to this moment, or else of the oldest that is known."""
        number = bisect.bisect_right(self._sent, time_ns, key=lambda sent: sent.time_ns)
        return max(number - 1, 0)
