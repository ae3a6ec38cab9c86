"""A controller service on a bench: trackers, a link, a clock and a world that are all made here."""

import dataclasses
import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from swarmchase.batch.streams import chase_keys
from swarmchase.controllers import Controller
from swarmchase.controllers.condition import Condition
from swarmchase.formation import Action
from swarmchase.live.clock import VirtualClock
from swarmchase.live.link.messages import (
    Heartbeat,
    Message,
    PositionReport,
    RssiWindow,
    SetPoint,
    TrackerMode,
    VehicleState,
)
from swarmchase.live.service.chase_state import ChaseState, Decision, Transition
from swarmchase.live.service.safety import SafetyLimits, formation_m
from swarmchase.live.service.service import ControllerService
from swarmchase.live.service.settings import ServiceSettings
from swarmchase.observation import Observation
from swarmchase.scenario import NUM_TRACKERS, Scenario, paper_scenario
from swarmchase.world.environment import Environment, State

IDLE, CONNECTING, SAMPLING, MOVING, PURSUING, FOLLOWING, SEARCHING, HOLDING, REACHED, LOST, ABORTED = ChaseState
STEP_S = 0.05
SCENARIO = paper_scenario(window_samples=10)
"""Windows of a second."""
CENTER_M = np.array([10.0, -20, 30])
FLYING = VehicleState(is_armed=True, is_airborne=True, is_simulated=True)
BY_OPERATOR = ServiceSettings(reached_windows=0, settle_s=0.0)


class FakeLink:
    """The controller's end, and what a test does with what passes it."""

    def __init__(self) -> None:
        self.rejected: Counter[str] = Counter()
        self.incoming: list[Message] = []
        self.sent: list[SetPoint] = []

    def send(self, message: Message) -> None:
        assert isinstance(message, SetPoint)
        self.sent.append(message)

    def receive(self) -> Sequence[Message]:
        messages, self.incoming = self.incoming, []
        return messages

    def clocks_ahead_s(self) -> list[float | None]:
        return [0.0] * NUM_TRACKERS

    def close(self) -> None:
        raise AssertionError("the service does not own the link")


class FakeTracker:
    """Flies to each set-point at this speed, or jumps; samples at 10 Hz or what it is told; dates by its own clock."""

    def __init__(self, number: int, position_m: np.ndarray, speed_mps: float = math.inf) -> None:
        self.number, self.position_m, self.speed_mps = number, position_m.copy(), speed_mps
        self.clock_ahead_ns = (number + 1) * 10**12 + 123_456_789
        self.target_m = position_m.copy()
        self.levels: list[float] = []
        self.newest_ns = 0
        self.mode = TrackerMode.FOLLOWING
        self.vehicle = FLYING
        self.is_alive = self.hears = True

    def fly(self, seconds: float) -> None:
        if self.mode is TrackerMode.MANUAL:
            return
        way_m = self.target_m - self.position_m
        length_m = float(np.linalg.norm(way_m))
        if length_m <= self.speed_mps * seconds:
            self.position_m = self.target_m.copy()
        else:
            self.position_m = self.position_m + way_m / length_m * self.speed_mps * seconds

    def obey(self, set_point: SetPoint) -> None:
        if self.is_alive and self.mode is not TrackerMode.MANUAL:
            self.target_m = np.array(set_point.position_m)

    def sample(self, now_ns: int, level_dbm: float) -> None:
        self.levels = [*self.levels, level_dbm][-50:]
        self.newest_ns = now_ns + self.clock_ahead_ns

    def reports(self, now_ns: int, sampling_hz: float) -> list[Message]:
        own_ns = now_ns + self.clock_ahead_ns
        x_m, y_m, z_m = self.position_m.tolist()
        said: list[Message] = [
            Heartbeat(self.number, own_ns, self.mode, self.vehicle),
            PositionReport(self.number, own_ns, (x_m, y_m, z_m)),
        ]
        if self.levels and self.hears:
            said.append(RssiWindow(self.number, self.newest_ns, sampling_hz, tuple(self.levels)))
        return said if self.is_alive else []


class Still:
    """A controller that does what it is told: by default 4 m north and a spacing of 3."""

    name = "still"

    def __init__(self) -> None:
        self.displacement_m = [0.0, 4.0, 0.0]
        self.spacing_m = 3.0
        self.condition: Condition | None = None
        self.error: Exception | None = None
        self.seen: list[Observation] = []

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> Any:
        assert num_chases == 1
        return "nothing yet"

    def decide(self, observation: Observation, memory: Any) -> tuple[Action, Any]:
        self.seen.append(observation)
        if self.error is not None:
            raise self.error
        wanted = torch.tensor([self.spacing_m, *self.displacement_m], dtype=torch.float64)
        action = Action(wanted[:1], wanted[None, 1:])
        if self.condition is None:
            return action, len(self.seen)
        return action, ConditionMemory(torch.tensor([int(self.condition)]))


@dataclasses.dataclass(frozen=True)
class ConditionMemory:
    condition: torch.Tensor


