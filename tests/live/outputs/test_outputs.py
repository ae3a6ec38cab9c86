"""Outputs of a real chase: what listeners on real sockets hear of it, and what becomes of it when nobody listens."""

import json
import math
import re
import socket
import sys
import threading
import time
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from live.outputs.listeners import PATIENCE_S, Broker, CotListener
from live.outputs.shown_chase import CHASE_S, DETAILS, NOBODY, ORIGIN, Shown, copy_at, frame_of, metres
from swarmchase.errors import InputError
from swarmchase.live.alarms import Alarm
from swarmchase.live.frame import Frame
from swarmchase.live.outputs.address import open_output
from swarmchase.live.outputs.cot_events import STALE_S, cot_events
from swarmchase.live.outputs.ellipse import GroundEllipse, ground_ellipse
from swarmchase.live.outputs.kind import KINDS, OutputDetails
from swarmchase.live.outputs.publisher import Publisher
from swarmchase.live.outputs.remote_id import EstimateMessage, estimate_message

# Cursor-on-Target

TIME = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z"
DECIMAL = r"-?\d+(\.\d+)?"
SCHEMA = {
    # What MITRE's Event.xsd of version 2.0 requires or allows, by element and attribute.
    "event": {
        "version": r"2\.0",
        "uid": r".+",
        "type": r"\w+(-\w+)*",
        "time": TIME,
        "start": TIME,
        "stale": TIME,
        "how": r"\w(-\w+)*",
        "opex": r"[oes](-.*)?",
    },
    "point": dict.fromkeys(("lat", "lon", "hae", "ce", "le"), DECIMAL),
}


@pytest.mark.parametrize("carried", ["udp", "tcp"])
def test_every_event_is_of_the_schema(carried: str, shown: Shown) -> None:
    events = getattr(shown, carried).events
    assert len(events) > 7 * CHASE_S
    for event in events:
        assert [child.tag for child in event] == ["point", "detail"]
        for element, name in ((event, "event"), (event[0], "point")):
            assert set(element.attrib) == set(SCHEMA[name])
            for attribute, pattern in SCHEMA[name].items():
                assert re.fullmatch(pattern, element.attrib[attribute]), (attribute, element.attrib)
        began, ends = (datetime.fromisoformat(event.attrib[name]) for name in ("start", "stale"))
        assert (ends - began).total_seconds() == STALE_S
        contact = event.find("detail/contact")
        assert contact is not None
        assert contact.attrib["callsign"]


def test_both_ways_carry_the_same_and_say_that_nothing_flies(shown: Shown) -> None:
    newest = [{event.attrib["uid"]: event.attrib["type"] for event in one.events} for one in (shown.udp, shown.tcp)]
    assert (
        newest[0]
        == newest[1]
        == {
            "swarmchase-here-swarm": "a-f-A-M-F-Q",
            **{f"swarmchase-here-tracker-{number}": "a-f-A-M-F-Q" for number in range(6)},
            "swarmchase-here-estimate": "a-u-A",
            "swarmchase-here-region": "u-d-c-c",
        }
    )
    assert {(event.attrib["how"], event.attrib["opex"]) for event in shown.udp.events} == {("m-s", "s-swarmchase")}


@pytest.mark.parametrize("carried", ["udp", "tcp"])
def test_places_are_those_of_the_chase(carried: str, shown: Shown) -> None:
    """Of trackers, swarm and estimate, at every moment that was shown."""
    listener: CotListener = getattr(shown, carried)
    for number in range(6):
        for event in listener.of(f"tracker-{number}"):
            tracker = frame_of(shown, event.attrib["time"])["trackers"][number]
            assert metres(event) == pytest.approx(tracker["position_m"], abs=0.02)
            assert event.findtext("detail/remarks", "").startswith(tracker["condition"])
    for event in listener.of("estimate"):
        estimate = frame_of(shown, event.attrib["time"])["estimate"]
        assert estimate is not None
        assert metres(event) == pytest.approx(estimate["position_m"], abs=0.02)
        track = event.find("detail/track")
        assert track is not None
        assert estimate["velocity_mps"] is not None
        east_mps, north_mps, _ = estimate["velocity_mps"]
        assert float(track.attrib["speed"]) == pytest.approx(math.hypot(east_mps, north_mps), abs=0.01)
        course = math.radians(float(track.attrib["course"]))
        assert math.sin(course) * north_mps == pytest.approx(math.cos(course) * east_mps, abs=0.02)


