"""The loop around the tracker agent."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from ...processes.stop_request import StopRequest
from ..link.mavlink import TrackerMavlinkLink
from ..link.messages import Metres, TrackerMode
from ..link.news import LinkNews
from ..ticker import Ticker
from .agent import TrackerAgent
from .sources import RssiSource
from .vehicles import Vehicle

STEPS_HZ = 50.0
COMPLAIN_AGAIN_S = 60.0
"""A receiver that stays without a level is told of so often."""

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
    levels: int
    """That it has taken up from its receiver."""
    ignored: dict[str, int]
    """What the agent heard and did not obey, by reason."""
    rejected: dict[str, int]
    """Datagrams that the link dropped, by reason."""
    rejected_skew_s: dict[str, dict[str, float]]
    """Where the reason was their time, by reason and sender: see ``RejectedError``, of the newest."""
    source_rejected: dict[str, int]
    """Records that were no samples, by reason."""
    dropped: dict[str, int]
    """Samples that were no levels, or too old or too new, by reason."""


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

    ``tell`` is given a line when the vehicle's mode changes, when the source fails or yields no level, with what it
    saw instead, when it hears again, and of what the link drops.
    """
    began_s = time.monotonic()
    ticker = Ticker(STEPS_HZ)
    mode: TrackerMode | None = None
    complaints = _Complaints(tracker, agent, tell)
    link_news = LinkNews(link)
    try:
        while not request.made:
            agent.step()
            complaints.look(time.monotonic())
            if vehicle.mode is not mode:
                mode = vehicle.mode
                tell(f"tracker {tracker} {_DOES[mode]}, at {_shown(vehicle.position_m)}")
            for line in link_news.lines():
                tell(f"tracker {tracker} {line}")
            ticker.wait()
    finally:
        agent.close()
    return TrackerSummary(
        tracker=tracker,
        mode=vehicle.mode.name.lower(),
        position_m=vehicle.position_m,
        seconds=round(time.monotonic() - began_s, 3),
        levels=agent.levels,
        ignored=_counts(agent.ignored),
        rejected=_counts(link.rejected),
        rejected_skew_s=link.rejections.skew_s(),
        source_rejected=_counts(source.rejected),
        dropped=_counts(agent.dropped),
    )


class _Complaints:
    """Tells of a receiver from which no level comes: at once, again after a pause, and when it is over."""

    def __init__(self, tracker: int, agent: TrackerAgent, tell: Callable[[str], None]) -> None:
        self._tracker, self._agent, self._tell = tracker, agent, tell
        self._told_s: float | None = None

    def look(self, now_s: float) -> None:
        complaint = self._agent.source_complaint
        if complaint is None:
            if self._told_s is not None:
                self._tell(f"tracker {self._tracker} hears again")
            self._told_s = None
        elif self._told_s is None or (self._agent.source_failure is None and now_s - self._told_s >= COMPLAIN_AGAIN_S):
            self._told_s = now_s
            self._tell(f"tracker {self._tracker} hears nothing, and flies on: {complaint}")


def _shown(position_m: Metres | None) -> str:
    return "an unknown place" if position_m is None else "({:.2f}, {:.2f}, {:.2f}) m".format(*position_m)


def _counts(counter: dict[str, int]) -> dict[str, int]:
    return {str(reason): count for reason, count in sorted(counter.items())}
