"""Captures of packets: containers, radiotap headers, who transmits, Remote ID."""

import contextlib
import os
import struct
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmchase.errors import InputError
from swarmchase.live.tracker.captures.radiotap import Radiotap, parse_radiotap
from swarmchase.live.tracker.captures.wifi_frame import transmitter_address, transmitter_names
from swarmchase.live.tracker.sources import PcapSource, ReplaySource, Transmitters, pcap_rows
from swarmchase.live.tracker.sources.address import open_source
from swarmchase.live.tracker.sources.captured_levels import CapturedLevels
from swarmchase.live.tracker.sources.kind import SourceDetails

SECOND_NS = 1_000_000_000
ADDRESS = "02:00:00:00:00:07"


def radiotap(words: list[int], fields: bytes) -> bytes:
    header = struct.pack("<BBH", 0, 0, 4 + 4 * len(words) + len(fields))
    return header + b"".join(struct.pack("<I", word) for word in words) + fields


def bits(*numbers: int) -> int:
    return sum(1 << number for number in numbers)


@pytest.mark.parametrize(
    ("header", "signal_dbm", "bad_fcs"),
    [
        (radiotap([bits(5)], b"\xc4"), -60, False),
        (radiotap([bits(5)], b"\x7f"), 127, False),
        (radiotap([0], b""), None, False),
        (radiotap([bits(6, 11)], b"\xa0\x01"), None, False),  # only the noise and the antenna
        (radiotap([bits(1, 5)], b"\x40\xc4"), -60, True),
        # Flags and rate, channel (2-aligned), signal: what most drivers write.
        (radiotap([bits(1, 2, 3, 5)], b"\x10\x02" + struct.pack("<HH", 5745, 0x140) + b"\xc3"), -61, False),
        # A rate alone puts the channel on an even byte.
        (radiotap([bits(2, 3, 5)], b"\x02\x99" + struct.pack("<HH", 5745, 0x140) + b"\xc3"), -61, False),
        # TSFT is 8-aligned from the beginning of the header: with one word at 8, with two at 16.
        (radiotap([bits(0, 5)], b"\x00" * 8 + b"\xc2"), -62, False),
        (radiotap([bits(0, 5, 31), bits(11)], b"\x99" * 4 + b"\x00" * 8 + b"\xc2\x01"), -62, False),
        # Two antennas, each with a word of its own behind the common one: the common one counts.
        (radiotap([bits(5, 29, 31), bits(5, 11, 29, 31), bits(5, 11)], b"\xc1\xc0\x00\xbf\x01"), -63, False),
        # No common one.
        (radiotap([bits(2, 29, 31), bits(5, 11)], b"\x02\xc0\x00"), -64, False),
        # A vendor's fields are jumped over (its head is 2-aligned), its bits mean nothing, and our space begins again.
        (
            radiotap(
                [bits(2, 30, 31), bits(2, 6, 29, 31), bits(5)],
                b"\x02\x99" + b"\x00\x11\x22\x01" + b"\x03\x00" + b"\x01\x02\x03" + b"\xbf",
            ),
            -65,
            False,
        ),
        # Without a reset the second word's bits are 32 and up, which nobody has defined.
        (radiotap([bits(2, 31), bits(5)], b"\x02\xc0"), None, False),
        # TLVs follow: what came before counts.
        (radiotap([bits(5, 28)], b"\xbe\x00\x00\x00\x01\x00\x01\x00\x07"), -66, False),
        (radiotap([bits(2, 28, 29, 31), bits(5)], b"\x02\xc0"), None, False),
        # It ends before the field.
        (radiotap([bits(0, 5)], b"\x00" * 8), None, False),
    ],
)
def test_radiotap_headers(header: bytes, signal_dbm: int | None, bad_fcs: bool) -> None:
    assert parse_radiotap(header + b"frame") == Radiotap(len(header), signal_dbm, bad_fcs)


