"""A vehicle that is computed: a point with a limited speed and a limited acceleration."""

import math
from dataclasses import dataclass

from ....errors import InputError
from ....ranges import POSITIVE, ranged, require_ranges
from ...link.messages import Metres, PositionReport, TrackerMode, VehicleState
from .kind import VehicleDetails, VehicleKind
from .protocol import Said

LONGEST_STEP_S = 0.02
LONGEST_UPDATE_S = 1.0
"""Of simulated time: after a longer pause the vehicle has stood still for the rest of it."""
ARRIVED_M, ARRIVED_MPS = 0.001, 0.05
"""Nearer and slower than this it is put on the set-point itself."""


@dataclass(frozen=True)
class VehicleLimits:
    """How fast it may be.

    Raises:
        InputError: a limit that is not above 0.
    """

    speed_mps: float = ranged(5.0, POSITIVE)
    acceleration_mps2: float = ranged(5.0, POSITIVE)

    def __post_init__(self) -> None:
        require_ranges(self)


class SimulatedVehicle:
    """Starts at rest and flies straight to where it is told to, braking in time."""

    def __init__(self, position_m: Metres, limits: VehicleLimits | None = None) -> None:
        self._limits = limits or VehicleLimits()
        self._position_m = position_m
        self._velocity_mps: Metres = (0.0, 0.0, 0.0)
        self._target_m: Metres | None = None
        self._manual = False
        self._now_ns: int | None = None

    @property
    def position_m(self) -> Metres:
        """Where it is."""
        return self._position_m

    @property
    def position_age_s(self) -> float:
        """None: it knows where it is."""
        return 0.0

    @property
    def velocity_mps(self) -> Metres:
        """How fast it is."""
        return self._velocity_mps

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

    def said(self) -> list[Said]:
        """Nothing."""
        return []

    def go_to(self, position_m: Metres) -> None:
        """Fly there."""
        if not self._manual:
            self._target_m = position_m

    def hold(self) -> None:
        """Brake, and stay there."""
        self._target_m = None

    def take_over(self) -> None:
        """A pilot takes it, and brakes."""
        self._manual, self._target_m = True, None

    def give_back(self) -> None:
        """The pilot gives it back."""
        self._manual = False

    def update(self, now_ns: int) -> None:
        """Fly until now."""
        passed_s = 0.0 if self._now_ns is None else (now_ns - self._now_ns) / 1e9
        self._now_ns = now_ns
        passed_s = min(passed_s, LONGEST_UPDATE_S)
        steps = math.ceil(passed_s / LONGEST_STEP_S)
        for _ in range(steps):
            self._fly(passed_s / steps)

    def close(self) -> None:
        """Nothing is held."""

    def _fly(self, step_s: float) -> None:
        change_mps = _less(self._wanted_mps(step_s), self._velocity_mps)
        change_mps = _shortened(change_mps, self._limits.acceleration_mps2 * step_s)
        self._velocity_mps = _plus(self._velocity_mps, change_mps)
        self._position_m = _plus(self._position_m, _times(self._velocity_mps, step_s))
        if self._target_m is not None:
            distance_m = math.dist(self._position_m, self._target_m)
            if distance_m < ARRIVED_M and math.hypot(*self._velocity_mps) < ARRIVED_MPS:
                self._position_m, self._velocity_mps = self._target_m, (0.0, 0.0, 0.0)

    def _wanted_mps(self, step_s: float) -> Metres:
        """Towards the target, as fast as it can still brake from: v^2 = 2 a d, of which .8 leaves room for turning."""
        if self._target_m is None:
            return (0.0, 0.0, 0.0)
        way_m = _less(self._target_m, self._position_m)
        distance_m = math.hypot(*way_m)
        if distance_m == 0:
            return (0.0, 0.0, 0.0)
        braking_mps = math.sqrt(2 * 0.8 * self._limits.acceleration_mps2 * distance_m)
        speed_mps = min(self._limits.speed_mps, braking_mps, distance_m / step_s / 2)
        return _times(way_m, speed_mps / distance_m)


def _plus(one: Metres, other: Metres) -> Metres:
    return (one[0] + other[0], one[1] + other[1], one[2] + other[2])


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
