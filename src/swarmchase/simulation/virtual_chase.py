"""A whole live chase in one process, faster than real time: the real service, agents, link and vehicles, on a clock
that is made and a network that fails. The same seed gives the same chase.
"""

import itertools
import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from ..controllers.protocol import Controller
from ..live.clock import Clock, VirtualClock
from ..live.link.keys import KEY_BYTES
from ..live.link.mavlink import ControllerMavlinkLink, TrackerMavlinkLink
from ..live.link.messages import Metres
from ..live.service.chase_state import IN_FLIGHT, UNDER_WAY, ChaseState, Decision, Snapshot, Transition
from ..live.service.safety import SafetyLimits
from ..live.service.service import ControllerService, Recorder
from ..live.service.settings import ServiceSettings
from ..live.tracker.agent import AgentSettings, TrackerAgent
from ..live.tracker.sources import Rejected, Sample
from ..live.tracker.vehicles import SimulatedVehicle
from ..scenario import NUM_TRACKERS, Scenario
from .fault_plan import FaultPlan, ProcessFault
from .site import Site, reporting_in, site_limits
from .told_controller import told_where
from .virtual_network import CONTROLLER, VirtualNetwork

TICK_S = 0.025
"""Agents step in every tick, 40 times a second; the service steps in every second one and listens in the others."""
START_NS = 2_000_000_000 * 10**9
"""A moment of the year 2033: the link's timestamps count from 2015."""
LONGEST_CHASE_S = 3600.0
SLOW_TICKS = 10
"""A slow tracker steps once in so many ticks."""
KEYS = {tracker: bytes([tracker]) * KEY_BYTES for tracker in range(NUM_TRACKERS)}
"""Of a simulation: no secret."""


@dataclass(frozen=True)
class VirtualResult:
    """How a chase ended."""

    state: str
    reason: str
    reached: bool
    """The service says that the target is reached, and the centre is within the success radius, or of a target that
    flies was so in the last second."""
    movements: int
    movements_to_target: int | None
    """When the centre first was within the success radius; None where it never was."""
    capture_s: float | None
    """When the centre first was there, since a target that flies began to; None where it never was, or stands."""
    flown_s: float | None
    """So long a target that flies had done so at the end; None of one that stands."""
    said_distance_m: float
    """How near the centre was to the target just before the chase ended: see ``Site.just_now_m``."""
    following_share: float | None
    """See ``Site.following_share``."""
    least_separation_m: float
    """Of any two vehicles, where they truly were."""
    seconds: float
    """Of the made clock."""
    rejected: dict[str, int]
    decision_latency_s: list[float]
    """Of this machine's clock, for each decision: from before the step until the set-points are sent."""


class SkewedClock:
    """Ahead of another clock, and faster or slower: what two machines, or a machine and real time, are to each other.
    Whoever sets ``ahead_ns`` or ``drift`` steps it.
    """

    def __init__(self, clock: Clock) -> None:
        self.ahead_ns = 0
        self.drift = 0.0
        """Seconds that it gains in one second, counted from its making."""
        self._clock, self._made_ns = clock, clock.now_ns()

    def now_ns(self) -> int:
        """Nanoseconds."""
        return self.shown_ns(self._clock.now_ns())

    def shown_ns(self, time_ns: int) -> int:
        """What it shows when the other one shows this."""
        return time_ns + self.ahead_ns + round(self.drift * (time_ns - self._made_ns))


