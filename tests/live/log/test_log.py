"""The log of a live chase: what is written is read back bit for bit, whatever happens to the process or the disk."""

import dataclasses
import functools
import io
import json
import math
import re
import signal
import struct
import subprocess
import sys
import threading
import urllib.request
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("mcap", reason="the log needs mcap: pip install 'swarmchase[live]'")

from jsonschema import Draft202012Validator
from mcap.reader import make_reader
from mcap.records import Chunk, McapRecord
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from live_bench import REACHED, Bench, SimulatedWorld, evaluated
from swarmchase.cli import main
from swarmchase.controllers import load_controller
from swarmchase.controllers.protocol import Controller
from swarmchase.errors import InputError
from swarmchase.files import new_file
from swarmchase.formation import Action
from swarmchase.live.alarms import Alarm, Severity
from swarmchase.live.earth import EarthOrigin
from swarmchase.live.events import Event, Events
from swarmchase.live.frame import Frame, event_frame, frame_of
from swarmchase.live.log import recorder as recorder_module
from swarmchase.live.log import verification as verification_module
from swarmchase.live.log.entries import (
    DECISION_TOPIC,
    EVENT_TOPIC,
    FORMS,
    FRAME_TOPIC,
    HEAD_TOPIC,
    SCENE_TOPIC,
    TRANSITION_TOPIC,
    DecisionForm,
    HeadForm,
    LogHead,
    Number,
    TransitionForm,
    decision_form,
    decision_of,
    event_form,
    from_json,
    head_form,
    head_of,
    new_head,
    to_json,
    transition_form,
    transition_of,
)
from swarmchase.live.log.file import LogFile
from swarmchase.live.log.json_forms import SIMPLE_TYPES, form_check
from swarmchase.live.log.mcap_messages import MOST_RECORD_BYTES
from swarmchase.live.log.recorder import FLUSH_S, MOST_WAITING, MOST_WAITING_FRAMES, ChaseRecorder
from swarmchase.live.log.recording import Recording, read_recording
from swarmchase.live.log.verification import verify
from swarmchase.live.page.info import page_info
from swarmchase.live.service.chase_state import ChaseState, Decision, Transition
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.observation import Observation
from swarmchase.scenario import Scenario, load_scenario, paper_scenario

PATIENCE_S = 120.0
"""Nothing here takes a tenth of it, unless the machine is very busy with something else."""
SHORT = paper_scenario(window_samples=2)
BEGAN_NS = 5_000_000_000


def head_for(controller: str = "gradient", scenario: Scenario = SHORT, seed: int = 4, chase: int = 7) -> LogHead:
    origin = EarthOrigin(-33.9, 18.4, 12.5)
    return new_head(controller, scenario, seed, chase, 3, SafetyLimits(), BEGAN_NS, origin)


def a_transition(number: int = 0, reason: str = "arrived") -> Transition:
    return Transition(BEGAN_NS + number, ChaseState.MOVING, ChaseState.SAMPLING, reason)


def a_decision(number: int = 1, scenario: Scenario = SHORT, spacing_m: float = 3.0) -> Decision:
    generator = np.random.default_rng(number)
    rssi_dbm = generator.normal(-60, 4, (scenario.window_samples, 6)).astype(np.float32).astype(np.float64)
    position_m = generator.normal(0, 5, (scenario.window_samples, 6, 3))
    return Decision(BEGAN_NS + number * 10**9, number, rssi_dbm, position_m, spacing_m, (4.0, -2.0, 0.0), "")


@functools.cache
def a_frame(number: int = 0) -> Frame:
    bench = Bench()
    bench.run_until(ChaseState.MOVING)
    events = Events(lambda _snapshot: [Alarm("log", "the log has lost 3 frames")])
    snapshot = bench.service.snapshot()
    events(snapshot)
    frame = frame_of(snapshot, 0, [(10.0, -20.0, 30.0)], [0.1] * 5 + [None], Counter(), 0.001, events)
    frame["time_s"] = float(number)
    return frame


def an_event(number: int = 0) -> Event:
    return Event(BEGAN_NS + number, Severity.CRITICAL, "tracker 3 is lost")


def bits(decision: Decision) -> tuple[Any, ...]:
    """All of it, comparable bit by bit; every NaN is the same."""
    numbers = [decision.rssi_dbm, decision.tracker_position_m, [decision.spacing_m], decision.displacement_m]
    text = [[value.hex() for value in np.asarray(values, dtype=np.float64).ravel().tolist()] for values in numbers]
    return decision.time_ns, decision.movement, decision.changed, decision.rssi_dbm.shape, text


def written(path: Path, head: LogHead, items: Sequence[Transition | Decision | Event | Frame]) -> Path:
    """A log that was ended as it should be."""
    with ChaseRecorder(path, head) as recorder:
        for item in items:
            if isinstance(item, dict):
                recorder.record_frame(item)
            else:
                recorder.record(item)
    assert (recorder.failure, recorder.alarms) == (None, [])
    return path


# What is written is read

ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True)


@st.composite
def decisions(draw: st.DrawFn) -> Decision:
    values = draw(st.lists(ANY_FLOAT, min_size=52, max_size=52))
    rssi_dbm, position_m = np.array(values[:12]).reshape(2, 6), np.array(values[12:48]).reshape(2, 6, 3)
    x_m, y_m, z_m = values[49:]
    time_ns, movement = draw(st.integers(0, 2**63 - 1)), draw(st.integers(0, 500))
    return Decision(time_ns, movement, rssi_dbm, position_m, values[48], (x_m, y_m, z_m), draw(st.text()))