@pytest.mark.parametrize(
    ("bit", "padding", "size"),
    [
        # radiotap.org's list of fields: name, alignment, size.
        (3, 1, 4),  # channel, 2, 4
        (14, 1, 2),  # RX flags, 2, 2
        (16, 0, 1),  # RTS retries, 1, 1
        (18, 3, 8),  # XChannel, 4, 8
        (19, 0, 3),  # MCS, 1, 3
        (20, 3, 8),  # A-MPDU status, 4, 8
        (21, 1, 12),  # VHT, 2, 12
        (22, 3, 12),  # timestamp, 8, 12
        (23, 1, 12),  # HE, 2, 12
        (24, 1, 12),  # HE-MU, 2, 12
        (25, 1, 6),  # HE-MU-other-user, 2, 6
        (26, 0, 1),  # 0-length-PSDU, 1, 1
        (27, 1, 4),  # L-SIG, 2, 4
    ],
)
def test_fields_before_the_signal(bit: int, padding: int, size: int) -> None:
    """The rate is byte 12, so that the next field begins at 13, 14 or 16."""
    fields = b"\x02" + b"\x99" * padding + b"\x55" * size + b"\xc4"
    header = parse_radiotap(radiotap([bits(2, bit, 29, 31), bits(5)], fields))
    assert header is not None
    assert header.antenna_signal_dbm == -60


@pytest.mark.parametrize(
    "packet",
    [
        b"",
        b"\x00" * 7,
        b"\x01" + radiotap([bits(5)], b"\xc4")[1:],  # another version
        radiotap([bits(5)], b"\xc4")[:-1],  # cut
        radiotap([bits(5, 31)], b"\xc4"),  # the second word is missing
        struct.pack("<BBHI", 0, 0, 4, bits(5)) + b"\xc4",  # shorter than itself
        struct.pack("<BBHI", 0, 0, 9, bits(31)) + b"\xc4" * 4,  # the second word lies behind it
    ],
)
def test_broken_radiotap_headers(packet: bytes) -> None:
    assert parse_radiotap(packet) is None


@settings(deadline=None)
@given(
    st.binary(max_size=80)
    | st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=4).map(lambda w: radiotap(w, b"\xc4" * 40))
)
def test_any_packet_has_a_header_or_none(packet: bytes) -> None:
    header = parse_radiotap(packet)
    if header is not None:
        assert 8 <= header.length <= len(packet)
        assert header.antenna_signal_dbm is None or -128 <= header.antenna_signal_dbm <= 127


def file_header(byte_order: str = "<", magic: int = 0xA1B2C3D4, link_type: int = 127) -> bytes:
    return struct.pack(byte_order + "IHHiIII", magic, 2, 4, 0, 0, 65535, link_type)


def captured(
    signal_dbm: int, seconds: int = 0, ticks: int = 0, byte_order: str = "<", frame: bytes = b"", flags: int = 0
) -> bytes:
    packet = radiotap([bits(1, 5)], struct.pack("Bb", flags, signal_dbm)) + frame
    return struct.pack(byte_order + "IIII", seconds, ticks, len(packet), len(packet)) + packet


def frame_of(address: str, control: int = 0x08) -> bytes:
    """A data frame: control, duration, receiver, transmitter."""
    return struct.pack("<BBH", control, 0, 0) + b"\xff" * 6 + bytes.fromhex(address.replace(":", "")) + b"\x00" * 8


@pytest.mark.parametrize("byte_order", ["<", ">"])
@pytest.mark.parametrize(("magic", "ticks"), [(0xA1B2C3D4, 500_000), (0xA1B23C4D, 500_000_000)])
def test_captures_of_either_byte_order_and_resolution(tmp_path: Path, byte_order: str, magic: int, ticks: int) -> None:
    path = tmp_path / "capture.pcap"
    packets = captured(-60, 1000, 0, byte_order) + captured(-61, 1001, ticks, byte_order)
    # The upper bits of the link type tell the length of the check sequence.
    path.write_bytes(file_header(byte_order, magic, 0x5400_007F) + packets + b"\x00" * 9)
    assert list(pcap_rows(path)) == [(1000, -60), (1001.5, -61)]
    assert ReplaySource(pcap_rows(path)).read(SECOND_NS) == [(SECOND_NS, -60)]


