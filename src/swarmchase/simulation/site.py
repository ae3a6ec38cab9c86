"""The site: six vehicles, each with a receiver, and the radio between them and the target, from moment to moment."""

import math
import statistics
from functools import partial
from random import Random

import torch

from ..errors import InputError
from ..formation import TRACKER_DIRECTION, turned_direction
from ..live.link.messages import FARTHEST_M, Metres
from ..live.service.safety import SafetyLimits
from ..live.tracker.agent import AgentSettings
from ..live.tracker.sources import Sample
from ..live.tracker.vehicles import SimulatedVehicle
from ..live.tracker.vehicles.simulated import VehicleLimits
from ..scenario import NUM_TRACKERS, Scenario
from ..world.behaviours.protocol import Swarm
from .fault_plan import FaultPlan, VehicleFault
from .radio import Radio, require_simulated
from .radio_in_flight import RadioInFlight, require_flight
from .receivers_gone_wrong import FailingReceiver
from .vehicles_gone_wrong import FailingVehicle

CATCHING_UP = 1.2
"""A vehicle is so many times as fast as a swarm that never stops: else who is behind stays behind."""
TARGETS_ROAM_M = 1500.0
"""So far from its start a target gets before the time is up, at least."""
REPORTS_IN_FLIGHT_HZ = 20.0
"""RSSI messages and positions of each tracker, a second."""
MOST_SAMPLES_MADE_UP = 100
"""A site that stood still for longer leaves samples out."""


class Site:
    """Chase ``chase`` of run ``seed``. The swarm hovers around the origin, with the scenario's initial spacing, and
    hears nothing before ``begin``. ``vehicles`` are flown instead of ideal ones from there.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        chase: int,
        plan: FaultPlan | None = None,
        vehicles: list[SimulatedVehicle] | None = None,
    ) -> None:
        flies = scenario.pace == "listen_in_flight"
        self._success_radius_m = scenario.success_radius_m
        self._plan = plan or FaultPlan()
        require_played(scenario, self._plan)
        second_m = self._plan.second_m
        self.radio = RadioInFlight(scenario, seed, chase, second_m) if flies else Radio(scenario, seed, chase)
        places_m = (scenario.initial_spacing_m * TRACKER_DIRECTION).tolist()
        limits = _vehicle_limits(scenario)
        self.vehicles = vehicles or [SimulatedVehicle((x_m, y_m, z_m), limits) for x_m, y_m, z_m in places_m]
        """They fly where they are told, through ``advance``."""
        self.flown = [
            FailingVehicle(vehicle, partial(self._vehicle_fault, tracker))
            for tracker, vehicle in enumerate(self.vehicles)
        ]
        """The same as their agents have them."""
        self._start_ns: int | None = None
        self._now_ns = 0
        self._period_ns = 1e9 / scenario.sampling_hz
        self._taken = 0
        self._spacing_m, self._turned_rad = scenario.initial_spacing_m, 0.0
        self._receivers = [FailingReceiver(Random(f"{seed} {chase} {tracker}")) for tracker in range(NUM_TRACKERS)]

    def begin(self, now_ns: int) -> None:
        """The target begins to transmit, and the faults' clock to run."""
        self._start_ns = self._now_ns = now_ns

    def advance(self, now_ns: int) -> list[list[Sample]]:
        """Let everything happen until now: what each receiver reports meanwhile."""
        reported: list[list[Sample]] = [[] for _ in range(NUM_TRACKERS)]
        if self._start_ns is not None:
            due = int((now_ns - self._start_ns) / self._period_ns)
            self._taken = max(self._taken, due - MOST_SAMPLES_MADE_UP)
            while self._taken < due:
                self._taken += 1
                self._sample(self._start_ns, round(self._taken * self._period_ns), reported)
        self._now_ns = now_ns
        self._fly(now_ns)
        return reported

    def _sample(self, start_ns: int, after_ns: int, reported: list[list[Sample]]) -> None:
        """So long after the start."""
        time_ns = start_ns + after_ns
        self._fly(time_ns)
        position_m = torch.tensor(self.positions_m(), dtype=torch.float64)
        if isinstance(self.radio, RadioInFlight):
            faults = self._plan.of_target(after_ns / 1e9)
            heard_dbm = self.radio.heard_dbm(time_ns, position_m, self._swarm(), faults)
        else:
            heard_dbm = self.radio.heard_dbm(time_ns, position_m)
        for tracker, level_dbm in enumerate(heard_dbm):
            fault = self._plan.of_receiver(tracker, after_ns / 1e9)
            reported[tracker] += self._receivers[tracker].reported((time_ns, level_dbm), fault)

    def _vehicle_fault(self, tracker: int) -> VehicleFault | None:
        if self._start_ns is None:
            return None
        return self._plan.of_vehicle(tracker, (self._now_ns - self._start_ns) / 1e9)

    def positions_m(self) -> list[Metres]:
        """Where the vehicles are."""
        return [vehicle.true_position_m for vehicle in self.vehicles]

    def announce(self, since_ns: int, center_m: Metres, spacing_m: float, turned_rad: float = 0.0) -> None:
        """The controller's next window is of what is sampled from this moment on, in this formation; in flight also
        what it looks like now.
        """
        self._spacing_m, self._turned_rad = spacing_m, turned_rad
        self.radio.announce(since_ns, center_m)

    def _swarm(self) -> Swarm:
        """As a target sees it: most of its vehicles."""
        velocity_mps = [
            statistics.median(axis) for axis in zip(*(one.velocity_mps for one in self.vehicles), strict=True)
        ]
        vectors = (torch.tensor([vector], dtype=torch.float64) for vector in (self._center_m(), velocity_mps))
        return Swarm(*vectors)

    def distance_to_target_m(self) -> float:
        """From the centre of most of the vehicles."""
        return math.dist(self._center_m(), self.radio.target_m)

    def is_reached(self) -> bool:
        """Whether that is within the success radius, or of a target that flies was so just now."""
        if isinstance(self.radio, RadioInFlight):
            return self.radio.is_reached
        return self.distance_to_target_m() <= self._success_radius_m

    @property
    def capture_s(self) -> float | None:
        """When the centre first was that near to a target that flies, since it began to; None where it never was."""
        if isinstance(self.radio, RadioInFlight) and math.isfinite(self.radio.reached_s):
            return self.radio.reached_s
        return None

    @property
    def just_now_m(self) -> float:
        """How near the centre was just now; in the paper's world, is."""
        return self.radio.just_now_m if isinstance(self.radio, RadioInFlight) else self.distance_to_target_m()

    @property
    def flown_s(self) -> float | None:
        """So long a target that flies has done so; None of one that stands."""
        return self.radio.now_s if isinstance(self.radio, RadioInFlight) else None

    @property
    def following_share(self) -> float | None:
        """See ``RadioInFlight``; None of a target that stands."""
        return self.radio.following_share if isinstance(self.radio, RadioInFlight) else None

    def _center_m(self) -> list[float]:
        """Where most vehicles' places in the last announced formation say that its centre is: one that has been left
        behind, or two, do not count.
        """
        position_m = torch.tensor(self.positions_m(), dtype=torch.float64)
        turned_rad = torch.tensor(self._turned_rad, dtype=torch.float64)
        claimed_m = position_m - self._spacing_m * turned_direction(turned_rad)
        return [statistics.median(axis) for axis in claimed_m.T.tolist()]

    def _fly(self, until_ns: int) -> None:
        for vehicle in self.vehicles:
            vehicle.update(until_ns)