@given(decisions())
def test_a_decision_keeps_every_bit(decision: Decision) -> None:
    read = decision_of(from_json(to_json(decision_form(decision)), DecisionForm), 2)
    assert bits(read) == bits(decision)


@given(st.integers(0, 2**63 - 1), st.sampled_from(ChaseState), st.sampled_from(ChaseState), st.text())
def test_a_transition_is_kept(time_ns: int, before: ChaseState, after: ChaseState, reason: str) -> None:
    transition = Transition(time_ns, before, after, reason)
    assert transition_of(from_json(to_json(transition_form(transition)), TransitionForm)) == transition


def test_a_head_is_kept() -> None:
    scenario = paper_scenario(sampling_hz=20, spacing_choices_m=(1.5, 2.5), los_phase="independent")
    limits = SafetyLimits(fence_west_m=-12.25, highest_speed_mps=3.0)
    head = new_head("paper", scenario, 2**63, 11, 7, limits, 123_456_789)
    assert re.fullmatch("[0-9a-f]{64}", str(head.weights_sha256))
    assert head_of(from_json(to_json(head_form(head)), HeadForm)) == head


def test_a_log_holds_what_was_recorded_in_its_order(tmp_path: Path) -> None:
    head, frames = head_for(), [a_frame(0), a_frame(2), a_frame(7)]
    items = [a_transition(0), frames[0], a_decision(1), a_transition(1, "movement 1"), frames[1], a_decision(3)]
    items += [an_event(5), an_event(6), frames[2]]
    recording = read_recording(written(tmp_path / "new" / "chase.mcap", head, items))
    assert recording.head == head
    assert recording.transitions == (items[0], items[3])
    assert list(map(bits, recording.decisions)) == [bits(a_decision(1)), bits(a_decision(3))]
    assert recording.events == (an_event(5), an_event(6))
    # Each with the events that were told before it.
    told = [[], [], [event_frame(one, head.began_ns) for one in (an_event(5), an_event(6))]]
    expected = [frame | {"events": events} for frame, events in zip(frames, told, strict=True)]
    assert list(recording.frames()) == list(recording.frames()) == expected
    assert (recording.num_frames, recording.seconds, recording.movements) == (3, 7.0, 3)
    assert (recording.state, recording.reason) == (ChaseState.SAMPLING, "movement 1")
    assert (recording.is_cut, recording.lost_frames, recording.lost_entries) == (False, 0, 0)


def test_an_empty_log_is_a_chase_that_has_not_begun(tmp_path: Path) -> None:
    recording = read_recording(written(tmp_path / "chase.mcap", head_for(), []))
    assert (recording.state, recording.reason, recording.movements) == (ChaseState.IDLE, "", 0)
    assert (recording.decisions, list(recording.frames()), recording.seconds) == ((), [], 0.0)


def test_stock_tools_read_it_and_every_message_is_of_its_schema(tmp_path: Path) -> None:
    head = head_for()
    broken = dataclasses.replace(a_decision(2), spacing_m=math.nan, displacement_m=(math.inf, -math.inf, 0.0))
    broken.rssi_dbm[1, 3] = math.nan
    path = written(tmp_path / "chase.mcap", head, [a_transition(), a_frame(5), a_decision(1), broken, an_event()])
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert {channel.topic for channel in summary.channels.values()} == set(FORMS)
        assert [(one.name, one.metadata["controller"]) for one in reader.iter_metadata()] == [
            ("swarmchase", "gradient")
        ]
        seen = Counter[str]()
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            validator = Draft202012Validator(json.loads(schema.data))
            document = json.loads(message.data)
            validator.validate(document)
            for name in document:
                assert not validator.is_valid({**document, name: {"no": "such thing"}}) or name in {"scenario"}
                assert not validator.is_valid({key: value for key, value in document.items() if key != name})
            seen[channel.topic] += 1
            assert message.log_time == message.publish_time
            since_ns = message.log_time - head.wall_ns(BEGAN_NS)
            assert since_ns == (
                5 * 10**9
                if channel.topic in {FRAME_TOPIC, SCENE_TOPIC}
                else document.get("time_ns", BEGAN_NS) - BEGAN_NS
            )
        file.seek(0)
        assert any(
            isinstance(record, Chunk) for record in StreamReader(file, emit_chunks=True, validate_crcs=True).records
        )
    assert seen == {
        HEAD_TOPIC: 1,
        TRANSITION_TOPIC: 1,
        FRAME_TOPIC: 1,
        SCENE_TOPIC: 1,
        DECISION_TOPIC: 2,
        EVENT_TOPIC: 1,
    }


def test_schemas_name_only_what_foxglove_and_lichtblick_take(tmp_path: Path) -> None:
    """They refuse a channel of which any named property is a union, null, or an array of arrays."""

    def require_simple(schema: dict[str, Any]) -> int:
        assert schema["type"] == "object"
        for name, field in schema["properties"].items():
            kind = field["items"]["type"] if field["type"] == "array" else field["type"]
            assert kind in SIMPLE_TYPES, name
            if kind == "object":
                require_simple(field.get("items", field))
        return len(schema["properties"])

    with open(written(tmp_path / "chase.mcap", head_for(), []), "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for schema in summary.schemas.values():
        assert require_simple(json.loads(schema.data)) > 1


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        (float, [0, -0.0, 1e308], [True, None, "1", math.inf, math.nan, 10**400, []]),
        (int, [0, -(2**63), 2**64 - 1], [1.0, True, None, 2**64, "1"]),
        (bool, [True, False], [0, 1, None]),
        (str, ["", "x"], [None, 1, []]),
        (Number, [1.5, None, "inf", "-inf"], ["nan", math.inf, True, [], {}]),
        (list[float | None], [[], [1.0, None]], [(1.0,), [1.0, "x"], {}, None]),
        (dict[str, int], [{}, {"a": 1}], [{"a": 1.5}, [], None]),
        (TransitionForm, [transition_form(a_transition()) | {"more": 1}], [{}, {"time_ns": 1}, [], None]),
    ],
)
def test_what_comes_from_outside_is_checked(kind: Any, good: list[Any], bad: list[Any]) -> None:
    check = form_check(kind)
    assert [check(value) for value in good] == [True] * len(good)
    assert [check(value) for value in bad] == [False] * len(bad)


