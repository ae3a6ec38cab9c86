"""The parts of the simulated site, one by one: what goes wrong as planned, and what is heard, carried and flown."""

import math
import socket
from collections import Counter
from collections.abc import Iterator
from random import Random
from typing import Any

import numpy as np
import pytest
import torch

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from live_bench import FLYING
from swarmchase.batch.streams import chase_keys
from swarmchase.errors import InputError
from swarmchase.formation import Action, tracker_position_m
from swarmchase.levels import highest_dbm, is_level
from swarmchase.live.clock import VirtualClock
from swarmchase.live.link.codec import TRACKER_COMPONENT, ReportDecoder, system_of
from swarmchase.live.link.messages import Heartbeat, Metres, PositionReport, RssiWindow, TrackerMode
from swarmchase.live.link.packet import PacketReader, PacketWriter, Peer
from swarmchase.live.link.rejection import RejectedError
from swarmchase.live.link.timestamps import Timestamps
from swarmchase.live.tracker.sources import Sample
from swarmchase.live.tracker.vehicles import SimulatedVehicle
from swarmchase.live.tracker.vehicles.address import open_vehicle
from swarmchase.live.tracker.vehicles.kind import VehicleDetails
from swarmchase.scenario import paper_scenario
from swarmchase.simulation.fault_plan import (
    FaultPlan,
    ProcessFault,
    ReceiverFault,
    TrackerFault,
    VehicleFault,
    fault_plan,
)
from swarmchase.simulation.faulty_path import Faults
from swarmchase.simulation.forger import Forger
from swarmchase.simulation.radio import BREAK_AFTER_S, BREAK_BEFORE_S, Radio
from swarmchase.simulation.receivers_gone_wrong import FailingReceiver
from swarmchase.simulation.simulated_ardupilot import LOITER, SimulatedArduPilot
from swarmchase.simulation.site import MOST_SAMPLES_MADE_UP, Site
from swarmchase.simulation.tracker_processes import free_udp_ports
from swarmchase.simulation.udp_relay import UdpRelay
from swarmchase.simulation.virtual_chase import KEYS, START_NS, SkewedClock
from swarmchase.simulation.virtual_network import CONTROLLER, VirtualNetwork
from swarmchase.world.environment import Environment, distance_to_target_m

SILENT, STUCK, GARBAGE, WRONG, DEAF, LOUD, DELAYED, INTERMITTENT = ReceiverFault
OFFSET, ORIGIN, STAYS, FENCE = VehicleFault
SLOW, FROZEN, KILL, RESTART = ProcessFault


# What is to go wrong


@pytest.mark.parametrize(
    ("text", "plan"),
    [
        ("", FaultPlan()),
        (" , ,", FaultPlan()),
        ("loss=0.15", FaultPlan(Faults(loss=0.15))),
        ("loss=0.1,loss=0.2", FaultPlan(Faults(loss=0.2))),
        ("burst=0.2,duplicate=1,reorder=0.1,replay=0", FaultPlan(Faults(0.0, 0.2, duplication=1.0, reordering=0.1))),
        ("delay=0.03,jitter=0.01", FaultPlan(Faults(delay_s=0.03, jitter_s=0.01))),
        ("jitter=0.01,delay=0.03", FaultPlan(Faults(delay_s=0.03, jitter_s=0.01))),
        ("jitter=0.01", FaultPlan(Faults(delay_s=0.01, jitter_s=0.01))),  # nothing comes before it was sent
        ("outage=10-13, outage=20-21.5", FaultPlan(Faults(outages_s=((10.0, 13.0), (20.0, 21.5))))),
        ("forge=200", FaultPlan(forged_hz=200.0)),
        ("silent=2@10-20", FaultPlan(trackers=(TrackerFault(SILENT, 2, 10.0, 20.0),))),
        ("offset=5@3", FaultPlan(trackers=(TrackerFault(OFFSET, 5, 3.0, math.inf),))),
        ("garbage=0@0", FaultPlan(trackers=(TrackerFault(GARBAGE, 0, 0.0, math.inf),))),
        (
            "restart=4@30,kill=5@1.5,frozen=1@2-3",
            FaultPlan(
                trackers=(
                    TrackerFault(RESTART, 4, 30.0),
                    TrackerFault(KILL, 5, 1.5),
                    TrackerFault(FROZEN, 1, 2.0, 3.0),
                )
            ),
        ),
    ],
)
def test_plans_that_people_write(text: str, plan: FaultPlan) -> None:
    assert fault_plan(text) == plan


