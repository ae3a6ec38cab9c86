"""Which share of a sender's packets get lost, from the numbers that they carry."""

from collections import deque

MOST_REMEMBERED = 100
"""Packets that the share is of: some ten seconds of a tracker's."""
NUMBERS = 256
"""MAVLink's packets are numbered by one byte."""


class LossMeter:
    """Of one sender whose packets come in the order of their sending, or late and then not at all."""

    def __init__(self) -> None:
        self._newest: int | None = None
        self._came: deque[bool] = deque(maxlen=MOST_REMEMBERED)

    def heard(self, number: int) -> None:
        """A packet has come; those between it and the one before have not. After a sender's restart the gap says
        nothing true, but is forgotten as fast as any other.
        """
        if self._newest is not None:
            missing = (number - self._newest - 1) % NUMBERS
            self._came.extend([False] * min(missing, MOST_REMEMBERED))
        self._newest = number
        self._came.append(True)

    @property
    def share(self) -> float | None:
        """Lost of the last packets; None before the second."""
        return None if len(self._came) < 2 else round(self._came.count(False) / len(self._came), 3)
