"""How the operator wants a chase run, apart from the safety limits."""

from dataclasses import dataclass

from ...ranges import AT_LEAST_ZERO, POSITIVE, Range, ranged, require_ranges
from ...scenario import NUM_TRACKERS


@dataclass(frozen=True)
class OperatorSettings:
    """Those that commands offer as options."""

    minimum_trackers: int = ranged(4, Range(1, NUM_TRACKERS))
    """With fewer that are heard and can be commanded, the service holds."""
    reached_windows: int = ranged(2, AT_LEAST_ZERO)
    """Windows of strong signals by which the target counts as reached; 0: only the word reached counts."""
    follow: bool = False
    """In flight, stay with a target that is reached, and look for it where it is lost, until told to end."""
    arrival_tolerance_m: float = ranged(0.3, POSITIVE)
    """A tracker this near to its place has arrived. By satellites alone, without RTK, it wants 1 m and more."""


@dataclass(frozen=True)
class ServiceSettings(OperatorSettings):
    """How the service runs a chase.

    Raises:
        InputError: a number of trackers or windows, a length or a time that cannot be.
    """

    connect_wait_s: float = ranged(2.0, AT_LEAST_ZERO)
    """With enough trackers it waits so long for the others before it begins."""
    settle_s: float = ranged(0.8, AT_LEAST_ZERO)
    """Then it brakes and swings for a moment: samples count from so long after its arrival."""
    move_allowance_s: float = ranged(5.0, AT_LEAST_ZERO)
    """A movement may take twice its shortest time and this."""
    sampling_allowance_s: float = ranged(2.0, AT_LEAST_ZERO)
    """A window may take this much longer than its samples, from the first valid one on; what has not come by then is
    missing."""
    retry_s: float = ranged(1.0, AT_LEAST_ZERO)
    """After the controller's failure it holds for so long."""

    def __post_init__(self) -> None:
        require_ranges(self)