def test_only_the_frames_of_one_transmitter() -> None:
    parser = CapturedLevels(Transmitters(ADDRESS))
    other = "02:00:00:00:00:08"
    packets = [
        captured(-60, frame=frame_of(ADDRESS)),
        captured(-61, frame=frame_of(other)),
        captured(-62, frame=frame_of(ADDRESS), flags=0x40),  # damaged: whose it is is not known
        captured(-63, frame=frame_of(ADDRESS, control=0xD4)),  # ACK: no transmitter in it
        captured(-64, frame=frame_of(ADDRESS)[:15]),
        captured(-65, frame=frame_of(ADDRESS, control=0x80)),  # beacon
        captured(-66),
    ]
    assert [level for _, level in parser.feed(file_header() + b"".join(packets))] == [-60, -65]
    assert parser.rejected == {"of another transmitter": 5}
    assert parser.rejected.seen("of another transmitter") == [other]
    assert transmitter_address(frame_of(other)) == bytes.fromhex("020000000008")


def test_a_growing_capture(tmp_path: Path) -> None:
    path = tmp_path / "capture.pcap"
    without_level = struct.pack("<IIII", 9, 0, 8, 8) + radiotap([0], b"")
    path.write_bytes(file_header() + without_level + captured(-1, 10))
    source = PcapSource(path)
    assert source.read(5 * SECOND_NS) == []  # what it held before is not how things are now
    assert source.rejected == {}
    with open(path, "ab") as file:
        packet = captured(-60, 20)
        file.write(packet[:20])
        file.flush()
        assert source.read(6 * SECOND_NS) == []
        file.write(packet[20:] + captured(-61, 20, 250_000))
        file.flush()
        assert [level_dbm for _, level_dbm in source.read(7 * SECOND_NS)] == [-60, -61]
        file.write(captured(-62, 20, 750_000))
        file.flush()
        # Half a second after the packet before, by the capturing clock.
        assert source.read(8 * SECOND_NS) == [(7 * SECOND_NS + 500_100_000, -62)]
        file.write(struct.pack("<IIII", 0, 0, 2**31, 0) + captured(-63, 21))
        file.flush()
        assert source.read(9 * SECOND_NS) == []
        file.write(captured(-64, 22))
        file.flush()
        assert source.read(10 * SECOND_NS) == []
    assert source.rejected == {"broken capture": 1}
    source.close()


