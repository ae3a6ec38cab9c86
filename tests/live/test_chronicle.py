"""What people are told of a chase: lines about trackers, and frames for a page or a log."""

import dataclasses
import json
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")


from swarmchase.live.alarms import Alarm, Alarms
from swarmchase.live.chronicle import Chronicle
from swarmchase.live.events import Event, Events
from swarmchase.live.frame import Frame
from swarmchase.live.link.mavlink import ControllerMavlinkLink
from swarmchase.live.link.messages import Metres, TrackerMode
from swarmchase.live.link.rejection import Reason, RejectedError
from swarmchase.live.service.chase_state import ChaseState, Snapshot, TrackerSnapshot

BEGAN_NS = 7 * 10**12
THERE = TrackerSnapshot(
    position_m=(1.0, 2.0, 3.0),
    set_point_m=(1.0, 2.0, 3.5),
    mode=TrackerMode.FOLLOWING,
    position_age_s=0.1,
    rssi_age_s=0.05,
    is_lost=False,
    is_silent=False,
    missing_share=0.0,
    rssi_dbm=(-60.0, -61.0),
    dropped={},
)
NOWHERE = dataclasses.replace(
    THERE, position_m=None, set_point_m=None, mode=None, is_lost=True, is_silent=True, missing_share=1.0
)
SNAPSHOT = Snapshot(
    time_ns=BEGAN_NS,
    epoch=1,
    state=ChaseState.SAMPLING,
    reason="arrived",
    movements=0,
    origin_m=(0.0, 0.0, 0.0),
    center_m=(0.0, 0.0, 0.0),
    spacing_m=5.0,
    trackers=(THERE,) * 6,
    last_decision=None,
    explanation=None,
    window_since_ns=None,
    recorder_failures=0,
)


# Lines


@pytest.fixture
def link() -> Iterator[ControllerMavlinkLink]:
    link = ControllerMavlinkLink("127.0.0.1", 0, unsigned=True)
    yield link
    link.close()


def news_of(link: ControllerMavlinkLink, *trackers: tuple[TrackerSnapshot, ...]) -> list[str]:
    """What is told of these, one moment after the other, before the start."""
    told: list[Event] = []
    events = Events(Alarms(link), [told.append])
    for one in trackers:
        events(dataclasses.replace(SNAPSHOT, state=ChaseState.IDLE, trackers=one))
    return [event.text for event in told]


@pytest.mark.parametrize(
    ("conditions", "told"),
    [
        ([{"position_m": None, "is_lost": True, "is_silent": True}] * 3, []),  # who has never been there is no news
        ([{}, {}, {}], ["tracker 2 is there"]),
        ([{}, {"is_silent": True}, {}], ["tracker 2 is there", "tracker 2 is silent", "tracker 2 is there"]),
        ([{}, {"is_lost": True}, {"is_lost": True}], ["tracker 2 is there", "tracker 2 is lost"]),
        (
            [{}, {"mode": TrackerMode.MANUAL, "is_silent": True}, {"mode": TrackerMode.HOLDING}],
            ["tracker 2 is there", "tracker 2 is flown by somebody else, or cannot be commanded", "tracker 2 is there"],
        ),
        (
            [{"is_silent": True}, {"is_lost": True, "mode": TrackerMode.MANUAL}],
            ["tracker 2 is silent", "tracker 2 is lost"],
        ),
        ([{"mode": TrackerMode.HOLDING}, {"mode": TrackerMode.FOLLOWING}], ["tracker 2 is there"]),
    ],
)
def test_what_has_changed_with_a_tracker_is_told_once(
    conditions: list[dict[str, Any]], told: list[str], link: ControllerMavlinkLink
) -> None:
    """Of tracker 2, who is there at first but for these changes, one after the other."""
    moments = [(*[NOWHERE] * 2, dataclasses.replace(THERE, **one), *[NOWHERE] * 3) for one in conditions]
    assert news_of(link, *moments) == told


def test_each_tracker_has_its_own_news(link: ControllerMavlinkLink) -> None:
    first = (THERE, NOWHERE, THERE, NOWHERE, NOWHERE, NOWHERE)
    told = news_of(link, first, (THERE,) * 5 + (NOWHERE,))
    assert told == [f"tracker {number} is there" for number in (0, 2, 1, 3, 4)]


# Frames