def test_the_ellipse_holds_the_belief(shown: Shown) -> None:
    """At least 95 % of its points, seen from above; and it is drawn around the region's centre."""
    events = shown.udp.of("region")
    assert len(events) > 3
    for event in events:
        frame = frame_of(shown, event.attrib["time"])
        drawn = event.find("detail/shape/ellipse")
        assert drawn is not None
        assert frame["belief_m"] is not None
        turn = math.radians(float(drawn.attrib["angle"]))
        apart_m = np.array(frame["belief_m"])[:, :2] - metres(event)[:2]
        along = apart_m @ [math.sin(turn), math.cos(turn)] / float(drawn.attrib["major"])
        across = apart_m @ [math.cos(turn), -math.sin(turn)] / float(drawn.attrib["minor"])
        assert (along**2 + across**2 <= 1.05).mean() >= 0.94
        assert float(drawn.attrib["major"]) >= float(drawn.attrib["minor"]) > 0
        link = event.find("detail/link")
        assert link is not None
        assert link.attrib == {"uid": "swarmchase-here-estimate", "type": "a-u-A", "relation": "p-p"}


def test_states_are_told_at_once(shown: Shown) -> None:
    """In their order, with what they were entered for; the newest counts where two follow one another at once."""
    callsigns = [event.find("detail/contact") for event in shown.tcp.of("swarm")]
    states = list(dict.fromkeys(one.attrib["callsign"].removeprefix("swarm: ") for one in callsigns if one is not None))
    assert states == [one.after.value for one in shown.log.transitions if one.after.value in states]
    assert {"pursuing", "following", "reached"} <= set(states)
    remarks = shown.tcp.of("swarm")[-1].findtext("detail/remarks", "")
    assert remarks == f"reached: {shown.log.reason}; {shown.log.movements} movements"


def test_who_is_lost_is_left_to_grow_stale(shown: Shown) -> None:
    frame = json.loads(json.dumps(shown.frames[-1]))
    frame["trackers"][4]["is_lost"] = True
    frame["estimate"]["region"] = None
    frame["reason"] = "a \x00 & <b>"
    events = [ElementTree.fromstring(event) for event in cot_events(frame, 0, DETAILS)]
    names = [event.attrib["uid"].rpartition("here-")[2] for event in events]
    assert names == ["swarm", "tracker-0", "tracker-1", "tracker-2", "tracker-3", "tracker-5", "estimate"]
    assert [event[0].attrib["ce"] for event in events] == ["9999999.00"] * 7
    assert "a ? & <b>" in events[0].findtext("detail/remarks", "")


# The estimate as JSON


def test_lines_and_broker_have_the_estimate(shown: Shown) -> None:
    published = [(topic, json.loads(payload)) for topic, payload in shown.broker.published]
    assert {topic for topic, _ in published} == {"site/target"}
    assert {message["time"] for _, message in published} & {line["time"] for line in shown.lines}
    for line in [*shown.lines, *(message for _, message in published)]:
        assert set(line) == set(EstimateMessage.__annotations__)
        frame = frame_of(shown, line["time"])
        assert (line["state"], line["uas_id"]) == (frame["state"], "swarmchase-here-estimate")
        if frame["estimate"] is None:
            assert line["latitude_deg"] is line["horizontal_accuracy_m"] is line["position_m"] is None
            continue
        position = line["latitude_deg"], line["longitude_deg"], line["altitude_geodetic_m"] - DETAILS.geoid_height_m
        assert ORIGIN.metres(position) == pytest.approx(line["position_m"], abs=0.1)
        assert line["position_m"] == frame["estimate"]["position_m"]
        assert 0 < line["horizontal_accuracy_m"] <= frame["estimate"]["radius_m"] * 1.6
    assert shown.lines[-1]["state"] == "reached"


def test_without_an_origin_metres_are_all_that_is_known(shown: Shown) -> None:
    line = json.loads(estimate_message(shown.frames[-1], 0, OutputDetails(station="here")))
    assert line["latitude_deg"] is line["longitude_deg"] is line["altitude_geodetic_m"] is None
    assert line["position_m"] is not None


# Nobody listens


def test_an_output_that_nobody_hears_is_an_alarm_and_one_line(shown: Shown) -> None:
    """On terminal, page and log; the chase went its way meanwhile."""
    line = f"output {NOBODY} fails: Connection refused; it is tried again"
    assert [line in told for told in shown.told].count(True) == 1
    assert [event.text for event in shown.log.events].count(line) == 1
    assert line in [alarm["text"] for alarm in shown.frames[-1]["alarms"]]
    assert not any("works again" in told for told in shown.told)
    assert shown.log.state.value == "reached"


