"""What is wrong with a chase, and what has happened in it: the same for terminal, page and log."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")
pytest.importorskip("mcap", reason="the log needs mcap: pip install 'swarmchase[live]'")

from live_bench import Bench
from page_frames import ShownChase, misheard_chase, ordinary_chase, recorded, troubled_chase
from swarmchase.controllers.condition import Condition
from swarmchase.live.alarms import Alarms, Severity
from swarmchase.live.audience import Audience, AudienceOptions
from swarmchase.live.estimate import estimate_of
from swarmchase.live.events import Event, Events
from swarmchase.live.link.mavlink import ControllerMavlinkLink
from swarmchase.live.log.recording import read_recording
from swarmchase.live.service.chase_state import ChaseState
from swarmchase.scenario import load_scenario
from swarmchase.simulation.site import site_limits
from swarmchase.simulation.virtual_chase import START_NS, TICK_S


def alarms_at(time_s: float) -> dict[str, str]:
    """Of the troubled chase: text and severity."""
    return {alarm["text"]: alarm["severity"] for alarm in troubled_chase().at(time_s)["alarms"]}


def test_a_chase_in_which_nothing_goes_wrong_has_no_alarm() -> None:
    frames = ordinary_chase().frames
    assert [alarm for frame in frames for alarm in frame["alarms"]] == []
    assert {event["severity"] for event in frames[-1]["events"]} == {"info", "success"}
    assert frames[-1]["ended_s"] == 24.15


def test_all_that_the_service_knows_is_an_alarm_while_it_lasts() -> None:
    now = alarms_at(14.0)
    assert list(now)[:4] == ["all hold: 2 trackers are too few", *(f"tracker {one} is lost" for one in (3, 4, 5))]
    assert list(now.values())[:4] == ["critical"] * 4
    assert now["tracker 2 is silent"] == "warning"
    rejected = next(text for text in now if text.startswith("datagrams are rejected"))
    assert 40 < sum(float(rate) for rate in re.findall(r"([\d.]+)/s", rejected)) < 80  # 60 a second are forged
    clipped = r"the safety filter changed movement \d+: centre moved by \S+ m to keep the fence( and the .* altitude)?"
    assert any(re.fullmatch(clipped, text) for text in now)
    assert {"tracker 3 is lost", "all hold: 2 trackers are too few"}.isdisjoint(alarms_at(21.0))
    assert "tracker 2 is silent" not in alarms_at(24.0)


@pytest.mark.parametrize("name", ["flight", "field"])
def test_trackers_that_have_just_come_are_not_silent_before_their_first_sample(name: str) -> None:
    """Everybody says where it is before it has heard anything; in the field one hears nothing for most of a second."""
    frames, scenario = list[Any](), load_scenario(name)
    shown = ShownChase(frames.append, controller="particle", scenario=scenario, limits=site_limits(scenario))
    while shown.seconds() < 1.5:
        shown.chase.tick()
    assert shown.chase.service.state is ChaseState.PURSUING
    first = frames[0]["trackers"]
    assert {(one["condition"], one["rssi_age_s"]) for one in first} == {("there", None)}
    assert [alarm for frame in frames for alarm in frame["alarms"]] == []
    assert not [event.text for event in shown.events.newest if "silent" in event.text]


def test_a_tracker_that_never_hears_anything_is_silent_a_second_after_it_came_and_holds_up_the_start() -> None:
    scenario = load_scenario("flight")
    shown = ShownChase(lambda _frame: None, controller="particle", faults="silent=2@0", scenario=scenario)
    while shown.seconds() < 1.5:
        assert shown.chase.service.state is ChaseState.CONNECTING
        shown.chase.tick()
    said = [
        ((event.time_ns - START_NS) / 1e9, event.text) for event in shown.events.newest if "tracker 2" in event.text
    ]
    assert said == [(0.05, "tracker 2 is there"), (pytest.approx(1.05, abs=0.06), "tracker 2 is silent")]
    failed = [(one.tracker, one.name) for one in shown.chase.service.snapshot().preflight if one.passed is False]
    assert failed == [(2, "levels")]
    shown.say("override")
    while shown.chase.service.state is ChaseState.CONNECTING:
        assert shown.seconds() < 3.0
        shown.chase.tick()


def test_events_say_what_begins_changes_and_ends_and_when() -> None:
    events = troubled_chase().frames[-1]["events"]
    told = [(event["text"], event["time_s"]) for event in events]
    order = [
        "idle -> connecting: the operator starts",
        "tracker 2 is silent",
        "sampling -> holding: 2 trackers are too few",
        "tracker 5 is lost",
        "holding -> sampling: the cause of holding is gone",
        "tracker 5 is there",
        "tracker 2 is there",
        "sampling -> aborted: the operator aborts",
    ]
    places = [next(place for place in range(len(told) - 1, -1, -1) if told[place][0] == text) for text in order]
    assert places == sorted(places)
    assert [time_s for _, time_s in told] == sorted(time_s for _, time_s in told)
    assert dict(told)["tracker 5 is lost"] == pytest.approx(13, abs=0.1)  # a second after it froze
    assert len([text for text, _ in told if text.startswith("the safety filter changes what")]) == 1
    assert not [text for text, _ in told if "movement 1" in text]


def test_a_tracker_that_stays_where_it_is_not_to_be_is_named_before_it_is_left_out() -> None:
    chase = recorded(13.0, controller="gradient", faults="stays=2@0")
    alarms = [alarm for frame in chase.frames for alarm in frame["alarms"]]
    assert {(alarm["text"], alarm["severity"], alarm["tracker"]) for alarm in alarms} == {
        (f"tracker 2 has not moved for {seconds} s, and is told to be elsewhere", "warning", 2) for seconds in (10, 11)
    }
    said = [event["text"] for event in chase.frames[-1]["events"] if "move" in event["text"]]
    assert said[-1] == "tracker 2 does not move, and is told to be elsewhere"


def test_rejections_are_told_again_after_a_pause() -> None:
    shown = ShownChase(lambda _frame: None, controller="gradient")
    told = shown.events.newest

    def run_to(seconds: float) -> list[str]:
        while shown.seconds() < seconds:
            shown.chase.tick()
        return [event.text for event in told if "reject" in event.text]

    noise = b"\xfenoise"
    shown.chase.network.controller.put(noise, ("stranger", 1))
    assert run_to(1.0) == ["rejected a datagram: malformed"]
    for _ in range(5):
        shown.chase.network.controller.put(noise, ("stranger", 1))
        run_to(shown.seconds() + 1)
    (alarm,) = shown.events.alarms
    assert alarm.text == "datagrams are rejected: malformed 1.2/s"  # six in five seconds
    once = ["rejected a datagram: malformed", "no datagram has been rejected for 10 s"]
    assert run_to(18.0) == once
    assert shown.events.alarms == []
    shown.chase.network.controller.put(noise, ("stranger", 1))
    assert run_to(19.0) == once
    assert [alarm.text for alarm in shown.events.alarms] == ["datagrams are rejected: malformed 0.1/s"], (
        "one in ten seconds"
    )
    assert run_to(61.0)[2] == "no datagram has been rejected for 10 s"
    assert re.fullmatch(r"rejected 6 more \(0\.1 a second\): malformed", run_to(61.0)[-1])


def test_a_receiver_that_the_controller_does_not_count_is_named_with_the_reason() -> None:
    """A real chase in which tracker 3 hears 20 dB too much; the page and the log have the same lines."""
    chase = misheard_chase()
    text = "the controller leaves out what tracker 3 hears: its receiver is wrong"
    assert any(text in [alarm["text"] for alarm in frame["alarms"]] for frame in chase.frames)
    assert text in [event["text"] for event in chase.frames[-1]["events"]]
    assert not any(f"tracker {number} hears" in str(chase.frames[-1]["events"]) for number in (0, 1, 2, 4, 5))


@pytest.mark.parametrize(
    ("condition", "begins", "ends"),
    [
        (
            Condition.LOST,
            "the controller has begun anew: what was heard contradicted its estimate",
            "the controller has an estimate again",
        ),
        (
            Condition.DEAF,
            "the controller has heard nothing in the last window",
            "the controller hears the target again",
        ),
    ],
)
def test_what_the_controller_says_of_itself_is_told(condition: Condition, begins: str, ends: str) -> None:
    link = ControllerMavlinkLink("127.0.0.1", 0, unsigned=True)
    try:
        bench, told = Bench(), list[Event]()
        events = Events(Alarms(link), [told.append])
        bench.still.condition = condition
        decided = 0
        while decided < 3:
            bench.step()
            decided = len(bench.still.seen)
            events(bench.service.snapshot())
            bench.still.condition = condition if decided == 0 else Condition.TRACKING
            if decided == 1:
                assert [alarm.text for alarm in events.alarms] == [begins]
        assert [event.text for event in told if "controller" in event.text] == [begins, ends]
    finally:
        link.close()


def test_a_tracker_that_has_not_come_is_no_alarm_until_the_others_fly() -> None:
    frames: list[Any] = []
    shown = ShownChase(frames.append, controller="gradient", faults="restart=5@0,restart=4@0", starts=False)
    while shown.seconds() < 1.0:
        shown.chase.tick()
    assert {tracker["condition"] for tracker in frames[-1]["trackers"]} == {"expected", "there"}
    assert frames[-1]["alarms"] == []
    shown = ShownChase(frames.append, controller="gradient", faults="kill=5@0")
    while shown.chase.service.state is not ChaseState.MOVING:
        assert shown.chase.service.state is not ChaseState.CONNECTING or shown.events.alarms == []
        shown.chase.tick()
    assert [(alarm.text, alarm.severity) for alarm in shown.events.alarms] == [
        ("tracker 5 has not come", Severity.WARNING)
    ]


def test_terminal_page_and_log_have_the_same_events(tmp_path: Path) -> None:
    """Put together as ``serve`` and ``live`` do."""
    path, lines, frames = tmp_path / "chase.mcap", list[str](), list[Any]()
    shown = ShownChase(lambda _frame: None, controller="gradient", faults="silent=1@3-6,forge=5", starts=False)
    audience = Audience(AudienceOptions(log=path), shown.head, shown.chase.link, lines.append)
    try:
        shown.chase._recorder = audience.journal
        shown.chase._watch = lambda snapshot: [watch(snapshot, None) for watch in audience.watchers].clear()
        shown.chase.service.start()
        while shown.seconds() < 8.0:
            shown.chase.tick()
        shown.chase.service.abort()
        for _ in range(round(1 / TICK_S)):
            shown.chase.tick()
    finally:
        audience.close()
    recording = read_recording(path)
    frames = list(recording.frames())
    assert len(recording.events) > 10
    began_ns = recording.head.began_ns
    told = [f"{(event.time_ns - began_ns) / 1e9:7.1f} s  {event.text}" for event in recording.events]
    assert [line for line in lines if re.match(r" *\d+\.\d s  ", line)] == told
    shown_events = [(event["severity"], event["text"]) for event in frames[-1]["events"]]
    besides_routine = [event for event in recording.events if event.severity is not Severity.ROUTINE]
    assert shown_events == [(event.severity.value, event.text) for event in besides_routine]
    assert ("warning", "tracker 1 is silent") in shown_events
    assert any("-> moving: movement 1" in event.text for event in recording.events)


# The estimate


def test_an_estimate_is_the_middle_of_the_belief_and_how_far_it_reaches() -> None:
    belief_m = np.array([[10.0, 10.0, 5.0]] * 95 + [[10.0, 10.0, 25.0]] * 5)
    assert estimate_of(belief_m, (0.0, 0.0, 5.0)) == {
        "position_m": [10.0, 10.0, 5.0],
        "radius_m": 0.0,
        "distance_m": 14.1,
        "bearing_deg": 45.0,
        "elevation_deg": 0.0,
        "velocity_mps": None,
        "region": {"center_m": [10.0, 10.0, 6.0], "half_axes_m": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]},
    }
    wide = estimate_of(np.vstack([belief_m, belief_m[-1:]]), (20.0, 10.0, 15.0))
    assert wide is not None
    assert (wide["radius_m"], wide["bearing_deg"], wide["elevation_deg"]) == (20.0, 270.0, -45.0)
    point = estimate_of(belief_m[:1], (10.0, 20.0, 5.0))
    assert point is not None
    assert (point["radius_m"], point["bearing_deg"]) == (None, 180.0)
    assert estimate_of(None, (0.0, 0.0, 0.0)) is None
    assert estimate_of(belief_m, None) is None


def test_the_estimate_of_a_real_chase_holds_the_target() -> None:
    """Of the decisions, by the radius that 95 % of the belief is within; and it narrows."""
    chase = ordinary_chase()
    by_movement = {frame["movements"]: frame for frame in chase.frames if frame["estimate"] is not None}
    radii_m = []
    for frame in by_movement.values():
        estimate, target_m = frame["estimate"], frame["target_m"]
        assert estimate is not None
        assert target_m is not None
        assert estimate["radius_m"] is not None
        off_m = np.linalg.norm(np.subtract(estimate["position_m"], target_m))
        assert off_m <= estimate["radius_m"] + 0.2
        radii_m.append(estimate["radius_m"])
    assert len(radii_m) == 7
    assert radii_m[-1] < 0.2 * radii_m[0]
