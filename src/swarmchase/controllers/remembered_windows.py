"""The windows that a chase remembers: their levels, where they were heard, and what the network has read in them.

When there is no room for another, the one goes that was heard nearest to where another was: what it says of the target,
the other says too. A receiver that gives one value whatever happens, while others do not, is stuck and says nothing.
"""

import math
from dataclasses import dataclass

import torch

from ..batch.array_types import Bool, Float, Int, Tensor
from ..networks.windows import HeardWindows, WindowsLaw, WindowsNetwork
from ..observation import Observation, mean_position_m, mean_power_dbm
from ..scenario import NUM_TRACKERS

MOST_WINDOWS = 40
"""A chase of the paper's ends before; each costs time at every decision."""
STUCK_WINDOWS = 3
"""So many in a row with one and the same value, and a receiver is stuck."""
FEWEST_SAMPLES = 10
"""Of a window in which one value is suspicious."""
SAME_DB = 0.01


@dataclass(frozen=True)
class RememberedWindows:
    """Of each chase, the oldest first; windows from ``number`` on are empty."""

    number: Int[Tensor, "chase"]
    heard: Int[Tensor, "chase"]
    """Windows altogether, also those that went."""
    level_dbm: Float[Tensor, "chase window 6"]
    """Mean power; NaN where a tracker heard nothing."""
    tracker_position_m: Float[Tensor, "chase window 6 3"]
    is_flat: Bool[Tensor, "chase window 6"]
    """Whether all samples were the same."""
    own: Float[Tensor, "chase window 6 head"]
    """``HeardWindows.own``."""
    together: Float[Tensor, "chase window feature"]
    """``HeardWindows.together``."""


@dataclass(frozen=True)
class ReadWindows:
    """All windows of one chase, read in the light of each other."""

    level_dbm: Float[Tensor, "window 6"]
    """Mean power; NaN where a tracker heard nothing or is stuck."""
    tracker_position_m: Float[Tensor, "window 6 3"]
    law: WindowsLaw
    """Of the fading in them."""
    is_stuck: Bool[Tensor, "6"]
    """Receivers that are stuck now."""
    heard: int
    """Windows altogether, also those that are no longer remembered."""


def no_windows(network: WindowsNetwork, num_chases: int) -> RememberedWindows:
    """Before the first."""
    size = (num_chases, MOST_WINDOWS)
    return RememberedWindows(
        number=torch.zeros(num_chases, dtype=torch.int64),
        heard=torch.zeros(num_chases, dtype=torch.int64),
        level_dbm=torch.full((*size, NUM_TRACKERS), math.nan),
        tracker_position_m=torch.zeros(*size, NUM_TRACKERS, 3),
        is_flat=torch.zeros(*size, NUM_TRACKERS, dtype=torch.bool),
        own=torch.zeros(*size, NUM_TRACKERS, network.own_features),
        together=torch.zeros(*size, network.window_features),
    )


def remembered(windows: RememberedWindows, observation: Observation, network: WindowsNetwork) -> RememberedWindows:
    """With those of an observation; one in which nobody heard anything leaves no trace."""
    level_dbm = mean_power_dbm(observation.rssi_dbm)
    position_m = mean_position_m(observation).float()
    is_flat = _is_flat(observation.rssi_dbm)
    number, is_heard = windows.number.clone(), level_dbm.isfinite().any(dim=1)
    parts = [
        part.clone()
        for part in (windows.level_dbm, windows.tracker_position_m, windows.is_flat, windows.own, windows.together)
    ]
    for row in is_heard.nonzero()[:, 0].tolist():
        if number[row] == MOST_WINDOWS:
            gone = _least_missed(parts[1][row])
            for part in parts:
                part[row, gone:-1] = part[row, gone + 1 :].clone()
            number[row] -= 1
        # Window by window: what the network says of one is not to depend on the others of the batch.
        read = network.heard(observation.rssi_dbm[row : row + 1])
        new = (level_dbm[row], position_m[row], is_flat[row], read.own[0], read.together[0])
        for part, value in zip(parts, new, strict=True):
            part[row, number[row]] = value
        number[row] += 1
    return RememberedWindows(number, windows.heard + is_heard, *parts)


def read_windows(windows: RememberedWindows, row: int, network: WindowsNetwork) -> ReadWindows:
    """Those of one chase, which must have one at least."""
    number = int(windows.number[row])
    level_dbm = windows.level_dbm[row, :number]
    is_stuck = _is_stuck(level_dbm, windows.is_flat[row, :number])
    hangs = is_stuck & windows.is_flat[row, :number] & ((level_dbm - level_dbm[-1]).abs() < SAME_DB)
    all_of_it = HeardWindows(windows.own[row : row + 1, :number], windows.together[row : row + 1, :number])
    law = network.law(all_of_it, torch.ones(1, number, dtype=torch.bool))
    return ReadWindows(
        level_dbm=level_dbm.masked_fill(hangs, math.nan),
        tracker_position_m=windows.tracker_position_m[row, :number],
        law=WindowsLaw(law.mean_db[0], law.apart_db[0], law.together_db[0]),
        is_stuck=is_stuck,
        heard=int(windows.heard[row]),
    )


def _is_flat(rssi_dbm: Float[Tensor, "chase sample 6"]) -> Bool[Tensor, "chase 6"]:
    valid = rssi_dbm.isfinite()
    highest_dbm = torch.where(valid, rssi_dbm, -math.inf).amax(dim=1)
    lowest_dbm = torch.where(valid, rssi_dbm, math.inf).amin(dim=1)
    return (valid.sum(dim=1) >= FEWEST_SAMPLES) & (highest_dbm == lowest_dbm)


def _is_stuck(level_dbm: Float[Tensor, "window 6"], is_flat: Bool[Tensor, "window 6"]) -> Bool[Tensor, "6"]:
    last_dbm = level_dbm[-STUCK_WINDOWS:]
    same = is_flat[-STUCK_WINDOWS:].all(dim=0) & ((last_dbm - last_dbm[0]).abs() < SAME_DB).all(dim=0)
    if len(last_dbm) < STUCK_WINDOWS or same.sum() > NUM_TRACKERS // 2:
        return torch.zeros_like(same)  # where most are flat, it is the channel
    return same


def _least_missed(tracker_position_m: Float[Tensor, "window 6 3"]) -> int:
    """The window that was heard nearest to where another was; the older of the two."""
    center_m = tracker_position_m.mean(dim=1)
    apart_m = torch.cdist(center_m, center_m).fill_diagonal_(math.inf)
    return int(apart_m.amin(dim=1).argmin())
