"""A vehicle that is computed: a point with a limited speed and a limited acceleration, and with the habits of real ones
if they are asked for.
"""

import math
from dataclasses import dataclass
from random import Random

from ....errors import InputError
from ....ranges import AT_LEAST_ZERO, POSITIVE, ranged, require_ranges
from ...link.messages import Health, Metres, PositionReport, TrackerMode, VehicleState
from .kind import VehicleDetails, VehicleKind
from .protocol import Said

LONGEST_STEP_S = 0.02
LONGEST_UPDATE_S = 1.0
"""Of simulated time: after a longer pause the vehicle has stood still for the rest of it."""
ARRIVED_M, ARRIVED_MPS = 0.001, 0.05
"""Nearer and slower than this it is put on the set-point itself."""
ERROR_PERIOD_S = 20.0
GUST_S = 2.0
"""So long a gust lasts."""
LAG_GAIN = 0.45
"""With lag it goes for what is left at this share of it in each lag time, as autopilots do, lest it swings."""
LEAST_LAG_S = 0.3
"""No autopilot goes for a place that moves as if it lagged less."""
AT_REST_MPS = 0.2
"""Slower than this it takes its place for the one to stay at."""


@dataclass(frozen=True)
class VehicleLimits:
    """How fast it may be, and how far from ideal. Without lag it fights any gust at once.

    Raises:
        InputError: a speed or an acceleration that is not above 0, or a habit below 0.
    """

    speed_mps: float = ranged(5.0, POSITIVE)
    acceleration_mps2: float = ranged(5.0, POSITIVE)
    lag_s: float = ranged(0.0, AT_LEAST_ZERO)
    """In which it makes two thirds of a change of speed."""
    gusts_mps2: float = ranged(0.0, AT_LEAST_ZERO)
    """What the wind adds to its acceleration (root mean square), beyond what it has got used to. It fights gusts with
    its lag alone: the acceleration above is what it is told to use, and less than it has."""
    position_error_m: float = ranged(0.0, AT_LEAST_ZERO)
    """How far it is from where it takes itself to be, in a direction that turns once in ``ERROR_PERIOD_S``."""

    def __post_init__(self) -> None:
        require_ranges(self)


