"""What a live chase survives: the whole live system, over its real signed link, on a clock that is made.

Seconds are of that clock, and the same in every run. Undisturbed, the chase of ``Flight`` goes so (its controller is
``recurrent``, its target 10 m away):

    0.05 sampling   1.45 moving   3.65 sampling   5.05 moving   7.05 sampling   8.45 reached
"""

import itertools
import math
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jaxtyping
import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from live_bench import FLYING
from swarmchase import load_controller
from swarmchase.batch.streams import chase_keys
from swarmchase.controllers import Controller
from swarmchase.formation import Action
from swarmchase.live.alarms import Alarm, Alarms
from swarmchase.live.chronicle import Chronicle
from swarmchase.live.events import Events
from swarmchase.live.frame import Frame
from swarmchase.live.link.codec import TRACKER_COMPONENT, system_of
from swarmchase.live.link.mavlink import MOST_OF_ONE_SENDER, ControllerMavlinkLink
from swarmchase.live.link.messages import Heartbeat, Message, PositionReport, RssiWindow, TrackerMode
from swarmchase.live.link.packet import PacketWriter
from swarmchase.live.link.timestamps import Timestamps
from swarmchase.live.service.chase_state import ChaseState, Decision, Snapshot, Transition
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.live.service.service import ControllerService
from swarmchase.live.service.settings import ServiceSettings
from swarmchase.live.tracker.agent import AgentSettings
from swarmchase.live.tracker.vehicles import VehicleLimits
from swarmchase.observation import Observation
from swarmchase.scenario import Scenario, paper_scenario
from swarmchase.simulation.fault_plan import fault_plan
from swarmchase.simulation.virtual_chase import KEYS, START_NS, TICK_S, VirtualChase, VirtualResult
from swarmchase.simulation.virtual_network import CONTROLLER, VirtualSocket
from swarmchase.world.environment import Environment

IDLE, CONNECTING, SAMPLING, MOVING, PURSUING, FOLLOWING, SEARCHING, HOLDING, REACHED, LOST, ABORTED = ChaseState
NEAR: dict[str, Any] = {
    "sampling_hz": 100,
    "spatial_correlation": 0.9,
    "start_distance_m": 10,
    "max_movements": 12,
}
FARTHER_M = 20
"""For those that need more than two movements."""
REACHED_S = 8.45
"""When the undisturbed chase has reached its target."""
HOLD_S = 1.0
"""After its last set-point a tracker holds."""
STEP_S = 2 * TICK_S
"""Between two steps of the service; an agent steps twice as often."""


class Flight:
    """A virtual chase, and what it has recorded."""

    def __init__(
        self,
        faults: str = "",
        controller: str | Controller = "recurrent",
        *,
        seed: int = 1,
        chase: int = 0,
        settings: ServiceSettings | None = None,
        limits: SafetyLimits | None = None,
        agent_settings: AgentSettings | None = None,
        **changes: Any,
    ) -> None:
        self.scenario = paper_scenario(**{**NEAR, **changes})
        self.log: list[Transition | Decision] = []
        self.snapshots: list[Snapshot] = []
        """One a step of the service."""
        self.chase = VirtualChase(
            self.scenario,
            load_controller(controller, self.scenario) if isinstance(controller, str) else controller,
            seed,
            chase,
            fault_plan(faults),
            settings,
            self.log.append,
            self.snapshots.append,
            limits,
            agent_settings=agent_settings,
        )

    @property
    def seconds(self) -> float:
        return (self.chase.clock.now_ns() - START_NS) / 1e9

    @property
    def state(self) -> ChaseState:
        return self.chase.service.state

    @property
    def snapshot(self) -> Snapshot:
        return self.chase.service.snapshot()

    def run_to(self, seconds: float, each_tick: Callable[[], None] = lambda: None) -> None:
        while self.seconds < seconds - 1e-9:
            self.chase.tick()
            each_tick()

    def run_until(self, is_so: Callable[[], bool], at_most_s: float = 20.0) -> float:
        """Seconds until it is so."""
        began_s = self.seconds
        while not is_so():
            assert self.seconds < began_s + at_most_s, (self.state, self.told())
            self.chase.tick()
        return self.seconds - began_s

    def run(self) -> VirtualResult:
        return self.chase.run()

    def decisions(self) -> list[Decision]:
        return [entry for entry in self.log if isinstance(entry, Decision)]

    def told(self) -> list[tuple[float, str, str]]:
        """Each transition: seconds, the new state, the reason."""
        return [
            ((entry.time_ns - START_NS) / 1e9, entry.after.value, entry.reason)
            for entry in self.log
            if isinstance(entry, Transition)
        ]

    def states(self) -> set[str]:
        return {state for _, state, _ in self.told()}

    def modes(self) -> list[TrackerMode]:
        return [vehicle.mode for vehicle in self.chase.site.vehicles]

    def speeds_mps(self) -> list[float]:
        return [math.hypot(*vehicle.velocity_mps) for vehicle in self.chase.site.vehicles]

    def ignored(self, reason: str) -> int:
        """How many set-points the trackers have not obeyed for this reason."""
        return sum(agent.ignored[reason] for agent in self.chase.agents if agent is not None)