@pytest.mark.parametrize(
    "text",
    [
        *("rain=1", "loss", "loss=", "loss=much", "loss=0.1;burst=0.1", "=1", "silent", "LOSS=0.1"),
        *("outage=10", "outage=-", "outage=a-b", "silent=2", "silent=6@1", "silent=-1@1", "silent=2@", "silent=2@5-5"),
        *("silent=2@5-4", "silent=2@-3", "silent=2@nan", "kill=3@1-2", "restart=3@1-2", "silent=1.5@2", "silent=two@2"),
    ],
)
def test_plans_that_nobody_can_mean_are_refused_with_the_words_there_are(text: str) -> None:
    with pytest.raises(
        InputError, match=r"^fault '.*' is refused: there are loss=SHARE, .* kill, restart=TRACKER@START$"
    ):
        fault_plan(text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("loss=1.1", "loss = 1.1 is refused: allowed is between 0 and 1"),
        ("loss=nan", "loss = nan is refused"),
        ("burst=0.99", "burst_loss = 0.99 is refused: it needs longer bursts"),
        ("delay=-1", "delay_s = -1.0 is refused"),
        ("jitter=-1", "jitter_s = -1.0 is refused"),
        ("delay=inf", "delay_s = inf is refused"),
        ("outage=5-4", "an outage from 5.0 s to 4.0 s is refused"),
        ("forge=-1", "forge = -1 is refused: allowed is 0 to 100000 a second"),
        ("forge=1e9", "forge = 1e9 is refused"),
        ("forge=nan", "forge = nan is refused"),
    ],
)
def test_values_that_cannot_be_are_refused_by_what_they_are(text: str, words: str) -> None:
    with pytest.raises(InputError) as refusal:
        fault_plan(text)
    assert str(refusal.value).startswith(f"fault {text!r} is refused: {words}")


@pytest.mark.parametrize(
    ("chase_s", "receiver", "process"),
    [
        (0.0, None, []),
        (9.99, None, []),
        (10.0, SILENT, []),
        (12.0, STUCK, []),  # the last one named
        (14.0, SILENT, [SLOW]),
        (20.0, None, [SLOW, KILL]),
        (1e6, None, [SLOW, KILL]),
    ],
)
def test_what_is_wrong_at_a_moment(chase_s: float, receiver: ReceiverFault | None, process: list[ProcessFault]) -> None:
    plan = fault_plan("silent=2@10-20,stuck=2@11-13,slow=2@14,kill=2@20,garbage=3@0,frozen=4@0")
    assert plan.of_receiver(2, chase_s) is receiver
    assert [fault.fault for fault in plan.of_process(2, chase_s)] == process


# Receivers that fail

MS_NS = 10**6


@pytest.mark.parametrize(
    ("fault", "heard", "said"),
    [
        (None, [(0, -60.0), (100, -61.0)], [(0, -60.0), (100, -61.0)]),
        (SILENT, [(0, -60.0), (100, -61.0)], []),
        (WRONG, [(0, -60.0), (100, -61.0)], [(0, -40.0), (100, -41.0)]),
        (DEAF, [(0, -60.0), (100, -61.0)], [(0, -200.0), (100, -200.0)]),
        (LOUD, [(0, -60.0), (100, -61.0)], [(0, 20.0), (100, 20.0)]),
        # It is silent in every second half second of the clock.
        (
            INTERMITTENT,
            [(0, -60.0), (499, -61.0), (500, -62.0), (999, -63.0), (1000, -64.0)],
            [(0, -60.0), (499, -61.0), (1000, -64.0)],
        ),
        # Half a second late, dated when they were taken.
        (DELAYED, [(0, -60.0), (400, -61.0), (500, -62.0), (950, -63.0)], [(0, -60.0), (400, -61.0)]),
    ],
)
def test_what_a_failing_receiver_says(
    fault: ReceiverFault | None, heard: list[tuple[int, float]], said: list[tuple[int, float]]
) -> None:
    receiver = FailingReceiver(Random(1))
    reported: list[Sample] = []
    for time_ms, level_dbm in heard:
        reported += receiver.reported((time_ms * MS_NS, level_dbm), fault)
    assert reported == [(time_ms * MS_NS, level_dbm) for time_ms, level_dbm in said]