# A process that is killed

WRITER = """
import json, sys, time
from pathlib import Path
sys.path[:0] = [sys.argv[2], str(Path(sys.argv[2]).parents[1])]
from test_log import asked, a_frame, head_for, a_transition, BEGAN_NS
from swarmchase.live.log.recorder import ChaseRecorder
from swarmchase.live.log.recording import read_recording

path = Path(sys.argv[1])
head, decisions, frame = head_for("particle"), asked("particle", 60), a_frame(1)
recorder = ChaseRecorder(path, head)
for number, decision in enumerate(decisions):
    if number == 40:
        # The file is not ended, and its reader sees everything.
        while len(read_recording(path).decisions) < 40 or read_recording(path).num_frames < 40:
            time.sleep(0.05)
        print("forty are safe", flush=True)
    recorder.record(decision)
    recorder.record_frame(frame)
print("all are told", flush=True)
while True:
    recorder.record(a_transition(1))
    time.sleep(0.001)
"""


def asked(name: str, number: int, scenario: Scenario = SHORT) -> list[Decision]:
    """Windows of noise, and what this controller decides on them in chase 7 of seed 4."""
    controller = load_controller(name, scenario)
    memory = controller.begin(1, 4, 7)
    course = []
    for movement in range(1, number + 1):
        window = a_decision(movement, scenario)
        rssi_dbm, position_m = torch.from_numpy(window.rssi_dbm), torch.from_numpy(window.tracker_position_m)
        action, memory = controller.decide(Observation(rssi_dbm.float()[None], position_m[None]), memory)
        x_m, y_m, z_m = action.displacement_m[0].tolist()
        course.append(dataclasses.replace(window, spacing_m=action.spacing_m.item(), displacement_m=(x_m, y_m, z_m)))
    return course