@pytest.fixture(scope="module", autouse=True)
def _without_type_checks() -> Iterator[None]:
    """Of each call they would take ten times as long as the chases themselves; one test has them."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", before)


def test_a_faulty_chase_with_every_type_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", False)
    flight = Flight("loss=0.1,duplicate=0.2,replay=0.1,forge=50,garbage=1@0,kill=2@2")
    flight.run_to(5.0)
    assert flight.snapshot.movements >= 1


@pytest.fixture(scope="module")
def undisturbed() -> Flight:
    """A chase that nothing happens to, when it has ended."""
    flight = Flight()
    assert flight.run().reached
    return flight


def require_same_course(flight: Flight, undisturbed: Flight, level_db: float = 2e-3) -> None:
    """The same actions on the same windows, but for what centimetres between places make of levels."""
    assert len(flight.decisions()) == len(undisturbed.decisions()) > 0
    for decision, clean in zip(flight.decisions(), undisturbed.decisions(), strict=True):
        assert decision.rssi_dbm == pytest.approx(clean.rssi_dbm, abs=level_db)
        assert (decision.spacing_m, decision.displacement_m) == (clean.spacing_m, clean.displacement_m)
        assert decision.changed == ""


def require_same_log(flight: Flight, undisturbed: Flight) -> None:
    """Bit for bit, and at the same moments."""
    assert flight.told() == undisturbed.told()
    assert len(flight.decisions()) == len(undisturbed.decisions()) > 0
    for decision, clean in zip(flight.decisions(), undisturbed.decisions(), strict=True):
        assert decision.time_ns == clean.time_ns
        assert (decision.spacing_m, decision.displacement_m) == (clean.spacing_m, clean.displacement_m)
        assert np.array_equal(decision.rssi_dbm, clean.rssi_dbm, equal_nan=True)
        assert np.array_equal(decision.tracker_position_m, clean.tracker_position_m)


# Without faults


@pytest.mark.parametrize(
    ("controller", "changes"),
    [
        ("recurrent", {"start_distance_m": 30}),
        ("recurrent", {"continuity": "continuous"}),
        ("particle", {}),
        ("particle", {"sampling_hz": 10}),
        ("particle", {"silent_trackers": 1, "missing_sample_share": 0.2}),
        ("gradient", {"sampling_hz": 50}),
        ("gradient", {"continuity": "continuous"}),
    ],
)
def test_a_chase_without_faults_is_the_evaluated_one(controller: str, changes: dict[str, Any]) -> None:
    """Movement by movement: actions, windows to 0.002 dB, places to 1 mm."""
    changes = {"start_distance_m": FARTHER_M, "max_movements": 4, **changes}
    flight = Flight(controller=controller, seed=5, chase=2, **changes)
    flight.run()
    environment, same = Environment(flight.scenario), load_controller(controller, flight.scenario)
    state, memory = environment.reset(chase_keys(5, 1, 2)), same.begin(1, 5, 2)
    assert len(flight.decisions()) > 2
    for decision in flight.decisions():
        observation = state.observation()
        action, memory = same.decide(observation, memory)
        evaluated_dbm = observation.rssi_dbm[0].double().numpy()
        assert decision.rssi_dbm == pytest.approx(evaluated_dbm, abs=2e-3, nan_ok=True)
        assert decision.tracker_position_m == pytest.approx(observation.tracker_position_m[0].numpy(), abs=1e-3)
        assert decision.spacing_m == action.spacing_m.item()
        assert list(decision.displacement_m) == action.displacement_m[0].tolist()
        state, _ = environment.step(state, action)
    assert flight.states() <= {"connecting", "sampling", "moving", "reached", "lost"}


def test_the_same_seed_is_the_same_chase_and_another_is_another(undisturbed: Flight) -> None:
    flight, other = Flight(), Flight(seed=2)
    flight.run()
    require_same_log(flight, undisturbed)
    other.run_until(lambda: len(other.decisions()) == 1)
    assert not np.array_equal(other.decisions()[0].rssi_dbm, undisturbed.decisions()[0].rssi_dbm)


# The controller dies, the link is down


def test_a_link_that_is_down_stops_every_tracker_and_the_chase_goes_on_when_it_heals() -> None:
    """Row "controller dies, link down": set-points stream and expire; the tracker holds within 1 s of the last one.

    From 5.5 to 9.5 s, in the middle of a movement.
    """
    flight = Flight("outage=5.5-9.5")
    flight.run_to(5.45)
    assert flight.modes() == [TrackerMode.FOLLOWING] * 6
    assert min(flight.speeds_mps()) > 1
    flight.run_to(5.5 + HOLD_S - STEP_S - TICK_S)
    assert flight.modes() == [TrackerMode.FOLLOWING] * 6
    flight.run_to(5.5 + HOLD_S + TICK_S)
    assert flight.modes() == [TrackerMode.HOLDING] * 6
    assert flight.run_until(lambda: max(flight.speeds_mps()) == 0, at_most_s=1.1) <= 1.1
    stood_m = flight.chase.site.positions_m()
    flight.run_to(9.5)
    assert flight.chase.site.positions_m() == stood_m
    assert flight.state is HOLDING
    assert flight.told()[-1][2] == "0 trackers are too few"
    healed_s = flight.run_until(lambda: flight.state is MOVING and flight.modes() == [TrackerMode.FOLLOWING] * 6)
    assert healed_s <= 2
    assert flight.run().reached


def test_after_outages_windows_and_actions_are_those_of_an_undisturbed_chase(undisturbed: Flight) -> None:
    """While moving, and then while sampling: nothing that was in flight before them counts after them."""
    flight = Flight("outage=2-5,outage=8-11")
    flight.run_to(8.0)
    assert flight.state is SAMPLING
    assert flight.told()[-2][1] == "moving"
    assert flight.run().reached
    assert "holding" in flight.states()
    first, clean = flight.decisions()[0], undisturbed.decisions()[0]
    assert first.rssi_dbm == pytest.approx(clean.rssi_dbm, abs=2e-3)
    for decision in flight.decisions():
        assert np.isfinite(decision.rssi_dbm).all()
        assert decision.tracker_position_m == pytest.approx(decision.tracker_position_m[:1].repeat(50, 0), abs=1e-3)


def test_when_the_controller_dies_trackers_hold_and_after_a_minute_return() -> None:
    """Row "controller dies, link down": returns after a set time. Sixty seconds after the last set-point, here twenty,
    the way they came: as slowly, and as far from one another.
    """
    assert AgentSettings().return_after_s == 60
    flight = Flight(sampling_hz=10, start_distance_m=FARTHER_M, agent_settings=AgentSettings(return_after_s=20.0))
    flight.run_to(8.0)
    homes_m = np.array([[5, 0, 0], [-5, 0, 0], [0, 5, 0], [0, -5, 0], [0, 0, 5], [0, 0, -5]])
    died_s = flight.seconds
    while flight.seconds < died_s + HOLD_S + 1.1:
        flight.chase.tick_without_service()
    assert flight.modes() == [TrackerMode.HOLDING] * 6
    assert max(flight.speeds_mps()) == 0
    stood_m = np.array(flight.chase.site.positions_m())
    assert np.linalg.norm(stood_m - homes_m, axis=1).min() > 1
    while flight.seconds < died_s + 19.9:
        flight.chase.tick_without_service()
    assert np.array_equal(flight.chase.site.positions_m(), stood_m)
    while flight.seconds < died_s + 20 + died_s + 7:
        flight.chase.tick_without_service()
        positions_m = np.array(flight.chase.site.positions_m())
        assert min(np.linalg.norm(one - other) for one, other in itertools.combinations(positions_m, 2)) >= 1.4
        assert max(flight.speeds_mps()) <= 5 + 1e-9
    assert np.array(flight.chase.site.positions_m()) == pytest.approx(homes_m, abs=0.02)
    # They follow nobody: a controller that comes back finds them at their disposal.
    assert [agent._mode() for agent in flight.chase.agents if agent is not None] == [TrackerMode.HOLDING] * 6


# A tracker is silent


def test_a_silent_tracker_is_marked_after_a_second_and_the_others_go_on() -> None:
    """Row "a tracker is silent": marked after 1 s, its column NaN, the controller goes on with five.

    From 4 s on, in the middle of a window.
    """
    flight = Flight("silent=2@4", start_distance_m=FARTHER_M)
    flight.run_to(4.0 + 1.0 - STEP_S)
    assert not flight.snapshot.trackers[2].is_silent
    flight.run_to(4.0 + 1.0 + 2 * STEP_S)
    assert [tracker.is_silent for tracker in flight.snapshot.trackers] == [False, False, True, False, False, False]
    result = flight.run()
    assert result.movements >= 4
    assert "holding" not in flight.states()
    first, second, *others = flight.decisions()
    assert np.isfinite(first.rssi_dbm).all()
    assert np.isfinite(second.rssi_dbm[:, [0, 1, 3, 4, 5]]).all()
    assert len(others) >= 2
    for decision in others:
        assert np.isnan(decision.rssi_dbm[:, 2]).all()
        assert np.isfinite(decision.rssi_dbm[:, [0, 1, 3, 4, 5]]).all()
    # It flies with the others.
    center_m = np.array(flight.snapshot.center_m)
    wanted_m = center_m + np.array([0, flight.snapshot.spacing_m or math.nan, 0])
    assert flight.chase.site.vehicles[2].position_m == pytest.approx(wanted_m, abs=0.02)


def test_with_three_silent_trackers_it_holds_and_goes_on_when_one_is_heard_again() -> None:
    """Row "a tracker is silent": below the minimum of four: hold."""
    flight = Flight("silent=0@4-9,silent=1@4-20,silent=2@4-20", start_distance_m=FARTHER_M)
    flight.run_to(9.0)
    assert flight.state is HOLDING
    assert flight.told()[-1][2] == "3 trackers are too few"
    assert flight.told()[-1][0] <= 4 + 1 + 2 * STEP_S
    assert len(flight.decisions()) == 1
    assert max(flight.speeds_mps()) == 0
    assert flight.run_until(lambda: flight.state is not HOLDING) <= 2
    flight.run_to(20.0)
    heard = np.isfinite(flight.decisions()[-1].rssi_dbm).all(axis=0)
    assert heard.tolist() == [True, False, False, True, True, True]


SAYS: dict[str, Callable[[Any], bool]] = {
    # What contradicts the others' levels is not heard.
    "stuck": lambda levels_dbm: len(set(levels_dbm[np.isfinite(levels_dbm)])) == 1,
    "garbage": lambda levels_dbm: 0.25 < np.isnan(levels_dbm).mean() < 0.6 and np.nanmax(levels_dbm) < -20,
    "wrong": lambda levels_dbm: np.isfinite(levels_dbm).all(),
    "delayed": lambda levels_dbm: 0 < np.isnan(levels_dbm).mean() < 1,
    "intermittent": lambda levels_dbm: 0.2 < np.isnan(levels_dbm).mean() < 0.8,
}


@pytest.mark.parametrize("faults", [{4: "stuck", 1: "intermittent"}, {4: "delayed", 1: "wrong"}, {4: "garbage"}])
def test_receivers_that_fail_do_not_stop_the_chase(faults: dict[int, str]) -> None:
    """PX4's fault words, from the first movement on. What is no level is never heard."""
    words = ",".join(f"{fault}={tracker}@1.5" for tracker, fault in faults.items())
    flight = Flight(words, controller="particle", start_distance_m=FARTHER_M)
    flight.run_until(lambda: len(flight.decisions()) == 4)
    assert "holding" not in flight.states()
    levels_dbm = np.array([decision.rssi_dbm for decision in flight.decisions()])
    assert np.isfinite(levels_dbm[0]).all()
    for tracker, fault in faults.items():
        assert SAYS[fault](levels_dbm[1:, :, tracker]), fault
    assert np.isfinite(np.delete(levels_dbm, list(faults), axis=2)).all()


