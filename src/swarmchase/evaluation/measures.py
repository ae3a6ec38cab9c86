"""What is seen on the way of a chase: how long the swarm stays with the target, and what the controller's belief is
worth. Its region covers much where it knows nothing, so coverage, radius and error stand together.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scenario import Scenario
from .play import Step
from .statistics import nearest_rank_percentile

FOLLOWING_RADIUS_M = 10.0
"""A target nearer than this to the centre is followed."""
FOLLOWED_S = 30.0
"""Who has followed for so long without a break is counted."""
BELIEF_AFTER = (10, 20, 40, 80)
"""The belief's error is told after so many seconds, or movements where chases are measured by these."""


def following_s(moment_s: NDArray[np.float64], distance_m: NDArray[np.float64]) -> float:
    """The longest time without a break within ``FOLLOWING_RADIUS_M``.

    Args:
        moment_s: [moment], none before the one before it.
        distance_m: [moment], which changes evenly from each moment to the next.
    """
    is_near = distance_m <= FOLLOWING_RADIUS_M
    crossing = np.flatnonzero(is_near[1:] != is_near[:-1])
    way_m = distance_m[crossing + 1] - distance_m[crossing]
    share = (FOLLOWING_RADIUS_M - distance_m[crossing]) / way_m
    crossing_s = moment_s[crossing] + share * (moment_s[crossing + 1] - moment_s[crossing])
    edges_s = np.concatenate([moment_s[:1][is_near[:1]], crossing_s, moment_s[-1:][is_near[-1:]]])
    # In and out by turns.
    return float(np.max(edges_s[1::2] - edges_s[::2], initial=0.0))


@dataclass(frozen=True)
class Track:
    """What has been seen of one chase so far: an array a movement, or a number a decision."""

    moment_s: list[NDArray[np.float64]] = field(default_factory=list)
    distance_m: list[NDArray[np.float64]] = field(default_factory=list)
    clock: list[float] = field(default_factory=list)
    """Of each decision: seconds or movements."""
    is_held: list[bool] = field(default_factory=list)
    """Whether the target was inside the belief's region."""
    radius_m: list[float] = field(default_factory=list)
    error_m: list[float] = field(default_factory=list)

    def measures(self) -> dict[str, Any]:
        """Those of ``ChaseResult``; nothing of what was not seen."""
        following, belief = {}, {}
        if self.moment_s:
            following["following_s"] = following_s(np.concatenate(self.moment_s), np.concatenate(self.distance_m))
        if self.clock:
            belief = {
                "belief_decisions": len(self.clock),
                "belief_held": sum(self.is_held),
                "belief_radius_m": nearest_rank_percentile(self.radius_m, 50),
                "belief_error_m": nearest_rank_percentile(self.error_m, 50),
                **{f"belief_error_{after}_m": self._error_m(after) for after in BELIEF_AFTER},
            }
        return following | belief

    def _error_m(self, after: int) -> float | None:
        """Of the first decision then; None where the chase had ended."""
        number = int(np.searchsorted(self.clock, after - 1e-9))
        return self.error_m[number] if number < len(self.clock) else None


class Tracks:
    """Those of the chases at work."""

    def __init__(self, scenario: Scenario) -> None:
        self._follows = scenario.follow_s > 0
        self._by_the_clock = scenario.is_told_in_seconds
        self._of: dict[int, Track] = {}

    def see(self, step: Step) -> None:
        """One movement of every chase."""
        tracks = [self._of.setdefault(chase, Track()) for chase in step.chases]
        if self._follows:
            moment_s, distance_m = step.outcome.moment_s.cpu().numpy(), step.outcome.distance_m.cpu().numpy()
            for row, track in enumerate(tracks):
                track.moment_s.append(moment_s[row])
                track.distance_m.append(distance_m[row])
        if step.belief is not None:
            target_m, before = step.before.target_position_m, step.before
            is_held, radius_m = step.belief.holds(target_m).tolist(), step.belief.radius_m.tolist()
            error_m = step.belief.error_m(target_m).tolist()
            clock = (before.time_s if self._by_the_clock else before.movements).tolist()
            for row, track in enumerate(tracks):
                track.clock.append(clock[row])
                track.is_held.append(is_held[row])
                track.radius_m.append(radius_m[row])
                track.error_m.append(error_m[row])

    def end(self, chase: int) -> dict[str, Any]:
        """The measures of a chase that has ended."""
        return self._of.pop(chase).measures()
