"""What a controller gets to see."""

import math
from dataclasses import dataclass

import torch

from .batch.array_types import Float, Tensor
from .errors import InputError

NEPERS_PER_DB = math.log(10) / 10
"""Of power: its natural logarithm over its level in dB."""


@dataclass(frozen=True)
class Observation:
    """One window of every chase in a batch.

    Raises:
        InputError: shapes that do not belong together.
    """

    rssi_dbm: Float[Tensor, "chase sample tracker"]
    """S_t, Eq. (6); a missing sample is NaN."""
    tracker_position_m: Float[Tensor, "chase sample tracker 3"]
    """Where each sample was taken, in the chase's own frame (origin: the centre's start)."""

    def __post_init__(self) -> None:
        if self.rssi_dbm.ndim != 3 or self.tracker_position_m.shape != (*self.rssi_dbm.shape, 3):
            raise InputError(
                f"rssi_dbm {tuple(self.rssi_dbm.shape)} must be [chase, sample, tracker] and tracker_position_m "
                f"{tuple(self.tracker_position_m.shape)} the same with three coordinates"
            )


def mean_power_dbm(rssi_dbm: Float[Tensor, "chase sample tracker"]) -> Float[Tensor, "chase tracker"]:
    """The mean power of each tracker's valid samples, averaged in milliwatts; NaN where a tracker has none.

    Of all simple statistics of a window it says most about the distance: the mean of its dB values is spoilt by a
    few deep fades.
    """
    # One layout in memory, and exp in the place of a power of ten: else the last bits would depend on the batch.
    rssi_dbm = rssi_dbm.float().transpose(1, 2).contiguous()
    valid = rssi_dbm.isfinite()
    # Relative to the strongest sample: ten to the power of a level below -380 dBm would be no float32.
    strongest_dbm = torch.where(valid, rssi_dbm, -torch.inf).amax(dim=2)
    relative = torch.where(valid, ((rssi_dbm - strongest_dbm[..., None]) * NEPERS_PER_DB).exp(), 0.0)
    return strongest_dbm + 10 * torch.log10(relative.sum(dim=2) / valid.sum(dim=2))


def mean_position_m(observation: Observation) -> Float[Tensor, "chase tracker 3"]:
    """Where each tracker was in the window, averaged over its samples, float64."""
    return observation.tracker_position_m.double().contiguous().mean(dim=1)


def center_m(observation: Observation) -> Float[Tensor, "chase 3"]:
    """The centre of the swarm at the end of the window, float64."""
    return observation.tracker_position_m[:, -1].double().mean(dim=1)
