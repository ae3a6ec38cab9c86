"""The last samples of one receiver on the grid of the sampling rate."""

import math
from collections import Counter

from ....errors import InputError
from ....levels import is_level, why_no_level
from ...link.messages import FASTEST_SAMPLING_HZ, MOST_SAMPLES, SLOWEST_SAMPLING_HZ
from ...link.sample_grid import SampleGrid
from .protocol import Sample

LATENESS_S = 0.1
"""So long after the end of a slot of the grid its sample may still come (a serial line, a bridge, a poll); then it
counts as missing. A window therefore ends so much earlier where the receiver is silent."""


class SampleBuffer:
    """Keeps the last ``num_samples`` slots: the cells of a grid that begins with the first sample. Each holds its
    latest valid sample; ``link.sample_grid`` says why.

    Raises:
        InputError: a rate or number of samples that no message may carry.
    """

    def __init__(self, sampling_hz: float, num_samples: int = MOST_SAMPLES) -> None:
        if not SLOWEST_SAMPLING_HZ <= sampling_hz <= FASTEST_SAMPLING_HZ:
            allowed = f"{SLOWEST_SAMPLING_HZ} to {FASTEST_SAMPLING_HZ}"
            raise InputError(f"sampling_hz = {sampling_hz} is refused: allowed is {allowed}")
        if not 1 <= num_samples <= MOST_SAMPLES:
            raise InputError(f"num_samples = {num_samples} is refused: allowed is 1 to {MOST_SAMPLES}")
        self._grid = SampleGrid(sampling_hz)
        self._num_samples = num_samples
        self._first_ns: int | None = None
        self._newest_slot = 0
        self._slots: dict[int, Sample] = {}
        self.dropped: Counter[str] = Counter()
        """Samples that were not taken up, by reason."""

    def add(self, sample: Sample, now_ns: int) -> bool:
        """Take up a sample and say so. One that is no level, lies in the future or is older than the window is dropped
        and counted."""
        time_ns, rssi_dbm = sample
        if not is_level(rssi_dbm):
            return self._drop(why_no_level(rssi_dbm))
        # Another process may have read the same clock a moment after us.
        if time_ns > now_ns + LATENESS_S * 1e9:
            return self._drop("dated in the future")
        if self._first_ns is None:
            self._first_ns = time_ns
        slot = self._grid.cell(time_ns - self._first_ns)
        if slot <= self._newest_slot - self._num_samples:
            return self._drop("older than the window")
        kept = self._slots.get(slot)
        # Of two that were taken at one time the one that came last.
        if kept is None or time_ns >= kept[0]:
            self._slots[slot] = sample
        self._move_to(slot)
        return True

    def _drop(self, reason: str) -> bool:
        self.dropped[str(reason)] += 1
        return False

    def window(self, now_ns: int) -> tuple[int, tuple[float, ...]] | None:
        """When the newest slot was, in nanoseconds, and the levels in dBm up to it, oldest first, NaN where nothing
        valid came; None before the first sample."""
        if self._first_ns is None:
            return None
        self._move_to(self._grid.cell(now_ns - round(LATENESS_S * 1e9) - self._first_ns) - 1)
        oldest_slot = max(0, self._newest_slot - self._num_samples + 1)
        levels_dbm = tuple(
            self._slots[slot][1] if slot in self._slots else math.nan
            for slot in range(oldest_slot, self._newest_slot + 1)
        )
        return self._first_ns + self._grid.middle_ns(self._newest_slot), levels_dbm

    def _move_to(self, slot: int) -> None:
        if slot <= self._newest_slot:
            return
        self._newest_slot = slot
        oldest_slot = self._newest_slot - self._num_samples + 1
        for passed in [kept for kept in self._slots if kept < oldest_slot]:
            del self._slots[passed]
