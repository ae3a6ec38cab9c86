"""When a target that flies is lost, and the search for it.

It is lost when nothing has been heard for ``SILENCE_S``, or when the belief, having once been narrow, has spread: its
95 % region reaches further than ``SPREAD_M``. It is found when something is heard and the belief is narrow again.

While nothing is heard the swarm flies a spiral at full speed around where the target was last believed to be: turn by
turn ``PITCH_M`` further out, ``CLIMB_M`` higher than it was, where less stands in the way, with the widest spacing,
inside the fence. As soon as something is heard the controller leads again, as it does at the beginning.
"""

import math
from collections.abc import Callable

import numpy as np

from ...controllers.belief import Belief
from ...scenario import Scenario
from .safety import SafetyLimits
from .sample_window import Point

SILENCE_S = 5.0
"""Longer than a target that transmits now and then is silent."""
NARROW_M, SPREAD_M = 20.0, 60.0
"""Half the longest axis of the belief's region. In flights that followed 99 % of the regions were within 5 m."""
PITCH_M, CLIMB_M = 60.0, 20.0
FARTHEST_RAD = 400.0 / PITCH_M * 2 * math.pi
"""So far along it, 400 m out, the spiral begins anew."""
FIRST_TURN_RAD = math.pi
"""How far along it is begun: the innermost half turn is too tight to be flown."""
STEP_RAD = 0.05
MOST_STEPS = round(2 * math.pi / STEP_RAD)
"""In an interval: inside a fence that is narrower than the swarm flies in it there is nowhere else."""


class Loss:
    """Whether the target is lost, and why."""

    def __init__(self) -> None:
        self._heard_s: float | None = None
        """The end of the last window with something in it."""
        self._was_narrow = False
        self.reason = ""
        """Empty where it is not."""

    def forget(self) -> None:
        """The swarm has paused: silence counts from now on."""
        self._heard_s = None

    def take(self, ended_s: float, is_heard: bool, belief: Belief | None) -> None:
        """After each window: when it ended, whether anybody heard anything in it, what is believed after it."""
        if is_heard or self._heard_s is None:
            self._heard_s = ended_s
        radius_m = 0.0 if belief is None else float(belief.radius_m[0])
        if self.reason:
            if is_heard and radius_m <= NARROW_M:
                self.reason, self._was_narrow = "", True
        elif ended_s - self._heard_s >= SILENCE_S:
            self.reason = f"nothing has been heard of it for {SILENCE_S:g} s"
        elif self._was_narrow and radius_m > SPREAD_M:
            self.reason = f"it may be {radius_m:.0f} m from where it is believed to be"
        self._was_narrow = (self._was_narrow or radius_m <= NARROW_M) and not self.reason


class Spiral:
    """Around one place. Metres are of the shared frame."""

    def __init__(self, scenario: Scenario, limits: SafetyLimits, middle_m: Point) -> None:
        self._limits, self._middle_m = limits, middle_m + np.array([0.0, 0.0, CLIMB_M])
        self.spacing_m = max(scenario.spacing_choices_m)
        """The widest."""
        self._step_m = scenario.tracker_speed_mps * scenario.decision_s
        self._turned_rad = FIRST_TURN_RAD

    def displacement_m(self, center_m: Point) -> Point:
        """Of the centre, which is here now, in one interval."""
        way_m, self._turned_rad = ahead_m(self._point_m, self._turned_rad, center_m, self._step_m)
        if self._turned_rad > FARTHEST_RAD:
            self._turned_rad = FIRST_TURN_RAD
        return way_m

    def _point_m(self, turned_rad: float) -> Point:
        """Of the spiral, as far as it is flown."""
        radius_m = PITCH_M * turned_rad / (2 * math.pi)
        turn = np.array([math.cos(turned_rad), math.sin(turned_rad), 0.0])
        point_m = self._middle_m + radius_m * turn
        return np.asarray(np.clip(point_m, self._limits.low_m + self.spacing_m, self._limits.high_m - self.spacing_m))


def ahead_m(
    point_m: Callable[[float], Point], turned_rad: float, center_m: Point, step_m: float
) -> tuple[Point, float]:
    """The way of the centre, which is here now, in one interval along a way round something; and how far along it is
    then.

    Args:
        point_m: Of the way, so far along it.
        turned_rad: Nothing before here is flown to.
        step_m: The length of what is flown.
    """
    way_m = point_m(turned_rad) - center_m
    for _ in range(MOST_STEPS):
        if np.linalg.norm(way_m[:2]) >= step_m:
            break
        turned_rad += STEP_RAD
        way_m = point_m(turned_rad) - center_m
    return np.asarray(way_m * step_m / max(float(np.linalg.norm(way_m)), 1e-9)), turned_rad