class SimulatedVehicle:
    """Starts at rest and flies straight to where it is told to, braking in time.

    Args:
        position_m: Where it is.
        random: Its winds and errors.
    """

    def __init__(self, position_m: Metres, limits: VehicleLimits | None = None, random: Random | None = None) -> None:
        self._limits = limits or VehicleLimits()
        self._random = random or Random(0)
        self._true_position_m = position_m
        self._error_m = _times(self._direction(), self._limits.position_error_m)
        self._error_axis = self._direction()
        self._gust_mps2: Metres = (0.0, 0.0, 0.0)
        self._blown_mps: Metres = (0.0, 0.0, 0.0)
        self._rest_m: Metres | None = None
        self._velocity_mps: Metres = (0.0, 0.0, 0.0)
        self._target_m: Metres | None = None
        self._tracked_mps: Metres | None = None
        """How fast it is to be there."""
        self._manual = False
        self._now_ns: int | None = None

    @property
    def position_m(self) -> Metres:
        """Where it takes itself to be, and says that it is."""
        return _plus(self._true_position_m, self._error_m)

    @property
    def true_position_m(self) -> Metres:
        """Where it is."""
        return self._true_position_m

    @property
    def position_age_s(self) -> float:
        """None: it knows where it is."""
        return 0.0

    @property
    def velocity_mps(self) -> Metres:
        """How fast it is."""
        return _plus(self._velocity_mps, self._blown_mps)

    @property
    def mode(self) -> TrackerMode:
        """What it is doing."""
        if self._manual:
            return TrackerMode.MANUAL
        return TrackerMode.HOLDING if self._target_m is None else TrackerMode.FOLLOWING

    @property
    def state(self) -> VehicleState:
        """In the air from the beginning."""
        return VehicleState(is_armed=True, is_airborne=True, is_simulated=True)

    def health(self, tracker: int) -> Health | None:
        """It has no autopilot."""
        return None

    def said(self) -> list[Said]:
        """Nothing."""
        return []

    def go_to(self, position_m: Metres) -> None:
        """Fly there."""
        if not self._manual:
            self._target_m, self._tracked_mps, self._rest_m = position_m, None, None

    def track(self, place_m: Metres, velocity_mps: Metres) -> None:
        """Be there now, as fast as that: what an autopilot has it do that is told both."""
        if not self._manual:
            self._target_m, self._tracked_mps, self._rest_m = place_m, velocity_mps, None

    def hold(self) -> None:
        """Brake, and stay there."""
        self._target_m, self._tracked_mps = None, None

    def take_over(self) -> None:
        """A pilot takes it, and brakes."""
        self._manual, self._target_m, self._tracked_mps = True, None, None

    def give_back(self) -> None:
        """The pilot gives it back."""
        self._manual = False

    def update(self, now_ns: int) -> None:
        """Fly until now."""
        passed_s = 0.0 if self._now_ns is None else (now_ns - self._now_ns) / 1e9
        self._now_ns = now_ns
        if self._stands_still():
            return
        passed_s = min(passed_s, LONGEST_UPDATE_S)
        steps = math.ceil(passed_s / LONGEST_STEP_S)
        for _ in range(steps):
            self._fly(passed_s / steps)

    def close(self) -> None:
        """Nothing is held."""

    def _stands_still(self) -> bool:
        """Whether nothing moves it: in a chase it does so most of the time."""
        limits = self._limits
        if self._velocity_mps != (0.0, 0.0, 0.0) or limits.gusts_mps2 > 0 or limits.position_error_m > 0:
            return False
        return self._tracked_mps is None and self._target_m in {None, self._true_position_m}

    def _fly(self, step_s: float) -> None:
        limits = self._limits
        change_mps = _less(self._wanted_mps(step_s), self._velocity_mps)
        if limits.lag_s > 0:
            change_mps = _times(change_mps, min(step_s / limits.lag_s, 1.0))
        change_mps = _shortened(change_mps, limits.acceleration_mps2 * step_s)
        self._velocity_mps = _plus(self._velocity_mps, change_mps)
        if limits.gusts_mps2 > 0 and limits.lag_s > 0:
            kept = max(1 - step_s / limits.lag_s, 0.0)
            self._blown_mps = _plus(_times(self._blown_mps, kept), _times(self._gust(step_s), step_s))
        if limits.position_error_m > 0:
            self._turn_the_error(step_s)
        self._true_position_m = _plus(self._true_position_m, _times(self.velocity_mps, step_s))
        if self._target_m is not None and self._tracked_mps is None:
            distance_m = math.dist(self.position_m, self._target_m)
            if distance_m < ARRIVED_M and math.hypot(*self._velocity_mps) < ARRIVED_MPS:
                self._true_position_m, self._velocity_mps = _less(self._target_m, self._error_m), (0.0, 0.0, 0.0)

    def _wanted_mps(self, step_s: float) -> Metres:
        """Towards the target, or where it came to rest without one, as fast as it can still brake from: v^2 = 2 a d, of
        which .8 leaves room for turning.
        """
        goal_m = self._resting_m() if self._target_m is None else self._target_m
        if goal_m is None:
            return (0.0, 0.0, 0.0)
        if self._tracked_mps is not None:
            gain_hz = LAG_GAIN / max(self._limits.lag_s, LEAST_LAG_S)
            correction_mps = _times(_less(goal_m, self.position_m), gain_hz)
            return _shortened(_plus(self._tracked_mps, correction_mps), self._limits.speed_mps)
        way_m = _less(goal_m, self.position_m)
        distance_m = math.hypot(*way_m)
        if distance_m == 0:
            return (0.0, 0.0, 0.0)
        speed_mps = min(self._limits.speed_mps, self._braking_mps(distance_m), distance_m / step_s / 2)
        return _times(way_m, speed_mps / distance_m)

    def _braking_mps(self, distance_m: float) -> float:
        """With lag it is slower at the end, and begins to brake earlier."""
        braking_mps2 = 0.8 * self._limits.acceleration_mps2
        if self._limits.lag_s == 0:
            return math.sqrt(2 * 0.8 * self._limits.acceleration_mps2 * distance_m)
        gain_hz = LAG_GAIN / self._limits.lag_s
        linear_m = braking_mps2 / gain_hz**2
        if distance_m <= linear_m:
            return gain_hz * distance_m
        return math.sqrt(2 * braking_mps2 * (distance_m - linear_m / 2))

    def _resting_m(self) -> Metres | None:
        """Where it stays without a target, once it has braked; without wind it stays by itself."""
        if self._limits.gusts_mps2 > 0 and self._rest_m is None and math.hypot(*self._velocity_mps) < AT_REST_MPS:
            self._rest_m = self.position_m
        return self._rest_m

    def _gust(self, step_s: float) -> Metres:
        """The next moment of a process with this root mean square that forgets in ``GUST_S``."""
        share = step_s / GUST_S
        spread_mps2 = self._limits.gusts_mps2 * math.sqrt(2 * share / 3)
        push_mps2 = tuple(self._random.gauss(0.0, spread_mps2) for _ in range(3))
        self._gust_mps2 = _plus(_times(self._gust_mps2, 1 - share), (push_mps2[0], push_mps2[1], push_mps2[2]))
        return self._gust_mps2

    def _turn_the_error(self, step_s: float) -> None:
        """Around its axis, at the same length."""
        turned_m = _plus(
            self._error_m, _times(_cross(self._error_axis, self._error_m), math.tau / ERROR_PERIOD_S * step_s)
        )
        self._error_m = _times(turned_m, self._limits.position_error_m / math.hypot(*turned_m))

    def _direction(self) -> Metres:
        """Any."""
        x, y, z = (self._random.gauss(0.0, 1.0) for _ in range(3))
        length = math.hypot(x, y, z)
        return (x / length, y / length, z / length)


def _plus(one: Metres, other: Metres) -> Metres:
    return (one[0] + other[0], one[1] + other[1], one[2] + other[2])


def _cross(one: Metres, other: Metres) -> Metres:
    return (
        one[1] * other[2] - one[2] * other[1],
        one[2] * other[0] - one[0] * other[2],
        one[0] * other[1] - one[1] * other[0],
    )


def _less(one: Metres, other: Metres) -> Metres:
    return (one[0] - other[0], one[1] - other[1], one[2] - other[2])


def _times(vector: Metres, factor: float) -> Metres:
    return (vector[0] * factor, vector[1] * factor, vector[2] * factor)


def _shortened(vector: Metres, longest: float) -> Metres:
    length = math.hypot(*vector)
    return vector if length <= longest else _times(vector, longest / length)


def _open(_place: str, details: VehicleDetails) -> SimulatedVehicle:
    if details.position_m is None:
        raise InputError("a simulated vehicle starts somewhere: give --position-m X Y Z")
    PositionReport(0, 0, details.position_m)  # refuses what is no position
    return SimulatedVehicle(details.position_m)


KIND = VehicleKind(scheme="simulated", place="", open=_open)
