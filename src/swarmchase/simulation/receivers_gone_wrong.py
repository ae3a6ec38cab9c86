"""What a receiver that fails makes of what it hears."""

import math
from collections import deque
from random import Random

from ..live.tracker.sources import Sample
from ..world.receivers import GARBAGE_DBM, WRONG_DB
from .fault_plan import ReceiverFault

CONSTANT_DBM = {ReceiverFault.DEAF: -200.0, ReceiverFault.LOUD: 20.0}
DELAY_S = 0.5
HALF_SECOND_NS = 500_000_000
GARBAGE_SHARE = 0.5


class FailingReceiver:
    """One tracker's. It is asked sample by sample, in the order of time."""

    def __init__(self, random: Random) -> None:
        self._random = random
        self._last_dbm = math.nan
        self._waiting: deque[Sample] = deque()

    def reported(self, sample: Sample, fault: ReceiverFault | None) -> list[Sample]:
        """What it says when this sample was taken."""
        time_ns, rssi_dbm = sample
        self._waiting.append(sample)
        is_late = fault is ReceiverFault.DELAYED
        num_due = self._num_due(time_ns - round(DELAY_S * 1e9)) if is_late else len(self._waiting)
        due = [self._waiting.popleft() for _ in range(num_due)]
        is_off = fault is ReceiverFault.INTERMITTENT and time_ns // HALF_SECOND_NS % 2 == 1
        if is_off or fault is ReceiverFault.SILENT:
            return []
        if fault is ReceiverFault.STUCK:
            # Where nobody hears anything, so that it does not begin a window of its own.
            return [(time_ns, rssi_dbm if math.isnan(rssi_dbm) else self._last_dbm)]
        if fault is ReceiverFault.GARBAGE and self._random.random() < GARBAGE_SHARE:
            return [(time_ns, self._random.choice(GARBAGE_DBM))]
        if fault in CONSTANT_DBM:
            return [(time_ns, rssi_dbm if math.isnan(rssi_dbm) else CONSTANT_DBM[fault])]
        if fault is ReceiverFault.WRONG:
            return [(time_ns, rssi_dbm + WRONG_DB)]
        self._last_dbm = self._last_dbm if math.isnan(rssi_dbm) else rssi_dbm
        return due

    def _num_due(self, until_ns: int) -> int:
        return sum(time_ns <= until_ns for time_ns, _ in self._waiting)