def test_a_stuck_receiver_repeats_the_last_level_from_before_and_recovers() -> None:
    receiver = FailingReceiver(Random(1))
    course = [(-60.0, None), (math.nan, None), (-61.0, STUCK), (math.nan, STUCK), (-62.0, STUCK), (-63.0, None)]
    said = [receiver.reported((number, level_dbm), fault) for number, (level_dbm, fault) in enumerate(course)]
    levels_dbm = [level_dbm for samples in said for _, level_dbm in samples]
    assert levels_dbm == [
        -60,
        pytest.approx(math.nan, nan_ok=True),
        -60,
        pytest.approx(math.nan, nan_ok=True),
        -60,
        -63,
    ]


def test_garbage_comes_among_true_levels_and_all_of_it_is_dropped_or_harmless() -> None:
    """Each of the numbers that receivers report; of them only the single -89 is a level of Table I's transmitter."""
    receiver = FailingReceiver(Random(1))
    levels_dbm = [receiver.reported((number, -60.0), GARBAGE)[0][1] for number in range(400)]
    assert set(levels_dbm) == {0, 31, 127, -128, 17, 121, -89, -60}
    assert 150 < levels_dbm.count(-60) < 250
    highest = highest_dbm(paper_scenario())
    assert {level_dbm for level_dbm in levels_dbm if is_level(level_dbm, highest)} == {-60, -89}


# The forger


def test_nothing_that_a_forger_sends_is_ever_accepted() -> None:
    """7000 datagrams, each kind by itself and mixed, against a reader that has heard the six trackers themselves; then
    each tracker is still heard.
    """
    clock = VirtualClock(START_NS)
    reader = PacketReader(
        [Peer(tracker, system_of(tracker), TRACKER_COMPONENT, KEYS[tracker]) for tracker in range(6)],
        ReportDecoder(),
        Timestamps([system_of(tracker) for tracker in range(6)], None, clock.now_ns),
    )
    writers = [
        PacketWriter(system_of(tracker), TRACKER_COMPONENT, Timestamps([], None, clock.now_ns)) for tracker in range(6)
    ]
    forger = Forger(Random(5), clock.now_ns)

    def say(time_ns: int) -> None:
        for tracker, writer in enumerate(writers):
            for message in (
                Heartbeat(tracker, time_ns, TrackerMode.FOLLOWING, FLYING),
                PositionReport(tracker, time_ns, (1.0, 2.0, 3.0)),
                RssiWindow(tracker, time_ns, 10.0, (-60.0,) * 50),
            ):
                datagram = writer.datagram(message, KEYS[tracker])
                assert reader.open(datagram, *reader.claim(datagram)).tracker == tracker
                forger.overhear(datagram)

    def reason(datagram: bytes) -> str:
        with pytest.raises(RejectedError) as rejection:
            reader.open(datagram, *reader.claim(datagram))
        return str(rejection.value.reason)

    say(1)
    clock.advance(1.0)
    reasons = {kind.__name__: Counter(reason(kind()) for _ in range(500)) for kind in forger._kinds}
    assert set(reasons["_wrong_key"]) == {"wrong key"}
    assert set(reasons["_unsigned"]) == {"unsigned"}
    assert set(reasons["_replay"]) == {"replayed"}
    assert set(reasons["_giant"]) == {"giant"}
    assert set(reasons["_cut"]) == {"truncated", "replayed"}
    assert {"bad checksum", "wrong key", "malformed", "truncated"} <= set(reasons["_damaged"])
    mixed = Counter(reason(forger.datagram()) for _ in range(3500))
    assert set(mixed) >= {"wrong key", "unsigned", "replayed", "giant", "truncated", "malformed"}
    clock.advance(1.0)
    say(2)


# The network


