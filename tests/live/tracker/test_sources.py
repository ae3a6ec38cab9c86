"""Where RSSI samples come from: recordings, lines, datagrams, Kismet, captures; calibration; the sampling grid."""

import contextlib
import itertools
import json
import math
import os
import random
import socket
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from urllib.parse import parse_qs

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmchase.errors import InputError
from swarmchase.levels import is_level, level_or_nan
from swarmchase.live.clock import VirtualClock
from swarmchase.live.link.mavlink import TrackerMavlinkLink
from swarmchase.live.link.messages import RssiWindow
from swarmchase.live.serial_port import open_serial_port
from swarmchase.live.tracker.agent import TrackerAgent
from swarmchase.live.tracker.sources import (
    CalibratedSource,
    JsonDatagramSource,
    JsonRecords,
    KismetSource,
    LineSource,
    OpenDescriptor,
    PcapSource,
    Rejected,
    ReplaySource,
    RssiSource,
    Sample,
    SampleBuffer,
    SenderClock,
    SimulatedSource,
    csv_rows,
    json_rows,
    sik_dbm,
)
from swarmchase.live.tracker.sources.address import open_source
from swarmchase.live.tracker.sources.json_records import LONGEST_LINE_BYTES, parse_record
from swarmchase.live.tracker.sources.kind import SourceDetails
from swarmchase.live.tracker.sources.kismet import parse_answer
from swarmchase.live.tracker.sources.protocol import MOST_PER_READ
from swarmchase.live.tracker.vehicles import SimulatedVehicle

BIRDSEYE = Path(__file__).parents[4] / "shared" / "data" / "birdseye"
NEEDS_TRACES = pytest.mark.skipif(
    not BIRDSEYE.is_dir(), reason="the recorded traces of BirdsEye lie beside the project, not in it"
)
SECOND_NS = 1_000_000_000
ADDRESS = "02:00:00:00:00:07"


def levels(samples: list[Sample]) -> list[float | None]:
    """In dBm, None for a missing one, so that lists compare."""
    return [None if math.isnan(rssi_dbm) else rssi_dbm for _, rssi_dbm in samples]


def eventually(condition: Callable[[], bool]) -> None:
    """Another thread, or the kernel, needs a moment; that it takes for ever is the failure."""
    for _ in range(2000):
        if condition():
            return
        threading.Event().wait(0.005)
    raise AssertionError("it never happened")


class Given:
    """A source that gives what it is told to."""

    silence = "nothing is given"

    def __init__(self, *samples: Sample) -> None:
        self.rejected = Rejected()
        self.samples = list(samples)
        self.closed = False

    def read(self, now_ns: int) -> list[Sample]:
        given_now, self.samples = self.samples, []
        return given_now

    def close(self) -> None:
        self.closed = True


# Calibration and plausibility


@pytest.mark.parametrize(
    ("reported_dbm", "expected_dbm"),
    [
        (-60.0, -57.5),
        (-200.0, -197.5),
        (-200.1, None),  # would become plausible
        (50.0, None),  # would not be any more
        (47.5, 50.0),
        (0.0, None),  # would become -55 dBm of a receiver that heard nothing
        (31.0, None),
        (127.0, None),
        (-128.0, None),
        (math.nan, None),
        (math.inf, None),
        (-math.inf, None),
        (1e308, None),
    ],
)
def test_calibration_is_added_and_garbage_stays_garbage(reported_dbm: float, expected_dbm: float | None) -> None:
    inner = Given((5, reported_dbm))
    source = CalibratedSource(inner, 2.5)
    ((time_ns, rssi_dbm),) = source.read(9)
    assert time_ns == 5
    assert levels([(5, level_or_nan(rssi_dbm))]) == [expected_dbm]
    source.close()
    assert inner.closed


@settings(deadline=None)
@given(st.floats(), st.floats(-100, 100))
def test_no_offset_makes_a_level_of_what_is_none(reported_dbm: float, offset_db: float) -> None:
    ((_, rssi_dbm),) = CalibratedSource(Given((5, reported_dbm)), offset_db).read(9)
    assert is_level(reported_dbm) or not is_level(rssi_dbm)


# The sampling grid