def test_what_was_there_half_a_second_ago_survives_kill_9(tmp_path: Path) -> None:
    path = tmp_path / "chase.mcap"
    words = [sys.executable, "-c", WRITER, str(path), str(Path(__file__).parent)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "forty are safe\n"
        assert process.stdout.readline() == "all are told\n"
        process.kill()
        assert process.wait(PATIENCE_S) == -signal.SIGKILL
    recording = read_recording(path)
    assert recording.is_cut
    assert 40 <= len(recording.decisions) <= 60
    expected = asked("particle", 60)[: len(recording.decisions)]
    assert list(map(bits, recording.decisions)) == list(map(bits, expected))
    assert len(list(recording.frames())) == recording.num_frames >= 40
    assert verify(recording).is_same
    assert FLUSH_S <= 0.5


@pytest.fixture(scope="module")
def small_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two chunks after the head's."""
    path = tmp_path_factory.mktemp("log") / "chase.mcap"
    with new_file(path, "log") as file:
        log = LogFile(file, head_for())
        for number in (1, 2):
            log.write(a_transition(number))
            log.write(a_frame(number))
            log.write(a_decision(number))
            log.flush()
        log.finish()
    return path


def chunk_bounds(path: Path) -> list[int]:
    """Where the chunks begin and end."""
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunks = summary.chunk_indexes
    return [at for one in chunks for at in (one.chunk_start_offset, one.chunk_start_offset + one.chunk_length)]


def places(path: Path) -> list[int]:
    """Every byte near the ends of a chunk and of the file, and many between."""
    length = path.stat().st_size
    bounds = [0, *chunk_bounds(path), length]
    return [at for at in range(length) if at % 11 == 0 or min(abs(at - bound) for bound in bounds) <= 45]


def read_all(path: Path) -> tuple[Recording, list[Frame]]:
    recording = read_recording(path)
    return recording, list(recording.frames())


def test_cut_anywhere_it_gives_what_is_whole(small_log: Path, tmp_path: Path) -> None:
    whole, frames = read_all(small_log)
    data, path = small_log.read_bytes(), tmp_path / "cut.mcap"
    seen = set()
    for length in places(small_log):
        path.write_bytes(data[:length])
        try:
            cut, cut_frames = read_all(path)
        except InputError:
            seen.add("refused")
            assert seen == {"refused"}, "a head that was there is gone"
            continue
        count = len(cut.decisions)
        assert len(cut.transitions) == cut.num_frames == count
        assert cut.transitions == whole.transitions[:count]
        assert list(map(bits, cut.decisions)) == list(map(bits, whole.decisions[:count]))
        assert cut_frames == frames[:count]
        assert count == len(whole.decisions) or cut.is_cut
        seen.add(count)
    assert seen == {"refused", 0, 1, 2}


def test_damaged_anywhere_it_gives_what_is_before_or_refuses(small_log: Path, tmp_path: Path) -> None:
    whole, frames = read_all(small_log)
    data, path = bytearray(small_log.read_bytes()), tmp_path / "damaged.mcap"
    damaged = []
    for at in places(small_log):
        data[at] ^= 1 << (at % 8)
        path.write_bytes(data)
        data[at] ^= 1 << (at % 8)
        try:
            read, read_frames = read_all(path)
        except InputError:
            damaged.append(at)
            continue
        count = len(read.decisions)
        assert list(map(bits, read.decisions)) == list(map(bits, whole.decisions[:count]))
        assert read_frames == frames[: len(read_frames)]
        assert read.is_cut or count == len(whole.decisions)
        if read.is_cut:
            damaged.append(at)
    first, last = chunk_bounds(small_log)[0], chunk_bounds(small_log)[-1]
    # A chunk's own times are not used.
    assert len(damaged) > 0.9 * len([at for at in places(small_log) if first <= at < last])


# Files that are no log


def foreign(path: Path, topic: str, data: bytes, compression: CompressionType = CompressionType.ZSTD) -> Path:
    with open(path, "wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        channel = writer.register_channel(topic, "json", 0)
        writer.add_message(channel, 0, data, 0)
        writer.finish()
    return path


def changed_head(**changes: Any) -> bytes:
    return json.dumps(head_form(head_for()) | changes).encode()


@pytest.mark.parametrize(
    ("topic", "data", "words"),
    [
        ("/imu", b"{}", "it does not begin with the head of a chase"),
        (HEAD_TOPIC, b"{}", "a message is no HeadForm"),
        (HEAD_TOPIC, b"\xff", "a message is no JSON"),
        (HEAD_TOPIC, b"[" * 200_000, "a message is no JSON"),
        (HEAD_TOPIC, b"9" * 5_000, "a message is no JSON"),
        (HEAD_TOPIC, changed_head(layout=6), "its layout is 6; this version reads 1 to 5"),
        (HEAD_TOPIC, changed_head(layout=0), "its layout is 0; this version reads 1 to 5"),
        (HEAD_TOPIC, changed_head(scenario={"window_samples": -1}), "window_samples = -1 is refused"),
        (HEAD_TOPIC, changed_head(scenario={"gravity": 9.81}), "scenario has no field 'gravity'"),
        (HEAD_TOPIC, changed_head(limits={"mood": 1.0}), "there is no limit 'mood'"),
        (HEAD_TOPIC, changed_head(limits={"minimum_separation_m": -1.0}), "minimum_separation_m = -1.0 is refused"),
        (HEAD_TOPIC, changed_head(started_at="yesterday"), "started_at = 'yesterday' is no time"),
        (HEAD_TOPIC, changed_head(global_origin=[47.4, 8.5]), "global_origin = [47.4, 8.5] is not latitude, longitude"),
        (HEAD_TOPIC, changed_head(global_origin=[91, 8.5, 0]), "latitude_deg = 91.0 is refused"),
        (HEAD_TOPIC, changed_head(seed=1.5), "a message is no HeadForm"),
    ],
)
def test_another_file_is_refused_in_one_line(topic: str, data: bytes, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as refusal:
        read_recording(foreign(tmp_path / "other.mcap", topic, data))
    assert str(refusal.value).startswith(f"cannot read the log {tmp_path / 'other.mcap'}: {words}")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("topic", "change", "words"),
    [
        (TRANSITION_TOPIC, {"after": "asleep"}, "a transition is refused: 'asleep' is not a valid ChaseState"),
        (TRANSITION_TOPIC, {"reason": None}, "a message is no TransitionForm"),
        (DECISION_TOPIC, {"rssi_dbm": [[0.0] * 6]}, "rssi_dbm of a decision is not of the shape [2, 6]"),
        (DECISION_TOPIC, {"rssi_dbm": [[0.0] * 6, [0.0] * 5]}, "rssi_dbm of a decision is not of the shape [2, 6]"),
        (DECISION_TOPIC, {"tracker_position_m": []}, "tracker_position_m of a decision is not of the shape [2, 6, 3]"),
        (DECISION_TOPIC, {"displacement_m": [1.0]}, "displacement_m of a decision is not of the shape [3]"),
        (DECISION_TOPIC, {"spacing_m": "wide"}, "a message is no DecisionForm"),
        (EVENT_TOPIC, {"severity": "grave"}, "an event is refused: 'grave' is not a valid Severity"),
        (EVENT_TOPIC, {"text": None}, "a message is no EventForm"),
    ],
)
def test_an_entry_of_another_form_is_refused(
    topic: str, change: dict[str, Any], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forms: dict[str, Any] = {
        TRANSITION_TOPIC: transition_form(a_transition()),
        DECISION_TOPIC: decision_form(a_decision()),
        EVENT_TOPIC: event_form(an_event()),
    }
    good = forms[topic]
    path = tmp_path / "chase.mcap"
    with new_file(path, "log") as file:
        log = LogFile(file, head_for())
        log._add(topic, BEGAN_NS, to_json(good | change))
        log.finish()
    with pytest.raises(InputError, match=re.escape(words)):
        read_recording(path)


def test_a_frame_of_another_form_is_refused_when_it_is_read(tmp_path: Path) -> None:
    path = written(tmp_path / "chase.mcap", head_for(), [Frame(**{**a_frame(), "movements": None})])
    with pytest.raises(InputError, match="a message is no Frame"):
        list(read_recording(path).frames())


def test_a_log_of_the_layout_before_is_read_and_asked_again() -> None:
    """The first movements of a simulated chase; trackers of that layout all stopped to listen."""
    recording = read_recording(Path(__file__).parent / "logs" / "layout-2.mcap")
    assert (recording.layout, recording.movements) == (2, 2)
    assert [decision.time_s for decision in recording.decisions] == [None, None]
    assert verify(recording).is_same


def test_a_decision_in_flight_keeps_when_each_sample_was_taken(tmp_path: Path) -> None:
    scenario = load_scenario("flight")
    time_s = np.arange(1, 11) / 20 + 1 / 3
    decision = dataclasses.replace(
        a_decision(1, dataclasses.replace(scenario, window_samples=scenario.samples_a_decision)), time_s=time_s
    )
    head = head_for("particle", scenario)
    (read,) = read_recording(written(tmp_path / "flight.mcap", head, [decision])).decisions
    assert read.time_s is not None
    assert bits(read) == bits(decision)
    assert read.time_s.tolist() == time_s.tolist()


def test_a_log_of_the_first_layout_is_read() -> None:
    """Of version 0.3.0: 8 s of a simulated chase, in which a receiver falls silent."""
    recording = read_recording(Path(__file__).parent / "logs" / "layout-1.mcap")
    assert (recording.layout, recording.state.value, recording.events) == (1, "moving", ())
    assert len(recording.decisions) == recording.movements > 1
    frames = list(recording.frames())
    assert len(frames) == recording.num_frames > 50
    first, last = frames[0], frames[-1]
    assert last["alarms"] == [
        {
            "text": "the log has lost 3 frames and 0 transitions and decisions",
            "severity": "warning",
            "tracker": None,
        }
    ]
    assert (first["estimate"], last["events"], last["preflight"], last["ended_s"]) == (None, [], [], None)
    assert last["estimate"] is not None
    assert last["estimate"]["radius_m"] is None  # of one point
    assert [tracker["condition"] for tracker in last["trackers"]] == ["there", "there", "silent", *["there"] * 3]
    assert {tracker["left_out"] for tracker in last["trackers"]} == {""}


def test_a_log_that_does_not_say_where_on_the_earth_it_was_is_read() -> None:
    """2 s of a simulated flight, as version 0.3.0 wrote it."""
    recording = read_recording(Path(__file__).parent / "logs" / "layout-4.mcap")
    assert (recording.layout, recording.head.origin, recording.is_cut) == (4, None, False)
    assert len(list(recording.frames())) == recording.num_frames == 6
    assert verify(recording).is_same


def test_a_log_that_does_not_say_what_the_radio_was_found_to_be_is_read() -> None:
    """7 s of a simulated chase, frames alone, before there was ``adaptive``."""
    recording = read_recording(Path(__file__).parent / "logs" / "layout-2-frames.mcap")
    frames = list(recording.frames())
    assert (recording.layout, len(frames)) == (2, recording.num_frames)
    assert {frame["channel"] for frame in frames} == {None}
    assert frames[-1]["movements"] > 0


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is no MCAP file"),
        (b"time_s,rssi_dbm\n0,-60\n", "is no MCAP file"),
        (b"\x89MCAP0\r", "is no MCAP file"),
        (b"\x89MCAP0\r\n", "holds no chase: its end is missing, from byte 8 on"),
        (b"\x89MCAP0\r\n" + bytes(100), "holds no chase: "),
        (b"\x89MCAP0\r\n\x06" + b"\xff" * 8 + b"x" * 50, "holds no chase: it is damaged at byte 8: a record of 18446"),
        (b"\x89MCAP0\r\n\x0f\x04" + bytes(11), "holds no chase: it is empty"),
    ],
)
def test_what_is_no_log_is_refused(data: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "chase.mcap"
    path.write_bytes(data)
    with pytest.raises(InputError, match=re.escape(words)):
        read_recording(path)


def test_a_folder_or_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="it is no regular file"):
        read_recording(tmp_path)
    with pytest.raises(InputError, match="No such file"):
        read_recording(tmp_path / "chase.mcap")


@pytest.mark.parametrize("claimed_bytes", [MOST_RECORD_BYTES + 1, 1000])
def test_a_chunk_that_unpacks_to_more_than_it_may_is_not_unpacked(
    claimed_bytes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """64 MiB of nothing are 6 kB packed."""
    path = tmp_path / "bomb.mcap"
    foreign(path, "/zeros", bytes(MOST_RECORD_BYTES))
    data = path.read_bytes()
    at = data.index(b"\x06", 8 + 9) if claimed_bytes == 0 else data.index(struct.pack("<I", 4) + b"zstd") - 12
    path.write_bytes(data[:at] + struct.pack("<Q", claimed_bytes) + data[at + 8 :])

    def unpack(*_: Any, **__: Any) -> Any:
        raise AssertionError("unpacked")

    monkeypatch.setattr("mcap.stream_reader.zstandard.decompress", unpack)
    with pytest.raises(InputError, match="a chunk of 6710"):
        read_recording(path)


def test_other_compressions_are_refused(tmp_path: Path) -> None:
    path = foreign(tmp_path / "packed.mcap", HEAD_TOPIC, changed_head(), CompressionType.LZ4)
    with pytest.raises(InputError, match="compressed by 'lz4'"):
        read_recording(path)


def test_a_log_that_was_unpacked_by_another_tool_is_read(tmp_path: Path) -> None:
    """Without chunks, too."""
    for number, options in enumerate([{"compression": CompressionType.NONE}, {"use_chunking": False}]):
        path = tmp_path / f"{number}.mcap"
        with open(path, "wb") as file:
            writer = Writer(file, **options)
            writer.start()
            writer.add_message(writer.register_channel(HEAD_TOPIC, "json", 0), 0, changed_head(), 0)
            writer.finish()
        assert read_recording(path).head.controller == "gradient"


def test_a_log_has_only_so_many_bytes_of_entries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "chase.mcap", head_for(), [a_transition(1, "x" * 1000), a_transition(2)])
    monkeypatch.setattr("swarmchase.live.log.recording.MOST_ENTRY_BYTES", 1000)
    with pytest.raises(InputError, match="have more than 1000 bytes"):
        read_recording(path)


def test_frames_are_read_one_by_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour of them does not fit into memory."""
    path = tmp_path / "chase.mcap"
    with new_file(path, "log") as file:
        log = LogFile(file, head_for())
        for number in range(30):
            log.write(a_frame(number))
            log.flush()
        log.finish()
    recording, unpacked = read_recording(path), []

    def counting(chunk: Chunk, validate_crc: bool) -> list[McapRecord]:
        unpacked.append(chunk.uncompressed_size)
        return breakup_chunk(chunk, validate_crc)

    monkeypatch.setattr("swarmchase.live.log.mcap_messages.breakup_chunk", counting)
    for number, frame in enumerate(recording.frames()):
        assert frame["time_s"] == number
        assert len(unpacked) == number + 2  # the head's chunk, and those of the frames so far


# Disks


def test_an_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "chase.mcap"
    path.write_text("mine")
    with pytest.raises(InputError, match="it exists already"):
        ChaseRecorder(path, head_for())
    assert path.read_text() == "mine"


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"cannot write to folder .*/file: File exists"):
        ChaseRecorder(tmp_path / "file" / "chase.mcap", head_for())


def test_a_disk_that_is_full_before_the_chase_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "new_file", lambda path, what: open("/dev/full", "wb"))  # noqa: SIM115
    with pytest.raises(InputError, match=r"cannot write the log .*: No space left on device"):
        ChaseRecorder(tmp_path / "chase.mcap", head_for())


FULL = """
import json, resource, signal, sys, time
from pathlib import Path
sys.path[:0] = [sys.argv[2], str(Path(sys.argv[2]).parents[1])]
from test_log import a_decision, a_frame, a_transition, head_for, paper_scenario
from swarmchase.live.log.recorder import ChaseRecorder

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
recorder, told, frame = ChaseRecorder(Path(sys.argv[1]), head_for(scenario=paper_scenario())), 0, a_frame()
while recorder.failure is None:
    if not recorder._waiting:
        for _ in range(6):
            told += 1
            recorder.record(a_decision(told, paper_scenario()))
    time.sleep(0.01)
recorder.record(a_transition())
recorder.record_frame(frame)
recorder.close()
alarms = [alarm.text for alarm in recorder.alarms]
print(json.dumps([told, recorder.failure, recorder.lost_entries, recorder.lost_frames, alarms]))
"""


def test_a_disk_that_gets_full_is_an_alarm_and_no_more(tmp_path: Path) -> None:
    path = tmp_path / "chase.mcap"
    words = [sys.executable, "-W", "error", "-c", FULL, str(path), str(Path(__file__).parent)]
    ran = subprocess.run(words, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert (ran.returncode, ran.stderr) == (0, "")
    told, failure, lost_entries, lost_frames, alarms = json.loads(ran.stdout)
    assert failure == "cannot write the log: File too large"
    assert alarms == [f"{failure}; 1 frames and {lost_entries} transitions, decisions and events are lost"]
    recording = read_recording(path)
    assert recording.is_cut
    assert 0 < len(recording.decisions) == told + 1 - lost_entries
    expected = [a_decision(number, paper_scenario()) for number in range(1, len(recording.decisions) + 1)]
    assert list(map(bits, recording.decisions)) == list(map(bits, expected))
    assert lost_frames == 1


class SlowFile(io.FileIO):
    """A new file whose disk stops answering when it is told to."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "x")
        self.answers, self.is_waiting = threading.Event(), threading.Event()
        self.answers.set()

    def write(self, data: Any) -> int:
        if not self.answers.is_set():
            self.is_waiting.set()
            assert self.answers.wait(PATIENCE_S)
        return super().write(data)


@pytest.fixture
def slow_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SlowFile]:
    file = SlowFile(tmp_path / "chase.mcap")
    monkeypatch.setattr(recorder_module, "new_file", lambda path, what: io.BufferedWriter(file, 1))
    yield file
    file.answers.set()


