"""Flights with two transmitters at one frequency: refused where their powers add up, told apart where receivers know
who transmits. The real service, agents and sources, on a made clock.
"""

import dataclasses
import json
import math
import socket
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from swarmchase import load_controller
from swarmchase.live.address import LOOPBACK
from swarmchase.live.alarms import Alarm, Alarms
from swarmchase.live.service.chase_state import ChaseState, Snapshot
from swarmchase.live.service.settings import ServiceSettings
from swarmchase.live.tracker.sources import Sample
from swarmchase.live.tracker.sources.json_datagrams import JsonDatagramSource
from swarmchase.live.tracker.sources.kind import SourceDetails
from swarmchase.scenario import NUM_TRACKERS, Scenario, load_scenario
from swarmchase.simulation.fault_plan import fault_plan
from swarmchase.simulation.radio_in_flight import RadioInFlight
from swarmchase.simulation.virtual_chase import VirtualChase
from swarmchase.world.radio import Radio


def scenario_of(**changes: Any) -> Scenario:
    return dataclasses.replace(load_scenario("flight"), behaviour="hover", **changes)


class Watched:
    """A flight, with what its alarms have said."""

    def __init__(
        self, scenario: Scenario, seed: int, chase: int, faults: str = "", settings: ServiceSettings | None = None
    ) -> None:
        self.alarms: list[tuple[Snapshot, Alarm]] = []
        self.heard_dbm: list[np.ndarray] = []
        controller = load_controller("particle", scenario)
        self.chase = VirtualChase(scenario, controller, seed, chase, fault_plan(faults), settings, watch=self._watch)
        self._alarms = Alarms(self.chase.link)

    def _watch(self, snapshot: Snapshot) -> None:
        self.alarms += [
            (snapshot, alarm) for alarm in self._alarms(snapshot) if alarm.cause in {"transmitters", "second look"}
        ]

    @property
    def radio(self) -> RadioInFlight:
        assert isinstance(self.chase.site.radio, RadioInFlight)
        return self.chase.site.radio

    def center_m(self) -> np.ndarray:
        return np.asarray(np.median(np.array(self.chase.site.positions_m()), axis=0))


def test_what_does_not_fit_one_transmitter_is_not_called_reached_and_the_reason_is_said() -> None:
    """The swarm comes to the other one, 150 m from the target, looks again from 40 m away, comes back, and stays there
    until its movements are spent.
    """
    flight = Watched(scenario_of(max_movements=112), 2000, 101, "second=150")
    result = flight.chase.run()
    other_m = np.array(flight.radio.target_m) + np.array([150.0, 0.0, 0.0])
    assert np.linalg.norm(flight.center_m() - other_m) < 10.0
    assert result.said_distance_m > 100.0
    assert (result.state, result.reason) == (
        "lost",
        "112 movements are spent; what is heard does not fit one transmitter",
    )
    told: dict[str, list[Snapshot]] = {}
    for snapshot, alarm in flight.alarms:
        told.setdefault(alarm.text, []).append(snapshot)
    assert list(told) == [
        "what is heard does not fit one transmitter: it fades as two do whose powers add up, and the service calls "
        "neither reached; the word reached does",
        "the swarm flies around the target, 40 m away, to hear whether two transmit: up to 30 s",
    ]
    two, look = told.values()
    # Once it is told of it stays told of, and the belief and the levels alone would have called that one reached.
    first = two[0].movements
    assert first < 45
    assert len({snapshot.movements for snapshot in two}) == 112 - first + 1
    assert max(snapshot.share_within or 0.0 for snapshot in two) > 0.8
    # The look begins where it would have been called reached, and has 60 decisions; the last one ends it.
    assert {snapshot.movements for snapshot in look} == set(range(look[0].movements, look[0].movements + 59))
    centers_m = np.array([snapshot.center_m for snapshot in look if snapshot.movements > look[0].movements + 15])
    out_m = np.linalg.norm(centers_m - other_m, axis=1)
    assert 20.0 < out_m.min() < out_m.max() < 60.0