class Shown:
    """A chronicle of steps every .05 s, and the frames that it has given out."""

    def __init__(self, link: ControllerMavlinkLink) -> None:
        self.frames: list[Frame] = []
        self.alarms: list[Alarm] = []
        self.target_m: Metres | None = None
        self._steps = 0
        self._events = Events(Alarms(link, lambda: self.alarms))
        self._chronicle = Chronicle(link, BEGAN_NS, [self.frames.append], self._events, target_m=lambda: self.target_m)

    def step(self, latency_s: float | None = None, **changes: Any) -> int:
        """How many frames that gives."""
        before = len(self.frames)
        self._steps += 1
        time_ns = BEGAN_NS + self._steps * 50_000_000
        snapshot = dataclasses.replace(SNAPSHOT, **{"time_ns": time_ns, **changes})
        self._events(snapshot)
        self._chronicle(snapshot, latency_s)
        return len(self.frames) - before


def test_ten_frames_a_second_of_twenty_steps(link: ControllerMavlinkLink) -> None:
    shown = Shown(link)
    assert [shown.step() for _ in range(12)] == [1, 0] * 6
    assert [frame["time_s"] for frame in shown.frames] == [0.05, 0.15, 0.25, 0.35, 0.45, 0.55]


def test_a_change_of_state_is_shown_at_once_and_once(link: ControllerMavlinkLink) -> None:
    shown = Shown(link)
    moving = {"state": ChaseState.MOVING}
    assert [shown.step() for _ in range(5)] == [1, 0, 1, 0, 1]
    # At .3 s, between two frames; from then on every tenth of a second again.
    assert [shown.step(**moving) for _ in range(5)] == [1, 0, 1, 0, 1]
    assert [frame["state"] for frame in shown.frames] == ["sampling"] * 3 + ["moving"] * 3


def test_after_a_pause_nothing_is_made_up_for(link: ControllerMavlinkLink) -> None:
    shown = Shown(link)
    shown.step()
    late_ns = BEGAN_NS + 60 * 10**9
    # At .02 s that of 59.95 s, then those of .05 and .15 s.
    assert [shown.step(time_ns=late_ns + ms * 10**6) for ms in (20, 40, 60, 90, 150)] == [1, 0, 1, 0, 1]


def test_the_path_has_one_place_a_movement(link: ControllerMavlinkLink) -> None:
    """Also of those between two frames; a formation that is put right during a movement is no new place."""
    shown = Shown(link)
    shown.step(center_m=None, spacing_m=None)
    shown.step(center_m=(0.0, 0.0, 1.0))
    shown.step(movements=1, center_m=(4.0, 0.0, 1.0))
    shown.step(movements=2, center_m=(8.0, 0.0004, 1.0))
    shown.step(movements=2, center_m=(7.0, 0.0, 1.0))
    shown.step(movements=2, center_m=(7.0, 0.0, 1.0))
    assert shown.frames[0]["path_m"] == []
    assert shown.frames[-1]["path_m"] == [[0, 0, 1], [4, 0, 1], [8, 0, 1]]


def test_frames_are_not_changed_by_what_comes_later(link: ControllerMavlinkLink) -> None:
    shown = Shown(link)
    shown.step()
    kept = json.dumps(shown.frames[0])
    for number in range(1, 5):
        shown.alarms.append(Alarm(f"late {number}", "late"))
        shown.step(movements=number)
    assert json.dumps(shown.frames[0]) == kept


def test_the_last_decision_s_latency_stays_until_the_next(link: ControllerMavlinkLink) -> None:
    shown = Shown(link)
    for latency_s in (None, 0.012, None, None, None, 0.0345, None):
        shown.step(latency_s)
    assert [frame["decision_latency_ms"] for frame in shown.frames] == [None, 12, 12, 34.5]


def test_alarms_rejections_and_the_target_are_those_of_the_moment(link: ControllerMavlinkLink) -> None:
    shown = Shown(link)
    shown.step()
    shown.alarms, shown.target_m = [Alarm("log", "the log has lost 3 frames")], (1.0, 2.00049, -3.0)
    for reason in [Reason.WRONG_KEY] * 3 + [Reason.GIANT]:
        link.rejections.add(RejectedError(reason))
    shown.step()
    shown.step(recorder_failures=2)
    first, last = shown.frames
    assert (first["alarms"], first["rejected"], first["target_m"]) == ([], {}, None)
    assert [alarm["text"] for alarm in last["alarms"]] == [
        "datagrams are rejected: wrong key 3.0/s, giant 1.0/s",
        "the log has lost 3 frames",
        "2 entries could not be recorded",
    ]
    assert list(last["rejected"].items()) == [("giant", 1), ("wrong key", 3)]
    assert last["target_m"] == [1, 2, -3]
    assert last["trackers"][0]["loss_share"] is None
