"""What one tracker has heard, by the time each sample was taken, whatever messages brought it and in which order.

Every message repeats earlier samples. A sample belongs to the cell of a grid of 1 / F on its tracker's own clock, and
of several for one cell always the same one is kept (``link.sample_grid`` says which); so any order, repetition or loss
of messages gives the same window as long as the same samples have arrived at least once, and a late message fills old
cells only.

A tracker should date its samples by a grid of its own (time of the first plus a whole number of periods). One that
samples faster than F is thinned out, one that samples slower leaves cells empty.
"""

from collections import Counter, deque
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from ...levels import NoLevel, highest_dbm, is_level, why_no_level
from ...observation import wild_samples
from ...scenario import Scenario
from ..link.messages import RssiWindow
from ..link.sample_grid import SampleGrid

Levels = npt.NDArray[np.float64]
Point = npt.NDArray[np.float64]
"""[xyz]"""
Points = npt.NDArray[np.float64]
"""[tracker, xyz]"""
Times = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

OFFSET_HORIZON_S = 10
"""The clock offset is the least of this long; a clock that is off by 100 ppm drifts 1 ms in it."""
RESTART_JUMP_S = 5.0
"""A heartbeat that is further from the clock offset than any delay tells that its sender's clock began anew. A smaller
jump is a delay for as long as ``OFFSET_HORIZON_S`` remembers what was before."""
KEPT_BEYOND_WINDOW_S = 5.0
"""So long samples are kept after another window's worth has come in."""
NEVER = np.iinfo(np.int64).min


class ClockOffset:
    """How far a tracker's clock is behind the controller's, plus the shortest delay of the link between them: the
    least difference of arrival and sender time over ``OFFSET_HORIZON_S``.

    What its sender dates s thus was there no later than s + offset, and whatever came in by now is dated no later than
    now - offset.
    """

    def __init__(self) -> None:
        self._least_ns: deque[tuple[int, int]] = deque()
        """(second of arrival, least difference in it), oldest first."""
        self.offset_ns: int | None = None
        """Nanoseconds; None before the first message."""

    def heard(self, sender_ns: int, arrival_ns: int) -> None:
        """Something with the sender's time in it has come in. Late messages change nothing."""
        second, difference_ns = arrival_ns // 10**9, arrival_ns - sender_ns
        if self._least_ns and self._least_ns[-1][0] == second:
            self._least_ns[-1] = (second, min(difference_ns, self._least_ns[-1][1]))
        else:
            self._least_ns.append((second, difference_ns))
        while self._least_ns[0][0] < second - OFFSET_HORIZON_S:
            self._least_ns.popleft()
        self.offset_ns = min(least_ns for _, least_ns in self._least_ns)

    def contradicts(self, sender_ns: int, arrival_ns: int) -> bool:
        """Whether a message dated when it was sent comes from a clock that has begun anew.

        Only such messages can tell: a window may be repeated long after its last sample was taken.
        """
        if self.offset_ns is None:
            return False
        return abs(arrival_ns - sender_ns - self.offset_ns) > RESTART_JUMP_S * 1e9

    def forget(self) -> None:
        """The sender's clock has begun anew."""
        self._least_ns.clear()
        self.offset_ns = None


