"""Where a vehicle that is led along a way should be at each moment, and how fast: what an autopilot is to be told so
that it flies as the controller takes it that vehicles do.
"""

import math

from ...link.messages import Metres

TURNING_SHARE = 0.8
"""Of what it may change its velocity by, with so much it brakes before the place where it is to rest; the rest is for
turning."""
GAIN_HZ = 2.0
"""Nearer to that place than it flies in 1 / this it slows down evenly."""
LONGEST_STEP_S = 0.25
"""A process that stood still does not make up for it."""
MOST_ASTRAY_M = 8.0
"""A vehicle that is further from it is not waited for: it begins anew where that is."""


class WayPoint:
    """A point that flies towards the place where its vehicle is to rest, as fast as it can brake from before it
    (v^2 = 2 b d). It begins where the vehicle is, and as fast as that is.
    """

    def __init__(self, position_m: Metres, velocity_mps: Metres, now_ns: int) -> None:
        self.position_m, self.velocity_mps = position_m, velocity_mps
        self._now_ns = now_ns

    def is_astray(self, vehicle_m: Metres) -> bool:
        """Whether the vehicle is not with it."""
        return math.dist(vehicle_m, self.position_m) > MOST_ASTRAY_M

    def fly(self, rest_m: Metres, braking_mps2: float, now_ns: int) -> None:
        """Until now."""
        seconds = min((now_ns - self._now_ns) / 1e9, LONGEST_STEP_S)
        self._now_ns = now_ns
        if seconds <= 0:
            return
        way_m = tuple(there - here for here, there in zip(self.position_m, rest_m, strict=True))
        distance_m = math.hypot(*way_m)
        # In the midst of the step: at its beginning it would brake too late.
        left_m = max(distance_m - math.hypot(*self.velocity_mps) * seconds / 2, 0.0)
        wanted_mps = min(math.sqrt(2 * braking_mps2 * left_m), GAIN_HZ * left_m)
        change_mps = tuple(
            wanted_mps * part_m / max(distance_m, 1e-9) - now_mps
            for part_m, now_mps in zip(way_m, self.velocity_mps, strict=True)
        )
        share = min(1.0, braking_mps2 / TURNING_SHARE * seconds / max(math.hypot(*change_mps), 1e-9))
        east_mps, north_mps, up_mps = (
            now + share * change for now, change in zip(self.velocity_mps, change_mps, strict=True)
        )
        east_m, north_m, up_m = (
            here + (before + after) / 2 * seconds
            for here, before, after in zip(
                self.position_m, self.velocity_mps, (east_mps, north_mps, up_mps), strict=True
            )
        )
        self.position_m, self.velocity_mps = (east_m, north_m, up_m), (east_mps, north_mps, up_mps)

    def rest_m(self, braking_mps2: float) -> Metres:
        """Where it comes to rest if it brakes now."""
        share_s = math.hypot(*self.velocity_mps) / (2 * braking_mps2)
        east_m, north_m, up_m = (
            here + share_s * speed for here, speed in zip(self.position_m, self.velocity_mps, strict=True)
        )
        return east_m, north_m, up_m
