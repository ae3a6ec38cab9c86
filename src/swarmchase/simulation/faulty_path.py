"""One direction of a link that fails as radio links do: seeded, and on anybody's clock. It carries anything."""

import heapq
from collections import deque
from dataclasses import dataclass
from random import Random
from typing import Generic, TypeVar

from ..errors import InputError
from ..ranges import AT_LEAST_ONE, AT_LEAST_ZERO, SHARE, ranged, require_ranges

MOST_IN_FLIGHT = 1000
"""On one path; when more are sent, the oldest give way."""
MOST_REMEMBERED = 100
"""Of the messages of a path, for replays."""

_Item = TypeVar("_Item")


@dataclass(frozen=True)
class Faults:
    """What a path does to the messages sent over it. The default does nothing.

    Raises:
        InputError: a probability outside [0, 1], a negative time, a jitter above the delay, a burst below 1 message,
            or an outage that ends before it starts.
    """

    loss: float = ranged(0.0, SHARE)
    """Probability that a message is lost, each on its own."""
    burst_loss: float = ranged(0.0, SHARE)
    """Share of messages lost in bursts (Gilbert's model: a path is good or bad, and in bad times loses everything)."""
    mean_burst_messages: float = ranged(10.0, AT_LEAST_ONE)
    """Mean length of such a burst."""
    delay_s: float = ranged(0.0, AT_LEAST_ZERO)
    """Mean time on the way."""
    jitter_s: float = 0.0
    """A message's delay is uniform within so much of the mean; messages sent closer together may change places."""
    duplication: float = ranged(0.0, SHARE)
    """Probability that a message comes twice, each copy with a delay of its own."""
    reordering: float = ranged(0.0, SHARE)
    """Probability that a message is held back for ``held_back_s``, so that later ones overtake it."""
    held_back_s: float = ranged(0.1, AT_LEAST_ZERO)
    replay: float = ranged(0.0, SHARE)
    """Probability, at each sending, that somebody also sends one of the last 100 messages again."""
    outages_s: tuple[tuple[float, float], ...] = ()
    """(start, end), seconds since the path was made: what is sent or would come within is lost."""

    def __post_init__(self) -> None:
        require_ranges(self)
        # Bursts of l messages on average, and at least one message between them, lose l / (l + 1) at most.
        if self.burst_loss < 1 and self.burst_loss > (1 - self.burst_loss) * self.mean_burst_messages:
            raise InputError(f"burst_loss = {self.burst_loss} is refused: it needs longer bursts")
        if not 0 <= self.jitter_s <= self.delay_s:
            raise InputError(f"jitter_s = {self.jitter_s} is refused: allowed is 0 to delay_s")
        for start_s, end_s in self.outages_s:
            if not 0 <= start_s <= end_s:
                raise InputError(f"an outage from {start_s} s to {end_s} s is refused")


class FaultyPath(Generic[_Item]):
    """One direction of a link: what is put in comes out later, or never, or twice.

    Args:
        faults: what happens on the way.
        random: all of this path's chance.
        start_ns: when it was made.
    """

    def __init__(self, faults: Faults, random: Random, start_ns: int) -> None:
        self.is_cut = False
        """Cut by hand, beside the outages of ``faults``."""
        self.overflows = 0
        """Messages that gave way to newer ones."""
        self._faults = faults
        self._random = random
        self._start_ns = start_ns
        self._is_bad = random.random() < faults.burst_loss
        self._number = 0
        self._in_flight: list[tuple[int, int, _Item]] = []
        self._sent: deque[_Item] = deque(maxlen=MOST_REMEMBERED)

    def put(self, item: _Item, now_ns: int) -> None:
        """Send it."""
        copies = [item]
        if self._random.random() < self._faults.duplication:
            copies.append(item)
        if self._sent and self._random.random() < self._faults.replay:
            copies.append(self._random.choice(self._sent))
        self._sent.append(item)
        for copy in copies:
            due_ns = now_ns + self._delay_ns()
            is_lost = self._is_lost()
            if not (is_lost or self.is_cut or self._is_out(now_ns) or self._is_out(due_ns)):
                self._number += 1
                heapq.heappush(self._in_flight, (due_ns, self._number, copy))
        while len(self._in_flight) > MOST_IN_FLIGHT:
            heapq.heappop(self._in_flight)
            self.overflows += 1

    def take(self, now_ns: int) -> list[tuple[int, _Item]]:
        """(when it came in ns, what came) of all that has come by now, in the order of its coming."""
        come: list[tuple[int, _Item]] = []
        while self._in_flight and self._in_flight[0][0] <= now_ns:
            due_ns, _, item = heapq.heappop(self._in_flight)
            come.append((due_ns, item))
        return [] if self.is_cut else come

    def _is_lost(self) -> bool:
        faults = self._faults
        is_lost = self._is_bad or self._random.random() < faults.loss
        # Stationary share of bad times: burst_loss. Their mean length: mean_burst_messages.
        leave_bad = 1 / faults.mean_burst_messages
        if faults.burst_loss < 1:
            enter_bad = leave_bad * faults.burst_loss / (1 - faults.burst_loss)
            self._is_bad = self._random.random() < (1 - leave_bad if self._is_bad else enter_bad)
        return is_lost

    def _delay_ns(self) -> int:
        faults = self._faults
        delay_s = faults.delay_s + faults.jitter_s * self._random.uniform(-1, 1)
        if self._random.random() < faults.reordering:
            delay_s += faults.held_back_s
        return round(delay_s * 1e9)

    def _is_out(self, time_ns: int) -> bool:
        since_start_s = (time_ns - self._start_ns) / 1e9
        return any(start_s <= since_start_s < end_s for start_s, end_s in self._faults.outages_s)