def test_the_operator_s_word_is_enough() -> None:
    """Then it has been said which one it is: where the swarm follows, the next word ends the chase."""
    flight = Watched(scenario_of(), 2000, 101, "second=150", ServiceSettings(follow=True))
    while not flight.alarms:
        flight.chase.tick()
    for after in (ChaseState.FOLLOWING, ChaseState.REACHED):
        flight.chase.service.declare_reached()
        flight.chase.tick()
        count = len(flight.alarms)
        for _ in range(60):
            flight.chase.tick()
        assert flight.chase.service.state is after
        assert len(flight.alarms) == count


TARGET, OTHER = "02:00:00:00:00:07", "02:00:00:00:00:08"
OTHER_M = 40.0
"""The other one stands so far east of the target."""


class TellingReceiver:
    """A board that prints whose transmission it hears: datagrams of JSON records to the tracker's real source."""

    def __init__(self, flight: Watched, tracker: int, details: SourceDetails) -> None:
        self.source = JsonDatagramSource(0, LOOPBACK, details)
        self._flight, self._tracker = flight, tracker
        self._radio = Radio(scenario_of())
        self._state = self._radio.begin([(9, 0)])
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def put(self, samples: list[Sample]) -> None:
        for time_ns, rssi_dbm in samples:
            self._say(time_ns, rssi_dbm, TARGET)
            self._say(time_ns, self._other_dbm(time_ns), OTHER)

    def _other_dbm(self, time_ns: int) -> float:
        site = self._flight.chase.site
        other_m = torch.tensor(site.radio.target_m, dtype=torch.float64) + torch.tensor([OTHER_M, 0.0, 0.0])
        position_m = torch.tensor(site.positions_m(), dtype=torch.float64)
        at_s = torch.tensor([[time_ns / 1e9]], dtype=torch.float64)
        heard_dbm, self._state = self._radio.heard_dbm(self._state, at_s, other_m[None, None], position_m[None, None])
        return float(heard_dbm[0, 0, self._tracker])

    def _say(self, time_ns: int, rssi_dbm: float, mac: str) -> None:
        record = {"rssi_dbm": rssi_dbm, "time_ns": time_ns, "mac": mac}
        self._socket.sendto(json.dumps(record).encode(), (LOOPBACK, self.source.port))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.source, name)

    def close(self) -> None:
        self.source.close()
        self._socket.close()


@pytest.fixture
def told_apart(request: pytest.FixtureRequest) -> Iterator[Watched]:
    """A flight whose receivers tell who transmits; the one that is chased is the parameter."""
    flight = Watched(scenario_of(start_distance_m=25.0, farthest_start_m=30.0), 0, 3)
    details = SourceDetails(same_clock=True, transmitter_mac=request.param, time_column="time_ns")
    receivers = [TellingReceiver(flight, tracker, details) for tracker in range(NUM_TRACKERS)]
    flight.chase._receivers = receivers  # type: ignore[assignment]
    flight.chase.agents = [flight.chase._agent(tracker) for tracker in range(NUM_TRACKERS)]
    yield flight
    for receiver in receivers:
        receiver.close()


@pytest.mark.parametrize(("told_apart", "away_m"), [(TARGET, 0.0), (OTHER, OTHER_M)], indirect=["told_apart"])
def test_of_two_whose_names_are_heard_the_chosen_one_is_reached(told_apart: Watched, away_m: float) -> None:
    result = told_apart.chase.run()
    chosen_m = np.array(told_apart.radio.target_m) + np.array([away_m, 0.0, 0.0])
    assert result.state == "reached"
    # At 10 m/s the swarm stands 12.5 m further on.
    assert np.linalg.norm(told_apart.center_m() - chosen_m) < 15.0
    assert not told_apart.alarms


@pytest.mark.parametrize("told_apart", [None], indirect=True)
def test_of_two_of_which_none_is_chosen_nothing_counts_and_they_are_listed(told_apart: Watched) -> None:
    for _ in range(360):
        told_apart.chase.tick()
    snapshot = told_apart.chase.service.snapshot()
    assert snapshot.state not in {ChaseState.REACHED, ChaseState.FOLLOWING}
    assert all(tracker.is_silent for tracker in snapshot.trackers)
    decision = snapshot.last_decision
    assert decision is None or all(math.isnan(level) for level in decision.rssi_dbm.ravel())
    for tracker in snapshot.trackers:
        said = " ".join(notice.text for notice in tracker.notices)
        assert "has 2 transmitters: say which one is chased with --transmitter-mac or --transmitter-name" in said
        assert TARGET in said
        assert OTHER in said
