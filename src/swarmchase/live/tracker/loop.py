"""The loop around the tracker agent."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from ...processes.stop_request import StopRequest
from ..link.mavlink import TrackerMavlinkLink
from ..link.messages import Metres, TrackerMode
from ..ticker import Ticker
from .agent import TrackerAgent
from .sources import RssiSource
from .vehicles import Vehicle

STEPS_HZ = 50.0

_DOES = {
    TrackerMode.HOLDING: "holds",
    TrackerMode.FOLLOWING: "flies",
    TrackerMode.MANUAL: "is flown by somebody else, or cannot be commanded",
}


@dataclass(frozen=True)
class TrackerSummary:
    """What a tracker did."""

    tracker: int
    mode: str
    position_m: Metres | None
    """Where it was at the end."""
    seconds: float
    ignored: dict[str, int]
    """What the agent heard and did not obey, by reason."""
    rejected: dict[str, int]
    """Datagrams that the link dropped, by reason."""
    source_rejected: dict[str, int]
    """Records that were no samples, by reason."""


def run_tracker(
    tracker: int,
    agent: TrackerAgent,
    source: RssiSource,
    vehicle: Vehicle,
    link: TrackerMavlinkLink,
    request: StopRequest,
    tell: Callable[[str], None],
) -> TrackerSummary:
    """Step until the request is made; then, and whatever happens, the vehicle is told to hold.

    ``tell`` is given a line when the vehicle's mode changes, and when the source fails.
    """
    began_s = time.monotonic()
    ticker = Ticker(STEPS_HZ)
    mode: TrackerMode | None = None
    has_told_failure = False
    try:
        while not request.made:
            agent.step()
            if agent.source_failure is not None and not has_told_failure:
                has_told_failure = True
                tell(f"tracker {tracker} hears nothing any more, and flies on: {agent.source_failure}")
            if vehicle.mode is not mode:
                mode = vehicle.mode
                tell(f"tracker {tracker} {_DOES[mode]}, at {_shown(vehicle.position_m)}")
            ticker.wait()
    finally:
        agent.close()
    return TrackerSummary(
        tracker=tracker,
        mode=vehicle.mode.name.lower(),
        position_m=vehicle.position_m,
        seconds=round(time.monotonic() - began_s, 3),
        ignored=_counts(agent.ignored),
        rejected=_counts(link.rejected),
        # Not every source can be given something to reject.
        source_rejected=_counts(getattr(source, "rejected", {})),
    )


def _shown(position_m: Metres | None) -> str:
    return "an unknown place" if position_m is None else "({:.2f}, {:.2f}, {:.2f}) m".format(*position_m)


def _counts(counter: dict[str, int]) -> dict[str, int]:
    return {str(reason): count for reason, count in sorted(counter.items())}