# Stale, late, duplicated, reordered data


def test_repeated_and_reordered_datagrams_give_the_same_windows(undisturbed: Flight) -> None:
    """Row "stale, late, duplicated, reordered data": any permutation with duplicates gives the same window.

    What overtakes makes the overtaken a replay to the link, and no sample is missed: each comes in five datagrams.
    """
    flight = Flight("delay=0.02,reorder=0.2,duplicate=0.5,replay=0.3")
    result = flight.run()
    assert result.reached
    assert set(result.rejected) == {"replayed"}
    assert result.rejected["replayed"] > 50
    require_same_course(flight, undisturbed)


def test_set_points_that_were_under_way_for_more_than_a_second_are_not_obeyed() -> None:
    """Row "stale, late, duplicated, reordered data": drop by sender time and age, as after a radio's full queue.

    For 3 s nothing reaches tracker 0, then all of it at once: of 60 set-points no older than 1 s is obeyed.
    """
    flight = Flight()
    flight.run_to(2.0)
    vehicle, agent, udp = flight.chase.site.vehicles[0], flight.chase.agents[0], flight.chase.network.trackers[0]
    assert agent is not None
    queue: list[tuple[bytes, Any]] = []
    udp.put = lambda datagram, address: queue.append((datagram, address))  # type: ignore[method-assign]
    flight.run_to(2.0 + HOLD_S + TICK_S)
    assert vehicle.mode is TrackerMode.HOLDING
    flight.run_to(5.0)
    assert len(queue) == 60
    del udp.put
    goals_m: list[Any] = []
    go_to = agent._vehicle.go_to
    agent._vehicle.go_to = lambda goal_m: (goals_m.append(goal_m), go_to(goal_m))  # type: ignore[method-assign]
    for datagram, address in queue:
        udp.put(datagram, address)
    flight.chase.tick()
    # Sent at 2.05, 2.1 ... 5 s. A call reads the newest 32, from 3.45 s on. The fastest have taken 0.025 s so far,
    # which counts as nothing, so at 5.025 s that of 4 s is a second old, but for what clocks may have drifted since.
    assert agent.ignored["too long under way"] == 11
    assert len(goals_m) == 32 - 11
    assert flight.run().reached


