"""The sockets of a controller and six trackers on a clock that is made, and a network between them that fails.

It carries bytes, so the real link runs over it, signatures and all.
"""

from collections import deque
from random import Random
from typing import Any

from ..live.clock import VirtualClock
from ..scenario import NUM_TRACKERS
from .fault_plan import FaultPlan
from .faulty_path import FaultyPath
from .forger import Forger

CONTROLLER: tuple[str, int] = ("127.0.0.1", 1)
STRANGER = -1
"""Nobody is there: what is sent to it is lost."""
MOST_WAITING = 10_000
"""In a socket's buffer; what comes then is lost."""


class VirtualNetwork:
    """Sockets for one controller and six trackers. ``pass_on`` moves what has come by now.

    Args:
        seed: of all chance.
    """

    def __init__(self, clock: VirtualClock, plan: FaultPlan, seed: str) -> None:
        self._clock, self._plan = clock, plan
        now_ns = clock.now_ns()
        self._to_controller, self._to_tracker = (
            [FaultyPath[bytes](plan.link, Random(f"{seed} {way} {tracker}"), now_ns) for tracker in range(NUM_TRACKERS)]
            for way in ("up", "down")
        )
        self.controller = VirtualSocket(self._send_down, 0)
        self.trackers = [
            VirtualSocket(lambda datagram, _, tracker=tracker: self._send_up(datagram, tracker), tracker + 1)
            for tracker in range(NUM_TRACKERS)
        ]
        self._forger = Forger(Random(f"{seed} forger"), clock.now_ns) if plan.forged_hz else None
        self._start_ns, self._num_forged = now_ns, 0

    def cut(self, tracker: int, is_cut: bool) -> None:
        """Cut this tracker's link by hand, both ways, or mend it."""
        self._to_controller[tracker].is_cut = self._to_tracker[tracker].is_cut = is_cut

    def pass_on(self) -> None:
        """Let arrive what has come by now, in the order of its coming."""
        now_ns = self._clock.now_ns()
        come = [
            (due_ns, datagram, tracker)
            for tracker, path in enumerate(self._to_controller)
            for due_ns, datagram in path.take(now_ns)
        ]
        for _, datagram, tracker in sorted(come, key=lambda one: one[0]):
            self.controller.put(datagram, ("tracker", tracker))
        for tracker, path in enumerate(self._to_tracker):
            for _, datagram in path.take(now_ns):
                self.trackers[tracker].put(datagram, CONTROLLER)
        if self._forger is not None:
            due = int((now_ns - self._start_ns) / 1e9 * self._plan.forged_hz)
            for _ in range(due - self._num_forged):
                self.controller.put(self._forger.datagram(), ("stranger", STRANGER))
            self._num_forged = due

    def _send_up(self, datagram: bytes, tracker: int) -> None:
        if self._forger is not None:
            self._forger.overhear(datagram)
        self._to_controller[tracker].put(datagram, self._clock.now_ns())

    def _send_down(self, datagram: bytes, address: Any) -> None:
        _, tracker = address
        if tracker != STRANGER:
            self._to_tracker[tracker].put(datagram, self._clock.now_ns())


class VirtualSocket:
    """A ``DatagramSocket``. Closing it changes nothing: whoever is started again finds it as it was."""

    def __init__(self, send: Any, number: int) -> None:
        self._send, self._number = send, number
        self._waiting: deque[tuple[bytes, Any]] = deque(maxlen=MOST_WAITING)

    def put(self, datagram: bytes, address: Any) -> None:
        """It has come."""
        self._waiting.append((datagram, address))

    def recvfrom(self, size: int, /) -> tuple[bytes, Any]:
        """The oldest that waits, cut to ``size``; ``BlockingIOError`` where there is none."""
        if not self._waiting:
            raise BlockingIOError
        datagram, address = self._waiting.popleft()
        return datagram[:size], address

    def sendto(self, datagram: bytes, address: Any, /) -> int:
        """Send it."""
        self._send(datagram, address)
        return len(datagram)

    def getsockname(self) -> Any:
        """Its name in this network."""
        return ("virtual", self._number)

    def fileno(self) -> int:
        """None: nobody waits for it, since its clock stands still meanwhile."""
        return -1

    def close(self) -> None:
        """Nothing is held."""
