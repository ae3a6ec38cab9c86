"""Live flights that go on after the capture: followed, lost, found again. The real service, on a made clock."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from swarmchase import load_controller, paper_scenario
from swarmchase.benchmarks.soak import of_the_target
from swarmchase.controllers.belief import Belief
from swarmchase.errors import InputError
from swarmchase.live.alarms import Alarms
from swarmchase.live.service.chase_state import ChaseState, Snapshot, Transition
from swarmchase.live.service.course import FlightCourse
from swarmchase.live.service.following import FOLLOWING_M
from swarmchase.live.service.pace import Window
from swarmchase.live.service.sample_window import Point
from swarmchase.live.service.second_transmitter import SecondTransmitter
from swarmchase.live.service.settings import ServiceSettings
from swarmchase.scenario import Scenario, load_scenario
from swarmchase.simulation.fault_plan import fault_plan
from swarmchase.simulation.radio_in_flight import RadioInFlight
from swarmchase.simulation.site import site_limits
from swarmchase.simulation.virtual_chase import VirtualChase, VirtualResult

FOLLOWS = ServiceSettings(follow=True)


class Flight:
    """A virtual chase of a target that begins near, and what is to be looked at of it."""

    def __init__(
        self, faults: str, settings: ServiceSettings = FOLLOWS, lowest_tracker_m: float | None = None, **changes: Any
    ) -> None:
        near = {"behaviour": "waypoints", "start_distance_m": 15.0, "farthest_start_m": 25.0}
        scenario = Scenario.from_dict(load_scenario("flight").to_dict() | near | changes)
        self.transitions: list[Transition] = []
        self.snapshots: list[Snapshot] = []
        self.target_m: list[tuple[float, ...]] = []
        controller, plan = load_controller("particle", scenario), fault_plan(faults)
        limits = site_limits(scenario)
        if lowest_tracker_m is not None:
            limits = dataclasses.replace(limits, lowest_altitude_m=lowest_tracker_m)
        self.chase = VirtualChase(scenario, controller, 0, 3, plan, settings, self._record, self._watch, limits)

    def _record(self, entry: Any) -> None:
        if isinstance(entry, Transition):
            self.transitions.append(entry)

    def _watch(self, snapshot: Snapshot) -> None:
        self.snapshots.append(snapshot)
        self.target_m.append(self.radio.target_m)

    @property
    def radio(self) -> RadioInFlight:
        assert isinstance(self.chase.site.radio, RadioInFlight)
        return self.chase.site.radio

    def states(self) -> list[str]:
        return [one.after.value for one in self.transitions]

    def run(self) -> VirtualResult:
        return self.chase.run()

    def until(self, state: ChaseState) -> None:
        for _ in range(2400):
            if self.chase.service.state is state:
                return
            self.chase.tick()
        raise AssertionError(f"never {state.value}: {self.states()}")


def test_a_target_that_falls_silent_is_followed_lost_looked_for_and_found_again() -> None:
    flight = Flight("mute=14-21", follow_s=22.0)
    result = flight.run()
    assert flight.states()[:5] == ["connecting", "pursuing", "following", "searching", "pursuing"]
    caught, lost, found = flight.transitions[2:5]
    ended = flight.transitions[-1]
    assert lost.reason == "the target is lost: nothing has been heard of it for 5 s"
    began_ns = flight.transitions[0].time_ns
    # The last window with something in it may have ended up to an interval before the silence began.
    assert 18.4 < (lost.time_ns - began_ns) / 1e9 < 20.5
    assert 21.0 < (found.time_ns - began_ns) / 1e9 < 25.0
    assert found.reason == "the target is found again"
    told = of_the_target(flight.transitions)
    assert (told["times_reached"], told["times_lost"], told["times_found"]) == (
        flight.states().count("following"),
        1,
        1,
    )
    assert told["searched_s"] == pytest.approx((found.time_ns - lost.time_ns) / 1e9, abs=0.1)
    assert (ended.after, ended.reason) == (ChaseState.REACHED, "it was followed for 22 s")
    assert (ended.time_ns - caught.time_ns) / 1e9 == pytest.approx(22.0, abs=0.6)
    assert result.least_separation_m > 6.0
    # What the service says of the time it was near is what was true, but for the silence.
    followed = flight.snapshots[-1].following
    assert followed is not None
    assert result.following_share is not None
    assert 0.2 < followed.share <= 1.0
    assert followed.share == pytest.approx(result.following_share, abs=0.3)


class AlwaysTwo(SecondTransmitter):
    """As if levels of two had been heard, whatever came."""

    def take(self, window: Window, origin_m: Point, belief: Belief | None, is_beside: bool) -> None:
        super().take(window, origin_m, belief, is_beside)
        self.is_heard = True


def test_a_target_that_is_followed_is_lost_and_followed_again_though_two_are_heard_by_then() -> None:
    """Which of them it is was said before; nothing else would end a pursuit that has no movements to spend."""
    flight = Flight("mute=8-14")
    flight.until(ChaseState.FOLLOWING)
    course = flight.chase.service._judge
    assert isinstance(course, FlightCourse)
    course._second = AlwaysTwo(flight.chase._scenario)
    for state in (ChaseState.SEARCHING, ChaseState.PURSUING, ChaseState.FOLLOWING):
        flight.until(state)
    assert not any(snapshot.hears_two for snapshot in flight.snapshots)


def test_a_search_that_goes_on_after_a_pause_says_that_the_target_is_lost() -> None:
    flight = Flight("mute=1-30")
    flight.until(ChaseState.SEARCHING)
    flight.chase.service.hold()
    flight.chase.service.resume()
    flight.until(ChaseState.SEARCHING)
    assert flight.transitions[-1].reason == "the cause of holding is gone; the target is still lost"
    told = of_the_target(flight.transitions)
    assert (told["times_lost"], told["times_found"]) == (1, 0)


def test_who_follows_stays_with_a_target_that_lands_and_holds_and_ends_by_the_operator_s_words() -> None:
    """The swarm may fly as low as the target stands, so its centre no lower than a spacing above it: it hovers there,
    and nothing is wrong with that.
    """
    flight = Flight("lands=8-60", lowest_altitude_m=46.0, lowest_tracker_m=-4.0)
    alarms = Alarms(flight.chase.link)
    flight.until(ChaseState.FOLLOWING)
    service, begun = flight.chase.service, len(flight.snapshots)
    while flight.radio.now_s < 28.0:
        flight.chase.tick()
    # It has sunk to 46 m above the ground, 4 m below the start, and stands there; so does the swarm.
    target_m = np.array(flight.radio.target_m)
    assert target_m[2] == pytest.approx(-4.0, abs=1e-6)
    center_m = np.median(np.array(flight.chase.site.positions_m()), axis=0)
    assert 2.0 < center_m[2] - target_m[2] < FOLLOWING_M
    assert np.linalg.norm(center_m[:2] - target_m[:2]) < 3.0
    assert max(math.hypot(*one.velocity_mps) for one in flight.chase.site.vehicles) < 2.0
    assert [alarm.text for one in flight.snapshots[begun:] for alarm in alarms(one) if alarm.cause == "standing"] == []
    service.hold()
    flight.chase.tick()
    assert service.state is ChaseState.HOLDING
    service.resume()
    flight.until(ChaseState.FOLLOWING)
    service.declare_reached()
    assert (service.state, flight.transitions[-1].reason) == (ChaseState.REACHED, "the operator says so")


def test_in_the_search_operators_hold_resume_and_abort() -> None:
    flight = Flight("mute=1.5-60", ServiceSettings())
    flight.until(ChaseState.SEARCHING)
    service = flight.chase.service
    service.hold()
    for _ in range(200):
        flight.chase.tick()
    assert service.state is ChaseState.HOLDING
    assert max(math.hypot(*one.velocity_mps) for one in flight.chase.site.vehicles) < 0.05
    service.resume()
    # It goes on as it was, and judges anew: nothing has been heard.
    flight.until(ChaseState.SEARCHING)
    service.abort()
    assert service.state is ChaseState.ABORTED


def test_the_word_reached_begins_to_follow() -> None:
    flight = Flight("")
    flight.until(ChaseState.PURSUING)
    flight.chase.service.declare_reached()
    assert flight.chase.service.state is ChaseState.FOLLOWING


@pytest.mark.parametrize("word", ["mute=10", "mute=20-10", "lands=-1-5", "second=0", "second=far", "second=inf"])
def test_faults_of_the_target_that_cannot_be_are_refused(word: str) -> None:
    with pytest.raises(InputError, match="is refused"):
        fault_plan(word)


@pytest.mark.parametrize("word", ["mute=10-20", "lands=10-20", "second=150"])
def test_a_target_that_stands_has_none_of_them(word: str) -> None:
    scenario = paper_scenario()
    with pytest.raises(InputError, match="they are of targets in flight"):
        VirtualChase(scenario, load_controller("particle", scenario), 0, 0, fault_plan(word))


def test_another_transmitter_adds_its_power_to_the_target_s() -> None:
    """150 m east of a target; trackers in between, where each is as far from both, hear 3 dB more in the mean."""
    levels_dbm = []
    for faults in ("", "second=150"):
        flight = Flight(faults, behaviour="hover", target_speed_mps=0.0)
        flight.chase.site.announce(2**62, (0.0, 0.0, 0.0), 5.0)
        at_m = torch_places(np.array(flight.radio.target_m) + np.array([75.0, 0.0, 0.0]))
        swarm = flight.chase.site._swarm()
        heard = [flight.radio.heard_dbm(one * 50_000_000, at_m, swarm) for one in range(400)]
        levels_dbm.append(10 * np.log10(np.mean(10 ** (np.array(heard) / 10))))
    assert levels_dbm[1] - levels_dbm[0] == pytest.approx(10 * math.log10(2), abs=0.7)


def test_another_transmitter_is_heard_while_the_target_is_silent() -> None:
    silent = {"behaviour": "hover", "target_speed_mps": 0.0, "silence_s": 10.0, "silence_at_s": 0.0}
    for faults, is_heard in (("", False), ("second=150", True)):
        flight = Flight(faults, **silent)
        flight.chase.site.announce(0, (0.0, 0.0, 0.0), 5.0)
        at_m = torch_places(np.array(flight.radio.target_m) + np.array([75.0, 0.0, 0.0]))
        swarm = flight.chase.site._swarm()
        heard = [flight.radio.heard_dbm(one * 50_000_000, at_m, swarm) for one in range(40)]
        assert (np.isfinite(np.array(heard)) == is_heard).all()


def torch_places(place_m: np.ndarray) -> Any:
    import torch

    return torch.from_numpy(np.tile(place_m, (6, 1)))


def test_trackers_that_stop_do_not_follow_nor_does_who_has_no_belief() -> None:
    scenario = paper_scenario()
    with pytest.raises(InputError, match="--follow is refused: trackers that stop"):
        VirtualChase(scenario, load_controller("particle", scenario), 0, 0, settings=FOLLOWS)
    with pytest.raises(InputError, match="gradient is refused where a target is followed: it has no belief"):
        VirtualChase(
            load_scenario("flight"), load_controller("gradient", load_scenario("flight")), 0, 0, settings=FOLLOWS
        )