class VirtualChase:
    """Chase ``chase`` of run ``seed``, step by step. Its parts are there to be looked at, and to be put out of order.

    Args:
        recorder: is given every transition and decision.
        watch: is given every snapshot after a step of the service.
        vehicles: are flown; ideal ones, around the origin, where none are given.
        starts: at once; otherwise when ``service.start`` is called.
    """

    def __init__(
        self,
        scenario: Scenario,
        controller: Controller,
        seed: int,
        chase: int,
        plan: FaultPlan | None = None,
        settings: ServiceSettings | None = None,
        recorder: Recorder = lambda _entry: None,
        watch: Callable[[Snapshot], None] = lambda _snapshot: None,
        limits: SafetyLimits | None = None,
        vehicles: list[SimulatedVehicle] | None = None,
        agent_settings: AgentSettings | None = None,
        starts: bool = True,
    ) -> None:
        self.clock = VirtualClock(START_NS)
        """The site's, and the controller's."""
        self.tracker_clocks = [SkewedClock(self.clock) for _ in range(NUM_TRACKERS)]
        """Monotonic ones: nobody but a reboot steps them."""
        self.wall_clock = SkewedClock(self.clock)
        """The controller's idea of real time."""
        self.tracker_wall_clocks = [SkewedClock(self.clock) for _ in range(NUM_TRACKERS)]
        self._scenario, self._seed, self._chase = scenario, seed, chase
        self._plan, self._settings, self._limits = plan or FaultPlan(), settings, limits or site_limits(scenario)
        self._recorder, self._watch, self._starts = recorder, watch, starts
        self._agent_settings = agent_settings or reporting_in(scenario)
        self.site = Site(scenario, seed, chase, self._plan, vehicles)
        self.site.begin(START_NS)
        self._controller = told_where(controller, self._target)
        self.network = VirtualNetwork(self.clock, self._plan, f"{seed} {chase}")
        self._receivers = [_Receiver(clock) for clock in self.tracker_clocks]
        self.agents: list[TrackerAgent | None] = [self._agent(tracker) for tracker in range(NUM_TRACKERS)]
        """None where its process is dead."""
        self._has_decided = False
        self.link, self.service = self._begun_service(epoch=1)
        self._announced: tuple[int | None, float | None, float] | None = None
        self._ticks = 0
        self._latency_s: list[float] = []
        self._movements_to_target: int | None = None
        self._least_separation_m = math.inf

    def restart_service(self, epoch: int) -> None:
        """Its process dies and is there again at once, without its state folder: a new chase begins."""
        self.link, self.service = self._begun_service(epoch)

    def run(self, each_tick: Callable[[], None] = lambda: None) -> VirtualResult:
        """Until the chase has ended."""
        while self.service.state in UNDER_WAY and self._seconds() < LONGEST_CHASE_S:
            self.tick()
            each_tick()
        snapshot = self.service.snapshot()
        near = self.site.is_reached()
        self._note_reached(snapshot)
        return VirtualResult(
            state=snapshot.state.value,
            reason=snapshot.reason,
            reached=near and snapshot.state is ChaseState.REACHED,
            movements=snapshot.movements,
            movements_to_target=self._movements_to_target,
            capture_s=self.site.capture_s,
            flown_s=self.site.flown_s,
            said_distance_m=self.site.just_now_m,
            following_share=self.site.following_share,
            least_separation_m=self._least_separation_m,
            seconds=self._seconds(),
            rejected=dict(Counter(self.link.rejected)),
            decision_latency_s=self._latency_s,
        )

    def tick(self) -> None:
        """Let ``TICK_S`` pass."""
        self.tick_without_service()
        if self._ticks % 2 == 0:
            self._step_service()
        else:
            self.service.listen()

    def tick_without_service(self) -> None:
        """The same while the service hangs."""
        self.clock.advance(TICK_S)
        self._ticks += 1
        for receiver, samples in zip(self._receivers, self.site.advance(self.clock.now_ns()), strict=True):
            receiver.put(samples)
        apart_m = itertools.starmap(math.dist, itertools.combinations(self.site.positions_m(), 2))
        self._least_separation_m = min(self._least_separation_m, *apart_m)
        self.network.pass_on()
        for tracker in range(NUM_TRACKERS):
            self._step_agent(tracker)
        self.network.pass_on()

    def _step_service(self) -> None:
        self._has_decided = False
        began_s = time.perf_counter()
        self.service.step()
        if self._has_decided:
            self._latency_s.append(time.perf_counter() - began_s)
        snapshot = self.service.snapshot()
        told = snapshot.window_since_ns, snapshot.spacing_m, snapshot.turned_rad
        if snapshot.window_since_ns is not None and told != self._announced:
            assert snapshot.center_m is not None
            assert snapshot.spacing_m is not None
            self._announced = told
            self.site.announce(snapshot.window_since_ns, snapshot.center_m, snapshot.spacing_m, snapshot.turned_rad)
            self._note_reached(snapshot)
        elif snapshot.state in IN_FLIGHT:
            self._note_reached(snapshot)
        self._watch(snapshot)

    def _note_reached(self, snapshot: Snapshot) -> None:
        """Whether it is, if it has not been before."""
        if self._movements_to_target is None and self.site.is_reached():
            self._movements_to_target = snapshot.movements

    def _record(self, entry: Transition | Decision) -> None:
        self._has_decided |= isinstance(entry, Decision)
        self._recorder(entry)

    def _step_agent(self, tracker: int) -> None:
        faults = {fault.fault for fault in self._plan.of_process(tracker, self._seconds())}
        agent = self.agents[tracker]
        if self._plan.is_dead(tracker, self._seconds()):
            self.agents[tracker] = None
            # Without its agent the vehicle does what an autopilot does without a companion.
            self.site.vehicles[tracker].hold()
        elif agent is None:
            self.agents[tracker] = self._agent(tracker)
        elif not (ProcessFault.FROZEN in faults or (ProcessFault.SLOW in faults and self._ticks % SLOW_TICKS)):
            agent.step()

    def _agent(self, tracker: int) -> TrackerAgent:
        link = TrackerMavlinkLink(
            tracker,
            *CONTROLLER,
            KEYS[tracker],
            wall_time_ns=self.tracker_wall_clocks[tracker].now_ns,
            monotonic_ns=self.tracker_clocks[tracker].now_ns,
            udp=self.network.trackers[tracker],
        )
        vehicle, receiver = self.site.flown[tracker], self._receivers[tracker]
        clock, sampling_hz = self.tracker_clocks[tracker], self._scenario.sampling_hz
        return TrackerAgent(tracker, receiver, vehicle, link, clock, sampling_hz, self._agent_settings)

    def _target(self) -> tuple[Metres, Metres]:
        """Where it is and how fast."""
        radio = self.site.radio
        return radio.target_m, radio.target_mps

    def _begun_service(self, epoch: int) -> tuple[ControllerMavlinkLink, ControllerService]:
        link = ControllerMavlinkLink(
            *CONTROLLER,
            KEYS,
            wall_time_ns=self.wall_clock.now_ns,
            monotonic_ns=self.clock.now_ns,
            udp=self.network.controller,
        )
        service = ControllerService(
            self._scenario,
            self._controller,
            link,
            self.clock,
            self._limits,
            self._record,
            epoch,
            self._seed,
            self._chase,
            self._settings,
        )
        if self._starts:
            service.start()
        if self._plan != FaultPlan():
            service.override()  # whoever has ordered faults wants to see them
        return link, service

    def _seconds(self) -> float:
        return (self.clock.now_ns() - START_NS) / 1e9


class _Receiver:
    """Hands on what the site has it hear, dated by its tracker's clock. An ``RssiSource``."""

    silence = "the site is silent"

    def __init__(self, clock: SkewedClock) -> None:
        self.rejected = Rejected()
        self._clock = clock
        self._samples: list[Sample] = []

    def put(self, samples: list[Sample]) -> None:
        self._samples += [(self._clock.shown_ns(time_ns), rssi_dbm) for time_ns, rssi_dbm in samples]

    def read(self, now_ns: int) -> list[Sample]:
        samples, self._samples = self._samples, []
        return samples

    def close(self) -> None:
        """Nothing is held."""
