"""Situations in which vehicles come near one another, drawn by a seed, and how near they truly came.

The real service, agents, link and vehicles (``VirtualChase``); a controller that wants anything; vehicles that lag,
brake at 2 to 5 m/s2, are blown about and are wrong about where they are; and at any moment pilots who take over and
give back, agents that are killed, start again or stand still, links that are cut, a service that hangs or dies, so that
all return by themselves.
"""

import dataclasses
import math
from collections import Counter
from dataclasses import dataclass
from random import Random
from typing import Any

import torch

from ..formation import TRACKER_DIRECTION, Action
from ..live.link.messages import Metres
from ..live.service.chase_state import Decision, Transition
from ..live.service.safety import ROOM_M, SafetyLimits
from ..live.service.separation import STRAYING_M
from ..live.service.settings import ServiceSettings
from ..live.tracker.agent import AgentSettings
from ..live.tracker.vehicles import SimulatedVehicle, VehicleLimits
from ..observation import Observation
from ..scenario import NUM_TRACKERS, paper_scenario
from .fault_plan import FaultPlan, ProcessFault, TrackerFault
from .faulty_path import Faults
from .virtual_chase import START_NS, VirtualChase

FLIGHT_S = 10.0
UPTIME_NS = 3600 * 10**9
"""Of the trackers' computers at the start."""
RETURN_AFTER_S = 3.0
RETURNED_S = 8.0
"""So long after its way back began, at the latest, every tracker is where it began."""
SEPARATIONS_M = (1.0, 2.0, 3.0)
MOST_ERROR_M = 0.5
MOST_GUSTS_MPS2 = 0.5
"""With the longest lag it puts a hovering vehicle up to .37 m beside its set-point (.32 m in 99 % of the time); of a
real ArduCopter in a wind of 8 m/s .23 m were seen."""
WANTED_SPACINGS_M = (1.0, 1.0, 2.0, 3.0, 5.0)
FARTHEST_WANTED_M = 6.0
"""On each axis, in one movement."""
EVASIONS = ("in turns", "by a detour", "spacing", "centre moved", "all stay")
"""Words of the safety filter."""
PILOT, CUT, HANGS, DIES = "pilot", "cut link", "service hangs", "service dies"


@dataclass(frozen=True)
class Event:
    """From ``start_s`` to ``end_s`` of the flight something is done to a tracker, or to the service (tracker -1)."""

    what: str
    tracker: int
    start_s: float
    end_s: float

    def is_at_work(self, seconds: float) -> bool:
        """Whether it is, so many seconds into the flight."""
        return self.start_s <= seconds < self.end_s


@dataclass(frozen=True)
class Situation:
    """All that is drawn but the winds and the wanted moves, which come from the seed, too."""

    seed: int
    limits: SafetyLimits
    spacing_m: float
    places: tuple[int, ...]
    """Which place of the formation each tracker starts in."""
    vehicles: tuple[VehicleLimits, ...]
    link: Faults
    events: tuple[Event, ...]

    @property
    def margin_m(self) -> float:
        """What the vehicles' errors and their straying may take from the limit."""
        return 2 * self.vehicles[0].position_error_m + STRAYING_M

    @property
    def seconds(self) -> float:
        """Of the whole flight, the return included."""
        dies_s = [event.start_s for event in self.events if event.what == DIES]
        return 2 * dies_s[0] + RETURN_AFTER_S + RETURNED_S if dies_s else FLIGHT_S


@dataclass(frozen=True)
class Encounter:
    """How a situation went."""

    seed: int
    least_m: float
    """The least true distance of any two vehicles at any moment."""
    limit_m: float
    margin_m: float
    movements: int
    at_s: float
    """When they came so near."""
    pair: tuple[int, int]
    evasions: dict[str, int]
    """How often the safety filter, or the stream of set-points, did what."""

    @property
    def spare_m(self) -> float:
        """How much further apart they stayed than is promised."""
        return self.least_m - (self.limit_m - self.margin_m)


def situation(seed: int) -> Situation:
    """Number ``seed``."""
    random = Random(f"encounter {seed}")
    separation_m = random.choice(SEPARATIONS_M)
    limits = SafetyLimits(highest_speed_mps=random.uniform(2.0, 5.0), minimum_separation_m=separation_m)
    narrowest_m = (separation_m + ROOM_M) / math.sqrt(2)
    places = list(range(NUM_TRACKERS))
    if random.random() < 0.5:
        random.shuffle(places)
    error_m = random.choice((0.0, random.uniform(0.0, MOST_ERROR_M), MOST_ERROR_M))
    vehicles = tuple(
        VehicleLimits(
            acceleration_mps2=random.uniform(2.0, 5.0),
            lag_s=random.uniform(0.1, 0.4),
            gusts_mps2=random.uniform(0.0, MOST_GUSTS_MPS2),
            position_error_m=error_m,
        )
        for _ in range(NUM_TRACKERS)
    )
    delay_s = random.uniform(0.0, 0.1)
    link = Faults(loss=random.uniform(0.0, 0.2), delay_s=delay_s, jitter_s=random.uniform(0.0, delay_s))
    # Start where nobody is too near even in truth.
    spacing_m = random.uniform(narrowest_m, narrowest_m + 1.5) + 2 * error_m / math.sqrt(2)
    return Situation(seed, limits, spacing_m, tuple(places), vehicles, link, _events(random))