def test_datagrams_go_where_they_are_sent_when_they_are_passed_on() -> None:
    clock = VirtualClock(START_NS)
    network = VirtualNetwork(clock, FaultPlan(), "seed")
    network.trackers[4].sendto(b"hello from 4", CONTROLLER)
    network.trackers[2].sendto(b"hello from 2", CONTROLLER)
    with pytest.raises(BlockingIOError):
        network.controller.recvfrom(100)
    network.pass_on()
    # As many bytes as were asked for; of two at one moment either may be first.
    heard = dict(network.controller.recvfrom(10)[::-1] for _ in range(2))
    assert heard == {("tracker", 4): b"hello from", ("tracker", 2): b"hello from"}
    network.controller.sendto(b"go", ("tracker", 4))
    network.controller.sendto(b"go", ("stranger", -1))
    network.pass_on()
    assert network.trackers[4].recvfrom(100) == (b"go", CONTROLLER)
    for udp in (*network.trackers, network.controller):
        with pytest.raises(BlockingIOError):
            udp.recvfrom(100)


def test_the_network_fails_as_planned_each_way_of_each_tracker_by_itself() -> None:
    clock = VirtualClock(START_NS)
    network = VirtualNetwork(clock, fault_plan("loss=0.5,delay=0.1,outage=5-6"), "seed")
    came: Counter[Any] = Counter()
    for number in range(400):
        for tracker in range(6):
            network.trackers[tracker].sendto(bytes([number % 256]), CONTROLLER)
        clock.advance(0.01)
        network.pass_on()
        while network.controller._waiting:
            came[network.controller.recvfrom(100)[1]] += 1
    # Of 400 in 4 s those of the last .1 s are still on their way.
    assert set(came) == {("tracker", tracker) for tracker in range(6)}
    assert all(150 < number < 240 for number in came.values())
    assert len(set(came.values())) > 1
    clock.advance(1.5)
    network.pass_on()
    while network.controller._waiting:
        network.controller.recvfrom(100)
    for tracker in range(6):
        network.trackers[tracker].sendto(b"lost", CONTROLLER)
        network.controller.sendto(b"lost", ("tracker", tracker))
    clock.advance(2.0)
    network.pass_on()
    assert not any(udp._waiting for udp in (*network.trackers, network.controller))


def test_a_forger_speaks_as_often_as_planned_and_the_seed_decides_what() -> None:
    said = []
    for seed in ("a", "a", "b"):
        clock = VirtualClock(START_NS)
        network = VirtualNetwork(clock, fault_plan("forge=40"), seed)
        for _ in range(20):
            clock.advance(0.05)
            network.pass_on()
        said.append([network.controller.recvfrom(3000) for _ in range(40)])
        assert not network.controller._waiting
    assert {address for _, address in said[0]} == {("stranger", -1)}
    assert said[0] == said[1] != said[2]


def test_a_clock_beside_another() -> None:
    clock = VirtualClock(START_NS)
    skewed = SkewedClock(clock)
    assert skewed.now_ns() == START_NS
    skewed.drift, skewed.ahead_ns = 1e-4, -5
    clock.advance(10.0)
    assert skewed.now_ns() == START_NS + 10**10 + 10**6 - 5


# The radio