def test_a_capture_from_a_pipe(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    source = PcapSource(path)
    assert source.read(5) == []
    writing = os.open(path, os.O_WRONLY)
    os.write(writing, file_header() + captured(-60, 20))
    assert source.read(5) == [(5, -60)]
    os.close(writing)
    assert source.read(6) == []
    source.close()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot read"),
        (b"x" * 24, "no pcap"),
        (b"\x0a\x0d\x0d\x0a" + b"\x00" * 30, "pcapng"),
        (file_header(link_type=105), "link type 105"),
    ],
)
def test_refused_captures(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "capture.pcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        PcapSource(path)
    with pytest.raises(InputError, match=message):
        list(pcap_rows(path))


@settings(deadline=None)
@given(st.lists(st.binary(max_size=60) | st.just(captured(-60)), max_size=10), st.integers(1, 100))
def test_any_capture_is_read_the_same_in_any_pieces(parts: list[bytes], size: int) -> None:
    content = b"".join(parts)
    whole, in_pieces = CapturedLevels(Transmitters()), CapturedLevels(Transmitters())
    expected = whole.feed(file_header() + content)
    in_pieces.feed(file_header())
    found = [
        sample for start in range(0, len(content), size) for sample in in_pieces.feed(content[start : start + size])
    ]
    assert found == expected
    assert in_pieces.rejected == whole.rejected


@settings(deadline=None)
@given(st.binary(max_size=60))
def test_any_file_is_a_capture_or_refused(content: bytes) -> None:
    with contextlib.suppress(InputError):
        assert CapturedLevels(Transmitters()).feed(content) == []


# pcapng


def block(kind: int, body: bytes, byte_order: str = "<") -> bytes:
    body += b"\x00" * (-len(body) % 4)
    length = struct.pack(byte_order + "I", 12 + len(body))
    return struct.pack(byte_order + "I", kind) + length + body + length


def section(byte_order: str = "<") -> bytes:
    """Magic, version 1.0, of unknown length."""
    return block(0x0A0D0D0A, struct.pack(byte_order + "IHHq", 0x1A2B3C4D, 1, 0, -1), byte_order)


def option(code: int, value: bytes, byte_order: str = "<") -> bytes:
    return struct.pack(byte_order + "HH", code, len(value)) + value + b"\x00" * (-len(value) % 4)


def interface(link_type: int = 127, options: bytes = b"", byte_order: str = "<") -> bytes:
    return block(1, struct.pack(byte_order + "HHI", link_type, 0, 262_144) + options, byte_order)


def enhanced(signal_dbm: int, ticks: int, number: int = 0, byte_order: str = "<", frame: bytes = b"") -> bytes:
    packet = radiotap([bits(5)], struct.pack("b", signal_dbm)) + frame
    head = struct.pack(byte_order + "IIIII", number, ticks >> 32, ticks & 0xFFFFFFFF, len(packet), len(packet))
    comment = option(1, b"seen", byte_order) + option(0, b"", byte_order)
    return block(6, head + packet + b"\x00" * (-len(packet) % 4) + comment, byte_order)


@pytest.mark.parametrize("byte_order", ["<", ">"])
@pytest.mark.parametrize(
    ("options", "ticks_per_second", "offset_s"),
    [
        (b"", 10**6, 0),
        ("nanoseconds", 10**9, 0),
        ("a binary fraction", 2**10, 0),
        ("behind an offset", 10**6, 1000),
    ],
)
def test_pcapng_of_either_byte_order_and_any_resolution(
    tmp_path: Path, byte_order: str, options: object, ticks_per_second: int, offset_s: int
) -> None:
    said = {
        "nanoseconds": option(9, b"\x09", byte_order),
        "a binary fraction": option(2, b"wlan0mon", byte_order) + option(9, b"\x8a", byte_order),
        "behind an offset": option(14, struct.pack(byte_order + "q", 1000), byte_order) + option(0, b"", byte_order),
    }
    path = tmp_path / "capture.pcapng"
    statistics = block(5, b"\x00" * 12, byte_order)
    path.write_bytes(
        section(byte_order)
        + interface(1, b"", byte_order)  # another one without radiotap
        + interface(127, said.get(str(options), b""), byte_order)
        + enhanced(-60, 2000 * ticks_per_second, 1, byte_order)
        + statistics
        + enhanced(-99, 2000 * 10**6, 0, byte_order)
        + enhanced(-61, 2001 * ticks_per_second + ticks_per_second // 2, 1, byte_order)
        + enhanced(-62, 0, 1, byte_order)[:-1]
    )
    assert list(pcap_rows(path)) == [(2000 + offset_s, -60), (2001.5 + offset_s, -61)]
    source = open_source(f"replay:{path}", SourceDetails())
    assert source.read(SECOND_NS) == [(SECOND_NS, -60)]
    assert source.rejected == {}
    source.close()


def test_what_of_a_pcapng_gives_no_level() -> None:
    levels = CapturedLevels(Transmitters())
    packet = radiotap([bits(5)], b"\xc4")
    simple = block(3, struct.pack("<I", len(packet)) + packet)
    content = section() + interface(1) + interface() + simple + enhanced(-60, 0, 0) + enhanced(-61, 0, 1)
    # A new section has its own interfaces, and may have its own byte order.
    content += section(">") + interface(127, b"", ">") + enhanced(-62, 0, 0, ">") + enhanced(-63, 0, 1, ">")
    content += enhanced(-64, 0, 0, ">")
    assert [level for _, level in levels.feed(content)] == [-61, -62]
    assert levels.rejected == {"of an interface without radiotap": 2, "broken capture": 1}
    assert levels.feed(enhanced(-65, 0, 0, ">")) == []
    levels = CapturedLevels(Transmitters())
    assert levels.feed(section() + interface() + simple) == []
    assert levels.rejected == {"without a time": 1}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x0a\x0d\x0d\x0a" + b"\x00" * 30, "no pcapng capture"),
        (section() + interface(1) + enhanced(-60, 0), "link type 1 is refused: allowed is 127, radiotap"),
    ],
)
def test_refused_pcapng(content: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        CapturedLevels(Transmitters()).feed(content)


@settings(deadline=None, max_examples=50)
@given(
    st.lists(st.binary(max_size=40) | st.sampled_from([enhanced(-60, 7), section(">"), interface(), block(3, b"")])),
    st.integers(1, 50),
)
def test_any_pcapng_is_read_the_same_in_any_pieces(parts: list[bytes], size: int) -> None:
    content = section() + interface() + b"".join(parts)

    def read(pieces: list[bytes]) -> tuple[list[tuple[int, float]], dict[str, int], bool]:
        levels = CapturedLevels(Transmitters())
        found: list[tuple[int, float]] = []
        try:
            for piece in pieces:
                found += levels.feed(piece)
        except InputError:
            return [], {}, True
        return found, dict(levels.rejected), False

    assert read([content]) == read([content[start : start + size] for start in range(0, len(content), size)])


# Who transmits


def beacon(address: str, *elements: bytes, control: int = 0x80) -> bytes:
    """IEEE 802.11: header, time stamp, interval, capability, elements."""
    sender = bytes.fromhex(address.replace(":", ""))
    header = struct.pack("<BBH", control, 0, 0) + b"\xff" * 6 + sender + sender + b"\x10\x00"
    return header + struct.pack("<QHH", 1, 100, 0x21) + b"".join(elements)


def element(number: int, content: bytes) -> bytes:
    return bytes([number, len(content)]) + content


def remote_id(*messages: bytes, counter: int = 0) -> bytes:
    """ASTM F3411: vendor-specific element, OUI FA:0B:BC, application code 0D, counter, a message or a pack of them."""
    pack = messages[0] if len(messages) == 1 else bytes([0xF2, 25, len(messages)]) + b"".join(messages)
    return element(221, b"\xfa\x0b\xbc\x0d" + bytes([counter]) + pack)


def basic_id(uas_id: bytes, kind: int = 1) -> bytes:
    """Type 0 and version 2, kind of id and of aircraft, 20 bytes of id, 3 reserved."""
    return bytes([0x02, kind << 4 | 2]) + uas_id.ljust(20, b"\x00") + b"\x00" * 3


LOCATION = b"\x12" + b"\x00" * 24
SERIAL = b"1581F4XK00000000ABCD"


@pytest.mark.parametrize(
    ("elements", "names"),
    [
        ([remote_id(basic_id(SERIAL))], [SERIAL.decode()]),
        ([remote_id(LOCATION)], []),
        ([remote_id(LOCATION, basic_id(b"SHORT-1"), LOCATION)], ["SHORT-1"]),
        # Two ids: a serial number, and the id of a session, which is no text.
        ([remote_id(basic_id(SERIAL), basic_id(bytes(range(1, 21)), 4))], [SERIAL.decode(), bytes(range(1, 21)).hex()]),
        ([element(0, b"hall"), element(1, b"\x82"), remote_id(basic_id(SERIAL))], ["hall", SERIAL.decode()]),
        ([element(0, b""), element(0, b"\x00\x00")], []),  # hidden networks
        ([element(221, b"\x00\x50\xf2\x04" + b"\x00" + basic_id(SERIAL))], []),  # another vendor
        ([element(221, b"\xfa\x0b\xbc\x0e" + b"\x00" + basic_id(SERIAL))], []),  # another application
        ([remote_id(basic_id(b""))], []),
        ([remote_id(basic_id(SERIAL)[:-1])], []),  # cut
        ([element(221, b"\xfa\x0b\xbc\x0d\x00")], []),
        ([element(221, b"\xfa\x0b\xbc\x0d\x00\xf2")], []),
        ([element(221, b"\xfa\x0b\xbc\x0d\x00\xf2\x18\x01" + basic_id(SERIAL))], []),  # messages of another size
        ([remote_id(basic_id(SERIAL))[:-5]], []),  # ends behind the frame
    ],
)
def test_what_a_beacon_calls_its_sender(elements: list[bytes], names: list[str]) -> None:
    assert transmitter_names(beacon(ADDRESS, *elements)) == names
    assert transmitter_names(beacon(ADDRESS, *elements, control=0x50)) == names  # the answer to a probe
    assert transmitter_names(beacon(ADDRESS, *elements, control=0x08)) == []  # data


@settings(deadline=None, max_examples=50)
@given(st.binary(max_size=120))
def test_any_frame_has_names_or_none(content: bytes) -> None:
    assert all(name for name in transmitter_names(content) + transmitter_names(beacon(ADDRESS, content)))


OTHER, PHONE = "02:00:00:00:00:08", "02:00:00:00:00:09"


def site() -> bytes:
    """A UAV whose beacons say in turn who and where it is, its controller, a phone, an ACK; and garbage."""
    frames = [
        (-60, beacon(ADDRESS, element(0, b"RID-A"), remote_id(LOCATION))),
        (-41, frame_of(OTHER)),
        (-61, beacon(ADDRESS, element(0, b"RID-A"), remote_id(basic_id(SERIAL)))),
        (-62, frame_of(ADDRESS)),
        (-50, frame_of(ADDRESS, control=0xD4)),  # ACK
        (-42, frame_of(OTHER)),
        (17, frame_of(PHONE)),  # once
        (-80, frame_of(PHONE)),
        (-82, frame_of(PHONE)),
        (-63, beacon(ADDRESS, element(0, b"RID-A"), remote_id(LOCATION))),
    ]
    return b"".join(captured(level_dbm, second, frame=frame) for second, (level_dbm, frame) in enumerate(frames))


QUESTION = (
    "has 3 transmitters: say which one is chased with --transmitter-mac or --transmitter-name. The strongest are "
    f"'{OTHER}' (-42 dBm), '{ADDRESS}' (-62 dBm, 'RID-A', '{SERIAL.decode()}'), '{PHONE}' (-80 dBm)"
)


@pytest.mark.parametrize("scheme", ["replay", "pcap"])
def test_a_capture_of_many_lists_them_and_asks(tmp_path: Path, scheme: str) -> None:
    path = tmp_path / "capture.cap"
    path.write_bytes(file_header() + site())
    with pytest.raises(InputError) as refusal:
        open_source(f"{scheme}:{path}", SourceDetails())
    assert str(refusal.value) == f"capture {path} {QUESTION}"


@pytest.mark.parametrize(
    ("chosen", "levels_dbm"),
    [
        ({"transmitter_mac": ADDRESS}, [-60, -61, -62, -63]),
        ({"transmitter_mac": OTHER.upper()}, [-41, -42]),
        ({"transmitter_name": SERIAL.decode()}, [-60, -61, -62, -63]),
        ({"transmitter_name": "RID-A"}, [-60, -61, -62, -63]),
        ({"transmitter_name": "RID-A", "transmitter_mac": ADDRESS}, [-60, -61, -62, -63]),
    ],
)
def test_one_of_many_is_chosen(tmp_path: Path, chosen: dict[str, str], levels_dbm: list[float]) -> None:
    path = tmp_path / "whatever"
    path.write_bytes(file_header() + site())
    source = open_source(f"replay:{path}", SourceDetails(**chosen))  # type: ignore[arg-type]
    found = [source.read(second * SECOND_NS) for second in range(1, 12)]
    assert [level_dbm for samples in found for _, level_dbm in samples] == levels_dbm


def test_by_its_name_it_is_known_from_the_first_frame_on_that_says_so(tmp_path: Path) -> None:
    path = tmp_path / "capture.pcap"
    path.write_bytes(file_header())
    source = open_source(f"pcap:{path}", SourceDetails(transmitter_name=SERIAL.decode()))
    with open(path, "ab") as file:
        file.write(site())
    assert [level_dbm for _, level_dbm in source.read(SECOND_NS)] == [-61, -62, -63]
    assert source.rejected == {"of another transmitter": 7}
    source.close()


@pytest.mark.parametrize("chosen", [{"transmitter_mac": "02:00:00:00:00:0f"}, {"transmitter_name": "nobody"}])
def test_who_is_not_in_a_recording_is_said_with_those_that_are(tmp_path: Path, chosen: dict[str, str]) -> None:
    path = tmp_path / "capture.pcap"
    path.write_bytes(file_header() + site())
    with pytest.raises(InputError, match=rf"is not in capture .*: the strongest are '{OTHER}' \(-42 dBm\), "):
        open_source(f"replay:{path}", SourceDetails(**chosen))  # type: ignore[arg-type]
    path.write_bytes(file_header())
    with pytest.raises(InputError, match=r"is not in capture .*: nobody is"):
        open_source(f"replay:{path}", SourceDetails(**chosen))  # type: ignore[arg-type]


def test_who_of_several_is_meant_is_asked_of_a_capture_under_way(tmp_path: Path) -> None:
    """One alone counts; once there are several none does, and three seconds later they are listed."""
    path = tmp_path / "capture.pcap"
    path.write_bytes(file_header())
    source = PcapSource(path)
    with open(path, "ab") as file:
        for second, packet in enumerate([captured(-60, frame=frame_of(ADDRESS)), site(), b"", b""], start=1):
            file.write(packet)
            file.flush()
            samples = source.read(second * SECOND_NS)
            assert [level_dbm for _, level_dbm in samples] == ([-60] if second == 1 else [-60] if second == 2 else [])
    assert source.rejected == {"of one of several transmitters": 9}
    with pytest.raises(InputError, match="has 3 transmitters: say which one"):
        source.read(5 * SECOND_NS)
    source.close()


def test_frames_of_others_are_said_with_who_sent_them(tmp_path: Path) -> None:
    path = tmp_path / "capture.pcap"
    path.write_bytes(file_header())
    source = PcapSource(path, Transmitters(ADDRESS))
    with open(path, "ab") as file:
        file.write(b"".join(captured(-60, frame=frame_of(other)) for other in [OTHER, PHONE] * 2))
    assert source.read(SECOND_NS) == []
    assert source.rejected == {"of another transmitter": 4}
    assert source.rejected.seen("of another transmitter") == [OTHER, PHONE]
    source.close()


def test_made_up_addresses_do_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("swarmchase.live.tracker.sources.transmitters.MOST_TRANSMITTERS", 5)
    transmitters = Transmitters()
    for number in range(50):
        transmitters.counts(f"02:00:00:00:00:{number:02x}", [f"network {name}" for name in range(50)], -60.0)
    with pytest.raises(InputError, match="has 5 transmitters") as refusal:
        transmitters.require_one("it")
    assert "network 7" in str(refusal.value)
    assert "network 8" not in str(refusal.value)