def fly(one: Situation) -> Encounter:
    """Fly it, and watch where the vehicles truly are."""
    torch.set_num_threads(1)
    scenario = paper_scenario(
        sampling_hz=10, window_samples=2, max_movements=1000, initial_spacing_m=one.spacing_m, start_distance_m=300
    )
    decisions: list[Decision] = []
    chase = VirtualChase(
        scenario,
        _WantsAnything(),
        one.seed,
        0,
        FaultPlan(link=one.link, trackers=tuple(_process_faults(one))),
        ServiceSettings(minimum_trackers=1, reached_windows=0, connect_wait_s=0.3, settle_s=0.1),
        lambda entry: _keep(entry, decisions),
        limits=one.limits,
        vehicles=_vehicles(one),
        agent_settings=AgentSettings(window_hz=2.0, return_after_s=RETURN_AFTER_S if _service_dies(one) else 0.0),
    )
    for clock in chase.tracker_clocks:
        clock.ahead_ns = UPTIME_NS - START_NS
    least = (math.inf, 0.0, (0, 0))
    while (seconds := (chase.clock.now_ns() - START_NS) / 1e9) < one.seconds:
        _happen(one, chase, seconds)
        if any(event.what in {HANGS, DIES} and event.is_at_work(seconds) for event in one.events):
            chase.tick_without_service()
        else:
            chase.tick()
        nearest_m, pair = _nearest(chase.site.positions_m())
        least = min(least, (nearest_m, seconds, pair))
    evasions = Counter(word for decision in decisions for word in EVASIONS if word in decision.changed)
    evasions["pulled back"] = chase.service.snapshot().pulled_back
    limit_m = one.limits.minimum_separation_m
    return Encounter(one.seed, least[0], limit_m, one.margin_m, len(decisions), least[1], least[2], dict(evasions))


def _events(random: Random) -> tuple[Event, ...]:
    """One to three things that happen; the service's death is the last, after which all that is left return."""
    dies = random.random() < 0.2
    kinds = [PILOT] if dies else [PILOT, CUT, HANGS, *map(str, (ProcessFault.KILL, ProcessFault.RESTART))]
    kinds += [] if dies else [str(ProcessFault.FROZEN), str(ProcessFault.SLOW)]
    last_s = random.uniform(3.0, 8.0) if dies else FLIGHT_S - 2.0
    events = []
    for _ in range(random.choice((1, 1, 2, 3))):
        start_s = random.uniform(0.5, last_s - 2.0)
        end_s = start_s + random.uniform(0.3, 4.0)
        what = random.choice(kinds)
        # Who is not commanded when the controller is lost does not return, and is in nobody's film.
        end_s = min(end_s, last_s - 1.0) if dies else end_s
        events.append(Event(what, -1 if what == HANGS else random.randrange(NUM_TRACKERS), start_s, end_s))
    return (*events, Event(DIES, -1, last_s, math.inf)) if dies else tuple(events)


def _process_faults(one: Situation) -> list[TrackerFault]:
    words = {str(fault): fault for fault in ProcessFault}
    return [
        TrackerFault(words[event.what], event.tracker, event.start_s, event.end_s)
        for event in one.events
        if event.what in words
    ]


def _service_dies(one: Situation) -> bool:
    return any(event.what == DIES for event in one.events)


def _vehicles(one: Situation) -> list[SimulatedVehicle]:
    places_m = (one.spacing_m * TRACKER_DIRECTION).tolist()
    return [
        SimulatedVehicle(tuple(places_m[place]), limits, Random(f"{one.seed} vehicle {tracker}"))
        for tracker, (place, limits) in enumerate(zip(one.places, one.vehicles, strict=True))
    ]


def _happen(one: Situation, chase: VirtualChase, seconds: float) -> None:
    """Pilots and cut links; the plan of faults and the loop do the rest."""
    for tracker, vehicle in enumerate(chase.site.vehicles):
        mine = [event for event in one.events if event.tracker == tracker]
        if any(event.what == PILOT and event.is_at_work(seconds) for event in mine):
            vehicle.take_over()
        else:
            vehicle.give_back()
        chase.network.cut(tracker, any(event.what == CUT and event.is_at_work(seconds) for event in mine))


def _nearest(positions_m: list[Metres]) -> tuple[float, tuple[int, int]]:
    return min(
        (math.dist(positions_m[one], positions_m[other]), (one, other))
        for other in range(NUM_TRACKERS)
        for one in range(other)
    )


def _keep(entry: Decision | Transition, decisions: list[Decision]) -> None:
    if isinstance(entry, Decision):
        decisions.append(entry)


class _WantsAnything:
    """A controller that draws every spacing and movement anew."""

    name = "anything"

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> Random:
        return Random(f"anything {seed} {first_chase}")

    def decide(self, observation: Observation, memory: Random) -> tuple[Action, Any]:
        wanted_m = [memory.uniform(-FARTHEST_WANTED_M, FARTHEST_WANTED_M) for _ in range(3)]
        spacing_m = memory.choice(WANTED_SPACINGS_M)
        return Action(torch.tensor([spacing_m]), torch.tensor([wanted_m])), memory


def to_json(encounter: Encounter) -> dict[str, Any]:
    """As a line of a file."""
    return dataclasses.asdict(encounter)


def from_json(line: dict[str, Any]) -> Encounter:
    """What ``to_json`` wrote."""
    return Encounter(**{**line, "pair": tuple(line["pair"])})