def test_on_a_slow_disk_frames_are_lost_first_and_nobody_waits(slow_file: SlowFile, tmp_path: Path) -> None:
    recorder, frame = ChaseRecorder(tmp_path / "chase.mcap", head_for()), a_frame()
    slow_file.answers.clear()
    recorder.record(a_transition(0))
    assert slow_file.is_waiting.wait(PATIENCE_S)
    for _ in range(MOST_WAITING_FRAMES + 50):
        recorder.record_frame(frame)
    for number in range(1, MOST_WAITING - MOST_WAITING_FRAMES + 1):
        recorder.record(a_transition(number))
    assert (recorder.lost_frames, recorder.lost_entries, recorder.failure) == (50, 0, None)
    for _ in range(7):
        recorder.record(a_transition())
    assert (recorder.lost_frames, recorder.lost_entries, recorder.failure) == (50, 7, None)
    assert [alarm.text for alarm in recorder.alarms] == [
        "the log has lost 50 frames and 7 transitions, decisions and events"
    ]
    slow_file.answers.set()
    recorder.close()
    assert recorder.failure is None
    recording = read_recording(tmp_path / "chase.mcap")
    assert (recording.is_cut, recording.lost_frames, recording.lost_entries) == (False, 50, 7)
    assert recording.num_frames == MOST_WAITING_FRAMES
    told = range(MOST_WAITING - MOST_WAITING_FRAMES + 1)
    assert [transition.time_ns for transition in recording.transitions] == [BEGAN_NS + number for number in told]
    assert verify(recording).doubts == ("the recorder has lost 7 transitions, decisions and events",)


