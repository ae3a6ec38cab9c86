"""The frames of a chase in bounded memory: the newest all of them, the older ones in even steps of time."""

import bisect
import zlib

MOST_FRAMES = 20_000
FAST = 1
"""Level of compression: some tenths of a millisecond a frame, a third of its size."""


class History:
    """Frames as compressed text, in the order of their time. Not thread-safe.

    When it is full, the older half is thinned to about half of what it was, evenly over its time: no step between two
    frames is made longer than the chase's duration times 8 / ``most_frames``, so that after hours every part of it can
    still be looked at.

    Args:
        most_frames: no more than this many are kept; at least 8.
    """

    def __init__(self, most_frames: int = MOST_FRAMES) -> None:
        self._most_frames = most_frames
        self._time_s: list[float] = []
        self._packed: list[bytes] = []

    def __len__(self) -> int:
        return len(self._time_s)

    @property
    def span_s(self) -> tuple[float, float] | None:
        """Time of the first and of the last frame; None without any."""
        return (self._time_s[0], self._time_s[-1]) if self._time_s else None

    def add(self, time_s: float, packed: bytes) -> None:
        """Keep one more frame, as ``pack`` makes it."""
        place = bisect.bisect_right(self._time_s, time_s)
        self._time_s.insert(place, time_s)
        self._packed.insert(place, packed)
        if len(self._time_s) > self._most_frames:
            self._thin()

    def nearest(self, time_s: float) -> bytes | None:
        """The frame next to this time, packed; None without any."""
        if not self._time_s:
            return None
        after = bisect.bisect_left(self._time_s, time_s)
        around = [index for index in (after - 1, after) if 0 <= index < len(self._time_s)]
        return self._packed[min(around, key=lambda index: abs(self._time_s[index] - time_s))]

    def _thin(self) -> None:
        """Of the older half drop each frame whose neighbours are no more than a step apart: about half of them stay."""
        half = len(self._time_s) // 2
        step_s = 4 * (self._time_s[half] - self._time_s[0]) / half
        kept = [0]
        for index in range(1, half):
            if self._time_s[index + 1] - self._time_s[kept[-1]] > step_s:
                kept.append(index)
        self._time_s = [self._time_s[index] for index in kept] + self._time_s[half:]
        self._packed = [self._packed[index] for index in kept] + self._packed[half:]


def pack(text: str) -> bytes:
    """Text as the history keeps it."""
    return zlib.compress(text.encode(), FAST)


def unpack(packed: bytes) -> str:
    """The text again."""
    return zlib.decompress(packed).decode()