def taken_by(radio: Radio, start_ns: int, number: int, place_m: torch.Tensor, sampling_hz: float) -> torch.Tensor:
    period_ns = round(1e9 / sampling_hz)
    heard = [radio.heard_dbm(start_ns + number * period_ns, place_m) for number in range(number)]
    return torch.tensor(heard, dtype=torch.float64)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"sampling_hz": 10, "spatial_correlation": 0.5},
        {"continuity": "continuous"},
        {"receiver_offset_db": 3.0, "silent_trackers": 1, "missing_sample_share": 0.2},
    ],
)
def test_announced_windows_are_those_of_the_evaluation(changes: dict[str, Any]) -> None:
    """Sample by sample, whatever is heard between them."""
    scenario = paper_scenario(**{"sampling_hz": 100, **changes})
    environment = Environment(scenario)
    state = environment.reset(chase_keys(3, 1, 8))
    radio = Radio(scenario, 3, 8)
    assert radio.target_m == tuple(state.target_position_m[0].tolist())
    now_ns = START_NS
    for movement in range(4):
        place_m = tracker_position_m(state.center_m, state.spacing_m)[0]
        # On the way: a while, another one each time.
        taken_by(radio, now_ns, 30 + 20 * movement, place_m, scenario.sampling_hz)
        now_ns += 10**10
        x_m, y_m, z_m = state.center_m[0].tolist()
        radio.announce(now_ns, (x_m, y_m, z_m))
        for off_s in (-BREAK_BEFORE_S, 0.0, BREAK_AFTER_S - 1e-6):
            assert all(map(math.isnan, radio.heard_dbm(now_ns + round(off_s * 1e9), place_m)))
        begins_ns = now_ns + round(BREAK_AFTER_S * 1e9)
        heard_dbm = taken_by(radio, begins_ns, scenario.window_samples, place_m, scenario.sampling_hz)
        expected_dbm = state.rssi_dbm[0].double()
        assert heard_dbm.numpy() == pytest.approx(expected_dbm.numpy(), abs=1e-3, nan_ok=True)
        assert torch.equal(heard_dbm.isnan(), expected_dbm.isnan())
        now_ns = begins_ns + 10**10
        displacement_m = torch.tensor([[4.0, -2.0, 0.0]], dtype=torch.float64)
        state, _ = environment.step(state, Action(torch.tensor([3.0], dtype=torch.float64), displacement_m))


def test_between_windows_other_fading_of_the_same_law_is_heard() -> None:
    """Its power over what is heard without fading: mean 1 and, in a Rician channel, variance (1 + 2 K) / (1 + K)^2."""
    scenario = paper_scenario(sampling_hz=10, spatial_correlation=0.0)
    radio = Radio(scenario, 1, 0)
    x_m, y_m, z_m = radio.target_m
    place_m = torch.tensor([[x_m + 10, y_m, z_m]] * 6, dtype=torch.float64)
    loss_db = scenario.reference_path_loss_db + 10 * scenario.path_loss_exponent
    heard_dbm = taken_by(radio, START_NS, 20_000, place_m, scenario.sampling_hz)
    power = (10 ** ((heard_dbm - scenario.transmit_power_dbm + loss_db) / 10)).numpy()
    k = scenario.rician_k
    assert power.mean() == pytest.approx(1, abs=0.02)
    assert power.var() == pytest.approx((1 + 2 * k) / (1 + k) ** 2, abs=0.03)
    # No window is heard twice.
    assert len(np.unique(heard_dbm.numpy()[:, 0].round(6))) > 19_900


# The world


def test_the_world_is_silent_until_it_begins_and_then_samples_on_its_grid() -> None:
    scenario = paper_scenario(sampling_hz=100)
    world = Site(scenario, 1, 0)
    assert world.advance(START_NS) == [[]] * 6
    world.begin(START_NS)
    reported = world.advance(START_NS + 55 * MS_NS)
    assert [[time_ns for time_ns, _ in samples] for samples in reported] == [
        [START_NS + number * 10 * MS_NS for number in range(1, 6)]
    ] * 6
    assert all(math.isfinite(level_dbm) for samples in reported for _, level_dbm in samples)
    # After a standstill of a minute it makes up for no more than a second.
    reported = world.advance(START_NS + 60_000 * MS_NS)
    times_ns = [time_ns for time_ns, _ in reported[0]]
    assert len(times_ns) == MOST_SAMPLES_MADE_UP
    assert times_ns[0] == START_NS + 59_010 * MS_NS
    assert times_ns[-1] == START_NS + 60_000 * MS_NS


def test_faults_of_receivers_count_from_the_beginning() -> None:
    world = Site(paper_scenario(sampling_hz=10), 1, 0, fault_plan("silent=2@1-2"))
    world.begin(START_NS)
    heard = [0] * 6
    numbers = []
    for step in range(1, 31):
        reported = world.advance(START_NS + step * 100 * MS_NS)
        heard = [total + len(samples) for total, samples in zip(heard, reported, strict=True)]
        numbers.append(len(reported[2]))
    assert heard == [30, 30, 20, 30, 30, 30]
    assert numbers == [1] * 9 + [0] * 10 + [1] * 11