def filled(samples: list[tuple[float, float]], now_s: float, num_samples: int = 5) -> tuple[float, list[float | None]]:
    """(seconds, dBm) put into a buffer of 10 Hz; the window at ``now_s``."""
    buffer = SampleBuffer(10.0, num_samples)
    for time_s, rssi_dbm in samples:
        buffer.add((round(time_s * 1e9), float(rssi_dbm)), round(max(time_s, now_s) * 1e9))
    window = buffer.window(round(now_s * 1e9))
    assert window is not None
    return window[0] / 1e9, levels([(0, level) for level in window[1]])


@pytest.mark.parametrize(
    ("samples", "now_s", "newest_s", "expected"),
    [
        ([(7.0, -60)], 7.0, 7.0, [-60]),
        ([(7.0, -60), (7.1, -61), (7.2, -62)], 7.2, 7.2, [-60, -61, -62]),
        # The grid is the first sample's: jitter of less than half a slot neither doubles nor loses one.
        ([(7.03, -60), (7.17, -61), (7.19, -62)], 7.2, 7.23, [-60, -61, -62]),
        # One was lost, one came without a valid level, one is not a level.
        ([(7.0, -60), (7.2, -62)], 7.2, 7.2, [-60, None, -62]),
        ([(7.0, -60), (7.1, math.nan), (7.2, -62)], 7.2, 7.2, [-60, None, -62]),
        ([(7.0, -60), (7.1, -201), (7.2, math.inf), (7.3, 50.1), (7.4, -64)], 7.4, 7.4, [-60, None, None, None, -64]),
        # Of two in one slot the later, in whatever order they come.
        ([(7.0, -60), (7.08, -61), (7.12, -62)], 7.2, 7.1, [-60, -62]),
        ([(7.0, -60), (7.12, -62), (7.08, -61)], 7.2, 7.1, [-60, -62]),
        # Of two taken at one time the one that came last, be it the weaker one.
        ([(7.0, -60), (7.1, -61), (7.1, -65)], 7.2, 7.1, [-60, -65]),
        ([(7.0, -60), (7.1, -65), (7.1, -61)], 7.2, 7.1, [-60, -61]),
        # Error values are none, before, after and instead of a level.
        ([(7.0, -60), (7.08, 0), (7.1, -61), (7.12, 31), (7.2, -128), (7.3, 127)], 7.3, 7.1, [-60, -61]),
        # Reordered, repeated.
        ([(7.0, -60), (7.2, -62), (7.1, -61), (7.1, -61)], 7.2, 7.2, [-60, -61, -62]),
        # Only the last five are kept, and what is older than they are is not taken up.
        ([(7 + k / 10, -60 - k) for k in range(8)], 7.7, 7.7, [-63, -64, -65, -66, -67]),
        ([(7.0, -60), (7.5, -65), (7.0, -1)], 7.5, 7.5, [None, None, None, None, -65]),
        ([(7.0, -60), (6.8, -58)], 7.0, 7.0, [-60]),
        # Silence: a slot is missing .1 s after its end, at 7.15 + .1 for that of 7.1.
        ([(7.0, -60)], 7.24, 7.0, [-60]),
        ([(7.0, -60)], 7.26, 7.1, [-60, None]),
        ([(7.0, -60)], 7.46, 7.3, [-60, None, None, None]),
        ([(7.0, -60)], 3600.0, 3599.8, [None] * 5),
        # A late one still finds its place.
        ([(7.0, -60), (7.3, -63), (7.1, -61)], 7.3, 7.3, [-60, -61, None, -63]),
    ],
)
def test_grid_by_hand(
    samples: list[tuple[float, float]], now_s: float, newest_s: float, expected: list[float | None]
) -> None:
    time_s, found = filled(samples, now_s)
    assert time_s == pytest.approx(newest_s, abs=1e-9)
    assert found == expected


def test_no_sample_no_window() -> None:
    buffer = SampleBuffer(10.0)
    buffer.add((SECOND_NS, math.nan), SECOND_NS)
    buffer.add((9 * SECOND_NS, -60.0), SECOND_NS)  # of the future
    assert buffer.window(SECOND_NS) is None
    buffer.add((SECOND_NS + 1000, -61.0), SECOND_NS)  # another process read the clock a moment later
    assert buffer.window(SECOND_NS) == (SECOND_NS + 1000, (-61.0,))


