"""The radio link between real tracker processes and a real controller: it passes their datagrams on, or fails to.

Each tracker dials a port of its own here, and has a socket of its own to the controller, which so tells them apart.
"""

import contextlib
import socket
import time
from random import Random
from typing import Any

from ..live.address import LOOPBACK
from ..live.link.udp_socket import bound_udp_socket
from ..scenario import NUM_TRACKERS
from .fault_plan import FaultPlan
from .faulty_path import FaultyPath
from .forger import Forger

MOST_DATAGRAMS = 1000
"""That one step takes from a socket."""
READ_BYTES = 65536


class UdpRelay:
    """Between the controller at ``controller_port`` of this machine and six trackers.

    Args:
        seed: of all chance.
    """

    def __init__(self, plan: FaultPlan, controller_port: int, seed: str) -> None:
        self._plan = plan
        self._lanes = [_Lane(controller_port) for _ in range(NUM_TRACKERS)]
        self._seed = seed
        self._forger_socket = bound_udp_socket(LOOPBACK, 0)
        self._controller = (LOOPBACK, controller_port)
        self._forger: Forger | None = None
        self._start_ns: int | None = None
        self._num_forged = 0

    @property
    def ports(self) -> list[int]:
        """What each tracker dials."""
        return [int(lane.near.getsockname()[1]) for lane in self._lanes]

    @property
    def sockets(self) -> list[socket.socket]:
        """Where something may come in."""
        return [one for lane in self._lanes for one in (lane.near, lane.far)]

    def begin(self, now_ns: int) -> None:
        """From now on the link fails as planned."""
        self._start_ns = now_ns
        for tracker, lane in enumerate(self._lanes):
            lane.fail(self._plan, f"{self._seed} {tracker}", now_ns)
        if self._plan.forged_hz:
            self._forger = Forger(Random(f"{self._seed} forger"), time.time_ns)

    def step(self, now_ns: int) -> None:
        """Take what has come, pass on what is due, and let the forger speak."""
        for lane in self._lanes:
            lane.step(now_ns, self._forger)
        if self._forger is not None and self._start_ns is not None:
            due = int((now_ns - self._start_ns) / 1e9 * self._plan.forged_hz)
            for _ in range(min(due - self._num_forged, MOST_DATAGRAMS)):
                with contextlib.suppress(OSError):
                    self._forger_socket.sendto(self._forger.datagram(), self._controller)
            self._num_forged = due

    def close(self) -> None:
        """Give the sockets back."""
        for one in (*self.sockets, self._forger_socket):
            one.close()


class _Lane:
    """One tracker's: two sockets and a path each way."""

    def __init__(self, controller_port: int) -> None:
        self.near, self.far = bound_udp_socket(LOOPBACK, 0), bound_udp_socket(LOOPBACK, 0)
        self._controller = (LOOPBACK, controller_port)
        self._tracker: Any = None
        """Where it last spoke from."""
        self.fail(FaultPlan(), "", 0)

    def fail(self, plan: FaultPlan, seed: str, now_ns: int) -> None:
        """From now on the paths fail as planned."""
        self._up, self._down = (FaultyPath[bytes](plan.link, Random(f"{way} {seed}"), now_ns) for way in ("up", "down"))

    def step(self, now_ns: int, forger: Forger | None) -> None:
        for datagram, address in _read(self.near):
            self._tracker = address
            self._up.put(datagram, now_ns)
            if forger is not None:
                forger.overhear(datagram)
        for datagram, _ in _read(self.far):
            self._down.put(datagram, now_ns)
        for _, datagram in self._up.take(now_ns):
            with contextlib.suppress(OSError):
                self.far.sendto(datagram, self._controller)
        for _, datagram in self._down.take(now_ns):
            with contextlib.suppress(OSError):
                self.near.sendto(datagram, self._tracker)


def _read(udp: socket.socket) -> list[tuple[bytes, Any]]:
    found: list[tuple[bytes, Any]] = []
    for _ in range(MOST_DATAGRAMS):
        try:
            found.append(udp.recvfrom(READ_BYTES))
        except BlockingIOError:
            break
        except OSError:  # what was sent before found nobody there
            continue
    return found
