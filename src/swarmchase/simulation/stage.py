"""The site process of ``swarmchase live``: the site, the link that fails, and the tracker processes.

It runs beside the process that holds the controller service, and hears from it only where its windows begin, which
keeps simulated windows in step with those of the evaluation.
"""

import json
import math
import select
import socket
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import torch

from ..live.address import LOOPBACK
from ..live.link.messages import Metres
from ..live.tracker.sources import Sample
from ..processes.children import begin_child
from ..processes.stop_request import StopRequest
from ..scenario import NUM_TRACKERS, Scenario
from .fault_plan import FaultPlan
from .simulated_ardupilot import SimulatedArduPilot
from .site import Site
from .tracker_processes import TrackerPorts, TrackerProcesses, free_udp_ports
from .udp_relay import UdpRelay

TICK_S = 0.005
POSITION_HZ = 20.0
TRUTH_PERIOD_S = 0.2
READY_S = 60.0
"""So long six processes may take to start on a busy machine."""


@dataclass(frozen=True)
class Announcement:
    """To the stage: the controller's next window, or how the formation looks in flight."""

    since_ns: int
    center_m: Metres
    spacing_m: float
    turned_rad: float


@dataclass(frozen=True)
class Truth:
    """From the stage: what only it knows."""

    target_m: Metres
    distance_m: float
    """From the swarm's centre to the target."""
    is_reached: bool
    """See ``Site.is_reached``,"""
    capture_s: float | None
    """and ``Site.capture_s``,"""
    following_share: float | None
    """and ``Site.following_share``."""


@dataclass(frozen=True)
class Ready:
    """From the stage: all trackers are there, and the chase may begin."""


@dataclass(frozen=True)
class ToldToStop:
    """From the stage: a signal wants it, or a tracker, to stop. It goes on until the command closes the connection."""


@dataclass(frozen=True)
class Failure:
    """From the stage: why it has ended."""

    reason: str


@dataclass(frozen=True)
class Play:
    """What the stage plays."""

    scenario: Scenario
    seed: int
    chase: int
    plan: FaultPlan
    controller_port: int
    folder: Path
    """Holds the trackers' key files."""


def run_stage(play: Play, connection: Connection) -> None:
    """The whole life of the process: until the other end of the connection is closed."""
    request = begin_child()
    torch.set_num_threads(1)
    try:
        stage = _Stage(play, connection, request)
    except Exception as error:
        connection.send(Failure(str(error)))
        return
    try:
        stage.run()
    except OSError:
        return  # the command has gone
    finally:
        stage.close()


class _Stage:
    def __init__(self, play: Play, connection: Connection, request: StopRequest) -> None:
        self._connection, self._request = connection, request
        self._has_told_the_request = False
        self._site = Site(play.scenario, play.seed, play.chase, play.plan)
        self._relay = UdpRelay(play.plan, play.controller_port, f"{play.seed} {play.chase}")
        free = free_udp_ports(2 * NUM_TRACKERS)
        ports = [
            TrackerPorts(source, vehicle, controller)
            for source, vehicle, controller in zip(
                free[:NUM_TRACKERS], free[NUM_TRACKERS:], self._relay.ports, strict=True
            )
        ]
        self._sources = [(LOOPBACK, one.source) for one in ports]
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._autopilots = [
            SimulatedArduPilot(vehicle, one.vehicle, position_hz=POSITION_HZ)
            for vehicle, one in zip(self._site.flown, ports, strict=True)
        ]
        self._trackers = TrackerProcesses(play.scenario, play.plan, ports, play.folder)
        self._start_ns: int | None = None
        self._told_ns = 0

    def run(self) -> None:
        """Until the connection is closed, or a tracker fails."""
        began_ns = time.monotonic_ns()
        while not self._hears_the_end():
            now_ns = time.monotonic_ns()
            self._step(now_ns)
            for tracker, exit_code in self._trackers.died().items():
                words = self._trackers.last_words(tracker)
                self._connection.send(Failure(f"tracker {tracker} ended with exit code {exit_code}: {words}"))
                return
            self._pass_on_the_request()
            if self._start_ns is None and (now_ns - began_ns) / 1e9 > READY_S:
                self._connection.send(Failure(f"after {READY_S:g} s not all trackers had started"))
                return
            passed_s = (time.monotonic_ns() - now_ns) / 1e9
            select.select(self._relay.sockets, [], [], max(TICK_S - passed_s, 0))

    def close(self) -> None:
        self._trackers.close()
        self._relay.close()
        for autopilot in self._autopilots:
            autopilot.close()
        self._socket.close()

    def _step(self, now_ns: int) -> None:
        for address, samples in zip(self._sources, self._site.advance(now_ns), strict=True):
            self._report(address, samples)
        for autopilot in self._autopilots:
            autopilot.step(now_ns)
        self._relay.step(now_ns)
        if self._start_ns is not None:
            self._trackers.step((now_ns - self._start_ns) / 1e9)
            self._tell_the_truth(now_ns)
        elif all(autopilot.has_companion for autopilot in self._autopilots):
            self._start_ns = now_ns
            self._site.begin(now_ns)
            self._relay.begin(now_ns)
            self._tell_the_truth(now_ns)
            self._connection.send(Ready())

    def _pass_on_the_request(self) -> None:
        """What tells the stage to stop, or a tracker, is meant for the whole command."""
        if not self._has_told_the_request and (self._request.made or self._trackers.any_was_stopped()):
            self._has_told_the_request = True
            self._connection.send(ToldToStop())

    def _report(self, address: tuple[str, int], samples: list[Sample]) -> None:
        for time_ns, rssi_dbm in samples:
            level_dbm = None if math.isnan(rssi_dbm) else rssi_dbm
            record = json.dumps({"rssi_dbm": level_dbm, "time_ns": time_ns}).encode()
            try:
                self._socket.sendto(record, address)
            except OSError:  # its tracker has gone
                continue

    def _tell_the_truth(self, now_ns: int) -> None:
        if now_ns - self._told_ns >= TRUTH_PERIOD_S * 1e9:
            self._told_ns = now_ns
            site = self._site
            distance_m, is_reached = site.distance_to_target_m(), site.is_reached()
            truth = Truth(site.radio.target_m, distance_m, is_reached, site.capture_s, site.following_share)
            self._connection.send(truth)

    def _hears_the_end(self) -> bool:
        try:
            while self._connection.poll():
                announcement: Announcement = self._connection.recv()
                self._site.announce(
                    announcement.since_ns, announcement.center_m, announcement.spacing_m, announcement.turned_rad
                )
        except (EOFError, OSError):
            return True
        return False