def test_a_disk_that_never_answers_does_not_keep_the_process(
    slow_file: SlowFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "CLOSE_S", 0.01)
    recorder = ChaseRecorder(tmp_path / "chase.mcap", head_for())
    slow_file.answers.clear()
    recorder.record(a_transition())
    recorder.close()
    assert recorder.failure == "cannot write the log: the disk does not answer"
    assert recorder._thread.daemon
    slow_file.answers.set()
    recorder._thread.join(PATIENCE_S)


def test_what_is_no_json_is_lost_and_the_rest_is_kept(tmp_path: Path) -> None:
    with ChaseRecorder(tmp_path / "chase.mcap", head_for()) as recorder:
        recorder.record_frame(Frame(**{**a_frame(), "spacing_m": math.nan}))
        recorder.record(a_decision())
    assert (recorder.failure, recorder.lost_frames, recorder.lost_entries) == (None, 1, 0)
    recording = read_recording(tmp_path / "chase.mcap")
    assert (len(recording.decisions), recording.num_frames, recording.lost_frames) == (1, 0, 1)


def test_after_the_end_nothing_is_recorded(tmp_path: Path) -> None:
    recorder = ChaseRecorder(tmp_path / "chase.mcap", head_for())
    recorder.close()
    recorder.close()
    recorder.record(a_transition())
    assert (recorder.lost_entries, read_recording(tmp_path / "chase.mcap").transitions) == (1, ())