@pytest.mark.parametrize(("sampling_hz", "num_samples"), [(0.0, 5), (-1.0, 5), (math.nan, 5), (1e5, 5), (10.0, 0)])
def test_refused_grids(sampling_hz: float, num_samples: int) -> None:
    with pytest.raises(InputError, match="is refused"):
        SampleBuffer(sampling_hz, num_samples)


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 20 * SECOND_NS), st.floats()), max_size=60), st.randoms(use_true_random=False))
def test_every_window_may_be_sent_and_order_does_not_matter(drawn: list[Sample], order: random.Random) -> None:
    """But of two samples taken at one time the one that comes last stays: here there are none such."""
    now_ns = 15 * SECOND_NS
    first: Sample = (0, -60.0)  # the grid is the first one's
    samples = [sample for sample in dict(drawn).items() if sample[0] != 0]
    windows = []
    for _ in range(2):
        buffer = SampleBuffer(10.0)
        for sample in [first, *samples, *samples[:5]]:
            buffer.add(sample, now_ns)
        window = buffer.window(now_ns)
        assert window is not None
        sent = RssiWindow(0, window[0], 10.0, window[1])
        assert now_ns - 0.3e9 <= sent.time_ns <= now_ns + 0.2e9
        windows.append((sent.time_ns, levels([(0, level) for level in sent.rssi_dbm])))
        order.shuffle(samples)
    assert windows[0] == windows[1]


# Times of other clocks


@pytest.mark.parametrize(
    ("messages", "expected_s"),
    [
        # (sent on the sender's clock, received on ours): ours runs 100 s ahead, the way takes 10 ms and sometimes more.
        ([(5.0, 105.0), (5.1, 105.15), (5.2, 105.5)], [105.0, 105.1, 105.2]),
        # A faster one shows that the first had been delayed by .2 s.
        ([(5.0, 105.2), (5.1, 105.1), (5.2, 105.2)], [105.2, 105.1, 105.2]),
        # Our process was stopped for an hour: what waited meanwhile is recognised as old.
        ([(5.0, 105.0), (5.1, 3705.0), (5.2, 3705.0), (3605.0, 3705.0)], [105.0, 105.46, 105.56, 3705.0]),
        # The sender was started again.
        ([(5.0, 105.0), (0.1, 107.0), (0.2, 107.1)], [105.0, 107.0, 107.1]),
        # Two were reordered: that is no new start.
        ([(5.0, 105.0), (5.1, 105.1), (5.05, 105.11)], [105.0, 105.1, 105.05]),
        # A broken time stamp spoils nothing but itself.
        ([(5.0, 105.0), (9e6, 105.1), (5.2, 105.2)], [105.0, 105.1, 105.2]),
    ],
)
def test_times_of_a_sender(messages: list[tuple[float, float]], expected_s: list[float]) -> None:
    clock = SenderClock()
    found = [clock.local_ns(round(sent_s * 1e9), round(now_s * 1e9)) / 1e9 for sent_s, now_s in messages]
    assert found == pytest.approx(expected_s, abs=1e-4)


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 2**63), st.integers(0, 10 * SECOND_NS)), max_size=30))
def test_nothing_was_sent_after_it_came(messages: list[tuple[int, int]]) -> None:
    clock, now_ns = SenderClock(), 0
    for sender_ns, passed_ns in messages:
        now_ns += passed_ns
        assert clock.local_ns(sender_ns, now_ns) <= now_ns


# Recordings


