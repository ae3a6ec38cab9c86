"""A second look, once and from further away, at a target that is not called reached because two transmitters may be
heard.

Samples taken beside it tell nothing of that (``second_transmitter``), so a suspicion that came by chance would last as
long as the swarm stays there. On a circle around the target all samples count, and another transmitter, if there is
one, is louder against this one. When ``LOOK_S`` have passed, or two are suspected no more, the swarm comes back, for
the operator to see which one it is.

Radius and time were set on the five of 1,660 flights with one transmitter in which two were suspected to the end, and
on 12 flights each with another one 80, 150 and 300 m away. docs/live.md has what came of it.
"""

import math

import numpy as np

from ...scenario import Scenario
from .safety import SafetyLimits
from .sample_window import Point
from .search import ahead_m
from .shortening import shortened

LOOK_S = 30.0
RADIUS_M = 40.0
SPEED_SHARE = 0.8
"""Of the trackers' speed, with which they fly around the target; the rest is for flying with it."""


class SecondLook:
    """Of one chase."""

    def __init__(self, scenario: Scenario, limits: SafetyLimits) -> None:
        self._limits, self._decision_s = limits, scenario.decision_s
        self._longest_m = scenario.tracker_speed_mps * scenario.decision_s
        self._left: int | None = None
        """Decisions; None: it has not begun."""
        self._turned_rad: float | None = None
        """How far along the circle; it begins on the side on which the swarm is."""

    @property
    def is_on(self) -> bool:
        """Whether it has begun, and lasts."""
        return bool(self._left)

    def begin(self) -> None:
        """The target would be reached but for the other transmitter. Nothing the second time."""
        if self._left is None:
            self._left = round(LOOK_S / self._decision_s)

    def displacement_m(self, target_m: Point, target_mps: Point, center_m: Point, spacing_m: float) -> Point:
        """Of the centre, which is here now, in the next interval of it; in the shared frame.

        Args:
            target_m: Where the target is believed to be now.
            spacing_m: By so much the centre stays inside the limits, as the formation is wide.
        """
        assert self._left
        self._left -= 1
        low_m, high_m = self._limits.low_m + spacing_m, self._limits.high_m - spacing_m

        def point_m(turned_rad: float) -> Point:
            out_m = RADIUS_M * np.array([math.cos(turned_rad), math.sin(turned_rad), 0.0])
            return np.asarray(np.clip(target_m + out_m, low_m, high_m))

        if self._turned_rad is None:
            east_m, north_m, _ = center_m - target_m
            self._turned_rad = math.atan2(north_m, east_m)
        way_m, self._turned_rad = ahead_m(point_m, self._turned_rad, center_m, SPEED_SHARE * self._longest_m)
        return shortened(way_m + target_mps * self._decision_s, self._longest_m)
