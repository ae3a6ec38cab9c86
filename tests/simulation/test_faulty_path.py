"""The path that fails: what each fault does to what is sent over it, and that the seed decides."""

import itertools
from random import Random
from typing import Any

import pytest

from swarmchase.errors import InputError
from swarmchase.live.clock import VirtualClock
from swarmchase.scenario import NUM_TRACKERS
from swarmchase.simulation.fault_plan import FaultPlan
from swarmchase.simulation.faulty_path import MOST_IN_FLIGHT, Faults, FaultyPath
from swarmchase.simulation.virtual_network import CONTROLLER, VirtualNetwork, VirtualSocket


def arrivals(faults: Faults, num_messages: int, seed: int = 0, every_s: float = 0.01) -> list[tuple[float, int]]:
    """(when it came in s, number) of messages put in one after the other."""
    path = FaultyPath[int](faults, Random(seed), 0)
    for number in range(num_messages):
        path.put(number, round(number * every_s * 1e9))
    return [(due_ns / 1e9, number) for due_ns, number in path.take(10**18)]


def waiting(socket: VirtualSocket) -> list[tuple[int, Any]]:
    """(number, from where) of the datagrams that have come to a socket of the network."""
    come = []
    while True:
        try:
            datagram, address = socket.recvfrom(100)
        except BlockingIOError:
            return come
        come.append((int(datagram), address))


def numbers(socket: VirtualSocket) -> list[int]:
    return [number for number, _ in waiting(socket)]


def send_up(network: VirtualNetwork, number: int, tracker: int) -> None:
    network.trackers[tracker].sendto(b"%d" % number, CONTROLLER)


def send_down(network: VirtualNetwork, number: int, tracker: int) -> None:
    network.controller.sendto(b"%d" % number, ("tracker", tracker))


def test_without_faults_everything_comes_at_once_and_in_order() -> None:
    path = FaultyPath[int](Faults(), Random(0), 0)
    for number in (3, 0, 7, 5):
        path.put(number, 10)
    assert path.take(9) == []
    assert path.take(10) == [(10, 3), (10, 0), (10, 7), (10, 5)]
    assert path.take(10) == []
    assert path.overflows == 0


def test_every_tracker_has_a_path_of_its_own_in_either_direction() -> None:
    network = VirtualNetwork(VirtualClock(), FaultPlan(), "0")
    for tracker in (3, 0, 3, 5):
        send_up(network, tracker, tracker)
    for tracker in (0, 3, 5):
        send_down(network, 10 + tracker, tracker)
    network.pass_on()
    heard = waiting(network.controller)
    assert sorted(number for number, _ in heard) == [0, 3, 3, 5]
    assert all(address == ("tracker", number) for number, address in heard)
    assert numbers(network.controller) == []
    assert [numbers(socket) for socket in network.trackers] == [[10], [], [], [13], [], [15]]


def test_the_controller_hears_all_trackers_in_the_order_of_coming() -> None:
    clock = VirtualClock()
    network = VirtualNetwork(clock, FaultPlan(Faults(delay_s=1.0)), "0")
    for number, tracker in enumerate((5, 0, 4, 1)):
        send_up(network, number, tracker)
        clock.advance(0.1)
    network.pass_on()
    assert numbers(network.controller) == []
    clock.advance(1.0)
    network.pass_on()
    assert numbers(network.controller) == [0, 1, 2, 3]


def test_a_message_comes_when_its_delay_has_passed() -> None:
    path = FaultyPath[int](Faults(delay_s=0.03), Random(0), 5_000_000_000)
    path.put(1, 5_000_000_000)
    assert path.take(5_029_900_000) == []
    assert path.take(5_030_000_000) == [(5_030_000_000, 1)]


@pytest.mark.parametrize("share", [0.05, 0.3, 1.0])
def test_the_share_lost(share: float) -> None:
    """Of 6,000: a standard deviation of .006 at most."""
    path = FaultyPath[int](Faults(loss=share), Random(3), 0)
    come: set[int] = set()
    for number in range(6_000):
        path.put(number, number)
        come |= {item for _, item in path.take(number)}
    assert 1 - len(come) / 6_000 == pytest.approx(share, abs=0.024)


@pytest.mark.parametrize(("share", "mean_messages"), [(0.15, 10.0), (0.3, 3.0)])
def test_bursts_have_the_share_and_the_length_asked_for(share: float, mean_messages: float) -> None:
    """Of 40,000 messages; the standard deviation is .007 for the share in the longer bursts, 4 % for their length."""
    path = FaultyPath[int](Faults(burst_loss=share, mean_burst_messages=mean_messages), Random(1), 0)
    is_lost = []
    for number in range(40_000):
        path.put(number, number)
        is_lost.append(not path.take(number))
    bursts = [len(list(group)) for lost, group in itertools.groupby(is_lost) if lost]
    assert sum(is_lost) / len(is_lost) == pytest.approx(share, abs=0.028)
    assert sum(bursts) / len(bursts) == pytest.approx(mean_messages, rel=0.16)


