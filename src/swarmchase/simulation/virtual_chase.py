"""A whole live chase in one process, faster than real time: the real service, agents, link and vehicles, on a clock
that is made and a network that fails. The same seed gives the same chase.
"""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from ..controllers.protocol import Controller
from ..live.agent import AgentSettings, TrackerAgent
from ..live.chase_state import UNDER_WAY, ChaseState, Decision, Snapshot, Transition
from ..live.clock import VirtualClock
from ..live.keys import KEY_BYTES
from ..live.mavlink_link import ControllerMavlinkLink, TrackerMavlinkLink
from ..live.safety import SafetyLimits
from ..live.service import ControllerService, Recorder, ServiceSettings
from ..live.sources import Sample
from ..scenario import NUM_TRACKERS, Scenario
from .fault_plan import RESTART_AFTER_S, FaultPlan, ProcessFault
from .virtual_network import CONTROLLER, VirtualNetwork
from .world import World

TICK_S = 0.025
"""Agents step in every tick, the service in every second: 40 and 20 times a second."""
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
    """The service says that the target is reached, and the swarm's centre is within the success radius."""
    movements: int
    movements_to_target: int | None
    """When the centre first was within the success radius; None where it never was."""
    seconds: float
    """Of the made clock."""
    rejected: dict[str, int]
    decision_latency_s: list[float]
    """Of this machine's clock, for each decision: from before the step until the set-points are sent."""


class VirtualChase:
    """Chase ``chase`` of run ``seed``, step by step.

    Args:
        recorder: is given every transition and decision.
        watch: is given every snapshot after a step of the service.
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
    ) -> None:
        self.clock = VirtualClock(START_NS)
        self._scenario, self._plan, self._watch = scenario, plan or FaultPlan(), watch
        self.world = World(scenario, seed, chase, self._plan)
        self.world.begin(START_NS)
        self._network = VirtualNetwork(self.clock, self._plan, f"{seed} {chase}")
        self._receivers = [_Receiver() for _ in range(NUM_TRACKERS)]
        self._agents: list[TrackerAgent | None] = [self._agent(tracker) for tracker in range(NUM_TRACKERS)]
        self.link = ControllerMavlinkLink(
            *CONTROLLER, KEYS, wall_time_ns=self.clock.now_ns, udp=self._network.controller
        )
        self._recorder = recorder
        self.service = ControllerService(
            scenario, controller, self.link, self.clock, SafetyLimits(), self._record, 1, seed, chase, settings
        )
        self._announced_ns: int | None = None
        self._has_decided = False
        self._ticks = 0
        self._latency_s: list[float] = []
        self._movements_to_target: int | None = None
        self.service.start()

    def run(self) -> VirtualResult:
        """Until the chase has ended."""
        while self.service.state in UNDER_WAY and self._seconds() < LONGEST_CHASE_S:
            self.tick()
        snapshot = self.service.snapshot()
        near = self.world.distance_to_target_m() <= self._scenario.success_radius_m
        return VirtualResult(
            state=snapshot.state.value,
            reason=snapshot.reason,
            reached=near and snapshot.state is ChaseState.REACHED,
            movements=snapshot.movements,
            movements_to_target=self._movements_to_target,
            seconds=self._seconds(),
            rejected=dict(Counter(self.link.rejected)),
            decision_latency_s=self._latency_s,
        )

    def tick(self) -> None:
        """Let ``TICK_S`` pass."""
        self.clock.advance(TICK_S)
        self._ticks += 1
        for receiver, samples in zip(self._receivers, self.world.advance(self.clock.now_ns()), strict=True):
            receiver.put(samples)
        self._network.pass_on()
        for tracker in range(NUM_TRACKERS):
            self._step_agent(tracker)
        self._network.pass_on()
        if self._ticks % 2 == 0:
            self._step_service()

    def _step_service(self) -> None:
        self._has_decided = False
        began_s = time.perf_counter()
        self.service.step()
        if self._has_decided:
            self._latency_s.append(time.perf_counter() - began_s)
        snapshot = self.service.snapshot()
        if snapshot.window_since_ns is not None and snapshot.window_since_ns != self._announced_ns:
            assert snapshot.center_m is not None
            assert snapshot.spacing_m is not None
            self._announced_ns = snapshot.window_since_ns
            self.world.announce(snapshot.window_since_ns, snapshot.center_m, snapshot.spacing_m)
            near = self.world.distance_to_target_m() <= self._scenario.success_radius_m
            if near and self._movements_to_target is None:
                self._movements_to_target = snapshot.movements
        self._watch(snapshot)

    def _record(self, entry: Transition | Decision) -> None:
        self._has_decided |= isinstance(entry, Decision)
        self._recorder(entry)

    def _step_agent(self, tracker: int) -> None:
        faults = {fault.fault: fault for fault in self._plan.of_process(tracker, self._seconds())}
        agent = self._agents[tracker]
        restart = faults.get(ProcessFault.RESTART)
        is_dead = ProcessFault.KILL in faults or (
            restart is not None and self._seconds() < restart.start_s + RESTART_AFTER_S
        )
        if is_dead:
            self._agents[tracker] = None
            # Without its agent the vehicle does what an autopilot does without a companion.
            self.world.vehicles[tracker].hold()
        elif agent is None:
            self._agents[tracker] = self._agent(tracker)
        elif not (ProcessFault.FROZEN in faults or (ProcessFault.SLOW in faults and self._ticks % SLOW_TICKS)):
            agent.step()

    def _agent(self, tracker: int) -> TrackerAgent:
        link = TrackerMavlinkLink(
            tracker, *CONTROLLER, KEYS[tracker], wall_time_ns=self.clock.now_ns, udp=self._network.trackers[tracker]
        )
        vehicle, receiver = self.world.vehicles[tracker], self._receivers[tracker]
        sampling_hz = self._scenario.sampling_hz
        return TrackerAgent(tracker, receiver, vehicle, link, self.clock, sampling_hz, AgentSettings())

    def _seconds(self) -> float:
        return (self.clock.now_ns() - START_NS) / 1e9


class _Receiver:
    """Hands on what the world has it hear. An ``RssiSource``."""

    def __init__(self) -> None:
        self._samples: list[Sample] = []

    def put(self, samples: list[Sample]) -> None:
        self._samples += samples

    def read(self, now_ns: int) -> list[Sample]:
        samples, self._samples = self._samples, []
        return samples

    def close(self) -> None:
        """Nothing is held."""
