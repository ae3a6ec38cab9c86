"""How the operator wants a chase run, apart from the safety limits."""

import math
from dataclasses import dataclass

from ...errors import InputError
from ...scenario import NUM_TRACKERS


@dataclass(frozen=True)
class OperatorSettings:
    """Those that commands offer as options."""

    minimum_trackers: int = 4
    """With fewer that are heard and can be commanded, the service holds."""
    reached_windows: int = 2
    """Windows of strong signals by which the target counts as reached; 0: only the word reached counts."""


@dataclass(frozen=True)
class ServiceSettings(OperatorSettings):
    """How the service runs a chase.

    Raises:
        InputError: a number of trackers or windows, a length or a time that cannot be.
    """

    connect_wait_s: float = 2.0
    """With enough trackers it waits so long for the others before it begins."""
    arrival_tolerance_m: float = 0.3
    """A tracker this near to its place has arrived."""
    settle_s: float = 0.8
    """Then it brakes and swings for a moment: samples count from so long after its arrival."""
    move_allowance_s: float = 5.0
    """A movement may take twice its shortest time and this."""
    sampling_allowance_s: float = 2.0
    """A window may take this much longer than its samples, from the first valid one on; what has not come by then is
    missing."""
    retry_s: float = 1.0
    """After the controller's failure it holds for so long."""

    def __post_init__(self) -> None:
        if not 1 <= self.minimum_trackers <= NUM_TRACKERS:
            raise InputError(f"minimum_trackers = {self.minimum_trackers} is refused: allowed is 1 to {NUM_TRACKERS}")
        if self.reached_windows < 0:
            raise InputError(f"reached_windows = {self.reached_windows} is refused: allowed is 0 or more")
        if not 0 < self.arrival_tolerance_m < math.inf:
            raise InputError(f"arrival_tolerance_m = {self.arrival_tolerance_m} is refused: allowed is above 0")
        for name in ("connect_wait_s", "settle_s", "move_allowance_s", "sampling_allowance_s", "retry_s"):
            if not 0 <= getattr(self, name) < math.inf:
                raise InputError(f"{name} = {getattr(self, name)} is refused: allowed is 0 or more")