def test_a_recording_is_played_at_its_pace_gaps_included(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("when,noise,level\n1000.5,1,-60\n1001,1,-61\n1003.5,1,none\nnever,1,-1\n1000,1,-2\n1004,1,-63.5\n")
    source = ReplaySource(csv_rows(path, rssi_column="level", time_column="when"))
    start_ns = 77 * SECOND_NS
    assert source.read(start_ns) == [(start_ns, -60)]
    assert source.read(start_ns + SECOND_NS // 2 - 1) == []
    assert source.read(start_ns + 2 * SECOND_NS) == [(start_ns + SECOND_NS // 2, -61)]
    samples = source.read(start_ns + 60 * SECOND_NS)
    assert [time_ns - start_ns for time_ns, _ in samples] == [3 * SECOND_NS, 3 * SECOND_NS + SECOND_NS // 2]
    assert levels(samples) == [None, -63.5]
    assert source.rejected == {"going back in time": 1}
    assert source.read(start_ns + 99 * SECOND_NS) == []
    source.close()


def test_a_table_without_times(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("rssi\n0\n148\n200\n")
    rows = list(csv_rows(path, "rssi", time_column=None, interval_s=0.25, to_dbm=sik_dbm))
    assert [time_s for time_s, _ in rows] == [0, 0.25, 0.5]
    assert levels([(0, level) for _, level in rows]) == [
        None,
        pytest.approx(-49.105, abs=1e-3),
        pytest.approx(-21.737, abs=1e-3),
    ]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot read"),
        ("", "has no column 'rssi_dbm': it has no head line"),
        ("time_s,rssi\n1,-60\n", "has no column 'rssi_dbm': it has time_s, rssi"),
        ("time_s,rssi_dbm\n", "holds no sample"),
        ("time_s,rssi_dbm\nx,-60\n", "holds no sample"),
        ('time_s,rssi_dbm\n"' + "x" * 200_000, "cannot read"),
    ],
)
def test_refused_tables(tmp_path: Path, content: str | None, message: str) -> None:
    path = tmp_path / "log.csv"
    if content is not None:
        path.write_text(content)
    with pytest.raises(InputError, match=message):
        ReplaySource(csv_rows(path))


@pytest.mark.parametrize("content", [None, "", "{", "[" * 100_000, "3", "{}", '{"1": {"rssi": -60}}'])
def test_refused_logs(tmp_path: Path, content: str | None) -> None:
    path = tmp_path / "log.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(InputError, match=r"log\.json"):
        ReplaySource(json_rows(path))


def test_a_log_is_put_in_order(tmp_path: Path) -> None:
    path = tmp_path / "log.json"
    path.write_text(
        '{"2": {"time": 2.5, "rssi": -62}, "1": {"time": "1.5", "rssi": null}, "3": 7, "4": {"time": null}}'
    )
    (first, second) = json_rows(path)
    assert (first[0], second) == (1.5, (2.5, -62))
    assert math.isnan(first[1])


@settings(deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes_are_a_recording_or_are_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any"
    for header in (b"", b"time_s,rssi_dbm\n"):
        path.write_bytes(header + content)
        for rows in (csv_rows(path), json_rows(path)):
            with contextlib.suppress(InputError):
                assert all(math.isfinite(time_s) for time_s, _ in rows)


@NEEDS_TRACES
def test_the_longest_field_test() -> None:
    """621 seconds of 634, with 13 gaps of one second each; a directional antenna, 4 to 250 m away."""
    rows = list(csv_rows(BIRDSEYE / "trace_634s.csv", rssi_column="rssi_dbm", time_column="t_unix"))
    assert rows[0] == (1653599174.0, -78.7463607788086)
    assert all(-120 < level < 0 for _, level in rows)
    source, buffer = ReplaySource(iter(rows)), SampleBuffer(1.0)
    num_samples, found = 0, []
    for second in range(50, 684):
        now_ns = second * SECOND_NS
        samples = source.read(now_ns)
        num_samples += len(samples)
        for sample in samples:
            buffer.add(sample, now_ns)
        if second % 50 == 49 or second == 683:
            window = buffer.window(now_ns)
            assert window is not None
            found += window[1][-(second % 50 + 1) :]
    assert num_samples == len(rows) == 621
    assert len(found) == 634
    recorded = dict(rows)
    expected = [recorded.get(rows[0][0] + second) for second in range(634)]
    assert levels([(0, level) for level in found]) == expected
    assert expected.count(None) == 13


@NEEDS_TRACES
def test_the_other_field_tests() -> None:
    log = list(json_rows(BIRDSEYE / "field_test_60s.json"))
    assert log[0] == (1653589177.1955013, -64.29933166503906)
    assert all(0 < later[0] - earlier[0] < 30 for earlier, later in itertools.pairwise(log))
    radio = list(csv_rows(BIRDSEYE / "telemetry_test1.csv", "rssi", time_column=None, to_dbm=sik_dbm))
    heard = [level for _, level in radio if not math.isnan(level)]
    assert 0 < len(heard) < len(radio)
    assert all(-127 < level < 10 for level in heard)


# JSON records


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ('{"rssi_dbm": -61.5}', (-61.5, None)),
        ('{"rssi_dbm": -61, "time_ns": 12345678901234567}', (-61, 12345678901234567)),
        ('{"rssi_dbm": -61, "time_s": 1.5, "tracker": 3, "x": [1]}', (-61, 1_500_000_000)),
        ('{"rssi_dbm": null}', (None, None)),
        ('{"rssi_dbm": NaN}', (None, None)),
        ('{"rssi_dbm": -61, "time_ns": null}', (-61, None)),
        ('{"rssi_dbm": 1e999}', (math.inf, None)),  # absurd, and for SampleBuffer to drop
        (f'{{"rssi_dbm": -1{"0" * 400}}}', (None, None)),
    ],
)
def test_records(line: str, expected: tuple[float | None, int | None]) -> None:
    record = parse_record(line.encode(), Rejected())
    assert record is not None
    assert (levels([(0, record[0])])[0], record[1]) == expected


@pytest.mark.parametrize(
    "line",
    [
        "",
        "rssi -61",
        "{",
        "[]",
        "-61",
        "null",
        '{"rssi": -61}',
        '{"rssi_dbm": "-61"}',
        '{"rssi_dbm": true}',
        '{"rssi_dbm": [1]}',
        '{"rssi_dbm": -61, "time_ns": -1}',
        '{"rssi_dbm": -61, "time_ns": 9223372036854775808}',
        '{"rssi_dbm": -61, "time_ns": "1"}',
        '{"rssi_dbm": -61, "time_s": 1e300}',
        '{"rssi_dbm": -61, "time_s": NaN}',
        '{"rssi_dbm": -61, "time_s": true}',
        '{"a":' * 600,
        "[" * 4000,
        f'{{"rssi_dbm": {"9" * 5000}}}',
        f'{{"rssi_dbm": -61, "x": "{"y" * LONGEST_LINE_BYTES}"}}',
        "\udcff",
    ],
)
def test_lines_that_are_no_records(line: str) -> None:
    rejected = Rejected()
    assert parse_record(line.encode(errors="surrogateescape"), rejected) is None
    assert rejected.total() == 1


ANY_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.just("-61"),
    lambda inner: st.lists(inner, max_size=2) | st.fixed_dictionaries({}, optional={"rssi_dbm": inner}),
    max_leaves=3,
)


@settings(deadline=None)
@given(
    st.binary(max_size=100)
    | st.fixed_dictionaries({}, optional=dict.fromkeys(["rssi_dbm", "time_ns", "time_s"], ANY_JSON)).map(
        lambda record: json.dumps(record).encode()
    )
)
def test_any_line_is_a_record_or_is_none(line: bytes) -> None:
    record = parse_record(line, Rejected())
    if record is not None:
        rssi_dbm, time_ns, _ = record
        assert isinstance(rssi_dbm, float)
        assert time_ns is None or 0 <= time_ns < 2**63


@pytest.fixture
def pipe() -> Iterator[tuple[int, LineSource]]:
    reading, writing = os.pipe()
    source = LineSource(OpenDescriptor(reading), "standard input", JsonRecords(SourceDetails()))
    yield writing, source
    source.close()
    with contextlib.suppress(OSError):
        os.close(writing)


def test_lines_come_in_pieces_and_bad_ones_are_counted(pipe: tuple[int, LineSource]) -> None:
    writing, source = pipe
    assert source.read(5) == []
    os.write(writing, b'boot ok\n{"rssi_dbm": -61}\r\n\n{"rssi_d')
    assert source.read(6) == [(6, -61)]
    os.write(writing, b'bm": -62}\n{"rssi_dbm": -63, "time_s": 100}\n{"rssi_dbm": -64, "time_s": 100.5}\n')
    # The third line was sent half a second after the second, whatever their common way took.
    assert source.read(7 * SECOND_NS) == [(7 * SECOND_NS, -62), (7 * SECOND_NS, -63), (7 * SECOND_NS, -64)]
    os.write(writing, b'{"rssi_dbm": -65, "time_s": 100.7}\n')
    # And the fourth .2 s later, though it came two seconds later.
    ((time_ns, rssi_dbm),) = source.read(9 * SECOND_NS)
    assert (time_ns / 1e9, rssi_dbm) == (pytest.approx(7.2, abs=1e-3), -65)
    assert source.rejected == {"no JSON object": 1}
    assert source.rejected.seen("no JSON object") == ["boot ok"]
    assert not source.ended
    os.write(writing, b'{"rssi_dbm": -66}')
    os.close(writing)
    assert source.read(10 * SECOND_NS) == []
    assert source.read(10 * SECOND_NS) == []
    assert source.ended


def test_a_line_without_an_end_does_not_fill_the_memory(pipe: tuple[int, LineSource]) -> None:
    writing, source = pipe
    for _ in range(50):
        os.write(writing, b"x" * 3000)
        assert source.read(5) == []
        assert len(source._parts._rest) <= LONGEST_LINE_BYTES
    assert source.rejected == {"too long a line": 1}
    os.write(writing, b'{"rssi_dbm": -1}\n{"rssi_dbm": -61}\n')
    assert source.read(6) == [(6, -61)]


@settings(deadline=None)
@given(st.lists(st.binary(max_size=60) | st.just(b'{"rssi_dbm": -61}\n'), max_size=20))
def test_any_stream_is_read(chunks: list[bytes]) -> None:
    reading, writing = os.pipe()
    source = LineSource(OpenDescriptor(reading), "standard input", JsonRecords(SourceDetails()))
    for chunk in [*chunks, b'\n{"rssi_dbm": -62}\n']:
        os.write(writing, chunk)
        samples = source.read(5)
    assert samples[-1] == (5, -62)
    source.close()
    os.close(writing)


def test_a_serial_port() -> None:
    """A pseudo-terminal is one, to the system."""
    other_end, port = os.openpty()
    source = open_source(f"serial:{os.ttyname(port)}", SourceDetails())
    os.close(port)
    os.write(other_end, b'{"rssi_dbm": -61}\n\x03{"rssi_dbm": -62}\n')  # raw: an interrupt is a byte like any other
    found: list[Sample] = []
    eventually(lambda: bool(found.extend(source.read(5))) or source.rejected.total() == 1)
    assert found == [(5, -61)]
    os.close(other_end)  # unplugged
    eventually(lambda: source.read(6) == [] and source.ended)
    source.close()


@pytest.mark.parametrize(
    ("name", "baud", "message"),
    [("nothing", 9600, "cannot open"), ("file", 9600, "no serial port"), ("file", 9601, "baud")],
)
def test_refused_serial_ports(tmp_path: Path, name: str, baud: int, message: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=message):
        open_serial_port(tmp_path / name, baud)


@pytest.fixture
def datagrams() -> Iterator[tuple[Callable[[bytes], None], JsonDatagramSource]]:
    source = JsonDatagramSource(0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        yield lambda datagram: sender.sendto(datagram, ("127.0.0.1", source.port)) and None, source
    source.close()


def test_datagrams(datagrams: tuple[Callable[[bytes], None], JsonDatagramSource]) -> None:
    send, source = datagrams
    assert source.read(5) == []
    send(b'{"rssi_dbm": -61}')
    send(b"")
    send(b"x" * 60_000)
    send(b'{"rssi_dbm": -62}\n{"rssi_dbm": null}\n')
    found: list[Sample] = []
    eventually(lambda: bool(found.extend(source.read(5))) or len(found) == 3)
    assert levels(found) == [-61, -62, None]
    assert source.rejected == {"no JSON object": 1, "too long a line": 1}


def test_a_flood_does_not_hold_the_agent_up(datagrams: tuple[Callable[[bytes], None], JsonDatagramSource]) -> None:
    send, source = datagrams
    for _ in range(200):
        send(b'{"rssi_dbm": -61}\n' * 50)
    found: list[int] = []
    eventually(lambda: found.append(len(source.read(5))) or (found[-1] == 0 and sum(found) > 0))
    assert max(found) < MOST_PER_READ + 50


def test_a_port_in_use(datagrams: tuple[Callable[[bytes], None], JsonDatagramSource]) -> None:
    with pytest.raises(InputError, match="cannot listen"):
        JsonDatagramSource(datagrams[1].port)
    with pytest.raises(InputError, match="cannot listen"):
        JsonDatagramSource(70_000)


def test_a_world_on_the_same_clock() -> None:
    source = JsonDatagramSource(0, details=SourceDetails(same_clock=True))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as world:
        world.sendto(b'{"rssi_dbm": -61, "time_ns": 7000000000}', ("127.0.0.1", source.port))
    found: list[Sample] = []
    eventually(lambda: bool(found.extend(source.read(8 * SECOND_NS))) or bool(found))
    assert found == [(7 * SECOND_NS, -61)]
    source.close()


# The simulated receiver


def test_a_simulated_receiver_is_asked_on_its_grid() -> None:
    source = SimulatedSource(lambda time_ns: -time_ns / SECOND_NS, 10.0)
    assert source.read(7 * SECOND_NS) == [(7 * SECOND_NS, -7)]
    assert source.read(7 * SECOND_NS + 99_999_999) == []
    assert source.read(7 * SECOND_NS + 200_000_000) == [(7_100_000_000, -7.1), (7_200_000_000, -7.2)]
    late = source.read(60 * SECOND_NS)
    assert [time_ns for time_ns, _ in late] == [55_100_000_000 + k * 100_000_000 for k in range(50)]
    source.close()


@pytest.mark.parametrize("sampling_hz", [3.0, 7.3, 10.0, 100.0])
def test_no_sample_of_a_simulated_receiver_is_lost_on_the_way_to_the_grid(sampling_hz: float) -> None:
    source, buffer = SimulatedSource(lambda time_ns: -50.0, sampling_hz), SampleBuffer(sampling_hz)
    for step in range(500):
        now_ns = 12_345_678_901 + step * 17_000_000
        for sample in source.read(now_ns):
            assert sample[0] <= now_ns
            buffer.add(sample, now_ns)
        window = buffer.window(now_ns)
        assert window is not None
        assert set(window[1]) == {-50.0}


# Kismet


class Kismet:
    """Answers as the server does, to one device, with what it is told to."""

    def __init__(self) -> None:
        self.answer: bytes = b"[]"
        self.status = 200
        self.requests: list[tuple[str, str | None, dict[str, list[list[str]]]]] = []
        kismet = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = parse_qs(self.rfile.read(int(self.headers["Content-Length"])).decode())
                kismet.requests.append((self.path, self.headers["Cookie"], json.loads(body["json"][0])))
                self.send_response(kismet.status)
                self.end_headers()
                self.wfile.write(kismet.answer)

            def log_message(self, format: str, *args: object) -> None:
                pass

        self.server = HTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        self.thread = threading.Thread(target=self.server.serve_forever, kwargs={"poll_interval": 0.01})
        self.thread.start()

    def hears(self, rssi_dbm: float, packets: int) -> None:
        self.answer = json.dumps([{"rssi_dbm": rssi_dbm, "last_time_s": 1700000000, "packets": packets}]).encode()

    def stop(self) -> None:
        self.server.shutdown()
        self.thread.join()
        self.server.server_close()


@pytest.fixture
def kismet() -> Iterator[Kismet]:
    server = Kismet()
    yield server
    server.stop()


def test_kismet_is_asked_for_one_device_and_each_packet_counts_once(kismet: Kismet) -> None:
    source = KismetSource(kismet.url + "/", ADDRESS, token="key", interval_s=0.002)
    found: list[float] = []

    def read() -> list[float]:
        found.extend(rssi_dbm for _, rssi_dbm in source.read(5))
        return found

    try:
        eventually(lambda: source.rejected["no such device in the answer"] > 0)
        kismet.hears(-61, 100)
        eventually(lambda: read() == [-61])
        asked = len(kismet.requests)
        eventually(lambda: len(kismet.requests) > asked + 3)
        assert read() == [-61]
        kismet.hears(-61, 101)
        eventually(lambda: read() == [-61, -61])
        kismet.status = 401
        eventually(lambda: source.rejected["no answer: HTTPError"] > 0)
        kismet.status, kismet.answer = 200, b"<html>"
        before = source.rejected["no such device in the answer"]
        eventually(lambda: source.rejected["no such device in the answer"] > before)
        kismet.hears(-63, 102)
        eventually(lambda: read() == [-61, -61, -63])
    finally:
        source.close()
    path, cookie, command = kismet.requests[0]
    assert (path, cookie) == (f"/devices/by-mac/{ADDRESS}/devices.json", "KISMET=key")
    assert ["kismet.device.base.signal/kismet.common.signal.last_signal", "rssi_dbm"] in command["fields"]


def test_a_kismet_that_is_not_there_is_asked_again() -> None:
    with socket.socket() as reserved:
        reserved.bind(("127.0.0.1", 0))
        source = KismetSource(f"http://127.0.0.1:{reserved.getsockname()[1]}", ADDRESS, interval_s=0.002)
        eventually(lambda: source.rejected["no answer: URLError"] > 2)
        assert source.read(5) == []
        source.close()
        assert not source._thread.is_alive()


@pytest.mark.parametrize(
    ("url", "mac"),
    [
        ("http://127.0.0.1", "02:00"),
        ("http://127.0.0.1", "02:00:00:00:00:0g"),
        ("http://127.0.0.1", "2:0:0:0:0:7"),
        ("http://127.0.0.1", f"{ADDRESS}/../"),
        ("file:///etc/passwd", ADDRESS),
    ],
)
def test_refused_kismets(url: str, mac: str) -> None:
    with pytest.raises(InputError, match="is refused"):
        KismetSource(url, mac)


@settings(deadline=None)
@given(st.binary(max_size=100) | ANY_JSON.map(lambda value: json.dumps([{"rssi_dbm": value}]).encode()))
def test_any_answer_is_a_level_or_none(answer: bytes) -> None:
    record = parse_answer(answer)
    assert record is None or isinstance(record[0], float)


def test_every_source_is_a_source() -> None:
    sources = [Given(), SimulatedSource(lambda time_ns: -60.0, 1.0), ReplaySource(iter([(0.0, -60.0)]))]
    kinds = [CalibratedSource, LineSource, JsonDatagramSource, KismetSource, PcapSource]
    assert all(isinstance(source, RssiSource) for source in sources)
    assert all(callable(getattr(kind, method)) for kind in kinds for method in ("read", "close"))


# What is said of a source that yields nothing


def complaint_of(source: RssiSource, offset_db: float = 0.0) -> str | None:
    """What an agent says of it after six seconds in which it was read at 10 Hz."""
    clock = VirtualClock(9 * SECOND_NS)
    link = TrackerMavlinkLink(3, "127.0.0.1", 1, unsigned=True)
    agent = TrackerAgent(3, CalibratedSource(source, offset_db), SimulatedVehicle((0.0, 0.0, 0.0)), link, clock, 10.0)
    for _ in range(61):
        agent.step()
        clock.advance(0.1)
    complaint = agent.source_complaint
    agent.close()
    return complaint


def test_a_port_to_which_nobody_sends() -> None:
    source = JsonDatagramSource(0)
    port = source.port
    assert complaint_of(source) == f"for 6 s no datagram has come to port {port}"


def test_records_of_another_form(pipe: tuple[int, LineSource]) -> None:
    writing, source = pipe
    os.write(writing, b'{"signal": -61, "ts": 5}\n' * 41 + b'{"rssi_dbm": "-61"}\nboot: ok\n')
    assert complaint_of(source) == (
        "for 6 s no level among 43 records: 41 without the field rssi_dbm (seen: signal, ts), "
        "1 with a field that is no number (seen: rssi_dbm), 1 no JSON object (seen: boot: ok)"
    )


def test_a_receiver_that_hears_nothing_and_says_so_in_its_own_way(pipe: tuple[int, LineSource]) -> None:
    writing, source = pipe
    os.write(writing, b'{"rssi_dbm": 0}\n{"rssi_dbm": 127}\n{"rssi_dbm": null}\n{"rssi_dbm": 300}\n')
    assert complaint_of(source, offset_db=-5.0) == (
        "for 6 s no level among 4 records: 2 an error value, 1 nothing heard, 1 beyond any receiver"
    )


def test_a_line_that_has_ended(pipe: tuple[int, LineSource]) -> None:
    writing, source = pipe
    os.close(writing)
    assert complaint_of(source) == "for 6 s standard input has ended"


def test_a_recording_that_is_over() -> None:
    assert complaint_of(ReplaySource(iter([(0.0, -60.0), (0.5, -61.0)]))) == "for 6 s the recording is over"


def test_a_source_that_yields_levels_is_not_complained_of() -> None:
    assert complaint_of(SimulatedSource(lambda time_ns: -60.0, 10.0)) is None


def test_many_different_mistakes_do_not_fill_the_memory() -> None:
    rejected = Rejected()
    for number in range(10_000):
        rejected.add("without the field rssi_dbm", f"field {number}")
    assert rejected == {"without the field rssi_dbm": 10_000}
    assert rejected.seen("without the field rssi_dbm") == [f"field {number}" for number in range(8)]