@pytest.mark.parametrize("scheme", ["cot-udp", "cot-tcp", "mqtt"])
def test_who_cannot_be_reached_is_told_once_and_tried_again(scheme: str, shown: Shown) -> None:
    """Frames are taken at once all the while; when somebody listens, the newest is what is heard."""
    kind = socket.SOCK_DGRAM if scheme == "cot-udp" else socket.SOCK_STREAM
    with socket.socket(socket.AF_INET, kind) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    name = f"{scheme}:127.0.0.1:{port}" + ("/target" if scheme == "mqtt" else "")
    publisher = Publisher(name, open_output(name, DETAILS), shown.head, retry_s=0.02)
    alarms: list[Alarm] = []

    def shown_until(fails: bool) -> None:
        """A second of the chase after the other."""
        deadline_s = time.monotonic() + PATIENCE_S
        while bool(publisher.alarms) is not fails:
            assert time.monotonic() < deadline_s
            publisher.take(copy_at(shown.frames[-1], float(len(seconds))))
            seconds.append(None)
            alarms.extend(publisher.alarms)
            time.sleep(0.02)

    seconds: list[None] = []
    try:
        shown_until(fails=True)
        listener: CotListener | Broker = Broker(port) if scheme == "mqtt" else CotListener(kind, port)
        shown_until(fails=False)
        assert {(alarm.text, alarm.over) for alarm in alarms} == {
            (f"output {name} fails: Connection refused; it is tried again", f"output {name} works again")
        }
        listener.wait(lambda: bool(listener.published if isinstance(listener, Broker) else listener.events))
        listener.close()
        shown_until(fails=True)  # it has gone, and that is noticed
    finally:
        publisher.close()


def test_a_broker_that_refuses_says_why(shown: Shown, tmp_path: Path) -> None:
    """As one that lets in nobody but the user whose password the file holds."""
    broker = Broker(refusal=5)
    (tmp_path / "password").write_text("secret\n")
    details = replace(DETAILS, mqtt_password_file=tmp_path / "password")
    output = open_output(f"mqtt:chaser@127.0.0.1:{broker.port}/target", details)
    try:
        with pytest.raises(ConnectionError, match="the broker refuses: Not authorized"):
            output.send(shown.frames[-1], 0)
        assert broker.users == [("chaser", "secret")]
    finally:
        output.close()
        broker.close()


class StuckOutput:
    """Somebody who takes nothing, and says nothing."""

    def __init__(self) -> None:
        self.calls = 0

    def send(self, frame: Frame, wall_ns: int) -> None:
        self.calls += 1
        threading.Event().wait()

    def close(self) -> None:
        raise AssertionError("it never came so far")


