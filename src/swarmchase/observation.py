"""What a controller gets to see."""

from dataclasses import dataclass

from .array_types import Float, Tensor
from .errors import InputError


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
