"""Receivers that are stuck: the level stays while the tracker flies, and no fading does that."""

from dataclasses import dataclass

import torch

from ..batch.array_types import Bool, Float, Int, Tensor
from ..observation import Observation
from ..scenario import NUM_TRACKERS

STUCK_AFTER = 6
"""Intervals in a row with the same level, in each of which the tracker has flown ``FLOWN_M`` or more."""
FLOWN_M = 1.0
FEWEST_SAMPLES = 2
"""Of fewer in an interval nobody can say whether they stay."""


@dataclass(frozen=True)
class ReceiverLevels:
    """What is kept of each receiver."""

    level_dbm: Float[Tensor, "chase tracker"]
    """Its level, if that has stayed in the last interval; else NaN."""
    intervals: Int[Tensor, "chase tracker"]
    """So many in a row it has stayed."""

    @classmethod
    def unheard(cls, num_chases: int) -> "ReceiverLevels":
        """Before the first interval."""
        shape = (num_chases, NUM_TRACKERS)
        return cls(torch.full(shape, torch.nan), torch.zeros(shape, dtype=torch.int64))

    @property
    def stuck(self) -> Bool[Tensor, "chase tracker"]:
        """Which are."""
        return self.intervals >= STUCK_AFTER

    def after(self, observation: Observation) -> "ReceiverLevels":
        """With this interval; one that says too little changes nothing."""
        rssi_dbm = observation.rssi_dbm.float()
        heard = rssi_dbm.isfinite()
        lowest_dbm = torch.where(heard, rssi_dbm, torch.inf).amin(dim=1)
        highest_dbm = torch.where(heard, rssi_dbm, -torch.inf).amax(dim=1)
        flown_m = (observation.tracker_position_m[:, -1] - observation.tracker_position_m[:, 0]).norm(dim=2)
        says = (heard.sum(dim=1) >= FEWEST_SAMPLES) & (flown_m >= FLOWN_M)
        stays = lowest_dbm == highest_dbm
        same = stays & (lowest_dbm == self.level_dbm)
        level_dbm = torch.where(says, torch.where(stays, lowest_dbm, torch.nan), self.level_dbm)
        intervals = torch.where(same, self.intervals + 1, stays.long())
        return ReceiverLevels(level_dbm, torch.where(says, intervals, self.intervals))