class Bench:
    """A service, its trackers and the time between them."""

    def __init__(
        self,
        scenario: Scenario = SCENARIO,
        controller: Controller | None = None,
        level_dbm: Callable[[FakeTracker, int], float] | None = None,
        limits: SafetyLimits | None = None,
        service_settings: ServiceSettings = BY_OPERATOR,
        speed_mps: float = math.inf,
        spacing_m: float = 5.0,
    ) -> None:
        self.scenario = scenario
        self.still = Still()
        self.controller = controller or self.still
        self.level_dbm = level_dbm or (lambda tracker, now_ns: -60.0 - tracker.number)
        self.limits, self.settings = limits or SafetyLimits(), service_settings
        self.clock, self.link = VirtualClock(5 * 10**9), FakeLink()
        self.log: list[Transition | Decision] = []
        places_m = formation_m(CENTER_M, spacing_m)
        self.trackers = [FakeTracker(number, place_m, speed_mps) for number, place_m in enumerate(places_m)]
        self.is_cut = False
        self.service = self.new_service(epoch=1)
        self.sampled_ns = self.clock.now_ns()
        self.service.start()

    def new_service(self, epoch: int) -> ControllerService:
        return ControllerService(
            self.scenario,
            self.controller,
            self.link,
            self.clock,
            self.limits,
            self.log.append,
            epoch,
            seed=4,
            chase=7,
            settings=self.settings,
        )

    def step(self, seconds: float = STEP_S) -> None:
        """A moment passes: the trackers fly and sample and report, the service answers."""
        self.clock.advance(seconds)
        now_ns = self.clock.now_ns()
        for tracker in self.trackers:
            tracker.fly(seconds)
        self.before_sampling()
        period_ns = round(1e9 / self.scenario.sampling_hz)
        while self.sampled_ns + period_ns <= now_ns:
            self.sampled_ns += period_ns
            for tracker in self.trackers:
                tracker.sample(self.sampled_ns, self.level_dbm(tracker, self.sampled_ns))
        for tracker in self.trackers:
            if not self.is_cut:
                self.link.incoming += tracker.reports(now_ns, self.scenario.sampling_hz)
        self.serve()

    def serve(self) -> None:
        self.link.sent.clear()
        self.service.step()
        for set_point in self.link.sent:
            if not self.is_cut:
                self.trackers[set_point.tracker].obey(set_point)

    def before_sampling(self) -> None:
        """For worlds that do something here."""

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.step()

    def run_until(self, state: ChaseState, at_most_s: float = 30.0) -> float:
        """Seconds until this state."""
        for number in range(round(at_most_s / STEP_S)):
            if self.service.state is state:
                return number * STEP_S
            self.step()
        raise AssertionError(f"{self.service.state} after {at_most_s} s, not {state}: {self.transitions()}")

    def transitions(self) -> list[tuple[ChaseState, str]]:
        return [(entry.after, entry.reason) for entry in self.log if isinstance(entry, Transition)]

    def decisions(self) -> list[Decision]:
        return [entry for entry in self.log if isinstance(entry, Decision)]

    def told(self) -> list[int]:
        """The trackers that the last step had a set-point for."""
        return [set_point.tracker for set_point in self.link.sent]

    @property
    def reason(self) -> str:
        return self.service.snapshot().reason


class SimulatedWorld(Bench):
    """The environment makes the RSSI: one window for each formation in which the trackers have arrived.

    On the way, and after a window's last sample, receivers report rubbish.
    """

    def __init__(self, scenario: Scenario, controller: Controller, seed: int, chase: int) -> None:
        self.environment = Environment(scenario)
        self.world = self.environment.reset(chase_keys(seed, 1, chase))
        self.taken, self.begins_ns, self.is_due = -1, 0, True
        super().__init__(scenario, controller, self.heard_dbm, spacing_m=scenario.initial_spacing_m)
        self.service = self.new_service(epoch=2)
        self.service.start()

    def heard_dbm(self, tracker: FakeTracker, now_ns: int) -> float:
        if self.is_due or now_ns < self.begins_ns:
            return -1.0
        self.taken += tracker.number == 0
        window = self.world.rssi_dbm[0]
        return float(window[self.taken, tracker.number]) if self.taken < len(window) else -1.0

    def before_sampling(self) -> None:
        self.arrive()

    def serve(self) -> None:
        super().serve()
        if not self.decisions() and self.is_due and self.service.state is SAMPLING:
            self.begin(self.clock.now_ns() + 1)
        self.is_due |= len(self.decisions()) > int(self.world.movements[0])

    def begin(self, now_ns: int) -> None:
        self.taken, self.begins_ns, self.is_due = -1, now_ns, False

    def arrive(self) -> None:
        """When the trackers are where the last action wants them, the world moves on and a window begins."""
        if not self.is_due or len(self.decisions()) == int(self.world.movements[0]):
            return
        last = self.decisions()[-1]
        spacing_m = torch.tensor([last.spacing_m], dtype=torch.float64)
        displacement_m = torch.tensor([last.displacement_m], dtype=torch.float64)
        place_m = formation_m(CENTER_M + (self.world.center_m + displacement_m)[0].numpy(), last.spacing_m)
        if all((tracker.position_m == place_m[tracker.number]).all() for tracker in self.trackers):
            self.world, outcome = self.environment.step(self.world, Action(spacing_m, displacement_m))
            self.begin(self.clock.now_ns())
            if outcome.reached:
                self.service.declare_reached()


def evaluated(
    scenario: Scenario, controller: Controller, seed: int, chase: int, most: int
) -> list[tuple[State, Action]]:
    """What evaluation sees and decides, movement by movement, until the target is reached."""
    environment = Environment(scenario)
    state, memory = environment.reset(chase_keys(seed, 1, chase)), controller.begin(1, seed, chase)
    course = []
    for _ in range(most):
        action, memory = controller.decide(state.observation(), memory)
        course.append((state, action))
        state, outcome = environment.step(state, action)
        if outcome.reached:
            break
    return course