def reporting_in(scenario: Scenario) -> AgentSettings:
    """How often agents report: in flight more often, since what is decided is as old as the last report."""
    if scenario.pace == "stop_and_listen":
        return AgentSettings()
    return AgentSettings(window_hz=REPORTS_IN_FLIGHT_HZ, position_hz=REPORTS_IN_FLIGHT_HZ)


def _vehicle_limits(scenario: Scenario) -> VehicleLimits:
    """Of vehicles that can fly what the scenario has a swarm fly."""
    if scenario.pace == "stop_and_listen" or scenario.tracker_acceleration_mps2 is None:
        return VehicleLimits()
    return VehicleLimits(CATCHING_UP * scenario.tracker_speed_mps, scenario.tracker_acceleration_mps2)


def require_site(scenario: Scenario) -> None:
    """Refuse a scenario that no site plays.

    Raises:
        InputError: it is such a one.
    """
    if scenario.pace == "stop_and_listen":
        require_simulated(scenario)
    else:
        require_flight(scenario)


def require_played(scenario: Scenario, plan: FaultPlan) -> None:
    """Refuse faults of targets in flight where the target stands.

    Raises:
        InputError: there is such a one.
    """
    if scenario.pace == "stop_and_listen" and (plan.target or plan.second_m is not None):
        raise InputError("the faults mute, lands and second are refused: they are of targets in flight")


def site_limits(scenario: Scenario) -> SafetyLimits:
    """With which a simulated site is flown: in flight there is room for wherever its targets get, as far as any place
    can be told.
    """
    if scenario.pace == "stop_and_listen":
        return SafetyLimits()
    roams_m = scenario.target_speed_mps * scenario.max_movements * scenario.decision_s
    room_m = min(max(TARGETS_ROAM_M, roams_m) + (scenario.farthest_start_m or scenario.start_distance_m), FARTHEST_M)
    return SafetyLimits(
        -room_m, room_m, -room_m, room_m, -scenario.start_altitude_m, room_m, scenario.tracker_speed_mps
    )