def test_nobody_waits_for_an_output_that_hangs(shown: Shown, monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread of a chase could not say so: frames, alarms and the end come back although one send never does."""
    monkeypatch.setattr("swarmchase.live.outputs.publisher.CLOSE_S", 0.05)
    stuck = StuckOutput()
    publisher = Publisher("stuck", stuck, shown.head)
    for frame in shown.frames:
        publisher.take(frame)
    publisher.close()
    assert (stuck.calls, publisher.alarms) == (1, [])


def test_what_fails_otherwise_is_told_and_no_end(shown: Shown) -> None:
    class Failing(StuckOutput):
        def send(self, frame: Frame, wall_ns: int) -> None:
            self.calls += 1
            raise ValueError("no such thing")

        def close(self) -> None:
            self.calls += 100

    failing = Failing()
    publisher = Publisher("odd", failing, shown.head, retry_s=0.0)
    deadline_s, number = time.monotonic() + PATIENCE_S, 0
    while failing.calls < 2:
        assert time.monotonic() < deadline_s
        publisher.take(copy_at(shown.frames[-1], float(number)))
        number += 1
        time.sleep(0.01)
    assert [alarm.text for alarm in publisher.alarms] == ["output odd fails: no such thing; it is tried again"]
    publisher.close()
    assert failing.calls > 100


def test_who_takes_a_frame_and_hangs_up_does_not_work_again(shown: Shown) -> None:
    """As a proxy does, or a server at its limit: one alarm for as long as it lasts, however many frames get through."""

    class Fickle(StuckOutput):
        def send(self, frame: Frame, wall_ns: int) -> None:
            self.calls += 1
            if self.calls % 3 == 1:
                raise ConnectionError("the other end has closed the connection")

        def close(self) -> None:
            pass

    fickle, seen = Fickle(), []
    publisher = Publisher("fickle", fickle, shown.head, retry_s=0.0)
    deadline_s = time.monotonic() + PATIENCE_S
    while fickle.calls < 10:
        assert time.monotonic() < deadline_s
        publisher.take(copy_at(shown.frames[-1], float(len(seen))))
        time.sleep(0.01)
        seen.append([alarm.text for alarm in publisher.alarms])
    publisher.close()
    alarm = ["output fickle fails: the other end has closed the connection; it is tried again"]
    assert seen[seen.index(alarm) :] == [alarm] * (len(seen) - seen.index(alarm))


def test_a_full_disk_leaves_whole_lines(shown: Shown, tmp_path: Path) -> None:
    output: Any = open_output(f"jsonl:{tmp_path / 'new' / 'lines.jsonl'}", DETAILS)
    output.send(shown.frames[-1], 0)
    whole = (tmp_path / "new" / "lines.jsonl").read_bytes()
    file = output._file

    class Full:
        def __getattr__(self, name: str) -> Any:
            return getattr(file, name)

        def write(self, data: bytes) -> int:
            file.write(data[:10])
            raise OSError(28, "No space left on device")

    output._file = Full()
    with pytest.raises(OSError, match="No space"):
        output.send(shown.frames[-1], 0)
    output._file = file
    output.send(shown.frames[-1], 0)
    output.close()
    assert (tmp_path / "new" / "lines.jsonl").read_bytes() == 2 * whole


# What is refused at the start


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            "cot:127.0.0.1:1",
            "output 'cot:127.0.0.1:1' is refused: allowed is one of cot-udp:HOST:PORT, cot-tcp:HOST:PORT",
        ),
        ("cot-udp:somewhere", "output cot-udp 'somewhere' is refused: allowed is HOST:PORT"),
        ("cot-udp:127.0.0.1:1", "output cot-udp is refused: it shows places on the earth; give --global-origin LATI"),
        ("cot-tcp:127.0.0.1:1", "output cot-tcp is refused: it shows places on the earth; give --global-origin LATI"),
        ("jsonl:there", "cannot write the output there: it exists already"),
        ("mqtt:127.0.0.1:1883", "output 'mqtt:127.0.0.1:1883' is refused: allowed is mqtt:[USER@]HOST[:PORT]/TOPIC"),
        ("mqtt:127.0.0.1:1/site/#", "topic 'site/#' is refused: + and # are for those who listen"),
    ],
)
def test_what_can_be_no_output_is_refused(
    words: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there").write_text("precious")
    with pytest.raises(InputError) as refusal:
        open_output(words, OutputDetails())
    assert str(refusal.value).startswith(line)
    assert Path("there").read_text() == "precious"


def test_mqtt_without_its_package_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "paho.mqtt.client", None)
    with pytest.raises(InputError, match="MQTT needs paho-mqtt: pip install"):
        open_output("mqtt:127.0.0.1/target", OutputDetails())


def test_the_document_has_every_output() -> None:
    text = (Path(__file__).parents[3] / "docs" / "outputs.md").read_text(encoding="utf-8")
    for kind in KINDS:
        assert f"`{kind.form}`" in text
    for name in EstimateMessage.__annotations__:
        assert f"`{name}`" in text, name


# The ellipse

LENGTH_M = st.floats(0.01, 500.0)


@settings(max_examples=25)
@given(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda turn: math.hypot(*turn) > 0.1), st.tuples(*[LENGTH_M] * 3))
def test_the_shadow_of_an_ellipsoid_touches_it_all_round(turn: tuple[float, ...], lengths_m: tuple[float, ...]) -> None:
    """From above an ellipsoid reaches, in each direction, as far as its half axes' parts in it together."""
    w, x, y, z = np.array(turn) / math.hypot(*turn)
    axes = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    half_axes_m = (axes * lengths_m).T
    ellipse = ground_ellipse({"center_m": [0.0, 0.0, 0.0], "half_axes_m": half_axes_m.tolist()})
    outline_m = np.array(ellipse.outline_m(720))
    for direction in (0.0, 0.7, 1.5, 2.9):
        seen_m = np.array([math.cos(direction), math.sin(direction)])
        reach_m = math.sqrt(((half_axes_m[:, :2] @ seen_m) ** 2).sum())
        assert (outline_m @ seen_m).max() == pytest.approx(reach_m, rel=1e-3, abs=1e-3)
    assert ellipse.half_height_m == pytest.approx(math.sqrt((half_axes_m[:, 2] ** 2).sum()))
    assert 0 <= ellipse.azimuth_deg < 180


def test_errors_are_standard_deviations_of_the_normal_with_this_region() -> None:
    """MITRE: one sigma. Of a normal with 10 m on each axis 95 % lie within 27.95 m."""
    ellipse = GroundEllipse(27.955, 27.955, 0.0, 27.955)
    assert (ellipse.circular_error_m, ellipse.linear_error_m) == (
        pytest.approx(10, abs=0.01),
        pytest.approx(10, abs=0.01),
    )
