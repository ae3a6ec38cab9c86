"""What other programs print or write: sketches' text, rtl_power, airodump-ng; fields and times by other names."""

import json
import math
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmchase.errors import InputError
from swarmchase.live.tracker.sources import Rejected, RssiSource
from swarmchase.live.tracker.sources.address import open_source
from swarmchase.live.tracker.sources.airodump import parse_devices
from swarmchase.live.tracker.sources.iso_time import time_s
from swarmchase.live.tracker.sources.json_records import parse_record
from swarmchase.live.tracker.sources.kind import SourceDetails
from swarmchase.live.tracker.sources.printed_records import PrintedRecords
from swarmchase.live.tracker.sources.rtl_power import Sweeps, parse_hop
from swarmchase.live.tracker.sources.sketch_text import Heard, heard_in

SECOND_NS = 1_000_000_000
ADDRESS, OTHER = "02:00:00:00:00:07", "02:00:00:00:00:08"


def levels_of(source: RssiSource, now_s: float = 1.0) -> list[float]:
    return [level_dbm for _, level_dbm in source.read(round(now_s * SECOND_NS))]


# Times


@pytest.mark.parametrize(
    ("said", "expected_s"),
    [
        (1.5, 1.5),
        ("1.5", 1.5),
        ("1970-01-01T00:00:01.5Z", 1.5),
        ("1970-01-01 00:00:01.5", 1.5),
        ("1970-01-01T02:00:01,5+02:00", 1.5),
        ("19700101T000001Z", 1.0),
        (" 2026-03-01T12:00:00 ", 1772366400.0),
        ("2019-06-14T13:14:40.226618748Z", 1560518080.226618),
        ("20260301", 20260301.0),
        ("noon", math.nan),
        ("", math.nan),
        (None, math.nan),
        (True, math.nan),
        ([1], math.nan),
        (10**400, math.nan),
    ],
)
def test_times(said: Any, expected_s: float) -> None:
    assert time_s(said) == pytest.approx(expected_s, abs=1e-6, nan_ok=True)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("log.csv", "time_s,rssi_dbm\n2026-03-01T12:00:00Z,-60\n2026-03-01T13:00:00.25+01:00,-61\nnoon,-9\n"),
        (
            "log.json",
            '[{"time_s": "2026-03-01T12:00:00.250", "rssi_dbm": -61}, {"time_s": "2026-03-01T12:00", "rssi_dbm": -60}]',
        ),
    ],
)
def test_recordings_with_times_of_iso_8601(tmp_path: Path, name: str, content: str) -> None:
    (tmp_path / name).write_text(content)
    source = open_source(f"replay:{tmp_path / name}", SourceDetails())
    assert source.read(SECOND_NS) == [(SECOND_NS, -60)]
    assert source.read(2 * SECOND_NS) == [(SECOND_NS + SECOND_NS // 4, -61)]


def test_a_recording_of_a_sik_radio_without_times(tmp_path: Path) -> None:
    """BirdsEye's logs of telemetry are such: 148 is 148 / 1.9 - 127 dBm."""
    (tmp_path / "log.csv").write_text("rssi\n148\n0\n200\n")
    details = SourceDetails(sampling_hz=4.0, rssi_column="rssi", time_column="", rssi_unit="sik")
    source = open_source(f"replay:{tmp_path / 'log.csv'}", details)
    found = source.read(SECOND_NS) + source.read(2 * SECOND_NS)
    assert [time_ns for time_ns, _ in found] == [SECOND_NS, SECOND_NS * 5 // 4, SECOND_NS * 3 // 2]
    assert [level for _, level in found] == pytest.approx([-49.105, math.nan, -21.737], abs=1e-3, nan_ok=True)


# Fields by other names


CHIRPSTACK = '{"time": "2026-03-01T12:00:00Z", "rxInfo": [{"gatewayId": "0016", "rssi": -97, "snr": 6.5}]}'
DRAGON = '[{"Basic ID": {"MAC": "02:00:00:00:00:07", "RSSI": -55, "id": "X"}}, {"Location/Vector Message": {}}]'


@pytest.mark.parametrize(
    ("line", "names", "expected"),
    [
        (CHIRPSTACK, ("rxInfo.0.rssi", "time", "mac"), (-97.0, 1772366400 * SECOND_NS, None)),
        (DRAGON, ("0.Basic ID.RSSI", "time_s", "0.Basic ID.MAC"), (-55.0, None, ADDRESS)),
        ('{"a.b": -1, "a": {"b": -2}}', ("a.b", "time_s", "mac"), (-1.0, None, None)),
        ('{"rssi": -61, "ts": 1.5}', ("rssi", "ts", "mac"), (-61.0, 3 * SECOND_NS // 2, None)),
    ],
)
def test_levels_in_records_of_others(
    line: str, names: tuple[str, str, str], expected: tuple[float, int | None, str | None]
) -> None:
    details = SourceDetails(rssi_column=names[0], time_column=names[1], mac_column=names[2])
    assert parse_record(line.encode(), Rejected(), details) == expected


@pytest.mark.parametrize("way", ["rxInfo.1.rssi", "rxInfo.rssi", "rxInfo.0.rssi.x", "nothing"])
def test_ways_that_lead_nowhere(way: str) -> None:
    rejected = Rejected()
    assert parse_record(CHIRPSTACK.encode(), rejected, SourceDetails(rssi_column=way)) is None
    assert rejected == {f"without the field {way}": 1}


# Sketches


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("-61", Heard(-61.0)),
        (" -61 dBm\r", Heard(-61.0)),
        ("RSSI: -61", Heard(-61.0)),
        ("RSSI:-61dBm", Heard(-61.0)),
        ("rssi=-61.5", Heard(-61.5)),
        ("Signal strength (RSSI): -61 dBm", Heard(-61.0)),
        ("Connected Network Signal Strength (RSSI): -61", Heard(-61.0)),
        ("Channel: 6 MAC: 02:00:00:00:00:07 SIGNAL: -61", Heard(-61.0, ADDRESS)),
        ("📡 MAC: 02:00:00:00:00:0A | RSSI: -61", Heard(-61.0, "02:00:00:00:00:0a")),
        ("RSSI: 31", Heard(31.0)),  # an error value, and dropped later
        ("1: hall (-61)*", Heard(-61.0, name="hall")),
        ("12: hall (east) (-61) [6] WPA2", Heard(-61.0, name="hall (east)")),
        (" 1 | hall                             | -61 |  6 | WPA2", Heard(-61.0, name="hall")),
        (
            f"PACKET TYPE=MGMT, CHAN=06, RSSI=-61, ADDR1=ff:ff:ff:ff:ff:ff, ADDR2={ADDRESS}, ADDR3={OTHER}",
            Heard(-61.0, ADDRESS),
        ),
        (f"Advertised Device: Name: x, Address: {ADDRESS}, rssi: -61", Heard(-61.0, ADDRESS)),
        (f'CSI_DATA,7,{ADDRESS},-61,11,1,0,"[1,2]"', Heard(-61.0, ADDRESS)),
        ('"rssi": -61,', Heard(-61.0)),
        ("", None),
        ("3", None),
        ("rst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)", None),
        ("scan done", None),
        ("5 networks found", None),
        ("RSSI: weak", None),
        ("RSSI: -1234", None),
        ("IP address: 192.168.1.61", None),
        ("CSI_DATA,7,nobody,-61,11", None),
    ],
)
def test_lines_of_sketches(line: str, expected: Heard | None) -> None:
    assert heard_in(line) == expected


@settings(deadline=None, max_examples=100)
@given(
    st.text(max_size=30) | st.lists(st.sampled_from(["RSSI", "1: ", "CSI_DATA,", "-61", "(", ")", " | "])).map("".join)
)
def test_any_text_has_a_level_or_none(line: str) -> None:
    heard = heard_in(line)
    assert heard is None or -1000 < heard.rssi_dbm < 1000


def test_a_board_on_a_serial_port() -> None:
    other_end, port = os.openpty()
    source = open_source(f"serial:{os.ttyname(port)}", SourceDetails(transmitter_name="hall"))
    os.write(other_end, b'boot: ok\n1: hall (-61)*\n2: other (-70)\n{"rssi_dbm": -62}\n-63\nRSSI: -64 dBm\n')
    found: list[float] = []
    while len(found) < 4:
        found += levels_of(source)
    assert found == [-61, -62, -63, -64]
    assert source.rejected == {"no level in it": 1, "of another transmitter": 1}
    source.close()
    os.close(port)
    os.close(other_end)


def test_a_sketch_that_hears_several_is_asked_about() -> None:
    records = PrintedRecords(SourceDetails())
    assert records.sample(b"1: hall (-61)", 5) == (5, -61.0)
    records.require_one("/dev/ttyUSB0", 5)
    assert records.sample(b"2: street (-70)", 5) is None
    assert records.sample(b"1: hall (-62)", 5) is None
    records.require_one("/dev/ttyUSB0", 5)
    with pytest.raises(InputError, match=r"/dev/ttyUSB0 has 2 transmitters.*'hall' \(-62 dBm\), 'street' \(-70 dBm\)"):
        records.require_one("/dev/ttyUSB0", 5 + 3 * SECOND_NS)


# rtl_power


def hop(second: int, low_hz: int, *levels_db: float, step_hz: float = 100.0) -> str:
    """As rtl_power's own help has it."""
    levels = ", ".join(f"{level_db:.2f}" for level_db in levels_db)
    high_hz = low_hz + round(step_hz * len(levels_db))
    return f"2026-03-01, 12:00:{second:02d}, {low_hz}, {high_hz}, {step_hz:.2f}, 512, {levels}\n"


@pytest.mark.parametrize(
    ("band_hz", "hops", "expected"),
    [
        # One hop a sweep: the first is over when the second begins, which ends where the first did.
        (None, [(0, -60.0), (0, -61.0), (0, -62.0)], [None, -61, -62]),
        # Two: a sweep is over with its second one. The power of all bins together.
        (None, [(0, -60.0), (100, -60.0), (0, -70.0), (100, -70.0)], [None, None, -56.99, -66.99]),
        # The band lies in the second of three.
        (
            (100.0, 200.0),
            [(0, -10.0), (100, -60.0), (200, -9.0), (0, -9.0), (100, -61.0)],
            [None, -60, None, None, -61],
        ),
        # It begins in the middle of a row: bins count by their middles.
        ((120.0, 240.0), [(0, -10.0, -60.0, -10.0, -10.0), (0, -10.0, -63.0, -10.0, -10.0)], [-60, -63]),
        # It ends beyond the sweep.
        ((100.0, 900.0), [(0, -10.0), (100, -60.0), (0, -10.0), (100, -61.0)], [None, None, -60, -61]),
        # A bin without a level.
        (None, [(0, -60.0, math.nan), (0, -61.0, -math.inf)], [None, -61]),
        # None of it is in the band.
        ((500.0, 600.0), [(0, -60.0), (0, -61.0)], [None, math.nan]),
    ],
)
def test_sweeps(band_hz: tuple[float, float] | None, hops: list[tuple[Any, ...]], expected: list[float | None]) -> None:
    sweeps = Sweeps(band_hz)
    for (low_hz, *levels_db), level_db in zip(hops, expected, strict=True):
        row = parse_hop(hop(0, low_hz, *levels_db).encode())
        assert row is not None
        found = sweeps.add(row)
        if level_db is None:
            assert found is None
        else:
            assert found is not None
            assert found[1] == pytest.approx(level_db, abs=0.01, nan_ok=True)


def test_sweeps_that_are_being_written(tmp_path: Path) -> None:
    path = tmp_path / "sweep.csv"
    path.write_text(hop(0, 0, -10.0, -20.0) + hop(1, 0, -10.0, -20.0))
    source = open_source(f"rtl_power:{path}", SourceDetails(frequency_hz=(100.0, 200.0)))
    assert levels_of(source) == []  # what it held before is not how things are now
    with open(path, "a") as file:
        file.write(hop(2, 0, -10.0, -60.0)[:20])
        file.flush()
        assert levels_of(source) == []
        file.write(hop(2, 0, -10.0, -60.0)[20:] + "usb_claim_interface error\n" + hop(3, 0, -10.0, -61.0))
        file.flush()
        assert source.read(7) == [(7, pytest.approx(-60)), (7, pytest.approx(-61))]
    assert source.rejected == {"no row of rtl_power": 1}
    source.close()


def test_sweeps_from_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    source = open_source(f"rtl_power:{tmp_path / 'pipe'}", SourceDetails(frequency_hz=(0.0, 100.0)))
    with open(tmp_path / "pipe", "w") as pipe:
        pipe.write(hop(0, 0, -60.0))
    assert levels_of(source) == [pytest.approx(-60)]
    assert levels_of(source) == []
    source.close()


def test_recorded_sweeps_are_played(tmp_path: Path) -> None:
    """Whatever their file is called: .csv is what rtl_power's users call it."""
    path = tmp_path / "sweep.csv"
    path.write_text(hop(0, 0, -60.0) + hop(2, 0, -61.0) + hop(3, 0, -62.0))
    source = open_source(f"replay:{path}", SourceDetails(frequency_hz=(0.0, 100.0)))
    assert source.read(SECOND_NS) == [(SECOND_NS, pytest.approx(-60))]
    assert source.read(9 * SECOND_NS) == [(3 * SECOND_NS, pytest.approx(-61)), (4 * SECOND_NS, pytest.approx(-62))]


@pytest.mark.parametrize("band_hz", [(2.0, 1.0), (1.0, 1.0), (-1.0, 1.0), (0.0, math.inf), (math.nan, 1.0)])
def test_refused_bands(band_hz: tuple[float, float], tmp_path: Path) -> None:
    (tmp_path / "sweep.csv").write_text(hop(0, 0, -60.0))
    for scheme in ("rtl_power", "replay"):
        with pytest.raises(InputError, match="frequency_hz = "):
            open_source(f"{scheme}:{tmp_path / 'sweep.csv'}", SourceDetails(frequency_hz=band_hz))


@settings(deadline=None, max_examples=100)
@given(
    st.binary(max_size=80)
    | st.lists(
        st.sampled_from(["2026-03-01", " 12:00:00", "0", "1e999", "nan", "-60", "-1", "", "1e300"]), max_size=9
    ).map(lambda cells: ",".join(cells).encode())
)
def test_any_row_is_a_hop_or_none(line: bytes) -> None:
    found = parse_hop(line)
    if found is not None:
        row = Sweeps((0.0, 1.0)).add(found)
        assert row is None or math.isfinite(row[0])


# airodump-ng


ACCESS_POINTS = (
    "BSSID, First time seen, Last time seen, channel, Speed, Privacy, Cipher, Authentication, Power, # beacons, # IV, "
    "LAN IP, ID-length, ESSID, Key"
)
STATIONS = "Station MAC, First time seen, Last time seen, Power, # packets, BSSID, Probed ESSIDs"


def access_point(mac: str, power: int, beacons: int, name: str = "hall") -> str:
    seen = "2026-03-01 12:00:00, 2026-03-01 12:00:09,  6,  54"
    return f"{mac}, {seen}, OPN, ,   , {power}, {beacons:8d},        0,   0.  0.  0.  0, {len(name):3d}, {name}, "


def station(mac: str, power: int, packets: int) -> str:
    return f"{mac}, 2026-03-01 12:00:00, 2026-03-01 12:00:09, {power}, {packets:8d}, (not associated) , "


def airodump(path: Path, access_points: list[str], stations: list[str], changed_s: int) -> None:
    """As airodump-ng writes it: an empty line before each table and at the end."""
    lines = ["", ACCESS_POINTS, *access_points, "", STATIONS, *stations, "", ""]
    path.write_bytes("\r\n".join(lines).encode())
    os.utime(path, ns=(changed_s * SECOND_NS,) * 2)


@pytest.mark.parametrize("chosen", [{"transmitter_mac": ADDRESS}, {"transmitter_name": "hall"}])
def test_a_device_of_airodump(tmp_path: Path, chosen: dict[str, str]) -> None:
    path = tmp_path / "hall-01.csv"
    phone = station(OTHER.upper(), -70, 3)
    airodump(path, [access_point(ADDRESS, -60, 1)], [phone], 1)
    source = open_source(f"airodump-ng:{path}", SourceDetails(**chosen))  # type: ignore[arg-type]
    assert levels_of(source) == []  # that was before
    airodump(path, [access_point(ADDRESS, -61, 2)], [phone], 2)
    assert levels_of(source) == [-61]
    assert levels_of(source) == []
    airodump(path, [access_point(ADDRESS, -61, 2)], [station(OTHER, -71, 4)], 3)
    assert levels_of(source) == []  # written anew, and nothing new of it
    airodump(path, [access_point(ADDRESS, -61, 9)], [phone], 4)
    assert levels_of(source) == [-61]
    airodump(path, [access_point(ADDRESS, -1, 10)], [phone], 5)
    assert levels_of(source) == []  # of unknown power
    path.unlink()
    assert levels_of(source) == []
    airodump(path, [access_point(ADDRESS, -63, 11)], [phone], 6)
    assert levels_of(source) == [-63]
    assert source.rejected["of unknown power"] == 1
    assert source.rejected["not to be read"] == 1
    source.close()


def test_a_station_of_airodump(tmp_path: Path) -> None:
    path = tmp_path / "hall-01.csv"
    airodump(path, [], [], 1)
    source = open_source(f"airodump-ng:{path}", SourceDetails())
    airodump(path, [], [station(ADDRESS, -60, 1)], 2)
    assert levels_of(source) == [-60]  # it is alone: nobody has to be chosen
    airodump(path, [access_point(OTHER, -50, 1)], [station(ADDRESS, -61, 2)], 3)
    assert levels_of(source) == []
    with pytest.raises(InputError, match="has 2 transmitters"):
        levels_of(source, now_s=9.0)


def test_many_of_airodump_are_listed(tmp_path: Path) -> None:
    path = tmp_path / "hall-01.csv"
    airodump(path, [access_point(ADDRESS, -60, 1)], [station(OTHER, -50, 3), station(OTHER[:-1] + "9", -1, 3)], 1)
    with pytest.raises(
        InputError, match=rf"hall-01.csv has 2 transmitters.* '{OTHER}' \(-50 dBm\), '{ADDRESS}' \(-60 dB"
    ):
        open_source(f"airodump-ng:{path}", SourceDetails())
    with pytest.raises(InputError, match="cannot read CSV of airodump-ng"):
        open_source(f"airodump-ng:{tmp_path / 'gone'}", SourceDetails())


@settings(deadline=None, max_examples=100)
@given(st.binary(max_size=200), st.integers(0, 200))
def test_any_file_has_devices_or_none(content: bytes, cut: int) -> None:
    table = f"{ACCESS_POINTS}\r\n{access_point(ADDRESS, -60, 1)}\r\n\r\n{STATIONS}\r\n".encode()
    for device in parse_devices(content) + parse_devices(table + content) + parse_devices(table[:-cut]):
        assert len(device.mac) == 17


def test_records_of_several_devices_are_asked_about() -> None:
    source = open_source("udp:0", SourceDetails())
    try:
        for number, mac in enumerate([ADDRESS, OTHER]):
            line = json.dumps({"rssi_dbm": -60, "mac": mac}).encode()
            sample = source._records.sample(line, number)  # type: ignore[attr-defined]
            assert (sample is None) is (mac == OTHER)
        assert levels_of(source) == []
        with pytest.raises(InputError, match=r"^port \d+ has 2 transmitters"):
            levels_of(source, now_s=4.0)
    finally:
        source.close()
