"""The in-process link: what each fault does to the messages, and that the seed decides."""

import itertools
from collections.abc import Sequence
from random import Random
from typing import Any

import pytest

from swarmchase.errors import InputError
from swarmchase.live.clock import VirtualClock
from swarmchase.live.link.memory_link import MemoryNetwork
from swarmchase.live.link.messages import Heartbeat, Message, SetPoint, TrackerMode
from swarmchase.live.link.protocol import Link
from swarmchase.simulation.faulty_path import MOST_IN_FLIGHT, NO_FAULTS, Faults, FaultyPath


def heartbeat(number: int, tracker: int = 0) -> Heartbeat:
    return Heartbeat(tracker, number, TrackerMode.HOLDING)


def set_point(number: int, tracker: int = 0) -> SetPoint:
    return SetPoint(tracker, number, 0, (1.0, 2.0, 3.0))


def numbers(messages: Sequence[Message]) -> list[int]:
    return [message.time_ns for message in messages]


def arrivals(faults: Faults, num_messages: int, seed: int = 0, every_s: float = 0.01) -> list[tuple[float, int]]:
    """(when it came in s, number) of messages put in one after the other."""
    path = FaultyPath[int](faults, Random(seed), 0)
    for number in range(num_messages):
        path.put(number, round(number * every_s * 1e9))
    return [(due_ns / 1e9, number) for due_ns, number in path.take(10**18)]


def test_without_faults_everything_comes_at_once_and_in_order() -> None:
    clock = VirtualClock()
    network = MemoryNetwork(clock)
    controller, trackers = network.controller_end(), [network.tracker_end(tracker) for tracker in range(6)]
    ends: list[Link] = [controller, *trackers]
    for tracker in (3, 0, 3, 5):
        trackers[tracker].send(heartbeat(tracker, tracker))
    assert sorted(numbers(controller.receive())) == [0, 3, 3, 5]
    assert controller.receive() == []
    for tracker in range(6):
        controller.send(set_point(10 + tracker, tracker))
    assert [numbers(end.receive()) for end in trackers] == [[10], [], [], [13], [], [15]], "only to those that dialled"
    assert [end.rejected.total() for end in ends] == [0] * 7


def test_the_controller_hears_all_trackers_in_the_order_of_coming() -> None:
    clock = VirtualClock()
    network = MemoryNetwork(clock, faults=Faults(delay_s=1.0))
    for number, tracker in enumerate((5, 0, 4, 1)):
        network.tracker_end(tracker).send(heartbeat(number, tracker))
        clock.advance(0.1)
    assert network.controller_end().receive() == []
    clock.advance(1.0)
    assert numbers(network.controller_end().receive()) == [0, 1, 2, 3]


def test_a_message_comes_when_its_delay_has_passed() -> None:
    clock = VirtualClock(5_000_000_000)
    network = MemoryNetwork(clock, faults=Faults(delay_s=0.03))
    controller, tracker = network.controller_end(), network.tracker_end(2)
    tracker.send(heartbeat(1, 2))
    clock.advance(0.0299)
    assert controller.receive() == []
    clock.advance(0.0001)
    assert numbers(controller.receive()) == [1]


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


def test_a_cut_link_passes_nothing_and_forgets_what_was_under_way() -> None:
    clock = VirtualClock()
    network = MemoryNetwork(clock, faults=Faults(delay_s=0.1))
    controller, cut, other = network.controller_end(), network.tracker_end(1), network.tracker_end(2)
    cut.send(heartbeat(0, 1))
    network.cut(1)
    cut.send(heartbeat(1, 1))
    other.send(heartbeat(2, 2))
    clock.advance(0.2)
    network.heal(1)
    cut.send(heartbeat(3, 1))
    clock.advance(0.2)
    assert numbers(controller.receive()) == [2, 3]
    controller.send(set_point(4, 1))
    network.cut(1)
    clock.advance(0.2)
    assert cut.receive() == []