# The same chase again


class RecordedWorld(SimulatedWorld):
    """Whose service records into a log, too."""

    def __init__(self, scenario: Scenario, controller: Controller, recorder: ChaseRecorder) -> None:
        super().__init__(scenario, controller, 4, 7)
        self.log = TwoLogs(recorder)
        self.service = self.new_service(epoch=3)
        self.service.start()


class TwoLogs(list[Transition | Decision]):
    def __init__(self, recorder: ChaseRecorder) -> None:
        super().__init__()
        self.recorder = recorder

    def append(self, entry: Transition | Decision) -> None:
        super().append(entry)
        self.recorder.record(entry)


@pytest.mark.parametrize(
    ("name", "changes", "most"),
    [
        ("gradient", {"sampling_hz": 100, "start_distance_m": 15.0}, 60),
        ("particle", {"sampling_hz": 100, "silent_trackers": 1, "missing_sample_share": 0.2}, 8),
        ("paper", {"sampling_hz": 100}, 8),
        ("random", {"sampling_hz": 100}, 8),
    ],
)
def test_the_log_of_a_live_chase_is_the_evaluated_chase_and_verifies(
    name: str, changes: dict[str, Any], most: int, tmp_path: Path
) -> None:
    """Movement by movement and bit for bit."""
    scenario, path = paper_scenario(**changes), tmp_path / "chase.mcap"
    course = evaluated(scenario, load_controller(name, scenario), 4, 7, most)
    with ChaseRecorder(path, head_for(name, scenario)) as recorder:
        world = RecordedWorld(scenario, load_controller(name, scenario), recorder)
        while len(world.decisions()) < len(course):
            world.step()
            assert world.clock.now_ns() < 600e9
        if most == 60:
            world.run_until(REACHED)
    recording = read_recording(path)
    assert list(recording.transitions) == [entry for entry in world.log if isinstance(entry, Transition)]
    assert len(recording.decisions) == len(course)
    for decision, (state, action) in zip(recording.decisions, course, strict=True):
        seen = state.observation()
        assert np.array_equal(decision.rssi_dbm, seen.rssi_dbm[0].double().numpy(), equal_nan=True)
        assert np.array_equal(decision.tracker_position_m, seen.tracker_position_m[0].numpy())
        assert decision.spacing_m == action.spacing_m.item()
        assert list(decision.displacement_m) == action.displacement_m[0].tolist()
    verification = verify(recording)
    assert (verification.decisions, verification.mismatches, verification.doubts) == (len(course), (), ())


@pytest.mark.parametrize(
    "change",
    [
        lambda decision: dataclasses.replace(decision, spacing_m=np.nextafter(decision.spacing_m, 9).item()),
        lambda decision: dataclasses.replace(decision, displacement_m=(0.0, 0.0, math.nan)),
        lambda decision: dataclasses.replace(decision, displacement_m=(99.0, *decision.displacement_m[1:])),
    ],
)
def test_an_action_that_was_changed_is_found(change: Callable[[Decision], Decision], tmp_path: Path) -> None:
    course = asked("particle", 5)
    original = course[2]
    course[2] = change(original)
    recording = read_recording(written(tmp_path / "chase.mcap", head_for("particle"), course))
    (mismatch,) = verify(recording).mismatches
    assert (mismatch.number, mismatch.movement, mismatch.reason) == (3, 3, "")
    assert mismatch.now == (original.spacing_m, *original.displacement_m)
    assert str(mismatch.recorded) == str((course[2].spacing_m, *course[2].displacement_m))


def test_a_window_or_a_seed_that_was_changed_is_found(tmp_path: Path) -> None:
    """One level of one tracker, by 6 dB; and another chase's random numbers."""
    course = asked("random", 5)
    recording = read_recording(written(tmp_path / "seed.mcap", head_for("random", seed=5), course))
    assert verify(recording).mismatches
    course = asked("particle", 5)
    course[1].rssi_dbm[0, 0] += 6
    recording = read_recording(written(tmp_path / "window.mcap", head_for("particle"), course))
    assert verify(recording).mismatches


class Scripted:
    """Counts in its memory; its second action is no number, its fourth an error."""

    name = "scripted"

    def __init__(self) -> None:
        self.asked = 0

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> int:
        return 0

    def decide(self, observation: Observation, memory: int) -> tuple[Action, int]:
        self.asked += 1
        if self.asked == 4:
            raise ArithmeticError("lost count")
        spacing_m = math.nan if self.asked == 2 else 1.0 + memory
        action = Action(torch.tensor([spacing_m], dtype=torch.float64), torch.zeros(1, 3, dtype=torch.float64))
        return action, memory + 1


