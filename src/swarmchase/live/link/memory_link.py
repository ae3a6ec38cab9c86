"""A link inside one process that fails as radio links do: seeded, on a clock that may stand still. For tests.

    network = MemoryNetwork(clock, seed=1, faults=Faults(loss=0.15, delay_s=0.03))
    controller, tracker = network.controller_end(), network.tracker_end(0)

Each direction of each tracker is a path of its own, with random numbers of its own: what happens on one never
changes another. It carries messages, not bytes; forging and damage are the matter of ``mavlink_link``'s tests.
"""

from collections import Counter
from collections.abc import Sequence
from random import Random

from ...errors import InputError
from ...scenario import NUM_TRACKERS
from ...simulation.faulty_path import NO_FAULTS, Faults, FaultyPath
from ..clock import VirtualClock
from .messages import Message, Report, SetPoint
from .protocol import Link
from .rejection import Reason


class MemoryNetwork:
    """One controller, six trackers, and what lies between.

    Args:
        clock: the time by which messages travel.
        seed: of all chance.
        faults: of every path.
        drops_replays: drop and count what was not sent after the newest that came, as ``mavlink_link`` does, also
            after a restart of either end; without it duplicates, late messages and replays come through, which is
            harder on whoever listens.
    """

    def __init__(
        self, clock: VirtualClock, seed: int = 0, faults: Faults = NO_FAULTS, *, drops_replays: bool = False
    ) -> None:
        self._paths_to_controller, self._paths_to_tracker = (
            [
                _MessagePath(FaultyPath(faults, Random(f"{seed} {direction} {tracker}"), clock.now_ns()), drops_replays)
                for tracker in range(NUM_TRACKERS)
            ]
            for direction in ("to controller", "to tracker")
        )
        self._clock = clock

    def controller_end(self) -> "MemoryControllerLink":
        """A controller's end. A second one is the controller after a restart: trackers have to dial it anew."""
        return MemoryControllerLink(self._clock, self._paths_to_controller, self._paths_to_tracker)

    def tracker_end(self, tracker: int) -> "MemoryTrackerLink":
        """A tracker's end. A second one is the tracker after a restart.

        Raises:
            InputError: no such tracker.
        """
        if not 0 <= tracker < NUM_TRACKERS:
            raise InputError(f"tracker = {tracker} is refused: allowed is 0 to {NUM_TRACKERS - 1}")
        return MemoryTrackerLink(
            self._clock, tracker, self._paths_to_tracker[tracker], self._paths_to_controller[tracker]
        )

    def cut(self, tracker: int) -> None:
        """From now on nothing passes between this tracker and the controller."""
        for path in (self._paths_to_controller[tracker], self._paths_to_tracker[tracker]):
            path.faulty.is_cut = True

    def heal(self, tracker: int) -> None:
        """It does again; what was sent or would have come meanwhile is lost."""
        for path in (self._paths_to_controller[tracker], self._paths_to_tracker[tracker]):
            path.faulty.take(self._clock.now_ns())
            path.faulty.is_cut = False


class _MessagePath:
    """A faulty path for messages, and what the receiver remembers of it over restarts."""

    def __init__(self, faulty: FaultyPath[tuple[int, Message]], drops_replays: bool) -> None:
        self.faulty = faulty
        self._drops_replays = drops_replays
        self._num_sent = 0
        self._newest = 0

    def put(self, message: Message, now_ns: int) -> None:
        self._num_sent += 1
        self.faulty.put((self._num_sent, message), now_ns)

    def take(self, now_ns: int, rejected: Counter[str]) -> list[tuple[int, Message]]:
        """(when it came in ns, message) of all that is not to be dropped."""
        accepted = []
        for come_ns, (number, message) in self.faulty.take(now_ns):
            if self._drops_replays and number <= self._newest:
                rejected[Reason.REPLAYED] += 1
                continue
            self._newest = max(self._newest, number)
            accepted.append((come_ns, message))
        if self.faulty.overflows:
            rejected[Reason.OVERFLOW] += self.faulty.overflows
            self.faulty.overflows = 0
        return accepted


class _MemoryEnd:
    """What both ends count and forget."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self._rejected: Counter[str] = Counter()
        self._is_closed = False

    @property
    def rejected(self) -> Counter[str]:
        """How many messages were dropped, by the words of ``Reason``: here replayed and overflow."""
        return self._rejected

    def close(self) -> None:
        """From now on it sends and receives nothing."""
        self._is_closed = True


class MemoryControllerLink(_MemoryEnd, Link):
    """The controller's end: made by ``MemoryNetwork``."""

    def __init__(
        self, clock: VirtualClock, from_trackers: Sequence[_MessagePath], to_trackers: Sequence[_MessagePath]
    ) -> None:
        super().__init__(clock)
        self._from_trackers = from_trackers
        self._to_trackers = to_trackers
        self._dialled: set[int] = set()

    def send(self, message: Message) -> None:
        """Send a set-point, if its tracker has been heard.

        Raises:
            TypeError: not a set-point.
        """
        if not isinstance(message, SetPoint):
            raise TypeError(f"a controller does not send a {type(message).__name__}")
        if message.tracker in self._dialled and not self._is_closed:
            self._to_trackers[message.tracker].put(message, self._clock.now_ns())

    def receive(self) -> Sequence[Message]:
        """What trackers have said since the last call."""
        if self._is_closed:
            return []
        come = [item for path in self._from_trackers for item in path.take(self._clock.now_ns(), self._rejected)]
        come.sort(key=lambda item: item[0])
        self._dialled.update(message.tracker for _, message in come)
        return [message for _, message in come]


class MemoryTrackerLink(_MemoryEnd, Link):
    """A tracker's end: made by ``MemoryNetwork``."""

    def __init__(
        self, clock: VirtualClock, tracker: int, from_controller: _MessagePath, to_controller: _MessagePath
    ) -> None:
        super().__init__(clock)
        self._tracker = tracker
        self._from_controller = from_controller
        self._to_controller = to_controller

    def send(self, message: Message) -> None:
        """Send a report.

        Raises:
            TypeError: not a report.
            ValueError: another tracker's.
        """
        if not isinstance(message, Report):
            raise TypeError(f"a tracker does not send a {type(message).__name__}")
        if message.tracker != self._tracker:
            raise ValueError(f"tracker {self._tracker} does not speak for tracker {message.tracker}")
        if not self._is_closed:
            self._to_controller.put(message, self._clock.now_ns())

    def receive(self) -> Sequence[Message]:
        """What the controller has said since the last call."""
        if self._is_closed:
            return []
        return [message for _, message in self._from_controller.take(self._clock.now_ns(), self._rejected)]