def test_jitter_spreads_the_delay_evenly_and_lets_messages_change_places() -> None:
    come = arrivals(Faults(delay_s=0.03, jitter_s=0.005), 900, every_s=0.001)
    delays_s = [when_s - number * 0.001 for when_s, number in come]
    assert min(delays_s) == pytest.approx(0.025, abs=1e-4)
    assert max(delays_s) == pytest.approx(0.035, abs=1e-4)
    assert sum(delays_s) / len(delays_s) == pytest.approx(0.03, abs=4e-4)  # .0029 / sqrt(900) = .0001
    order = [number for _, number in come]
    assert order != sorted(order)
    assert sorted(order) == list(range(900))


def test_what_is_held_back_is_overtaken() -> None:
    come = arrivals(Faults(reordering=0.1, held_back_s=0.05), 900)
    late = [number for when_s, number in come if when_s > number * 0.01 + 0.049]
    assert 50 < len(late) < 130
    order = [number for _, number in come]
    assert sorted(order) == list(range(900))
    overtaken = [number for number in late if number < 890 and number + 4 not in late]
    assert len(overtaken) > 40
    assert all(order.index(number) > order.index(number + 4) for number in overtaken)


def test_duplicates() -> None:
    order = [number for _, number in arrivals(Faults(duplication=0.2), 800)]
    twice = [number for number in set(order) if order.count(number) == 2]
    assert set(order) == set(range(800))
    assert len(order) == 800 + len(twice)
    assert 120 < len(twice) < 200


def test_replays_are_of_messages_that_were_sent_before() -> None:
    come = arrivals(Faults(replay=0.2), 800)
    seen: set[int] = set()
    replayed = []
    for _, number in come:
        if number in seen:
            replayed.append(number)
        seen.add(number)
    assert seen == set(range(800))
    assert 120 < len(replayed) < 200


def test_outages_take_what_is_sent_or_would_come_within() -> None:
    come = arrivals(Faults(delay_s=0.1, outages_s=((1.0, 2.0), (3.0, 3.5))), 50, every_s=0.1)
    lost = set(range(50)) - {number for _, number in come}
    assert lost == set(range(9, 20)) | set(range(29, 35))


def test_a_cut_path_passes_nothing_and_forgets_what_was_under_way() -> None:
    path = FaultyPath[int](Faults(delay_s=0.1), Random(0), 0)
    path.put(0, 0)
    path.is_cut = True
    path.put(1, 0)
    assert path.take(200_000_000) == []
    path.is_cut = False
    path.put(2, 200_000_000)
    assert [number for _, number in path.take(400_000_000)] == [2]


def everything(seed: int) -> list[list[int]]:
    """What six trackers and the controller hear in 3 s of all faults at once."""
    faults = Faults(0.1, 0.1, 5.0, 0.05, 0.04, 0.1, 0.1, 0.2, 0.1, ((1.0, 1.2),))
    clock = VirtualClock()
    network = VirtualNetwork(clock, FaultPlan(faults), str(seed))
    ends = [network.controller, *network.trackers]
    heard: list[list[int]] = [[] for _ in ends]
    for number in range(300):
        for tracker in range(NUM_TRACKERS):
            send_up(network, number, tracker)
            send_down(network, number, tracker)
        network.pass_on()
        for end, come in zip(ends, heard, strict=True):
            come.extend(numbers(end))
        clock.advance(0.01)
    return heard


def test_the_seed_decides() -> None:
    once, again, otherwise = everything(4), everything(4), everything(5)
    assert once == again
    assert all(one != other for one, other in zip(once, otherwise, strict=True))
    assert len({tuple(messages) for messages in once}) == 7, "every path has chance of its own"


def test_one_path_s_traffic_does_not_change_another_s() -> None:
    def heard(num_others: int) -> list[int]:
        network = VirtualNetwork(VirtualClock(), FaultPlan(Faults(loss=0.3)), "4")
        for number in range(100):
            for other in range(num_others):
                send_up(network, number, other)
            send_up(network, number, 3)
        network.pass_on()
        return [number for number, address in waiting(network.controller) if address == ("tracker", 3)]

    assert heard(0) == heard(3)
    assert 50 < len(heard(0)) < 90


def test_a_full_path_gives_up_the_oldest_and_counts_them() -> None:
    path = FaultyPath[int](Faults(delay_s=1.0), Random(0), 0)
    for number in range(MOST_IN_FLIGHT + 7):
        path.put(number, 0)
    assert [number for _, number in path.take(1_000_000_000)] == list(range(7, MOST_IN_FLIGHT + 7))
    assert path.overflows == 7


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"loss": 1.1}, "loss = 1.1"),
        ({"burst_loss": -0.1}, "burst_loss"),
        ({"replay": float("nan")}, "replay"),
        ({"mean_burst_messages": 0.5}, "mean_burst_messages"),
        ({"burst_loss": 0.8, "mean_burst_messages": 2.0}, "longer bursts"),
        ({"delay_s": -1.0}, "delay_s"),
        ({"held_back_s": float("inf")}, "held_back_s"),
        ({"delay_s": 0.01, "jitter_s": 0.02}, "jitter_s"),
        ({"outages_s": ((2.0, 1.0),)}, "outage"),
    ],
)
def test_faults_that_cannot_be(changes: dict[str, Any], what: str) -> None:
    with pytest.raises(InputError, match=what):
        Faults(**changes)
