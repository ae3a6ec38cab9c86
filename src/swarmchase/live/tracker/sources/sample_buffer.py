"""The last samples of one receiver on the grid of the sampling rate."""

import math

from ....errors import InputError
from ...link.messages import FASTEST_SAMPLING_HZ, MOST_SAMPLES, SLOWEST_SAMPLING_HZ
from ...link.sample_grid import SampleGrid
from .protocol import Sample, plausible_dbm

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

    def add(self, sample: Sample, now_ns: int) -> None:
        """Take up a sample. What is not valid, lies in the future or is older than the window changes nothing."""
        time_ns, rssi_dbm = sample
        # Another process may have read the same clock a moment after us.
        if math.isnan(plausible_dbm(rssi_dbm)) or time_ns > now_ns + LATENESS_S * 1e9:
            return
        if self._first_ns is None:
            self._first_ns = time_ns
        slot = self._grid.cell(time_ns - self._first_ns)
        if slot <= self._newest_slot - self._num_samples:
            return
        self._slots[slot] = max(self._slots.get(slot, sample), sample)
        self._move_to(slot)

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
