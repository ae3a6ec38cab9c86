"""Staying with a target that flies, once it is reached: where to fly instead of where the controller says, which is at
full speed to where it takes the target to be, and so past it.

The centre is to be as fast as the target, and come nearer to it no faster than it can brake from: v^2 = 2 b d.
"""

import math

import numpy as np

from ...scenario import Scenario
from .chase_state import FollowedShare
from .sample_window import Point
from .shortening import shortened

FOLLOWING_M = 10.0
"""A target that is believed to be no further from the centre is followed; the evaluation has the same distance."""
BRAKING_SHARE = 0.6
"""Of the scenario's acceleration: the rest is for the target's turns."""
SETTLING_S = 1.0
"""Nearer than the swarm flies in it it slows down evenly."""


class Following:
    """Counts for how much of the time since the target was first reached the swarm has been with it."""

    def __init__(self, scenario: Scenario) -> None:
        self._decision_s, self._speed_mps = scenario.decision_s, scenario.tracker_speed_mps
        self._braking_mps2 = BRAKING_SHARE * (scenario.tracker_acceleration_mps2 or math.inf)
        self._decisions = self._near = 0
        self._is_near = False

    @property
    def seconds(self) -> float:
        """Since the target was first reached, by the decisions that were made."""
        return self._decisions * self._decision_s

    @property
    def told(self) -> FollowedShare | None:
        """What there is to be told of it; None before the first decision."""
        if not self._decisions:
            return None
        return FollowedShare(self.seconds, self._near / self._decisions, FOLLOWING_M, self._is_near)

    def count(self, distance_m: float) -> None:
        """At a decision the target is believed to be so far from the centre."""
        self._decisions += 1
        self._is_near = distance_m <= FOLLOWING_M
        self._near += self._is_near

    def displacement_m(self, target_m: Point, target_mps: Point, center_m: Point) -> Point:
        """Of the centre, which is here now, in one interval.

        Args:
            target_m: Where the target is believed to be now.
        """
        way_m = target_m + target_mps * self._decision_s / 2 - center_m
        distance_m = float(np.linalg.norm(way_m))
        nearing_mps = min(math.sqrt(2 * self._braking_mps2 * distance_m), distance_m / SETTLING_S)
        wanted_mps = target_mps + nearing_mps / max(distance_m, 1e-9) * way_m
        return shortened(wanted_mps, self._speed_mps) * self._decision_s