def test_vehicles_fly_in_the_world_s_time() -> None:
    world = Site(paper_scenario(), 1, 0)
    assert world.positions_m()[:2] == [(5, 0, 0), (-5, 0, 0)]
    world.advance(START_NS)
    world.vehicles[1].go_to((-5.0, 20.0, 0.0))
    for step in range(1, 101):
        world.advance(START_NS + step * 100 * MS_NS)
    assert world.positions_m()[1] == (-5, 20, 0)
    assert world.positions_m()[0] == (5, 0, 0)


@pytest.mark.parametrize(
    ("fault", "told_m", "flies_to_m", "says_m"),
    [
        (OFFSET, (-5.0, 20.0, 0.0), (-5, 20, 0), (24.9, 20, 0)),
        (ORIGIN, (995.0, 20.0, 0.0), (-5, 20, 0), (995, 20, 0)),
        (STAYS, (-5.0, 20.0, 0.0), (-5, 0, 0), (-5, 0, 0)),
        (FENCE, (-5.0, 20.0, 0.0), (-5, 20, 0), (-5, 20, 0)),
        (FENCE, (-5.0, 20.0, 31.0), (-5, 0, 0), (-5, 0, 0)),
    ],
)
def test_what_a_failing_vehicle_does_and_says(
    fault: VehicleFault, told_m: Metres, flies_to_m: Metres, says_m: Metres
) -> None:
    """From second 1 to 30; before and after that it is a vehicle like any other."""
    world = Site(paper_scenario(), 1, 0, fault_plan(f"{fault}=1@1-30"))
    world.begin(START_NS)
    failing = world.flown[1]
    assert failing.position_m == (-5, 0, 0)
    world.advance(START_NS + 1000 * MS_NS)
    failing.go_to(told_m)
    world.advance(START_NS + 2000 * MS_NS)
    failing.go_to(told_m)
    for step in range(3, 20):
        world.advance(START_NS + 1000 * step * MS_NS)
    assert (failing.position_m, world.positions_m()[1]) == (pytest.approx(says_m), pytest.approx(flies_to_m))
    world.advance(START_NS + 30_000 * MS_NS)
    assert failing.position_m == world.positions_m()[1]


def test_the_distance_to_the_target_is_the_evaluation_s_also_with_two_trackers_left_behind() -> None:
    scenario = paper_scenario(start_distance_m=30)
    environment, world = Environment(scenario), Site(scenario, 2, 5)
    state = environment.reset(chase_keys(2, 1, 5))
    assert world.distance_to_target_m() == pytest.approx(float(distance_to_target_m(state)[0]))
    action = Action(torch.tensor([2.0], dtype=torch.float64), torch.tensor([[4.0, 4.0, -4.0]], dtype=torch.float64))
    state, _ = environment.step(state, action)
    world.announce(START_NS, (4.0, 4.0, -4.0), 2.0)
    for tracker, (x_m, y_m, z_m) in enumerate(tracker_position_m(state.center_m, state.spacing_m)[0].tolist()):
        if tracker not in {1, 4}:  # they stay where they were
            world.vehicles[tracker]._true_position_m = (x_m, y_m, z_m)
    assert world.distance_to_target_m() == pytest.approx(float(distance_to_target_m(state)[0]), abs=0.01)


# The autopilot


def test_a_simulated_autopilot_is_flown_by_the_agent_s_vehicle() -> None:
    """Over real sockets; time is made. It flies in GUIDED only, and in LOITER its pilot has it."""
    (port,) = free_udp_ports(1)
    flown = SimulatedVehicle((1.0, 2.0, 30.0))
    vehicle = open_vehicle(f"mavlink:{port}", VehicleDetails(autopilot_origin_m=(0.0, 0.0, 0.0)))
    autopilot = SimulatedArduPilot(flown, port)
    now_ns = START_NS

    def go_on(seconds: float) -> None:
        nonlocal now_ns
        for _ in range(round(seconds / 0.02)):
            now_ns += 20 * MS_NS
            flown.update(now_ns)
            autopilot.step(now_ns)
            vehicle.update(now_ns)

    try:
        assert vehicle.position_m is None
        go_on(1.0)
        assert vehicle.position_m == pytest.approx((1, 2, 30), abs=0.001)
        vehicle.go_to((4.0, -2.0, 33.0))
        go_on(0.1)
        assert autopilot.has_companion
        go_on(5.0)
        assert vehicle.mode is TrackerMode.FOLLOWING
        assert flown.position_m == pytest.approx((4, -2, 33), abs=0.001)
        assert vehicle.position_m == pytest.approx((4, -2, 33), abs=0.001)
        # A pilot takes it: what the agent wants is no longer obeyed.
        autopilot.choose(LOITER)
        go_on(1.5)
        assert vehicle.mode is TrackerMode.MANUAL
        vehicle.go_to((50.0, 50.0, 50.0))
        go_on(2.0)
        assert flown.position_m == pytest.approx((4, -2, 33), abs=0.001)
    finally:
        autopilot.close()
        vehicle.close()