def test_memory_is_kept_as_the_service_keeps_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    still = (0.0, 0.0, 0.0)
    spacings_m = [1.0, math.nan, 2.0, 3.0, 3.0]
    course = [
        dataclasses.replace(a_decision(number), spacing_m=spacing_m, displacement_m=still)
        for number, spacing_m in enumerate(spacings_m)
    ]
    recording = read_recording(written(tmp_path / "chase.mcap", head_for(), course))
    monkeypatch.setattr(verification_module, "load_controller", lambda name, scenario: Scripted())
    (mismatch,) = verify(recording).mismatches
    assert (mismatch.number, mismatch.now) == (4, None)
    assert mismatch.reason == "the controller failed: ArithmeticError: lost count"


def test_another_version_and_other_weights_are_told(tmp_path: Path) -> None:
    head = dataclasses.replace(head_for("particle"), version="0.0.1", weights_sha256="abc")
    verification = verify(read_recording(written(tmp_path / "chase.mcap", head, asked("particle", 2))))
    assert verification.is_same
    assert verification.doubts == (
        f"recorded by version 0.0.1, asked with {head_for().version}",
        "recorded with the weights abc, asked with None",
    )


def test_a_controller_that_is_not_there_is_refused(tmp_path: Path) -> None:
    head = dataclasses.replace(head_for(), controller="mine.safetensors")
    with pytest.raises(InputError, match=r"mine\.safetensors"):
        verify(read_recording(written(tmp_path / "chase.mcap", head, [a_decision()])))


# The command


def replayed(*words: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    """Exit code, standard output and standard error."""
    code: Any = 0
    try:
        main(["replay", *words])
    except SystemExit as end:
        code = end.code
    output = capsys.readouterr()
    return code or 0, output.out, output.err


def test_replay_prints_what_a_log_holds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    items = [a_transition(), *asked("particle", 3), a_frame(9), an_event(4 * 10**9)]
    path = written(tmp_path / "chase.mcap", head_for("particle"), items)
    code, out, err = replayed(str(path), "--json", "--verify", capsys=capsys)
    document = json.loads(out)
    expected = {
        "controller": "particle",
        "seed": 4,
        "chase": 7,
        "epoch": 3,
        "state": "sampling",
        "reason": "arrived",
        "movements": 3,
        "seconds": 9.0,
        "transitions": 1,
        "decisions": 3,
        "events": [{"time_ns": BEGAN_NS + 4 * 10**9, "severity": "critical", "text": "tracker 3 is lost"}],
        "frames": 1,
        "is_cut": False,
        "is_same": True,
        "doubts": [],
        "mismatches": [],
    }
    assert (code, {name: document[name] for name in expected}) == (0, expected)
    assert "All 3 decisions are the same, bit for bit." in err
    assert "    4.0 s  tracker 3 is lost" in err


def test_replay_tells_of_a_different_action_by_its_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    course = asked("particle", 3)
    course[1] = dataclasses.replace(course[1], spacing_m=math.inf)
    path = written(tmp_path / "chase.mcap", head_for("particle"), course)
    path.write_bytes(path.read_bytes()[:-300])
    code, out, err = replayed(str(path), "--verify", capsys=capsys)
    assert (code, out) == (1, "")
    assert "1 of 3 decisions are different:" in err
    code, out, err = replayed(str(path), "--verify", "--json", capsys=capsys)
    assert (code, [one["recorded"][0] for one in json.loads(out)["mismatches"]]) == (1, ["inf"])


def test_replay_says_that_a_log_is_cut(small_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "chase.mcap"
    path.write_bytes(small_log.read_bytes()[: chunk_bounds(small_log)[-1] - 1])
    code, out, err = replayed(str(path), "--json", capsys=capsys)
    document = json.loads(out)
    assert (code, document["is_cut"]) == (0, True)
    assert f"The log is not whole: {document['cut']}." in " ".join(err.split())


@pytest.mark.parametrize("words", [["--json"], ["--verify"], []])
def test_replay_refuses_a_broken_file_in_one_line(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "chase.mcap"
    path.write_bytes(b"not a log")
    code, out, err = replayed(str(path), *words, capsys=capsys)
    assert (code, out, err) == (2, "", f"swarmchase: {path} is no MCAP file\n")


def test_replay_refuses_to_show_a_log_without_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path / "chase.mcap", head_for(), [a_transition()])
    code, _, err = replayed(str(path), capsys=capsys)
    assert (code, err.splitlines()[-1]) == (
        2,
        f"swarmchase: the log {path} has no frames to show; --verify and --json work without",
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_replay_shows_the_chase_on_a_page_until_it_is_told_to_end(number: int, tmp_path: Path) -> None:
    pytest.importorskip("uvicorn")
    path = written(tmp_path / "chase.mcap", head_for(), [a_frame(1), a_frame(2)])
    words = [sys.executable, "-m", "swarmchase", "replay", str(path), "--page", "127.0.0.1:0"]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None
            lines = iter(process.stderr.readline, "")
            url = next(found[0] for line in lines if (found := re.search(r"http://\S+(?=;)", line)))
            with urllib.request.urlopen(url, timeout=PATIENCE_S) as answer:
                assert b"<html" in answer.read()
            process.send_signal(number)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()


def test_a_page_is_told_what_the_head_says() -> None:
    info = page_info(head_for(scenario=paper_scenario(sampling_hz=20)))
    assert json.loads(json.dumps(info)) == info
    assert (info["controller"], info["sampling_hz"], info["window_samples"]) == ("gradient", 20.0, 50)
    assert info["fence_m"] == {"low": [-200.0, -200.0, -150.0], "high": [200.0, 200.0, 150.0]}
    assert info["title"].startswith("chase 7 of seed 4, 20")
