"""The MAVLink link: what travels comes back, what is not the sender's to say is dropped and counted."""

import hashlib
import math
import os
import random
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from live_bench import FLYING
from swarmchase.errors import InputError
from swarmchase.live.link.messages import (
    MOST_NOTICES,
    MOST_PIECES,
    PIECE_CHARACTERS,
    FeedForward,
    Health,
    Heartbeat,
    Message,
    Notice,
    PositionReport,
    RssiWindow,
    SetPoint,
    Severity,
    TrackerMode,
    VehicleState,
)
from swarmchase.live.link.protocol import Link
from swarmchase.live.link.rejection import Reason, RejectedError

pytest.importorskip("pymavlink", reason="the MAVLink link needs pymavlink: pip install swarmchase[live]")

from swarmchase.live.link import codec, packet, state_file
from swarmchase.live.link import timestamps as timestamps_module
from swarmchase.live.link.codec import ReportDecoder, SetPointDecoder, system_of
from swarmchase.live.link.dialect import mavlink
from swarmchase.live.link.mavlink import MOST_DATAGRAMS, MOST_OF_ONE_SENDER, ControllerMavlinkLink, TrackerMavlinkLink
from swarmchase.live.link.packet import PacketReader, PacketWriter, Peer
from swarmchase.live.link.timestamps import UNIX_TIME_OF_2015_NS, Timestamps

DOCS = Path(__file__).parents[3] / "docs" / "link.md"
KEYS = {tracker: hashlib.sha256(b"key of tracker %d" % tracker).digest() for tracker in range(6)}
NOON_NS = 1_800_000_000 * 10**9
HOUR_NS = 3_600 * 10**9


class WallClock:
    """Real time that stands where it is put, and the monotonic clock, too: time that has passed, and no step."""

    def __init__(self, now_ns: int = NOON_NS) -> None:
        self.now_ns = now_ns

    def __call__(self) -> int:
        return self.now_ns


def window(tracker: int = 0, time_ns: int = 7_000_000_000) -> RssiWindow:
    return RssiWindow(tracker, time_ns, 10.0, (-61.5, math.nan, -60.25))


def position(tracker: int = 0, time_ns: int = 7_000_000_000) -> PositionReport:
    return PositionReport(tracker, time_ns, (1.5, -2.0, 30.25), (0.5, 0.25, -1.0))


def heartbeat(tracker: int = 0, time_ns: int = 7_000_000_000) -> Heartbeat:
    return Heartbeat(tracker, time_ns, TrackerMode.FOLLOWING, FLYING)


def set_point(tracker: int = 0, time_ns: int = 7_000_000_000, epoch: int = 3_000_000_001) -> SetPoint:
    return SetPoint(tracker, time_ns, epoch, (10.0, -20.5, 40.0))


REPORTS = (window, position, heartbeat)
SECOND_NS = 10**9
MINUTE_NS = 60 * SECOND_NS
SOON = (NOON_NS - UNIX_TIME_OF_2015_NS) // 10_000 + 100_000
"""A timestamp a second after noon."""


def timestamps_at(wall: Callable[[], int], senders: Sequence[int] = (), path: Path | None = None) -> Timestamps:
    return Timestamps(senders, path, wall, wall)


def tracker_writer(tracker: int = 0, wall: Callable[[], int] = lambda: NOON_NS) -> PacketWriter:
    return PacketWriter(system_of(tracker), codec.TRACKER_COMPONENT, timestamps_at(wall))


def controller_writer() -> PacketWriter:
    return PacketWriter(codec.CONTROLLER_SYSTEM, codec.CONTROLLER_COMPONENT, timestamps_at(WallClock()))


def controller_reader(keys: dict[int, bytes] | None = None) -> PacketReader:
    """It listens to trackers."""
    listened = dict.fromkeys(range(6)) if keys is None else keys
    peers = [Peer(k, system_of(k), codec.TRACKER_COMPONENT, key) for k, key in listened.items()]
    return PacketReader(peers, ReportDecoder(), timestamps_at(WallClock(), [system_of(k) for k in range(6)]))


def tracker_reader(tracker: int) -> PacketReader:
    """It listens to the controller."""
    peer = Peer(tracker, codec.CONTROLLER_SYSTEM, codec.CONTROLLER_COMPONENT, KEYS[tracker])
    return PacketReader([peer], SetPointDecoder(), timestamps_at(WallClock(), [peer.system]))


def read(reader: PacketReader, datagram: bytes) -> Message:
    return reader.open(datagram, *reader.claim(datagram))


def reason(reader: PacketReader, datagram: bytes) -> Reason | None:
    """Why it is dropped."""
    try:
        read(reader, datagram)
    except RejectedError as rejection:
        return rejection.reason
    return None


def signed(
    payload: Any,
    tracker: int = 0,
    *,
    system: int | None = None,
    component: int = codec.TRACKER_COMPONENT,
    link_id: int = 0,
    timestamp: int = (NOON_NS - UNIX_TIME_OF_2015_NS) // 10_000 + 1,
) -> bytes:
    """A pymavlink message packed and signed by pymavlink alone, with the tracker's key."""
    mav = mavlink.MAVLink(None, srcSystem=system_of(tracker) if system is None else system, srcComponent=component)
    mav.signing.secret_key, mav.signing.sign_outgoing = KEYS[tracker], True
    mav.signing.link_id, mav.signing.timestamp = link_id, timestamp
    datagram: bytes = payload.pack(mav)
    return datagram


def resealed(datagram: bytes, tracker: int) -> bytes:
    """Checksum and signature made right again after the bytes before them were changed."""
    payload_end = 10 + datagram[1]
    crc = mavlink.x25crc(datagram[1:payload_end])
    known = mavlink.mavlink_map.get(int.from_bytes(datagram[7:10], "little"))
    crc.accumulate(bytes([known.crc_extra if known else 0]))
    body = datagram[:payload_end] + crc.crc.to_bytes(2, "little") + datagram[-13:-6]
    return body + hashlib.sha256(KEYS[tracker] + body).digest()[:6]


def float32(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, width=32)


def vectors(bound: float) -> st.SearchStrategy[tuple[float, float, float]]:
    return st.tuples(float32(-bound, bound), float32(-bound, bound), float32(-bound, bound))


def whole(bound: int, unit: int = 1) -> st.SearchStrategy[int]:
    """0 and on, below ``bound`` units."""
    return st.integers(0, bound - 1).map(lambda number: number * unit)