@pytest.mark.parametrize("held_s", [2.5, 30.0])
def test_of_what_is_held_back_from_the_start_nothing_is_decided(held_s: float) -> None:
    """Row "withheld data counts as fresh": every datagram of every tracker comes, in order, so many seconds late."""
    flight = Flight(f"delay={held_s}", sampling_hz=10)
    flight.run_to(held_s + 5.0)
    assert flight.state is CONNECTING
    assert not flight.decisions()
    assert flight.modes() == [TrackerMode.HOLDING] * 6
    assert flight.chase.link.rejected.keys() == {"too old"}
    skews_s = flight.chase.link.rejections.skew_s()["too old"]
    assert skews_s == {f"tracker {number}": pytest.approx(-held_s, abs=STEP_S) for number in range(6)}


def test_what_a_path_holds_back_in_flight_stops_the_swarm_and_it_goes_on_afterwards() -> None:
    """Row "withheld data counts as fresh": for five seconds nothing comes, then its older half."""
    flight = Flight()
    flight.run_to(6.0)
    network, late = flight.chase.network, []
    put = network.controller.put
    network.controller.put = lambda *datagram: late.append(datagram)  # type: ignore[method-assign]
    flight.run_to(11.0)
    assert flight.state is HOLDING
    network.controller.put = put  # type: ignore[method-assign]
    held_m = flight.chase.site.positions_m()
    for datagram in late[: len(late) // 2]:
        network.controller.put(*datagram)
    flight.chase.tick()
    assert 100 < flight.chase.link.rejected["too old"] <= 6 * MOST_OF_ONE_SENDER
    assert flight.state is HOLDING
    assert flight.chase.site.positions_m() == held_m
    assert flight.run().reached


# Loss, bursts, jitter


@pytest.mark.parametrize(
    ("faults", "missing_share", "loss_share"),
    [
        # Of five datagrams with a sample one must come: 0.3^5 do not.
        ("loss=0.3", 0.01, 0.3),
        # A burst is of ten datagrams on average, about half a second of one tracker's.
        ("burst=0.2", 0.2, 0.2),
        # What is overtaken counts as lost.
        ("loss=0.15,delay=0.05,jitter=0.05,burst=0.05", 0.15, 0.4),
    ],
)
def test_a_bad_radio_link_does_not_keep_the_swarm_from_its_target(
    faults: str, missing_share: float, loss_share: float
) -> None:
    """Row "loss, bursts, jitter": the window in every datagram."""
    flight = Flight(faults, start_distance_m=FARTHER_M)
    result = flight.run()
    assert result.reached
    missing = [np.isnan(decision.rssi_dbm).mean() for decision in flight.decisions()]
    assert np.mean(missing) < missing_share
    told = [share for share in flight.chase.link.loss_share() if share is not None]
    assert len(told) == 6
    assert np.mean(told) == pytest.approx(loss_share, abs=0.12)


def test_the_loss_that_is_shown_is_that_of_the_link() -> None:
    """End to end: datagrams of one tracker are dropped, and its frame says so."""
    flight = Flight()
    put, number = flight.chase.network.controller.put, 0

    def every_fourth_lost(datagram: bytes, address: Any) -> None:
        nonlocal number
        number += address == ("tracker", 3)
        if address != ("tracker", 3) or number % 4:
            put(datagram, address)

    flight.chase.network.controller.put = every_fourth_lost  # type: ignore[method-assign]
    frames: list[Frame] = []
    chronicle = Chronicle(flight.chase.link, START_NS, [frames.append], Events(Alarms(flight.chase.link)))
    flight.run_to(8.0)
    chronicle(flight.snapshot, None)
    shown = [tracker["loss_share"] for tracker in frames[-1]["trackers"]]
    assert shown == [0, 0, 0, pytest.approx(0.25, abs=0.01), 0, 0]


# Replayed, forged, unsigned, wrong key


def test_of_what_a_stranger_sends_nothing_is_accepted(undisturbed: Flight) -> None:
    """Row "replayed, forged, unsigned, wrong key": none accepted. 200 datagrams a second in the trackers' names."""
    flight = Flight("forge=200")
    result = flight.run()
    require_same_log(flight, undisturbed)
    assert sum(result.rejected.values()) == pytest.approx(200 * REACHED_S, abs=1)
    kinds = {"malformed", "truncated", "unsigned", "wrong key", "replayed", "giant", "bad checksum"}
    assert kinds <= result.rejected.keys()
    assert min(result.rejected[kind] for kind in kinds) > 20


def test_after_a_restart_nothing_from_before_is_accepted() -> None:
    """Row "replayed, forged, unsigned, wrong key": also after a restart, here of a service that has lost its state."""
    flights = [Flight(faults) for faults in ("", "forge=200")]
    for flight in flights:
        flight.run_to(4.0)
        flight.chase.restart_service(epoch=2)
        flight.log.clear()
        flight.run()
    clean, forged = flights
    require_same_log(forged, clean)
    assert forged.chase.link.rejected["too old"] + forged.chase.link.rejected["replayed"] > 100
    assert not clean.chase.link.rejected


# A valid key, hostile values


class Hostile:
    """Holds tracker 5's key, and says with it what a program chooses, ten times a second."""

    def __init__(self, flight: Flight, says: Callable[[int], list[Message]]) -> None:
        self._flight, self._says = flight, says
        clock = flight.chase.clock
        self._writer = PacketWriter(system_of(5), TRACKER_COMPONENT, Timestamps([], None, clock.now_ns))
        self._ticks = 0

    def step(self) -> None:
        self._ticks += 1
        if self._ticks % 4 == 0:
            for message in self._says(self._flight.chase.clock.now_ns()):
                datagram = self._writer.datagram(message, KEYS[5])
                self._flight.chase.network.controller.put(datagram, ("tracker", 5))


def honest_but_for(lie: Callable[[int], list[Message]]) -> Callable[[int], list[Message]]:
    """At 0, 0, -5, hearing 60 dBm, and something else."""
    return lambda now_ns: [
        Heartbeat(5, now_ns, TrackerMode.FOLLOWING, FLYING),
        PositionReport(5, now_ns, (0.0, 0.0, -5.0)),
        RssiWindow(5, now_ns, 100.0, (-60.0,) * 50),
        *lie(now_ns),
    ]


FAR_NS = 2**62
LIES: dict[str, Callable[[int], list[Message]]] = {
    "far away": lambda now_ns: [
        Heartbeat(5, now_ns, TrackerMode.FOLLOWING, FLYING),
        PositionReport(5, now_ns, (-99_999.0, 99_999.0, 99_999.0)),
        RssiWindow(5, now_ns, 100.0, (50.0,) * 50),
    ],
    "here and there": lambda now_ns: [
        Heartbeat(5, now_ns, TrackerMode.FOLLOWING, FLYING),
        PositionReport(5, now_ns, (3.0 * (now_ns // 10**8 % 3), 0.5, -0.5)),
        RssiWindow(5, now_ns, 10.0, (-200.0, 50.0) * 25),
    ],
    "in the far future": honest_but_for(
        lambda now_ns: [
            Heartbeat(5, now_ns + FAR_NS, TrackerMode.MANUAL, FLYING),
            PositionReport(5, now_ns + FAR_NS, (1.0, 2.0, 3.0)),
            RssiWindow(5, now_ns + FAR_NS, 0.1, (0.0,) * 50),
            Heartbeat(5, 2**63 - 1, TrackerMode.FOLLOWING, FLYING),
        ]
    ),
    "from the beginning of time": honest_but_for(
        lambda now_ns: [Heartbeat(5, 0, TrackerMode.FOLLOWING, FLYING), RssiWindow(5, 0, 10_000.0, (math.nan,) * 50)]
    ),
    "now this, now that": lambda now_ns: [
        Heartbeat(5, now_ns, TrackerMode.MANUAL if now_ns // 10**8 % 2 else TrackerMode.FOLLOWING, FLYING),
        PositionReport(5, now_ns, (0.0, 0.0, -5.0), (200.0, -200.0, 200.0)),
    ],
}
FENCE = SafetyLimits(
    fence_west_m=-20.0,
    fence_east_m=25.0,
    fence_south_m=-25.0,
    fence_north_m=20.0,
    lowest_altitude_m=-25.0,
    highest_altitude_m=20.0,
)


@pytest.mark.parametrize("lie", LIES)
def test_a_tracker_that_lies_with_a_valid_key_moves_nobody_beyond_the_limits(lie: str) -> None:
    """Row "valid key, hostile values": checks of what is finite and in range, and the safety filter after them.

    From 2 to 8 s; then it falls silent, and the other five go on.
    """
    flight = Flight("kill=5@8", limits=FENCE, controller="gradient", max_movements=30, start_distance_m=FARTHER_M)
    flight.run_to(2.0)
    flight.chase.agents[5] = Hostile(flight, LIES[lie])  # type: ignore[call-overload]
    watch = Watch(flight, trackers=range(5))
    flight.run_to(8.0, watch)
    decided = len(flight.decisions())
    flight.run_to(13.0, watch)
    assert len(flight.decisions()) > decided
    assert not flight.states() & {"holding", "reached", "lost"}
    assert watch.set_points > 1000


def test_a_tracker_does_not_speak_for_another() -> None:
    """Row "valid key, hostile values": tracker 1 cannot speak for tracker 2."""
    flight = Flight()
    flight.run_to(2.0)
    writer = PacketWriter(system_of(2), TRACKER_COMPONENT, Timestamps([], None, flight.chase.clock.now_ns))
    for _ in range(20):
        flight.chase.tick()
        report = PositionReport(2, flight.chase.clock.now_ns(), (50.0, 50.0, 50.0))
        flight.chase.network.controller.put(writer.datagram(report, KEYS[1]), ("tracker", 1))
        seen_m = flight.snapshot.trackers[2].position_m
        assert seen_m == pytest.approx(flight.chase.site.vehicles[2].position_m, abs=1.0)
    assert flight.chase.link.rejected == {"wrong key": 19}


# Fence, altitude, separation, speed


class Watch:
    """Called after every tick, it checks the limits, of set-points and of what truly flies."""

    def __init__(self, flight: Flight, trackers: range = range(6)) -> None:
        self._chase, self._trackers = flight.chase, list(trackers)
        self._limits = flight.chase._limits
        self._before_m: dict[int, Any] = {}
        self.set_points = 0

    def __call__(self) -> None:
        vehicles = [self._chase.site.vehicles[tracker] for tracker in self._trackers]
        # A vehicle brakes in time, but not to the millimetre.
        self._check(np.array([vehicle.position_m for vehicle in vehicles]), slack_m=0.05)
        assert max(math.hypot(*vehicle.velocity_mps) for vehicle in vehicles) <= VehicleLimits().speed_mps + 1e-9
        trackers = self._chase.service.snapshot().trackers
        told = {tracker: trackers[tracker].set_point_m for tracker in range(6)}
        told_m = {tracker: np.array(place_m) for tracker, place_m in told.items() if place_m is not None}
        self._check(np.array([told_m[tracker] for tracker in self._trackers if tracker in told_m]), slack_m=1e-6)
        for tracker, place_m in told_m.items():
            if tracker in self._trackers and tracker in self._before_m:
                flown_m = np.linalg.norm(place_m - self._before_m[tracker])
                assert flown_m <= self._limits.highest_speed_mps * STEP_S + 1e-6
        self.set_points += len(told_m)
        self._before_m = told_m

    def _check(self, place_m: Any, slack_m: float) -> None:
        if len(place_m) == 0:
            return
        assert (place_m >= self._limits.low_m - slack_m).all()
        assert (place_m <= self._limits.high_m + slack_m).all()
        apart_m = np.linalg.norm(place_m[:, None] - place_m[None], axis=2) + 1e9 * np.eye(len(place_m))
        assert apart_m.min() >= self._limits.minimum_separation_m - slack_m


NARROW = SafetyLimits(
    fence_west_m=-8.0,
    fence_east_m=9.0,
    fence_south_m=-7.0,
    fence_north_m=8.0,
    lowest_altitude_m=-6.0,
    highest_altitude_m=10.0,
    highest_speed_mps=4.0,
)
"""Of set-points; a vehicle that has fallen behind one may catch up as fast as it can."""


@pytest.mark.parametrize(
    ("seed", "faults"),
    [
        (1, ""),
        (2, "loss=0.2,delay=0.05,jitter=0.05,duplicate=0.2,outage=6-9"),
        (3, "slow=0@2,frozen=1@3-6,restart=2@8,silent=3@10-14,forge=50"),
    ],
)
def test_whatever_a_controller_wants_nobody_leaves_the_limits(seed: int, faults: str) -> None:
    """Row "geofence, altitude, separation, speed": checked of every set-point, and of where all really are, 40 times a
    second, while a controller without a plan flies against a narrow fence.
    """
    flight = Flight(
        faults, controller="random", limits=NARROW, seed=seed, max_movements=100, start_distance_m=FARTHER_M
    )
    watch = Watch(flight)
    flight.run_to(16.0, watch)
    assert watch.set_points > 1500
    assert sum("centre moved" in decision.changed for decision in flight.decisions()) >= 2


# A pilot takes a vehicle


def test_what_a_pilot_takes_is_left_alone_and_flies_with_the_others_when_it_is_given_back() -> None:
    """Row "tracker's own failsafe or pilot takes over": stop commanding it, go on with the rest."""
    flight = Flight(start_distance_m=40, max_movements=30)
    vehicle = flight.chase.site.vehicles[3]
    flight.run_to(2.0)
    vehicle.take_over()
    # Until the next heartbeat nobody tells the controller.
    flight.run_to(3.1)
    assert flight.snapshot.trackers[3].mode is TrackerMode.MANUAL
    assert [tracker.set_point_m is None for tracker in flight.snapshot.trackers] == [False] * 3 + [True] + [False] * 2
    stood_m = vehicle.position_m
    flight.run_to(10.0)
    assert vehicle.position_m == stood_m
    assert vehicle.mode is TrackerMode.MANUAL
    decisions = flight.decisions()
    assert len(decisions) >= 3
    assert np.isnan(decisions[-1].rssi_dbm[:, 3]).all()
    assert np.isfinite(decisions[-1].rssi_dbm[:, [0, 1, 2, 4, 5]]).all()
    assert "holding" not in flight.states()
    vehicle.give_back()
    decided = len(decisions)
    flight.run_until(lambda: len(flight.decisions()) > decided + 1)
    assert vehicle.mode is TrackerMode.FOLLOWING
    last = flight.decisions()[-1]
    assert np.isfinite(last.rssi_dbm).all()
    # It is back in its place: on the axis of its opposite, on the other side of the centre.
    places_m = last.tracker_position_m[-1]
    assert places_m[3] == pytest.approx(2 * places_m[[0, 1]].mean(axis=0) - places_m[2], abs=0.1)


# The controller hangs, fails or says nonsense


class Failing:
    """``recurrent``, but for what it does when it is asked for these times."""

    name = "failing"

    def __init__(self, scenario: Scenario, fails: dict[int, Callable[[Action], Action]]) -> None:
        self._inner, self._fails = load_controller("recurrent", scenario), fails
        self._asked = 0

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> Any:
        return self._inner.begin(num_chases, seed, first_chase)

    def decide(self, observation: Observation, memory: Any) -> tuple[Action, Any]:
        self._asked += 1
        action, memory = self._inner.decide(observation, memory)
        return self._fails.get(self._asked, lambda action: action)(action), memory


def test_while_the_controller_hangs_all_hold() -> None:
    """Row "controller hangs, NaN, deadline missed": the loop itself is the proof of life; hold.

    Its second decision takes three seconds. Trackers hold after one; then the chase goes on as if nothing had been.
    """
    modes: dict[float, list[TrackerMode]] = {}

    def hangs(action: Action) -> Action:
        began_s = flight.seconds
        while flight.seconds < began_s + 3:
            flight.chase.tick_without_service()
            modes[round(flight.seconds - began_s, 3)] = flight.modes()
        return action

    flight = Flight(controller=Failing(paper_scenario(**NEAR), {2: hangs}))
    result = flight.run()
    assert modes[HOLD_S - STEP_S] == [TrackerMode.FOLLOWING] * 6
    assert modes[HOLD_S + TICK_S] == modes[3.0] == [TrackerMode.HOLDING] * 6
    assert result.reached
    assert result.seconds == pytest.approx(REACHED_S + 3, abs=2 * STEP_S)
    assert "holding" not in flight.states()


def test_a_service_that_is_not_given_time_in_mid_flight_stops_all(undisturbed: Flight) -> None:
    """Row "controller hangs, NaN, deadline missed": the whole process stands still for 3 s, while all are moving."""
    flight = Flight()
    flight.run_to(2.0)
    assert min(flight.speeds_mps()) > 1
    while flight.seconds < 2.0 + HOLD_S + 1.1:
        flight.chase.tick_without_service()
    assert flight.modes() == [TrackerMode.HOLDING] * 6
    assert max(flight.speeds_mps()) == 0
    while flight.seconds < 5.0:
        flight.chase.tick_without_service()
    assert flight.run().reached
    require_same_course(flight, undisturbed)


def fails(action: Action) -> Action:
    raise ZeroDivisionError("of course")


def test_a_controller_that_fails_holds_the_swarm_for_a_moment() -> None:
    """Row "controller hangs, NaN, deadline missed": the set-points go on, where they are, and a second later it is
    asked again. Three times, each before another movement.
    """
    failures: dict[int, tuple[Callable[[Action], Action], str]] = {
        1: (fails, "the controller failed: ZeroDivisionError: of course"),
        3: (lambda action: Action(action.spacing_m * math.nan, action.displacement_m), "the controller's action is no"),
        5: (lambda action: Action(action.spacing_m, action.displacement_m / 0), "the controller's action is no number"),
    }
    changes = {**NEAR, "start_distance_m": FARTHER_M}
    failing = Failing(paper_scenario(**changes), {asked: failure for asked, (failure, _) in failures.items()})
    flight = Flight(controller=failing, **changes)
    for _, reason in failures.values():
        flight.run_until(lambda: flight.state is HOLDING)
        assert flight.told()[-1][2].startswith(reason)
        stood_m = flight.chase.site.positions_m()
        held_s = flight.run_until(lambda: flight.state is not HOLDING)
        assert held_s == pytest.approx(ServiceSettings().retry_s, abs=STEP_S)
        assert flight.modes() == [TrackerMode.FOLLOWING] * 6
        assert flight.chase.site.positions_m() == stood_m
    assert flight.run().reached


# A restart in mid-chase


def test_a_tracker_that_reboots_is_recognised_and_its_window_is_empty_until_it_is_filled_again() -> None:
    """Row "restart in mid-chase": reboot detected, empty windows. Its clock begins at 3 s, where it was at 63 years."""
    flight = Flight("restart=4@2", start_distance_m=40, max_movements=30)
    flight.run_to(3.9)
    assert flight.chase.agents[4] is None
    assert flight.snapshot.trackers[4].is_lost
    assert flight.snapshot.trackers[4].missing_share == 0
    flight.chase.tracker_clocks[4].ahead_ns = 3 * 10**9 - flight.chase.clock.now_ns()
    shares = []
    flight.run_to(6.0, lambda: shares.append(flight.snapshot.trackers[4].missing_share))
    assert max(shares) >= 0.8
    assert shares[-1] == 0
    assert flight.snapshot.trackers[4].set_point_m is not None
    decided = len(flight.decisions())
    flight.run_until(lambda: len(flight.decisions()) > decided + 1)
    assert np.isfinite(flight.decisions()[-1].rssi_dbm).all()
    assert "holding" not in flight.states()


def test_three_trackers_that_reboot_at_once_are_waited_for() -> None:
    """Row "restart in mid-chase": hold until refilled."""
    flight = Flight("restart=0@4,restart=1@4,restart=2@4")
    flight.run_to(5.9)
    assert flight.state is HOLDING
    for tracker in range(3):
        flight.chase.tracker_clocks[tracker].ahead_ns = -flight.chase.clock.now_ns() + 10**9 * (tracker + 1)
    flight.run_until(lambda: flight.state is not HOLDING, at_most_s=2.5)
    assert flight.run().reached
    assert all(np.isfinite(decision.rssi_dbm).all() for decision in flight.decisions())


def test_a_restarted_service_begins_anew_with_empty_windows_and_a_newer_epoch() -> None:
    """Row "restart in mid-chase": at 4.2 s, with half a window heard. It first hears a whole one of its own."""
    flight = Flight()
    flight.run_to(4.2)
    flight.chase.restart_service(epoch=2)
    assert all(tracker.missing_share == 1 for tracker in flight.snapshot.trackers)
    flight.log.clear()
    flight.run_until(lambda: len(flight.decisions()) == 1)
    assert flight.states() == {"sampling", "moving"}
    assert flight.decisions()[0].time_ns - START_NS >= (4.2 + flight.scenario.window_s) * 1e9
    assert flight.decisions()[0].tracker_position_m[0].mean(axis=0) == pytest.approx(np.zeros(3), abs=0.02)
    assert flight.run().state == "reached"
    assert flight.chase.site.distance_to_target_m() <= 3  # what the judge promises
    assert flight.modes() == [TrackerMode.FOLLOWING] * 6


# Two controllers


def test_of_two_controllers_trackers_obey_the_newer(undisturbed: Flight) -> None:
    """Row "two controllers": a lease: trackers obey the newest epoch of an authorised key.

    The older one, with all keys and at an address of its own, hears all and wants everybody at a place of its own, in
    between the newer one's set-points and with signatures that are accepted.
    """
    flight = Flight()
    flight.chase.restart_service(epoch=7)
    flight.log.clear()
    flight.run_to(0.3)

    def to_tracker(datagram: bytes, address: Any) -> None:
        _, tracker = address
        flight.chase.network.trackers[tracker].put(datagram, ("older", 0))

    udp = VirtualSocket(to_tracker, 99)
    clock = flight.chase.clock
    link = ControllerMavlinkLink(*CONTROLLER, KEYS, wall_time_ns=clock.now_ns, monotonic_ns=clock.now_ns, udp=udp)
    older = ControllerService(
        flight.scenario, load_controller("random", flight.scenario), link, clock, SafetyLimits(), lambda _: None, 6
    )
    older.start()
    put = flight.chase.network.controller.put
    flight.chase.network.controller.put = (  # type: ignore[method-assign]
        lambda datagram, address: (put(datagram, address), udp.put(datagram, address))
    )
    refused = 0
    while flight.state is not REACHED and flight.seconds < 30:
        flight.chase.tick()
        if round(flight.seconds / TICK_S) % 2:  # when the newer one does not step
            older.step()
    assert older.state is not CONNECTING
    refused = flight.ignored("older epoch")
    assert refused > 6 * REACHED_S / STEP_S / 2 * 0.9
    require_same_course(flight, undisturbed)


# Clocks


def test_clocks_that_are_apart_and_drift_change_nothing(undisturbed: Flight) -> None:
    """Row "clock step, drift": monotonic only, offset per tracker estimated. Up to 100 ppm, years apart."""
    flight = Flight()
    for tracker, drift in enumerate([1e-4, -1e-4, 5e-5, -5e-5, 0.0, 1e-4]):
        clock = flight.chase.tracker_clocks[tracker]
        clock.drift, clock.ahead_ns = drift, (tracker - 3) * 10**17
    assert flight.run().reached
    require_same_course(flight, undisturbed)
    assert flight.states() == undisturbed.states()


def test_steps_of_wall_clocks_change_nothing(undisturbed: Flight) -> None:
    """Row "clock step, drift": by an hour or two, forth and back, of the controller's and of two trackers'."""
    flight = Flight()
    hour_ns = 3600 * 10**9
    flight.run_to(2.0)
    flight.chase.wall_clock.ahead_ns = -hour_ns
    flight.run_to(4.0)
    flight.chase.wall_clock.ahead_ns = hour_ns
    for tracker, ahead_ns in ((0, hour_ns), (5, -hour_ns)):
        flight.chase.tracker_wall_clocks[tracker].ahead_ns = ahead_ns
    flight.run_to(6.0)
    flight.chase.wall_clock.ahead_ns = 0
    assert flight.run().reached
    require_same_log(flight, undisturbed)
    assert not flight.chase.link.rejected


# Floods


def test_ten_times_the_traffic_in_forgeries_and_giant_packets_changes_nothing(undisturbed: Flight) -> None:
    """Row "flood, giant packet": bounded queues, newest wins, deadlines kept under 10x flood.

    Six trackers send 21 datagrams a second each. Every decision is the same, at the same moment, and every step is
    made.
    """
    flight = Flight("forge=1260")
    result = flight.run()
    require_same_log(flight, undisturbed)
    assert len(flight.snapshots) == len(undisturbed.snapshots) == round(REACHED_S / STEP_S)
    assert result.rejected["giant"] > 1000
    assert sum(result.rejected.values()) == pytest.approx(1260 * REACHED_S, abs=1)


def test_a_flood_beyond_all_bounds_is_cut_to_what_a_step_takes() -> None:
    """Row "flood, giant packet": 80,000 datagrams a second. A call takes 1024, a socket holds 10,000, all else is lost:
    the swarm holds, safe, and is there again when the flood ebbs.
    """
    flight = Flight()
    flight.run_to(2.0)
    network = flight.chase.network
    received: list[int] = []
    for _ in range(60):
        for _ in range(2000):
            network.controller.put(b"\xfd" * 281, ("stranger", -1))
        before = sum(flight.chase.link.rejected.values())
        flight.chase.tick()
        received.append(sum(flight.chase.link.rejected.values()) - before)
    assert max(received) == 1024
    assert flight.state is HOLDING
    flight.run_until(lambda: not network.controller._waiting)
    assert flight.run().reached


# The disk


def test_a_full_disk_does_not_stop_the_chase_and_the_operator_is_told(
    undisturbed: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Row "disk full, log fails": the recorder never blocks the loop; alarm."""
    pytest.importorskip("mcap", reason="the log needs: pip install 'swarmchase[live]'")
    from swarmchase.live.log.entries import new_head
    from swarmchase.live.log.file import LogFile
    from swarmchase.live.log.recorder import ChaseRecorder

    flight = Flight()
    head = new_head("recurrent", flight.scenario, 1, 0, 1, SafetyLimits(), START_NS)
    frames: list[Frame] = []
    with ChaseRecorder(tmp_path / "chase.mcap", head) as recorder:
        monkeypatch.setattr(LogFile, "flush", no_space)
        events = Events(Alarms(flight.chase.link, lambda: recorder.alarms))
        chronicle = Chronicle(flight.chase.link, START_NS, [frames.append, recorder.record_frame], events)
        flight.chase._recorder = lambda entry: (flight.log.append(entry), recorder.record(entry))
        flight.chase._watch = lambda snapshot: (events(snapshot), chronicle(snapshot, None))[0]
        flight.run_to(6.0)
        while recorder.failure is None:  # its thread writes twice a second
            time.sleep(0.01)
        result = flight.run()
    assert result.reached
    require_same_log(flight, undisturbed)
    assert frames[0]["alarms"] == []
    (alarm,) = frames[-1]["alarms"]
    assert re.fullmatch(
        r"cannot write the log: No space left on device; \d+ frames and \d+ transitions, decisions and events are lost",
        alarm["text"],
    )
    told = [event.text for event in events.newest if "log" in event.text]
    assert told.count("cannot write the log: No space left on device") == 1
    # The other where its thread is given no time to find out.
    assert set(told) <= {"cannot write the log: No space left on device", "the log loses what is to be recorded"}
    assert result.state == "reached"


def no_space(*_: Any) -> None:
    raise OSError(28, "No space left on device")


def test_a_recorder_that_raises_is_an_alarm_too(undisturbed: Flight) -> None:
    """Row "disk full, log fails": whatever fails there, and how often, the frames say."""
    flight = Flight()
    frames: list[Frame] = []
    events = Events(Alarms(flight.chase.link, lambda: [Alarm("other", "another")]))
    chronicle = Chronicle(flight.chase.link, START_NS, [frames.append], events)
    flight.chase._recorder = lambda entry: (flight.log.append(entry), no_space())
    flight.chase._watch = lambda snapshot: (events(snapshot), chronicle(snapshot, None))[0]
    flight.run_to(6.0)
    # Twice sampling, twice moving, and two decisions.
    assert [alarm["text"] for alarm in frames[-1]["alarms"]] == ["another", "6 entries could not be recorded"]
    flight.run()
    require_same_log(flight, undisturbed)


def test_the_oracle_is_told_where_the_site_has_its_target() -> None:
    result = Flight(controller="oracle").chase.run()
    assert (result.state, result.reached) == ("reached", True)
