"""Somebody who has no key and sends the controller datagrams in the trackers' names."""

from collections import deque
from collections.abc import Callable
from random import Random

from ..live.link.codec import TRACKER_COMPONENT, system_of
from ..live.link.keys import KEY_BYTES
from ..live.link.messages import PositionReport, RssiWindow
from ..live.link.packet import PacketWriter
from ..live.link.timestamps import Timestamps
from ..scenario import NUM_TRACKERS

MOST_OVERHEARD = 200
GIANT_BYTES = 2000


class Forger:
    """Makes datagrams; what it has overheard it also sends again, whole and cut."""

    def __init__(self, random: Random, wall_time_ns: Callable[[], int]) -> None:
        self._random = random
        self._wall_time_ns = wall_time_ns
        self._overheard: deque[bytes] = deque(maxlen=MOST_OVERHEARD)
        self._key = random.randbytes(KEY_BYTES)
        timestamps = Timestamps([], None, wall_time_ns)
        self._writers = [
            PacketWriter(system_of(tracker), TRACKER_COMPONENT, timestamps) for tracker in range(NUM_TRACKERS)
        ]
        self._kinds = (
            self._noise,
            self._wrong_key,
            self._unsigned,
            self._replay,
            self._cut,
            self._damaged,
            self._giant,
        )

    def overhear(self, datagram: bytes) -> None:
        """A tracker has sent this."""
        self._overheard.append(datagram)

    def datagram(self) -> bytes:
        """The next one, of a kind that chance decides."""
        return self._random.choice(self._kinds)()

    def _noise(self) -> bytes:
        return self._random.randbytes(self._random.randrange(300))

    def _giant(self) -> bytes:
        return b"\xfd" + self._random.randbytes(GIANT_BYTES)

    def _wrong_key(self) -> bytes:
        return self._lie(self._key)

    def _unsigned(self) -> bytes:
        return self._lie(None)

    def _lie(self, key: bytes | None) -> bytes:
        tracker = self._random.randrange(NUM_TRACKERS)
        time_ns = self._wall_time_ns() % 10**15
        if self._random.random() < 0.5:
            return self._writers[tracker].datagram(PositionReport(tracker, time_ns, (50_000.0, 0.0, 0.0)), key)
        return self._writers[tracker].datagram(RssiWindow(tracker, time_ns, 10.0, (0.0,) * 50), key)

    def _replay(self) -> bytes:
        return self._random.choice(self._overheard) if self._overheard else self._noise()

    def _cut(self) -> bytes:
        whole = self._replay()
        return whole[: self._random.randrange(len(whole) + 1)]

    def _damaged(self) -> bytes:
        damaged = bytearray(self._replay() or b"\xfd")
        damaged[self._random.randrange(len(damaged))] ^= 1 << self._random.randrange(8)
        return bytes(damaged)