# The relay


class Ends:
    """A controller's socket and six trackers', with a relay between them."""

    def __init__(self, faults: str) -> None:
        self.controller, *self.trackers = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(7))
        self.controller.bind(("127.0.0.1", 0))
        self.relay = UdpRelay(fault_plan(faults), self.controller.getsockname()[1], "seed")
        for udp, port in zip(self.trackers, self.relay.ports, strict=True):
            udp.connect(("127.0.0.1", port))
        for udp in (self.controller, *self.trackers):
            udp.setblocking(False)
        self.addresses: dict[bytes, Any] = {}
        """Where each datagram first came from,"""
        self.sources: set[Any] = set()
        """and all of these places."""

    def heard(self) -> list[bytes]:
        """By the controller."""
        datagrams = []
        while True:
            try:
                datagram, address = self.controller.recvfrom(3000)
            except BlockingIOError:
                return datagrams
            datagrams.append(datagram)
            self.addresses.setdefault(datagram, address)
            self.sources.add(address)

    def all_say(self) -> None:
        for tracker, udp in enumerate(self.trackers):
            udp.send(b"tracker %d" % tracker)

    def close(self) -> None:
        self.relay.close()
        for udp in (self.controller, *self.trackers):
            udp.close()


@pytest.fixture
def ends(request: pytest.FixtureRequest) -> Iterator[Ends]:
    ends = Ends(request.param)
    yield ends
    ends.close()


@pytest.mark.parametrize("ends", ["loss=1,forge=100"], indirect=True)
def test_the_relay_carries_both_ways_and_fails_only_after_the_beginning(ends: Ends) -> None:
    """The controller tells the trackers apart by where they come from, and answers there."""
    ends.all_say()
    ends.relay.step(START_NS)
    assert sorted(ends.heard()) == [b"tracker %d" % tracker for tracker in range(6)]
    assert len(ends.sources) == 6
    ends.controller.sendto(b"go", ends.addresses[b"tracker 3"])
    ends.relay.step(START_NS)
    assert ends.trackers[3].recv(100) == b"go"
    ends.relay.begin(START_NS)
    ends.all_say()
    ends.controller.sendto(b"go", ends.addresses[b"tracker 3"])
    ends.relay.step(START_NS + 10**9)
    assert len(ends.heard()) == 100
    assert len(ends.sources) == 7  # one more, which is the forger's
    with pytest.raises(BlockingIOError):
        ends.trackers[3].recv(100)


@pytest.mark.parametrize("ends", ["delay=0.5,duplicate=1"], indirect=True)
def test_the_relay_delays_and_repeats(ends: Ends) -> None:
    ends.relay.begin(START_NS)
    ends.all_say()
    ends.relay.step(START_NS)
    ends.relay.step(START_NS + 499 * MS_NS)
    assert ends.heard() == []
    ends.relay.step(START_NS + 500 * MS_NS)
    assert sorted(ends.heard()) == sorted([b"tracker %d" % tracker for tracker in range(6)] * 2)


@pytest.mark.parametrize("ends", [""], indirect=True)
def test_ends_that_are_not_there_do_not_stop_the_relay(ends: Ends) -> None:
    """Neither a tracker that has never dialled, nor a controller that has gone."""
    ends.relay.begin(START_NS)
    ends.controller.close()
    for step in range(5):
        ends.trackers[0].send(b"anybody?")
        ends.relay.step(START_NS + step)
    ends.controller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ends.controller.bind(ends.relay._controller)
    ends.controller.setblocking(False)
    ends.trackers[0].send(b"again")
    ends.relay.step(START_NS + 10)
    assert b"again" in ends.heard()