def everything(seed: int) -> list[list[int]]:
    """What six trackers and the controller hear in 3 s of all faults at once."""
    faults = Faults(0.1, 0.1, 5.0, 0.05, 0.04, 0.1, 0.1, 0.2, 0.1, ((1.0, 1.2),))
    clock = VirtualClock()
    network = MemoryNetwork(clock, seed, faults)
    ends: list[Link] = [network.controller_end(), *(network.tracker_end(tracker) for tracker in range(6))]
    heard: list[list[int]] = [[] for _ in ends]
    for number in range(300):
        for tracker in range(6):
            ends[1 + tracker].send(heartbeat(number, tracker))
            ends[0].send(set_point(number, tracker))
        for end, messages in zip(ends, heard, strict=True):
            messages.extend(numbers(end.receive()))
        clock.advance(0.01)
    return heard


def test_the_seed_decides() -> None:
    once, again, otherwise = everything(4), everything(4), everything(5)
    assert once == again
    assert all(one != other for one, other in zip(once, otherwise, strict=True))
    assert len({tuple(messages) for messages in once}) == 7, "every path has chance of its own"


def test_one_path_s_traffic_does_not_change_another_s() -> None:
    def heard(num_others: int) -> list[int]:
        clock = VirtualClock()
        network = MemoryNetwork(clock, 4, Faults(loss=0.3))
        controller, tracker = network.controller_end(), network.tracker_end(3)
        for number in range(100):
            for other in range(num_others):
                network.tracker_end(other).send(heartbeat(number, other))
            tracker.send(heartbeat(number, 3))
        return numbers([message for message in controller.receive() if message.tracker == 3])

    assert heard(0) == heard(3)
    assert 50 < len(heard(0)) < 90


def test_replays_are_dropped_and_counted_if_the_link_is_to_do_so_also_after_a_restart() -> None:
    clock = VirtualClock()
    faults = Faults(delay_s=0.01, duplication=0.3, reordering=0.2, replay=0.3)
    network = MemoryNetwork(clock, 1, faults, drops_replays=True)
    tracker = network.tracker_end(0)
    heard: list[int] = []
    num_rejected = 0
    for start in (0, 200):
        controller = network.controller_end()
        for number in range(start, start + 200):
            tracker.send(heartbeat(number))
            clock.advance(0.01)
            heard += numbers(controller.receive())
        assert set(controller.rejected) == {"replayed"}
        num_rejected += controller.rejected["replayed"]
    assert heard == sorted(set(heard))
    assert len(heard) > 300
    assert num_rejected > 150


def test_a_full_path_gives_up_the_oldest_and_counts_them() -> None:
    clock = VirtualClock()
    network = MemoryNetwork(clock, faults=Faults(delay_s=1.0))
    controller, tracker = network.controller_end(), network.tracker_end(0)
    for number in range(MOST_IN_FLIGHT + 7):
        tracker.send(heartbeat(number))
    clock.advance(1.0)
    assert numbers(controller.receive()) == list(range(7, MOST_IN_FLIGHT + 7))
    controller.receive()
    assert controller.rejected == {"overflow": 7}


def test_restarted_controllers_have_to_be_dialled_anew() -> None:
    network = MemoryNetwork(VirtualClock())
    tracker = network.tracker_end(0)
    tracker.send(heartbeat(0))
    assert numbers(network.controller_end().receive()) == [0]
    restarted = network.controller_end()
    restarted.send(set_point(1))
    assert tracker.receive() == []
    tracker.send(heartbeat(2))
    restarted.receive()
    restarted.send(set_point(3))
    assert numbers(tracker.receive()) == [3]


def test_closed_ends_say_and_hear_nothing() -> None:
    network = MemoryNetwork(VirtualClock())
    controller, tracker = network.controller_end(), network.tracker_end(0)
    tracker.send(heartbeat(0))
    controller.receive()
    controller.send(set_point(1))
    tracker.close()
    assert tracker.receive() == []
    tracker.send(heartbeat(2))
    assert controller.receive() == []


def test_ends_say_only_what_is_theirs() -> None:
    network = MemoryNetwork(VirtualClock())
    with pytest.raises(TypeError, match="controller does not send a Heartbeat"):
        network.controller_end().send(heartbeat(0))
    with pytest.raises(TypeError, match="tracker does not send a SetPoint"):
        network.tracker_end(0).send(set_point(0))
    with pytest.raises(ValueError, match="tracker 1 does not speak for tracker 0"):
        network.tracker_end(1).send(heartbeat(0))
    with pytest.raises(InputError, match="tracker = 6"):
        network.tracker_end(6)


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
    assert Faults() == NO_FAULTS