class SampleWindow:
    """The last samples of one tracker. All times are nanoseconds of the tracker's clock.

    What is no level of the scenario's transmitter is missing, and so is what is wild in its window (``levels``).
    """

    def __init__(self, scenario: Scenario) -> None:
        self._grid = SampleGrid(scenario.sampling_hz)
        self._window_samples, self._highest_dbm = scenario.samples_a_decision, highest_dbm(scenario)
        self._room = 2 * scenario.samples_a_decision + int(np.ceil(KEPT_BEYOND_WINDOW_S * scenario.sampling_hz))
        self.dropped: Counter[NoLevel] = Counter()
        """Samples that were reported and are no levels, by reason; one reported again and again counts once."""
        self.forget()

    def forget(self) -> None:
        """Empty it: the tracker's clock has begun anew."""
        # Cell c lives at place c modulo the room, until a newer one takes the place.
        self._cell: Times = np.full(self._room, NEVER, dtype=np.int64)
        self._time_ns: Times = np.zeros(self._room, dtype=np.int64)
        self._message_ns: Times = np.zeros(self._room, dtype=np.int64)
        """Of the message that the sample came with: when it was sent."""
        self._rssi_dbm: Levels = np.full(self._room, np.nan)
        self._reported_dbm: Levels = np.full(self._room, np.nan)
        """The same, but for what was reported and is no level."""
        self._newest_wild = NEVER
        """Up to this cell wild samples are counted."""
        self.newest_valid_ns: int | None = None
        """When the newest valid sample was taken."""

    def add(self, message: RssiWindow) -> None:
        """File the samples of a message."""
        reported_dbm = np.array(message.rssi_dbm, dtype=np.float64)
        rssi_dbm = np.where(is_level(reported_dbm, self._highest_dbm), reported_dbm, np.nan)
        ago = np.arange(len(rssi_dbm) - 1, -1, -1)
        time_ns = message.time_ns - np.rint(ago * (1e9 / message.sampling_hz)).astype(np.int64)
        valid = np.isfinite(rssi_dbm)
        if valid.any():
            self.newest_valid_ns = max(int(time_ns[valid][-1]), self.newest_valid_ns or 0)
        cell = self._grid.cell(time_ns)
        # The best last, which then stays where a message has several samples for one cell.
        message_ns = np.full_like(time_ns, message.time_ns)
        order = np.lexsort(self._merits(cell, time_ns, message_ns, rssi_dbm))
        cell, time_ns, rssi_dbm, reported_dbm = cell[order], time_ns[order], rssi_dbm[order], reported_dbm[order]
        place = cell % self._room
        newer, same = cell > self._cell[place], cell == self._cell[place]
        better = newer | (same & self._is_better(cell, time_ns, message_ns, rssi_dbm))
        place = place[better]
        self._count_dropped(reported_dbm[better], rssi_dbm[better], self._reported_dbm[place], newer[better])
        self._cell[place], self._time_ns[place] = cell[better], time_ns[better]
        self._message_ns[place] = message.time_ns
        self._rssi_dbm[place], self._reported_dbm[place] = rssi_dbm[better], reported_dbm[better]

    def _count_dropped(self, reported_dbm: Levels, rssi_dbm: Levels, before_dbm: Levels, newer: Flags) -> None:
        """Of the samples that are filed now, those that are no levels and are not already there."""
        counts = np.isnan(rssi_dbm) & ~np.isnan(reported_dbm) & (newer | (reported_dbm != before_dbm))
        for one_dbm in reported_dbm[counts].tolist():
            self.dropped[why_no_level(one_dbm)] += 1

    def _merits(self, cell: Times, time_ns: Times, message_ns: Times, rssi_dbm: Levels) -> tuple[npt.NDArray[Any], ...]:
        """What makes one sample better for its cell than another, the most important last: that it is valid, how near
        it was taken to the cell's middle, how late it was sent, and (so that the order of arrival never decides) how
        weak it is.
        """
        valid = np.isfinite(rssi_dbm)
        return np.where(valid, -rssi_dbm, 0.0), message_ns, -np.abs(time_ns - self._grid.middle_ns(cell)), valid

    def _is_better(self, cell: Times, time_ns: Times, message_ns: Times, rssi_dbm: Levels) -> Flags:
        """Whether these samples are better than what their cells hold."""
        place = cell % self._room
        old = self._merits(cell, self._time_ns[place], self._message_ns[place], self._rssi_dbm[place])
        better: Flags = np.zeros(len(cell), dtype=np.bool_)
        for merit, old_merit in zip(self._merits(cell, time_ns, message_ns, rssi_dbm), old, strict=True):
            better = np.asarray((merit > old_merit) | ((merit == old_merit) & better))
        return better

    def window(self, since_ns: int) -> tuple[Levels, Times]:
        """The first ``window_samples`` samples taken at or after this moment: their levels in dBm, NaN where nothing
        valid has come or what came is wild, and when they were taken.
        """
        cell = self._first_cell(since_ns) + np.arange(self._window_samples)
        place = cell % self._room
        there = self._cell[place] == cell
        # Nothing is known of a missing sample's moment but its cell, and that it is not before the window.
        missing_ns = np.maximum(self._grid.middle_ns(cell), since_ns)
        rssi_dbm = self._without_wild(np.where(there, self._rssi_dbm[place], np.nan), cell)
        return rssi_dbm, np.where(there, self._time_ns[place], missing_ns)

    def _without_wild(self, rssi_dbm: Levels, cell: Times) -> Levels:
        wild = wild_samples(torch.from_numpy(rssi_dbm)[None, :, None])
        if wild is None:
            return rssi_dbm
        found = wild[0, :, 0].numpy()
        self.dropped[NoLevel.WILD] += int((cell[found] > self._newest_wild).sum())
        self._newest_wild = max(self._newest_wild, int(cell[found].max()))
        return np.where(found, np.nan, rssi_dbm)

    def first_valid_ns(self, since_ns: int) -> int | None:
        """When the first valid sample at or after this moment was taken; None before there is one."""
        valid_ns = self._time_ns[(self._cell >= self._first_cell(since_ns)) & np.isfinite(self._rssi_dbm)]
        return int(valid_ns.min()) if len(valid_ns) else None

    def is_complete(self, since_ns: int) -> bool:
        """Whether the window that begins at this moment is over: its last sample or a later one has come."""
        return int(self._cell.max()) >= self._first_cell(since_ns) + self._window_samples - 1

    def last_window(self) -> Levels:
        """The newest ``window_samples`` samples, oldest first, in dBm."""
        newest = int(self._cell.max())
        if newest == NEVER:
            return np.full(self._window_samples, np.nan)
        cell = newest - np.arange(self._window_samples)[::-1]
        place = cell % self._room
        return np.where(self._cell[place] == cell, self._rssi_dbm[place], np.nan)

    def _first_cell(self, since_ns: int) -> int:
        """The cell of the first sample at or after this moment, known from where in its cell the newest one lies."""
        place = int(self._cell.argmax())
        newest = int(self._cell[place])
        phase_ns = 0 if newest == NEVER else int(self._time_ns[place]) - self._grid.middle_ns(newest)
        return self._grid.next_cell(since_ns, phase_ns)
