"""The grid of 1 / F on which both ends of the link file samples, and which of several samples for one cell stays.

A cell holds what was taken nearer to its middle than to any other's; the middles are whole numbers of periods from
where the grid begins. A tracker begins its grid with its receiver's first sample, so that a receiver of rate F has each
sample in the middle of a cell and its jitter puts no two into one. The controller begins every grid at 0 of the
tracker's clock, since it may hear any sample first.

A valid sample always displaces a missing one. Of several valid ones

- the tracker keeps the latest, whose level is the nearest to now: the controller's networks know samples, not means;
- the controller keeps the one nearest to the middle of the cell, of two as near that of the message that was sent last
  (its tracker may have put a later sample in the place of an earlier one), and of contradictory messages of one moment,
  which no tracker sends that lives by these rules, the weaker: it hears each sample many times and in any order, and
  what it keeps must not depend on that.
"""

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    _Whole = TypeVar("_Whole", int, npt.NDArray[np.int64])
else:
    # One whole number or an array of them: a tracker does without numpy.
    _Whole = TypeVar("_Whole")


class SampleGrid:
    """Cells of 1 / ``sampling_hz`` seconds, numbered by how many periods their middles lie after its beginning."""

    def __init__(self, sampling_hz: float) -> None:
        self._period_ns = round(1e9 / sampling_hz)

    def cell(self, since_ns: _Whole) -> _Whole:
        """Where a sample belongs that was taken so many nanoseconds after the beginning; of two cells as near the
        later one."""
        return (since_ns + self._period_ns // 2) // self._period_ns

    def middle_ns(self, cell: _Whole) -> _Whole:
        """The cell's middle, in nanoseconds after the beginning."""
        return cell * self._period_ns

    def next_cell(self, since_ns: int, phase_ns: int) -> int:
        """The first cell whose sample is taken at or after a moment, where samples are taken ``phase_ns`` after the
        middles of their cells."""
        return -((phase_ns - since_ns) // self._period_ns)
