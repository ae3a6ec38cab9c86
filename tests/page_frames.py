"""Chases that the real service, link, agents and vehicles have flown on a made clock, and the frames of them."""

import copy
import functools
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from swarmchase.controllers import ActionChoice, load_controller, weights_sha256
from swarmchase.live.alarms import Alarms
from swarmchase.live.chronicle import Chronicle
from swarmchase.live.events import Event, Events
from swarmchase.live.frame import Frame
from swarmchase.live.link.news import LinkNews
from swarmchase.live.log.entries import LogHead
from swarmchase.live.page.info import page_info
from swarmchase.live.service.chase_state import Decision, Snapshot, Transition
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.live.service.settings import ServiceSettings
from swarmchase.scenario import Scenario, load_scenario, paper_scenario
from swarmchase.simulation.fault_plan import fault_plan
from swarmchase.simulation.site import site_limits
from swarmchase.simulation.virtual_chase import START_NS, VirtualChase

TROUBLE = "frozen=3@12-20,frozen=4@12-20,frozen=5@12-20,silent=2@5-22,forge=60"
"""Three trackers get lost at a time, one receiver falls silent, and somebody forges datagrams."""
NARROW = SafetyLimits(
    fence_west_m=-12.0,
    fence_east_m=12.0,
    fence_south_m=-12.0,
    fence_north_m=12.0,
    lowest_altitude_m=-12.0,
    highest_altitude_m=12.0,
)
"""Wherever the target is, 25 m from the start, it is outside."""


SCENARIO = paper_scenario(sampling_hz=100, spatial_correlation=0.5, start_distance_m=25.0)


FLIGHT = Scenario.from_dict(
    load_scenario("flight").to_dict()
    | {
        "behaviour": "straight",
        "target_speed_mps": 3.0,
        "start_distance_m": 15.0,
        "farthest_start_m": 20.0,
        "follow_s": 1.0,
    }
)


def head_for(controller: str, limits: SafetyLimits, scenario: Scenario = SCENARIO) -> LogHead:
    """Of chase 0 of seed 3."""
    weights = weights_sha256(controller, scenario)
    began = datetime(2033, 5, 18, tzinfo=UTC)
    return LogHead("0.3.0", controller, weights, scenario, 3, 0, 1, limits, began, START_NS)


class ShownChase:
    """A virtual chase with its events and its frames, as ``Audience`` puts them together."""

    def __init__(
        self,
        take: Callable[[Frame], None],
        controller: str = "particle",
        faults: str = "",
        limits: SafetyLimits | None = None,
        starts: bool = True,
        action_choice: ActionChoice | None = None,
        scenario: Scenario = SCENARIO,
        settings: ServiceSettings | None = None,
    ) -> None:
        limits = limits or SafetyLimits()
        self.amend: Callable[[Snapshot], Snapshot] = lambda snapshot: snapshot
        """What stands in for a part of the service that this test is not about."""
        self.entries: list[Transition | Decision | Event] = []
        chase = self.chase = VirtualChase(
            scenario,
            load_controller(controller, scenario, action_choice),
            3,
            0,
            fault_plan(faults),
            limits=limits,
            settings=settings,
            starts=False,
        )
        self.head = head_for(controller, limits, scenario)
        link_news = LinkNews(chase.link, lambda: chase.clock.now_ns() / 1e9)
        self.events = Events(Alarms(chase.link), [self.entries.append], link_news.lines)
        self._chronicle = Chronicle(chase.link, START_NS, [take], self.events, lambda: chase.site.radio.target_m)
        chase._recorder = self._record
        chase._watch = lambda _snapshot: self._watch()
        if starts:
            chase.service.start()

    def say(self, word: str) -> None:
        """The operator's word, as the loop obeys it."""
        service = self.chase.service
        {"reached": service.declare_reached}.get(word, getattr(service, word, None))()  # type: ignore[misc]

    def seconds(self) -> float:
        """Of the made clock."""
        return (self.chase.clock.now_ns() - START_NS) / 1e9

    def _record(self, entry: Transition | Decision) -> None:
        self.entries.append(entry)
        self.events.record(entry)

    def _watch(self) -> None:
        self.chase.service.explain()
        snapshot = self.amend(self.chase.service.snapshot())
        self.events(snapshot)
        latencies_s = self.chase._latency_s
        self._chronicle(snapshot, latencies_s[-1] if latencies_s else None)


@dataclass(frozen=True)
class RecordedChase:
    """What a page is shown of one."""

    head: LogHead
    frames: list[Frame]
    entries: list[Transition | Decision | Event]

    @property
    def info(self) -> dict[str, Any]:
        """What the page knows besides."""
        return page_info(self.head) | {"duration_s": self.frames[-1]["time_s"]}

    def at(self, time_s: float) -> Frame:
        """The frame next to this time."""
        return min(self.frames, key=lambda frame: abs(frame["time_s"] - time_s))


def recorded(
    seconds: float, words: dict[float, str] | None = None, with_target: bool = True, **options: Any
) -> RecordedChase:
    """A chase for so long, in which the operator says these words at these times."""
    frames: list[Frame] = []
    shown = ShownChase(frames.append, **options)
    waiting = dict(words or {})
    while shown.seconds() < seconds:
        for at_s in [at_s for at_s in waiting if at_s <= shown.seconds()]:
            shown.say(waiting.pop(at_s))
        shown.chase.tick()
    if not with_target:
        for frame in frames:
            frame["target_m"] = None
    return RecordedChase(shown.head, frames, shown.entries)


@functools.cache
def ordinary_chase() -> RecordedChase:
    """Nothing goes wrong, and the target is reached after 24 s."""
    return recorded(27.0)


@functools.cache
def troubled_chase() -> RecordedChase:
    """Everything goes wrong, the target is outside the fence, and the operator aborts."""
    return recorded(27.0, {26.0: "abort"}, faults=TROUBLE, limits=NARROW)


@functools.cache
def misheard_chase() -> RecordedChase:
    """Tracker 3 hears 20 dB too much, and ``adaptive`` finds out."""
    return recorded(4.0, with_target=False, controller="adaptive", faults="wrong=3@0")


@functools.cache
def flown_chase() -> RecordedChase:
    """A target that flies past is heard in flight, one receiver falls silent, and the target is reached after 7 s and
    followed for a second.
    """
    settings = ServiceSettings(follow=True)
    return recorded(9.0, scenario=FLIGHT, limits=site_limits(FLIGHT), settings=settings, faults="silent=2@1-3")


@functools.cache
def wordless_chase(controller: str, action_choice: ActionChoice | None = None) -> RecordedChase:
    """The first decisions of a controller that has no belief, with real trackers."""
    return recorded(12.0, with_target=False, controller=controller, action_choice=action_choice)


@functools.cache
def _first_seconds() -> RecordedChase:
    return recorded(3.0)


def frame_at(time_s: float) -> Frame:
    """A frame of a real chase, dated otherwise."""
    frame = copy.deepcopy(_first_seconds().at(time_s))
    frame["time_s"] = round(time_s, 3)
    return frame