TRACKERS = st.integers(0, 5)
LEVELS = st.lists(float32(-200, 50) | st.just(math.nan), min_size=1, max_size=50).map(tuple)
OBEYED_MS = st.none() | st.integers(0, 2**32 - 1)
WINDOWS = st.tuples(TRACKERS, whole(2**63 // 1000, 1000), float32(0.125, 10_000), LEVELS, OBEYED_MS)
POSITIONS = st.tuples(TRACKERS, whole(2**32, 10**6), vectors(100_000), vectors(200))
VEHICLES = st.builds(VehicleState, st.booleans(), st.sampled_from([None, False, True]), st.booleans())
HEARTBEATS = st.tuples(TRACKERS, whole(2**32, 10**6), st.sampled_from(TrackerMode), VEHICLES)
LINES = st.text(st.characters(min_codepoint=32, max_codepoint=126), min_size=1, max_size=PIECE_CHARACTERS)
NOTICES = st.tuples(
    TRACKERS, st.integers(1, MOST_NOTICES), st.sampled_from(Severity), LINES, st.integers(0, MOST_PIECES - 1)
)
HEALTHS = st.tuples(
    TRACKERS,
    *(st.none() | st.integers(0, most) for most in (100, 8, 254)),
    st.none() | st.integers(0, 35_999).map(lambda number: number / 100),
)
FEED_FORWARDS = st.builds(FeedForward, vectors(200), float32(0, 2), float32(0.125, 100))
SET_POINTS = st.tuples(
    TRACKERS, whole(2**63 // 10**6, 10**6), whole(2**32), vectors(100_000), st.none() | FEED_FORWARDS
)


@pytest.mark.parametrize(
    ("kind", "values"),
    [(RssiWindow, WINDOWS), (PositionReport, POSITIONS), (Heartbeat, HEARTBEATS), (Notice, NOTICES), (Health, HEALTHS)],
)
@given(data=st.data())
def test_a_report_comes_back_as_it_was_sent(
    kind: type[Message], values: st.SearchStrategy[Any], data: st.DataObject
) -> None:
    report = kind(*data.draw(values))
    datagram = tracker_writer(report.tracker).datagram(report, KEYS[report.tracker])
    heard = read(controller_reader(KEYS), datagram)
    assert repr(heard) == repr(report)  # their words, because NaN is not equal to itself


@given(SET_POINTS)
def test_a_set_point_comes_back_as_it_was_sent(values: tuple[Any, ...]) -> None:
    point = SetPoint(*values)
    datagram = controller_writer().datagram(point, KEYS[point.tracker])
    assert read(tracker_reader(point.tracker), datagram) == point


def test_numbers_are_rounded_to_single_precision_and_times_down() -> None:
    reader, writer = controller_reader(KEYS), tracker_writer()
    heard = read(reader, writer.datagram(RssiWindow(0, 1_999_999, 1 / 3, (-0.1,)), KEYS[0]))
    assert heard == RssiWindow(0, 1_999_000, 0.3333333432674408, (-0.10000000149011612,))
    heard = read(reader, writer.datagram(PositionReport(0, 2_999_999, (0.1, 0.0, 0.0)), KEYS[0]))
    assert heard == PositionReport(0, 2_000_000, (0.10000000149011612, 0.0, 0.0))


def test_north_east_and_down() -> None:
    """A tracker 3 m east, 5 m north and 7 m up that climbs."""
    report = PositionReport(0, 0, (3.0, 5.0, 7.0), (0.1, 0.2, 0.5))
    fields = codec.to_mavlink(report)
    assert (fields.x, fields.y, fields.z) == (5.0, 3.0, -7.0)
    assert (fields.vx, fields.vy, fields.vz) == (0.2, 0.1, -0.5)


def test_times_since_boot_go_on_after_their_32_bits() -> None:
    """A tracker up for 60 days: its RSSI windows say so, and the other messages follow."""
    reader, writer = controller_reader(KEYS), tracker_writer()
    days_60_ns = 60 * 86_400 * 10**9

    def heard_at(report: Message) -> int:
        return read(reader, writer.datagram(report, KEYS[0])).time_ns

    days_40_ns = 40 * 86_400 * 10**9
    first = tracker_writer().datagram(heartbeat(time_ns=days_40_ns), KEYS[0])
    assert read(controller_reader(KEYS), first).time_ns == days_40_ns, (
        "the first word of a tracker that is up for 40 days"
    )
    assert heard_at(heartbeat(time_ns=days_60_ns)) == days_60_ns - 2**32 * 10**6, "nothing better is known yet"
    assert heard_at(window(time_ns=days_60_ns)) == days_60_ns
    assert heard_at(position(time_ns=days_60_ns + 10**9)) == days_60_ns + 10**9
    assert heard_at(heartbeat(time_ns=days_60_ns - 10**9)) == days_60_ns - 10**9
    wrap_ns = 2 * 2**32 * 10**6
    assert heard_at(window(time_ns=wrap_ns - 10**9)) == wrap_ns - 10**9
    assert heard_at(position(time_ns=wrap_ns + 10**9)) == wrap_ns + 10**9, "over the next turn"
    assert heard_at(window(time_ns=10**9)) == 10**9, "the tracker has booted"
    assert heard_at(heartbeat(time_ns=2 * 10**9)) == 2 * 10**9


def test_a_stranger_with_pymavlink_and_the_key_reads_ours_and_is_read() -> None:
    stranger = mavlink.MAVLink(None)
    stranger.signing.secret_key = KEYS[2]
    datagram = tracker_writer(2).datagram(position(2), KEYS[2])
    fields = stranger.decode(bytearray(datagram))
    assert (fields.get_type(), fields.get_srcSystem(), fields.get_signed()) == ("LOCAL_POSITION_NED", 3, True)
    assert (fields.x, fields.y, fields.z) == (-2.0, 1.5, -30.25)
    theirs = signed(mavlink.MAVLink_local_position_ned_message(9, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0), 2)
    assert read(controller_reader(KEYS), theirs) == PositionReport(2, 9_000_000, (2.0, 1.0, -3.0))
    stranger.signing.secret_key = KEYS[3]
    with pytest.raises(mavlink.MAVError, match="Invalid signature"):
        stranger.decode(bytearray(datagram))


def rssi_fields(**changes: Any) -> Any:
    data = [10.0, 1.0, *[0.0] * 6, -60.0, *[0.0] * 49]
    for name, value in changes.items():
        if name.startswith("data"):
            data[int(name[4:])] = value
    return mavlink.MAVLink_debug_float_array_message(
        changes.get("time_usec", 0), changes.get("name", b"rssi_dbm"), changes.get("array_id", 1), data
    )


def position_fields(*values: float) -> Any:
    return mavlink.MAVLink_local_position_ned_message(0, *values)


def set_point_fields(**changes: Any) -> Any:
    fields = codec.to_mavlink(set_point())
    for name, value in changes.items():
        assert hasattr(fields, name)
        setattr(fields, name, value)
    return fields


GENUINE = tracker_writer(wall=lambda: NOON_NS + 10**9).datagram(window(), KEYS[0])
UNSIGNED = tracker_writer().datagram(window(), None)


def changed(datagram: bytes, place: int, value: int) -> bytes:
    assert datagram[place] != value
    return datagram[:place] + bytes([value]) + datagram[place + 1 :]


DROPPED = {
    "a giant": ("giant", GENUINE + bytes(300)),
    "281 bytes": ("giant", GENUINE + bytes(281 - len(GENUINE))),
    "nothing": ("truncated", b""),
    "half a header": ("truncated", GENUINE[:5]),
    "the last byte is missing": ("truncated", GENUINE[:-1]),
    "the signature is missing": ("truncated", GENUINE[:-13]),
    "text": ("malformed", b"hello, is anybody there?"),
    "less text": ("malformed", b"hello"),
    "half a header with an unknown flag": ("malformed", b"\xfd\x09\x02"),
    "MAVLink 1": ("malformed", changed(GENUINE, 0, 0xFE)),
    "an unknown flag": ("malformed", changed(GENUINE, 2, 0x03)),
    "a byte too many": ("malformed", GENUINE + b"\0"),
    "two packets in one": ("malformed", UNSIGNED[:24] + UNSIGNED),
    "not signed": ("unsigned", UNSIGNED),
    "signature and flag cut off": ("unsigned", changed(GENUINE[:-13], 2, 0)),
    "no such tracker": ("unknown sender", signed(rssi_fields(), system=7)),
    "the controller itself": ("unknown sender", signed(rssi_fields(), system=255)),
    "another component": ("unknown sender", signed(rssi_fields(), component=1)),
    "another link": ("unknown sender", signed(rssi_fields(), link_id=1)),
    "a message of others": ("unknown message", signed(mavlink.MAVLink_ping_message(0, 0, 0, 0))),
    "a set-point to the controller": ("unknown message", signed(set_point_fields())),
    "an id nobody knows": ("unknown message", changed(GENUINE, 9, 0x7F)),
    "a damaged level": ("bad checksum", changed(GENUINE, 70, GENUINE[70] ^ 1)),
    "a damaged checksum": ("bad checksum", changed(GENUINE, len(GENUINE) - 14, GENUINE[-14] ^ 1)),
    "a damaged signature": ("wrong key", changed(GENUINE, len(GENUINE) - 1, GENUINE[-1] ^ 1)),
    "a damaged timestamp": ("wrong key", changed(GENUINE, len(GENUINE) - 12, GENUINE[-12] ^ 1)),
    "another tracker's key": ("wrong key", tracker_writer(0).datagram(window(0), KEYS[1])),
    "speaks for another": ("wrong key", signed(rssi_fields(), 1, system=system_of(0))),
    "no key": ("wrong key", tracker_writer(0).datagram(window(0), bytes(32))),
    "signed yesterday": ("too old", signed(rssi_fields(), timestamp=1)),
    "signed in 2037": ("too far ahead", signed(rssi_fields(), timestamp=2**46)),
    "another array": ("wrong layout", signed(rssi_fields(name=b"spectrum"))),
    "another layout": ("wrong layout", signed(rssi_fields(array_id=2))),
    "no samples": ("refused value", signed(rssi_fields(data1=0.0))),
    "51 samples": ("refused value", signed(rssi_fields(data1=51.0))),
    "half a sample": ("refused value", signed(rssi_fields(data1=0.5))),
    "NaN samples": ("refused value", signed(rssi_fields(data1=math.nan))),
    "infinitely many samples": ("refused value", signed(rssi_fields(data1=math.inf))),
    "no rate": ("refused value", signed(rssi_fields(data0=math.nan))),
    "after the end of time": ("refused value", signed(rssi_fields(time_usec=2**64 - 1))),
    "nowhere": ("refused value", signed(position_fields(math.nan, 0, 0, 0, 0, 0))),
    "too far": ("refused value", signed(position_fields(0, 0, 100_001, 0, 0, 0))),
    "too fast": ("refused value", signed(position_fields(0, 0, 0, 0, 201, 0))),
    "no mode": ("refused value", signed(mavlink.MAVLink_heartbeat_message(18, 8, 1, 0, 4, 3))),
    "two modes": ("refused value", signed(mavlink.MAVLink_heartbeat_message(18, 8, 8 | 64, 0, 4, 3))),
}


@pytest.mark.parametrize("level_dbm", [0.0, 51.0, 127.0, -math.inf, math.nan])
def test_what_is_no_level_costs_a_window_that_sample_alone(level_dbm: float) -> None:
    """It is decided where the window is taken in."""
    heard = read(controller_reader(KEYS), signed(rssi_fields(data1=3.0, data9=level_dbm, data10=-61.0)))
    assert isinstance(heard, RssiWindow)
    assert repr(heard.rssi_dbm) == repr((-60.0, level_dbm, -61.0))


@pytest.mark.parametrize(("expected", "datagram"), DROPPED.values(), ids=DROPPED.keys())
def test_what_the_controller_drops(expected: str, datagram: bytes) -> None:
    reader = controller_reader(KEYS)
    assert reason(reader, datagram) == expected
    assert repr(read(reader, GENUINE)) == repr(window()), "and the genuine tracker is heard as before"


@pytest.mark.parametrize(
    ("expected", "changes"),
    [
        ("wrong layout", {"target_system": 2}),
        ("wrong layout", {"target_component": 1}),
        ("wrong layout", {"coordinate_frame": 8}),
        ("wrong layout", {"type_mask": 0}),
        ("refused value", {"x": math.nan}),
        ("refused value", {"z": 100_001.0}),
        ("refused value", {"afx": 65_536.0}),
        ("refused value", {"afy": 0.5}),
        ("refused value", {"afy": -1.0}),
        ("refused value", {"afz": math.inf}),
        ("refused value", {"afz": 3_000.0}),
    ],
)
def test_what_a_tracker_drops(expected: str, changes: dict[str, float]) -> None:
    reader = tracker_reader(0)
    sender = {"system": 255, "component": codec.CONTROLLER_COMPONENT}
    assert reason(reader, signed(set_point_fields(**changes), **sender)) == expected
    later = signed(set_point_fields(), timestamp=SOON, **sender)
    assert read(reader, later) == set_point()
    assert reason(reader, changed(later, 20, later[20] ^ 1)) == "bad checksum"


def test_the_epoch_is_under_the_signature() -> None:
    datagram = controller_writer().datagram(set_point(epoch=5), KEYS[0])
    other = controller_writer().datagram(set_point(epoch=6), KEYS[0])
    place = next(index for index in range(10, len(datagram)) if datagram[index] != other[index])
    assert reason(tracker_reader(0), changed(datagram, place, other[place])) == "bad checksum"
    body_of_other = other[:-13] + datagram[-13:]
    assert reason(tracker_reader(0), body_of_other) == "wrong key"


def test_a_tracker_without_a_key_is_not_listened_to() -> None:
    reader = controller_reader({0: KEYS[0], 2: KEYS[2]})
    assert reason(reader, tracker_writer(1).datagram(window(1), KEYS[1])) == "unknown sender"
    assert repr(read(reader, tracker_writer(2).datagram(window(2), KEYS[2]))) == repr(window(2))


def test_each_packet_counts_once_and_late_ones_not_at_all() -> None:
    reader, writer = controller_reader(KEYS), tracker_writer()
    first, second, third = (writer.datagram(heartbeat(time_ns=time_ns), KEYS[0]) for time_ns in (0, 10**6, 2 * 10**6))
    of_another = tracker_writer(1).datagram(heartbeat(1), KEYS[1])
    reasons = [reason(reader, datagram) for datagram in (first, third, third, second, first, of_another)]
    assert reasons == [None, None, "replayed", "replayed", "replayed", None]


def test_a_forged_packet_from_the_future_does_not_silence_its_tracker() -> None:
    """pymavlink 2.4.50's own check remembers the timestamp first, and checks the signature afterwards."""
    forged = tracker_writer(0, WallClock(NOON_NS + 1000 * HOUR_NS)).datagram(window(), KEYS[1])
    reader = controller_reader(KEYS)
    assert reason(reader, forged) == "wrong key"
    assert repr(read(reader, GENUINE)) == repr(window())
    theirs = mavlink.MAVLink(None)
    theirs.signing.secret_key = KEYS[0]
    for datagram in (forged, GENUINE):
        with pytest.raises(mavlink.MAVError, match="Invalid signature"):
            theirs.decode(bytearray(datagram))


# Whatever comes: anything but a rejection or a message that its tracker has signed is a fault.


def mutated(chance: random.Random) -> tuple[bytes, int | None]:
    """(a datagram, the tracker that has signed it so or None): genuine ones that were damaged, cut, mixed, or filled
    with nonsense by somebody who has a key; and nonsense."""
    tracker = chance.randrange(6)
    datagram = bytearray(chance.choice(CORPUS[tracker]))
    match chance.randrange(9):
        case 0:
            for _ in range(chance.randint(1, 8)):
                datagram[chance.randrange(len(datagram))] ^= 1 << chance.randrange(8)
        case 1:
            del datagram[chance.randrange(len(datagram)) :]
        case 2:
            datagram += chance.randbytes(chance.randint(1, 2000))
        case 3:
            datagram = bytearray(chance.randbytes(chance.randint(0, 300)))
        case 4:
            other = chance.choice(CORPUS[chance.randrange(6)])
            place = chance.randrange(len(datagram))
            datagram[place:] = other[min(place, len(other)) :]
        case 5:
            datagram[chance.randrange(10)] = chance.randrange(256)
        case 6:
            payload = chance.randbytes(chance.randint(0, 255))
            datagram[10:-15] = payload
            datagram[1] = len(payload)
            return resealed(bytes(datagram), tracker), tracker
        case 7:
            for _ in range(chance.randint(1, 8)):
                datagram[chance.randrange(10, len(datagram) - 15)] = chance.choice([0, 1, 0x7F, 0x80, 0xC0, 0xFF])
            return resealed(bytes(datagram), tracker), tracker
        case 8:
            datagram[2] = 0
            del datagram[-13:]
    return bytes(datagram), SIGNERS.get(bytes(datagram))


CORPUS = [
    [
        *(tracker_writer(tracker).datagram(report(tracker), KEYS[tracker]) for report in REPORTS),
        controller_writer().datagram(set_point(tracker), KEYS[tracker]),
    ]
    for tracker in range(6)
]
SIGNERS = {datagram: tracker for tracker in range(6) for datagram in CORPUS[tracker]}


def outcome(chance: random.Random) -> str:
    """The reason, or the kind of message that was let through; anything else escapes as an error."""
    datagram, signer = mutated(chance)
    is_set_point = len(datagram) > 5 and datagram[5] == codec.CONTROLLER_SYSTEM
    reader = tracker_reader(signer or 0) if is_set_point else controller_reader(KEYS)
    try:
        message = read(reader, datagram)
    except RejectedError as rejection:
        return str(rejection.reason)
    assert signer is not None, "nobody has signed this"
    assert message.tracker == signer
    return type(message).__name__


@settings(max_examples=3000, deadline=None)
@given(st.randoms(use_true_random=False))
def test_no_mutation_does_anything_but_count(chance: random.Random) -> None:
    outcome(chance)


@settings(max_examples=1000, deadline=None)
@given(st.binary(max_size=300) | st.binary(max_size=280).map(lambda rest: b"\xfd" + rest))
def test_random_bytes_are_rejected(datagram: bytes) -> None:
    for reader in (controller_reader(KEYS), controller_reader(), tracker_reader(0)):
        if (why := reason(reader, datagram)) is None:
            assert reader.claim(datagram)[1].key is None, "only where nothing is signed"
        else:
            assert why in set(Reason)


def test_the_mutations_reach_every_reason_and_every_message() -> None:
    """Else the two tests above would say little."""
    outcomes = Counter(outcome(random.Random(seed)) for seed in range(4000))
    missing = {*map(str, Reason), "RssiWindow", "PositionReport", "Heartbeat", "SetPoint"} - set(outcomes)
    assert missing == {"overflow", "replayed", "too old", "too far ahead"}  # these need time, or many packets


# Real sockets on 127.0.0.1.


class Ends:
    """A controller and its trackers, which are closed at the end."""

    def __init__(self) -> None:
        self.opened: list[Any] = []

    def controller(self, keys: dict[int, bytes] | None = KEYS, **options: Any) -> ControllerMavlinkLink:
        options.setdefault("wall_time_ns", WallClock())
        options.setdefault("monotonic_ns", options["wall_time_ns"])
        self.opened.append(ControllerMavlinkLink("127.0.0.1", 0, keys, **options))
        return self.opened[-1]

    def tracker(
        self, controller: ControllerMavlinkLink, number: int = 0, key: bytes | None = None, **options: Any
    ) -> TrackerMavlinkLink:
        options.setdefault("wall_time_ns", WallClock())
        options.setdefault("monotonic_ns", options["wall_time_ns"])
        key = None if options.get("unsigned") else (key or KEYS[number])
        self.opened.append(TrackerMavlinkLink(number, *controller.address, key, **options))
        return self.opened[-1]

    def attacker(self) -> socket.socket:
        self.opened.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        return self.opened[-1]


@pytest.fixture
def ends() -> Any:
    made = Ends()
    yield made
    for end in made.opened:
        end.close()


def received(end: ControllerMavlinkLink | TrackerMavlinkLink, number: int) -> list[Message]:
    """What comes until so many datagrams have been accepted or rejected; fails if they do not come."""
    messages: list[Message] = []
    before = end.rejected.total()
    for _ in range(5000):
        messages.extend(end.receive())
        if len(messages) + end.rejected.total() - before >= number:
            return messages
        end._socket.setblocking(True)
        end._socket.settimeout(0.001)
        try:
            end._socket.recv(1, socket.MSG_PEEK)
        except TimeoutError:
            pass
        finally:
            end._socket.setblocking(False)
    pytest.fail(f"{len(messages)} messages, {end.rejected}: {number} were expected")


def test_six_trackers_and_a_controller(ends: Ends) -> None:
    controller = ends.controller()
    trackers = [ends.tracker(controller, number) for number in range(6)]
    both: list[Link] = [controller, trackers[0]]
    assert [end.receive() for end in both] == [[], []]
    for number, tracker in enumerate(trackers):
        controller.send(set_point(number))  # to nobody yet
        for report in REPORTS:
            tracker.send(report(number))
    heard = received(controller, 18)
    assert [repr(message) for message in heard] == [repr(report(number)) for number in range(6) for report in REPORTS]
    for number, tracker in enumerate(trackers):
        controller.send(set_point(number, epoch=number))
        assert received(tracker, 1) == [set_point(number, epoch=number)]
    assert {end.rejected.total() for end in (controller, *trackers)} == {0}


def test_only_an_accepted_packet_tells_where_a_tracker_is(ends: Ends) -> None:
    controller, attacker = ends.controller(), ends.attacker()
    tracker = ends.tracker(controller)
    genuine = tracker_writer(wall=lambda: NOON_NS + SECOND_NS).datagram(heartbeat(), KEYS[0])
    tracker.send(heartbeat())
    received(controller, 1)
    wrong_value = signed(position_fields(math.nan, 0, 0, 0, 0, 0), timestamp=SOON)
    for forged in (tracker_writer().datagram(heartbeat(), KEYS[1]), UNSIGNED, wrong_value, genuine[:-1]):
        attacker.sendto(forged, controller.address)
    assert received(controller, 4) == []
    assert controller.rejected == {"wrong key": 1, "unsigned": 1, "refused value": 1, "truncated": 1}
    controller.send(set_point())
    assert received(tracker, 1) == [set_point()]
    # A tracker that dials anew, from another port, is answered there.
    attacker.sendto(signed(codec.to_mavlink(heartbeat()), timestamp=SOON + 1), controller.address)
    assert received(controller, 1) == [heartbeat()]
    controller.send(set_point())
    attacker.settimeout(5)
    assert attacker.recv(500)[5] == codec.CONTROLLER_SYSTEM
    assert tracker.receive() == []


def test_trackers_believe_the_key_and_not_the_address(ends: Ends) -> None:
    controller = ends.controller()
    tracker, other = ends.tracker(controller, 0), ends.tracker(controller, 1)
    tracker.send(heartbeat(0))
    other.send(heartbeat(1))
    received(controller, 2)
    port = tracker._socket.getsockname()[1]
    attacker = ends.attacker()
    for_other = controller_writer().datagram(set_point(1), KEYS[1])
    for datagram in (for_other, controller_writer().datagram(set_point(0), None), b"", os.urandom(64) + b"\0" * 400):
        attacker.sendto(datagram, ("127.0.0.1", port))
    assert received(tracker, 4) == []
    assert tracker.rejected == {"wrong key": 1, "unsigned": 1, "truncated": 1, "giant": 1}


def test_a_recording_played_back_is_rejected(ends: Ends) -> None:
    controller, attacker = ends.controller(), ends.attacker()
    writer = tracker_writer(wall=lambda: NOON_NS + SECOND_NS)
    recording = [writer.datagram(heartbeat(), KEYS[0]) for _ in range(20)]
    for datagram in recording:
        attacker.sendto(datagram, controller.address)
    assert len(received(controller, 20)) == 20
    for datagram in recording:
        attacker.sendto(datagram, controller.address)
    assert received(controller, 20) == []
    assert controller.rejected == {"replayed": 20}


@pytest.mark.parametrize("has_state", [True, False])
def test_no_replay_after_a_restart(ends: Ends, tmp_path: Path, has_state: bool) -> None:
    """With the state file not even of a tracker whose clock is almost a minute ahead."""
    wall = WallClock()
    path = tmp_path / "state" if has_state else None
    tracker_wall = WallClock(NOON_NS + (MINUTE_NS - SECOND_NS if has_state else 0))
    writer = tracker_writer(wall=tracker_wall)
    recording = [writer.datagram(heartbeat(), KEYS[0]) for _ in range(20)]
    controller, attacker = ends.controller(state_path=path, wall_time_ns=wall), ends.attacker()
    for datagram in recording[:10]:
        attacker.sendto(datagram, controller.address)
    assert len(received(controller, 10)) == 10
    controller.close()
    wall.now_ns += 10**9
    controller = ends.controller(state_path=path, wall_time_ns=wall)
    for datagram in recording[:10]:
        attacker.sendto(datagram, controller.address)
    assert received(controller, 10) == []
    assert controller.rejected == {"replayed" if has_state else "too old": 10}
    tracker_wall.now_ns += 2 * 10**9
    attacker.sendto(writer.datagram(heartbeat(), KEYS[0]), controller.address)
    assert received(controller, 1) == [heartbeat()], "the genuine tracker goes on"


def test_what_was_recorded_while_nobody_listened_is_too_old(ends: Ends, tmp_path: Path) -> None:
    wall = WallClock()
    ends.controller(state_path=tmp_path / "state", wall_time_ns=wall).close()
    recording = tracker_writer(wall=WallClock(NOON_NS + 10**9)).datagram(heartbeat(), KEYS[0])
    wall.now_ns += HOUR_NS
    controller = ends.controller(state_path=tmp_path / "state", wall_time_ns=wall)
    ends.attacker().sendto(recording, controller.address)
    assert received(controller, 1) == []
    assert controller.rejected == {"too old": 1}


def test_a_killed_process_has_remembered(tmp_path: Path) -> None:
    path = tmp_path / "state"
    program = (
        "import os, signal, sys; from pathlib import Path\n"
        "from swarmchase.live.link.timestamps import Timestamps\n"
        "timestamps = Timestamps([1, 2], Path(sys.argv[1]), lambda: 0)\n"
        "timestamps.accept(2, 100); timestamps.accept(2, 123456); timestamps.next_to_send()\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program, str(path)], check=False, timeout=60)
    assert ended.returncode == -signal.SIGKILL
    timestamps = timestamps_at(lambda: 0, [1, 2], path)
    with pytest.raises(RejectedError, match="replayed"):
        timestamps.accept(2, 123456)
    timestamps.accept(2, 123457)
    timestamps.accept(1, 100)
    assert timestamps.next_to_send() == 2
    timestamps.close()


def test_what_is_sent_rises_though_the_clock_is_put_back(tmp_path: Path) -> None:
    """By more than a minute, nobody accepts it any more: then it is real time again."""
    wall = WallClock()
    sent = []
    for step_ns in (0, SECOND_NS, -SECOND_NS, 2 * HOUR_NS):
        wall.now_ns += step_ns
        timestamps = timestamps_at(wall, [255], tmp_path / "state")
        sent += [timestamps.next_to_send() for _ in range(3)]
        wall.now_ns -= MINUTE_NS // 2
        sent += [timestamps.next_to_send() for _ in range(3)]
        wall.now_ns += MINUTE_NS // 2
        timestamps.close()
    assert sent == sorted(set(sent))
    noon = (NOON_NS - UNIX_TIME_OF_2015_NS) // 10_000
    assert sent[:7] == [*range(noon, noon + 6), noon + 100_000]
    wall.now_ns = NOON_NS
    timestamps = timestamps_at(wall, [255])
    assert timestamps.next_to_send() == noon
    wall.now_ns -= MINUTE_NS + SECOND_NS
    assert timestamps.next_to_send() == noon - 61 * 100_000


def test_a_clock_that_is_put_right_does_not_keep_trackers_out() -> None:
    wall = WallClock(NOON_NS + HOUR_NS)
    timestamps = timestamps_at(wall, [1])
    now = (NOON_NS - UNIX_TIME_OF_2015_NS) // 10_000
    with pytest.raises(RejectedError, match="too old"):
        timestamps.accept(1, now)
    wall.now_ns = NOON_NS
    timestamps.accept(1, now)
    with pytest.raises(RejectedError, match="replayed"):
        timestamps.accept(1, now)


def test_the_state_file(tmp_path: Path) -> None:
    path = tmp_path / "state"
    timestamps = timestamps_at(WallClock(), [1, 2], path)
    with pytest.raises(InputError, match="in use by another process"):
        timestamps_at(WallClock(), [1, 2], path)
    timestamps.close()
    timestamps.close()
    copy = tmp_path / "copy"
    shutil.copy(path, copy)
    with pytest.raises(InputError, match="broken or of another end"):
        timestamps_at(WallClock(), [255], copy)
    for content in (b"", b"\xff\xfe" * 40, path.read_bytes()[:-1], path.read_bytes() + b"1"):
        copy.write_bytes(content)
        with pytest.raises(InputError, match="broken or of another end"):
            timestamps_at(WallClock(), [1, 2], copy)
    with pytest.raises(InputError, match="state"):
        timestamps_at(WallClock(), [1], tmp_path)


def test_a_state_file_that_cannot_be_written_is_counted_and_does_not_stop_the_flight(
    ends: Ends, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = ends.controller(state_path=tmp_path / "state")
    tracker = ends.tracker(controller)

    def full(*_: Any) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(state_file.os, "pwrite", full)
    tracker.send(heartbeat())
    assert received(controller, 1) == [heartbeat()]
    assert controller.state_errors == 1


def test_a_flood_in_one_name_crowds_out_nobody_else(ends: Ends) -> None:
    controller, attacker = ends.controller(), ends.attacker()
    quiet = ends.tracker(controller, 4)
    forged = tracker_writer(1).datagram(heartbeat(1), KEYS[0])
    for _ in range(100):
        attacker.sendto(forged, controller.address)
    quiet.send(heartbeat(4))
    genuine = signed(codec.to_mavlink(heartbeat(1)), 1, timestamp=SOON)
    attacker.sendto(genuine, controller.address)
    heard = received(controller, 102)
    assert heard == [heartbeat(4), heartbeat(1)], "and of the loud one the newest wins"
    assert controller.rejected == {"overflow": 101 - MOST_OF_ONE_SENDER, "wrong key": MOST_OF_ONE_SENDER - 1}


def test_what_waited_before_anybody_listened_is_no_flood(ends: Ends) -> None:
    controller = ends.controller()
    early = ends.tracker(controller, 4)
    for _ in range(2 * MOST_OF_ONE_SENDER):
        early.send(heartbeat(4))
    controller.wait(1.0)
    controller.forget_waiting()
    early.send(heartbeat(4))
    assert received(controller, 1) == [heartbeat(4)]
    assert controller.rejected == {}


class EndlessSocket:
    """There is always one more datagram."""

    def __init__(self, datagrams: Sequence[bytes]) -> None:
        self.datagrams = datagrams
        self.num_reads = 0

    def recvfrom(self, size: int) -> tuple[bytes, Any]:
        self.num_reads += 1
        return self.datagrams[self.num_reads % len(self.datagrams)][:size], ("127.0.0.1", 1)

    def close(self) -> None:
        pass


def test_a_flood_without_end_takes_a_bounded_share_of_one_call(ends: Ends, monkeypatch: pytest.MonkeyPatch) -> None:
    """Counted, not timed: reads of the socket, and the expensive checks."""
    controller = ends.controller()
    controller._socket.close()
    forged = [tracker_writer(number).datagram(window(number), bytes(32)) for number in range(6)]
    endless = EndlessSocket([*forged, b"\xfd" * 3000, b"", UNSIGNED])
    controller._socket = endless  # type: ignore[assignment]
    checked = []
    monkeypatch.setattr(packet, "require_signature", lambda *args: checked.append(args))
    monkeypatch.setattr(packet, "require_checksum", lambda *args: checked.append(args))
    monkeypatch.setattr(Timestamps, "accept", lambda *args: None)
    for call in (1, 2):
        assert len(controller.receive()) == 6 * MOST_OF_ONE_SENDER
        assert endless.num_reads == call * MOST_DATAGRAMS
        assert len(checked) == call * 2 * 6 * MOST_OF_ONE_SENDER
    assert controller.rejected.total() == 2 * (MOST_DATAGRAMS - 6 * MOST_OF_ONE_SENDER)
    assert set(controller.rejected) == {"overflow", "giant", "truncated", "unsigned"}


def test_nobody_at_the_other_end_is_no_error(ends: Ends) -> None:
    controller = ends.controller()
    tracker = ends.tracker(controller)
    tracker.send(heartbeat())
    received(controller, 1)
    controller.close()
    for _ in range(5):
        tracker.send(heartbeat())
        assert tracker.receive() == []
    assert tracker.rejected.total() == 0
    tracker.close()
    tracker.send(heartbeat())
    assert tracker.receive() == []


def test_ends_say_only_what_is_theirs(ends: Ends) -> None:
    controller = ends.controller()
    tracker = ends.tracker(controller, 1)
    with pytest.raises(TypeError, match="controller does not send a Heartbeat"):
        controller.send(heartbeat())
    with pytest.raises(TypeError, match="tracker does not send a SetPoint"):
        tracker.send(set_point())
    with pytest.raises(ValueError, match="tracker 1 does not speak for tracker 0"):
        tracker.send(heartbeat(0))


def test_without_keys_on_the_loopback_interface_if_asked_for(ends: Ends) -> None:
    controller = ends.controller(None, unsigned=True)
    tracker = ends.tracker(controller, 3, unsigned=True)
    assert tracker._socket.getsockname()[0] == "127.0.0.1", "nothing from outside reaches it"
    tracker.send(window(3))
    assert repr(received(controller, 1)) == repr([window(3)])
    controller.send(set_point(3))
    assert received(tracker, 1) == [set_point(3)]
    signed_one = ends.tracker(controller, 4)
    signed_one.send(window(4))
    assert received(controller, 1) == []
    assert controller.rejected == {"wrong key": 1}, "a signature that nobody can check is worth nothing"


@pytest.mark.parametrize(
    ("arguments", "options", "what"),
    [
        (("127.0.0.1", 0), {}, "needs keys"),
        (("127.0.0.1", 0, {}), {}, "no key"),
        (("127.0.0.1", 0, KEYS), {"unsigned": True}, "only one of them"),
        (("0.0.0.0", 0), {"unsigned": True}, "only the loopback interface is allowed, not 0.0.0.0"),
        (("127.0.0.1", 0, {0: b"short"}), {}, "5 bytes: needed are 32"),
        (("127.0.0.1", 0, {0: KEYS[0], 1: KEYS[0]}), {}, "same key"),
        (("127.0.0.1", 0, {6: KEYS[0]}), {}, "tracker 6 is refused"),
        (("127.0.0.1", 65_536, KEYS), {}, "port 65536"),
        (("a" * 300, 0, KEYS), {}, "cannot find host"),
        (("192.0.2.1", 0, KEYS), {}, "cannot bind UDP port 0 of 192.0.2.1"),
    ],
)
def test_controllers_that_cannot_be(arguments: tuple[Any, ...], options: dict[str, Any], what: str) -> None:
    with pytest.raises(InputError, match=what):
        ControllerMavlinkLink(*arguments, **options)


def test_trackers_that_cannot_be() -> None:
    with pytest.raises(InputError, match="tracker = 6"):
        TrackerMavlinkLink(6, "127.0.0.1", 14_550, KEYS[0])
    with pytest.raises(InputError, match="needs keys"):
        TrackerMavlinkLink(0, "127.0.0.1", 14_550)
    with pytest.raises(InputError, match="only the loopback interface is allowed"):
        TrackerMavlinkLink(0, "192.0.2.1", 14_550, unsigned=True)


def test_a_port_in_use_is_one_clear_line(ends: Ends, tmp_path: Path) -> None:
    host, port = ends.controller().address
    with pytest.raises(InputError, match=f"cannot bind UDP port {port} of {re.escape(host)}: Address already in use"):
        ControllerMavlinkLink(host, port, KEYS, state_path=tmp_path / "state")
    # Nor does a state file in use keep the port.
    ends.controller(state_path=tmp_path / "state")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        free = probe.getsockname()[1]
    with pytest.raises(InputError, match="in use by another process"):
        ControllerMavlinkLink("127.0.0.1", free, KEYS, state_path=tmp_path / "state")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", free))


def in_a_fresh_process(program: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", program], check=True, timeout=60, capture_output=True, text=True
    ).stdout.strip()


def test_the_link_stays_small() -> None:
    """It runs on the small computer of a tracker, where the whole agent has 80 MB."""
    program = (
        "import re, sys\n"
        "import swarmchase.live.link.mavlink, swarmchase.live.link.keys\n"
        "heavy = {'torch', 'numpy', 'scipy', 'lxml', 'pyarrow'} & set(sys.modules)\n"
        "most_kb = int(re.search(r'VmHWM:\\s*(\\d+) kB', open('/proc/self/status').read())[1])\n"
        "print(sorted(heavy), most_kb < 45_000)\n"
    )
    assert in_a_fresh_process(program) == "[] True"


def test_without_pymavlink_one_line_names_the_extra() -> None:
    program = (
        "import sys\n"
        "sys.modules['pymavlink'] = None\n"
        "from swarmchase.errors import InputError\n"
        "try:\n"
        "    import swarmchase.live.link.mavlink\n"
        "except InputError as error:\n"
        "    print(error)\n"
        "import swarmchase.live.link.messages, swarmchase.live.link.protocol, swarmchase.live.link.keys\n"
    )
    assert in_a_fresh_process(program) == "the MAVLink link needs pymavlink: pip install 'swarmchase[live]'"


# docs/link.md is what strangers implement from: it must be the code's.

DOCS_KEY = bytes(range(32))
DOCS_EXAMPLES: dict[str, Message] = {
    "RssiWindow": RssiWindow(0, 7_000_000_000, 10.0, (-61.5, -60.25), 70_000),
    "PositionReport": PositionReport(0, 7_000_000_000, (1.5, -2.0, 30.25), (0.5, 0.25, -1.0)),
    "Heartbeat": Heartbeat(0, 7_000_000_000, TrackerMode.FOLLOWING, FLYING),
    "Notice": Notice(0, 3, Severity.WARNING, "PreArm: Compass not calibrated"),
    "Health": Health(0, 87, 3, 14, 271.5),
    "SetPoint": SetPoint(0, 7_000_000_000, 3_000_000_001, (10.0, -20.5, 40.0), FeedForward((6.0, 8.0, -0.5), 1.5, 4.0)),
}


def docs_section(title: str) -> str:
    """From a heading that starts so to the next heading."""
    found = re.search(
        rf"^#+ {re.escape(title)}.*?(?=^#|\Z)", DOCS.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )
    assert found, f"docs/link.md has no section {title}"
    return found[0]


def docs_rows(section: str) -> list[list[str]]:
    """The cells of its tables, without title rows."""
    rows = [
        [cell.strip(" `") for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:1] == "|"
    ]
    rules = [index for index, row in enumerate(rows) if set(row[0]) == {"-"}]
    return [row for index, row in enumerate(rows) if index not in rules and index + 1 not in rules]


@pytest.mark.parametrize("name", DOCS_EXAMPLES)
def test_docs_message_map(name: str) -> None:
    section, example = docs_section(f"`{name}`"), DOCS_EXAMPLES[name]
    writer = controller_writer() if isinstance(example, SetPoint) else tracker_writer()
    datagram = writer.datagram(example, DOCS_KEY)
    assert "".join(section.split("```")[1].split()) == datagram.hex(), "the packet"
    fields = mavlink.MAVLink(None).decode(bytearray(datagram))
    assert section.splitlines()[0].startswith(f"### `{name}`: {fields.get_type()} ({fields.get_msgId()}), ")
    rows = [row for row in docs_rows(section) if len(row) == 4]
    types = dict(zip(fields.fieldnames, fields.fieldtypes, strict=True))
    assert list(dict.fromkeys(row[0].split("[")[0] for row in rows)) == fields.fieldnames
    places = []
    for field, field_type, _, value in rows:
        field_name, _, place = field.rstrip("]").partition("[")
        assert field_type == types[field_name], field
        held = getattr(fields, field_name)
        if place:
            first, _, last = place.partition("..")
            places += range(int(first), int(last or first) + 1)
            shown = [float(number) for number in value.split(",")]
            assert held[int(first) : int(first) + len(shown)] == shown, field
        else:
            assert str(held if isinstance(held, str) else f"{held:.10g}") == value, field
    assert places == list(range(len(fields.data) if name == "RssiWindow" else 0))


def test_docs_vehicle() -> None:
    rows = [row for row in docs_rows(docs_section("`Heartbeat`")) if len(row) == 2]
    states, flags = mavlink.enums["MAV_STATE"], mavlink.enums["MAV_MODE_FLAG"]
    airborne = {None: "unknown", False: "on the ground", True: "in the air"}
    assert rows == [
        [f"`base_mode`, {codec.ARMED_FLAG} ({flags[codec.ARMED_FLAG].name})".strip("`"), "armed"],
        [f"`base_mode`, {codec.SIMULATED_FLAG} ({flags[codec.SIMULATED_FLAG].name})".strip("`"), "simulated"],
        *(
            [f"`system_status`, {state} ({states[state].name})".strip("`"), airborne[is_airborne]]
            for is_airborne, state in codec.AIRBORNE_STATES.items()
        ),
    ]


def test_docs_modes() -> None:
    rows = [row for row in docs_rows(docs_section("`Heartbeat`")) if len(row) == 3]
    told = {row[0]: row[1] for row in rows}
    flags = codec.MODE_FLAGS
    names = {flag: mavlink.enums["MAV_MODE_FLAG"][flag].name for flag in flags.values()}
    assert told == {mode.name: f"{flag} ({names[flag]})" for mode, flag in flags.items()}


def test_docs_ids_and_limits() -> None:
    told = {row[0]: row[1] for row in docs_rows(docs_section("Who speaks to whom"))}
    assert told == {
        "system id of tracker k (0 to 5)": f"k + {system_of(0)}",
        "component id of a tracker": f"{codec.TRACKER_COMPONENT} (MAV_COMP_ID_ONBOARD_COMPUTER)",
        "system id of the controller": str(codec.CONTROLLER_SYSTEM),
        "component id of the controller": f"{codec.CONTROLLER_COMPONENT} (MAV_COMP_ID_MISSIONPLANNER)",
        "link id in signatures": str(packet.LINK_ID),
        "longest datagram": f"{packet.LONGEST_PACKET_BYTES} bytes",
    }
    flood = " ".join(docs_section("What is rejected").split("\n\n")[-1].split())
    assert f"One call takes {MOST_DATAGRAMS} datagrams" in flood
    assert f"newest {MOST_OF_ONE_SENDER} of each sender" in flood
    timestamp = (NOON_NS - UNIX_TIME_OF_2015_NS) // timestamps_module.UNIT_NS
    assert f"timestamp {timestamp} (15 January 2027, 08:00:00 UTC)" in docs_section("Messages")
    assert DOCS_KEY.hex() in docs_section("Messages")


def test_docs_reasons() -> None:
    assert [row[0] for row in docs_rows(docs_section("What is rejected"))] == [str(reason) for reason in Reason]
