"""Where the swarm's centre and the target were in the course of a chase, from its log of either format."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class FlightPaths:
    """Places at some moments of a chase, the first at its beginning. Metres east, north and up of the swarm's start."""

    clock: NDArray[np.float64]
    """[moment]: seconds since the chase began, or movements made where these are what it is measured by."""
    clock_label: str
    center_m: NDArray[np.float64]
    """[moment, 3]"""
    target_m: NDArray[np.float64]
    """[moment, 3]"""

    def __len__(self) -> int:
        return len(self.clock)

    @property
    def from_above_m(self) -> NDArray[np.float64]:
        """[place, 2]: all places of both."""
        return np.concatenate([self.center_m, self.target_m])[:, :2]

    @property
    def distance_m(self) -> NDArray[np.float64]:
        """[moment], between the two."""
        return np.asarray(np.linalg.norm(self.center_m - self.target_m, axis=1), dtype=np.float64)


def is_told_in_seconds(log: dict[str, Any]) -> bool:
    """Whether this chase is measured by the clock; those of the first format, without a number, are by movements."""
    return bool(log.get("format", 1) > 1)


def flight_paths(log: dict[str, Any]) -> FlightPaths:
    """Of the chase of this log."""
    moments, start_m = log["moments"], log["target_position_m"]
    center_m = np.array([moment["center_m"] for moment in moments])
    if not is_told_in_seconds(log):
        movements = np.array([moment["movement"] for moment in moments], dtype=np.float64)
        return FlightPaths(movements, "movement", center_m, np.tile(start_m, (len(moments), 1)))
    # The first moment is that of the first decision: by then the target may have flown.
    return FlightPaths(
        np.array([0.0, *(moment["time_s"] for moment in moments)]),
        "time (s)",
        np.vstack([np.zeros(3), center_m]),
        np.array([start_m, *(moment["target_position_m"] for moment in moments)]),
    )
