"""Sources on the network: MQTT, ZeroMQ, GNU Radio, a telemetry radio's RADIO_STATUS; and what is said without them."""

import contextlib
import math
import os
import re
import socket
import struct
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from swarmchase.errors import InputError
from swarmchase.live.tracker.sources import RssiSource
from swarmchase.live.tracker.sources.address import KINDS, open_source
from swarmchase.live.tracker.sources.kind import SourceDetails

ADDRESS = "02:00:00:00:00:07"


def eventually(condition: Callable[[], bool]) -> None:
    """Another thread, or the kernel, needs a moment; that it takes for ever is the failure."""
    for _ in range(2000):
        if condition():
            return
        threading.Event().wait(0.005)
    raise AssertionError("it never happened")


def heard(source: RssiSource, num_samples: int) -> list[float]:
    """So many levels of it, in dBm."""
    found: list[float] = []
    eventually(lambda: bool(found.extend(level for _, level in source.read(5))) or len(found) >= num_samples)
    return found


# MQTT


class Broker:
    """As much of a broker of MQTT 3.1.1 as one subscriber notices (OASIS standard, chapter 3)."""

    def __init__(self, password: bytes | None = None) -> None:
        self.connected: list[bytes] = []
        self.topics: list[bytes] = []
        self._password = password
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        self._client: socket.socket | None = None
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def publish(self, topic: bytes, payload: bytes) -> None:
        """PUBLISH of quality 0: type 3, length, topic, payload."""
        assert self._client is not None
        body = struct.pack(">H", len(topic)) + topic + payload
        self._client.sendall(b"\x30" + _length(len(body)) + body)

    def drop(self) -> None:
        """The subscriber, which comes back by itself."""
        assert self._client is not None
        self._client.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.shutdown(socket.SHUT_RDWR)
        self._thread.join()

    def _serve(self) -> None:
        while True:
            try:
                self._client, _ = self._socket.accept()
            except OSError:
                return
            with contextlib.suppress(OSError, IndexError), self._client, self._client.makefile("rb") as stream:
                while head := stream.read(1):
                    size, shift = 0, 0
                    while True:
                        byte = stream.read(1)[0]
                        size, shift = size | (byte & 0x7F) << shift, shift + 7
                        if byte < 0x80:
                            break
                    self._answer(head[0] >> 4, stream.read(size))

    def _answer(self, kind: int, body: bytes) -> None:
        assert self._client is not None
        if kind == 1:  # CONNECT: CONNACK with 0, or 5, not authorized
            self.connected.append(body)
            is_allowed = self._password is None or body.endswith(self._password)
            self._client.sendall(b"\x20\x02\x00" + (b"\x00" if is_allowed else b"\x05"))
        elif kind == 8:  # SUBSCRIBE: packet id, topic, quality; SUBACK
            (length,) = struct.unpack_from(">H", body, 2)
            self._client.sendall(b"\x90\x03" + body[:2] + b"\x00")
            self.topics.append(body[4 : 4 + length])
        elif kind == 12:  # PINGREQ
            self._client.sendall(b"\xd0\x00")


def _length(size: int) -> bytes:
    """Seven bits a byte, the lowest first."""
    return bytes([size]) if size < 0x80 else bytes([size & 0x7F | 0x80]) + _length(size >> 7)


@pytest.fixture
def broker(request: pytest.FixtureRequest) -> Iterator[Broker]:
    pytest.importorskip("paho.mqtt")
    broker = Broker(getattr(request, "param", None))
    yield broker
    broker.close()


def test_a_lora_gateway_behind_a_broker(broker: Broker) -> None:
    details = SourceDetails(rssi_column="rxInfo.0.rssi", time_column="time")
    source = open_source(f"mqtt:127.0.0.1:{broker.port}/gateway/+/event/up", details)
    try:
        eventually(lambda: broker.topics == [b"gateway/+/event/up"])
        broker.publish(b"gateway/1/event/up", b'{"rxInfo": [{"rssi": -97, "snr": 6.5}], "note": "' + b"x" * 200 + b'"}')
        broker.publish(b"gateway/1/event/up", b"-61")
        broker.publish(b"gateway/1/event/up", b"hello")
        broker.publish(b"gateway/1/event/up", b'{"rxInfo": [{"rssi": -98}], "time": "2026-03-01T12:00:00Z"}')
        assert heard(source, 3) == [-97, -61, -98]
        assert source.rejected == {"no level in it": 1}
    finally:
        source.close()


def test_a_broker_that_goes_away_and_comes_back(broker: Broker) -> None:
    source = open_source(f"mqtt:127.0.0.1:{broker.port}/rssi", SourceDetails())
    try:
        eventually(lambda: broker.topics == [b"rssi"])
        broker.drop()
        eventually(lambda: "it was lost" in source.silence or broker.topics == [b"rssi"] * 2)
        eventually(lambda: broker.topics == [b"rssi"] * 2)
        broker.publish(b"rssi", b'{"rssi_dbm": -61}')
        assert heard(source, 1) == [-61]
    finally:
        source.close()


@pytest.mark.parametrize("broker", [b"secret"], indirect=True)
@pytest.mark.parametrize("password", ["secret", "guess"])
def test_a_broker_that_wants_a_password(broker: Broker, tmp_path: Path, password: str) -> None:
    (tmp_path / "password").write_text(password + "\n")
    details = SourceDetails(mqtt_password_file=tmp_path / "password")
    source = open_source(f"mqtt:tracker-3@127.0.0.1:{broker.port}/rssi", details)
    try:
        if password == "secret":
            eventually(lambda: broker.topics == [b"rssi"])
            assert b"tracker-3" in broker.connected[0]
        else:
            eventually(lambda: "it refuses: Not authorized" in source.silence)
    finally:
        source.close()


def test_a_broker_that_is_not_there() -> None:
    pytest.importorskip("paho.mqtt")
    with socket.socket() as reserved:
        reserved.bind(("127.0.0.1", 0))
        source = open_source(f"mqtt:127.0.0.1:{reserved.getsockname()[1]}/rssi", SourceDetails())
        eventually(lambda: source.silence.endswith(": it cannot be reached"))
        source.close()


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("127.0.0.1", r"allowed is mqtt:\[USER@\]HOST"),
        ("127.0.0.1/", r"allowed is mqtt:\[USER@\]HOST"),
        ("127.0.0.1:70000/rssi", "with a port from 0"),
        ("127.0.0.1/rssi/#/x", "topic 'rssi/#/x' is refused"),
        ("127.0.0.1/rssi+", "topic 'rssi\\+' is refused"),
    ],
)
def test_refused_brokers(place: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        open_source(f"mqtt:{place}", SourceDetails())


def test_a_password_of_nobody(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a password is of a user"):
        open_source("mqtt:127.0.0.1/rssi", SourceDetails(mqtt_password_file=tmp_path / "password"))


# ZeroMQ


@pytest.fixture
def publisher(tmp_path: Path) -> Iterator[tuple[str, Any]]:
    """An endpoint, and the socket that publishes there."""
    zmq = pytest.importorskip("zmq")
    context = zmq.Context()
    publishing = context.socket(zmq.PUB)
    publishing.setsockopt(zmq.LINGER, 0)
    port = publishing.bind_to_random_port("tcp://127.0.0.1")
    yield f"tcp://127.0.0.1:{port}", publishing
    publishing.close()
    context.term()


def said_until_heard(publishing: Any, source: RssiSource, parts: list[bytes]) -> list[float]:
    """A subscriber hears what is published after it has connected, which takes a moment."""
    found: list[float] = []

    def say() -> bool:
        publishing.send_multipart(parts)
        found.extend(level for _, level in source.read(5))
        return bool(found)

    eventually(say)
    return found


def test_records_over_zeromq(publisher: tuple[str, Any]) -> None:
    endpoint, publishing = publisher
    names = {"rssi_column": "0.Basic ID.RSSI", "mac_column": "0.Basic ID.MAC", "transmitter_mac": ADDRESS}
    source = open_source(f"zmq:{endpoint}", SourceDetails(**names))  # type: ignore[arg-type]
    try:
        record = b'[{"Basic ID": {"MAC": "%s", "RSSI": -55, "id": "1581F"}}]'
        assert set(said_until_heard(publishing, source, [record % ADDRESS.encode()])) == {-55}
        publishing.send(record % b"02:00:00:00:00:08")
        eventually(lambda: bool(source.read(5)) or source.rejected["of another transmitter"] == 1)
        # In two parts, the first its topic.
        assert said_until_heard(publishing, source, [b"rid", record % ADDRESS.encode()])[0] == -55
    finally:
        source.close()


def test_floats_of_a_flow_graph(publisher: tuple[str, Any]) -> None:
    endpoint, publishing = publisher
    source = open_source(f"gnuradio:{endpoint}", SourceDetails())
    try:
        found = said_until_heard(publishing, source, [struct.pack("<3f", -70.0, -65.0, -61.5)])
        assert set(found) == {-61.5}
        publishing.send(b"12345")
        eventually(lambda: bool(source.read(5)) or source.rejected == {"no floats of 32 bits": 1})
        assert "no message has come from tcp://" in source.silence
    finally:
        source.close()


@pytest.mark.parametrize("scheme", ["zmq", "gnuradio"])
@pytest.mark.parametrize("endpoint", ["127.0.0.1:5556", "tcp://127.0.0.1", "tcp://127.0.0.1:port"])
def test_refused_endpoints(scheme: str, endpoint: str) -> None:
    pytest.importorskip("zmq")
    with pytest.raises(InputError, match=r"endpoint|cannot connect to"):
        open_source(f"{scheme}:{endpoint}", SourceDetails())


# RADIO_STATUS


def radio_status(rssi: int) -> bytes:
    """As a SiK radio puts it into the stream: system 51, component 68."""
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    radio = common.MAVLink(None, srcSystem=51, srcComponent=68)
    return bytes(common.MAVLink_radio_status_message(rssi, 190, 100, 40, 42, 0, 0).pack(radio))


def heartbeat() -> bytes:
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    return bytes(common.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(common.MAVLink(None, srcSystem=1)))


def test_a_radio_whose_stream_comes_over_udp() -> None:
    source = open_source("radio_status:0", SourceDetails())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as router:
        for datagram in (
            radio_status(148),
            heartbeat() + radio_status(200),
            b"noise",
            radio_status(0),
            radio_status(255),
        ):
            router.sendto(datagram, ("127.0.0.1", source._line._transport.port))  # type: ignore[attr-defined]
        found = heard(source, 4)
    # 148 / 1.9 - 127 dBm; 0 is nothing heard, 255 unknown.
    assert found == pytest.approx([-49.105, -21.737, math.nan, math.nan], abs=1e-3, nan_ok=True)
    assert source.rejected["no RADIO_STATUS"] >= 1
    assert "HEARTBEAT" in source.rejected.seen("no RADIO_STATUS")
    source.close()


def test_a_radio_at_a_serial_port() -> None:
    other_end, port = os.openpty()
    source = open_source(f"radio_status:{os.ttyname(port)}", SourceDetails(serial_baud=57_600))
    os.close(port)
    message = radio_status(148)
    os.write(other_end, message[:7])
    os.write(other_end, message[7:])
    assert heard(source, 1) == pytest.approx([-49.105], abs=1e-3)
    os.close(other_end)
    assert source.read(6) == []
    source.close()


@pytest.mark.parametrize(
    ("place", "message"),
    [("port", "allowed is PORT or HOST:PORT.*or the PATH of a serial port"), ("/gone", "cannot open")],
)
def test_refused_radios(place: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        open_source(f"radio_status:{place}", SourceDetails())


# What is not installed


@pytest.mark.parametrize(
    ("address", "missing", "package"),
    [
        ("mqtt:127.0.0.1/rssi", "paho", "paho-mqtt>=2"),
        ("zmq:tcp://127.0.0.1:1", "zmq", "pyzmq"),
        ("gnuradio:tcp://127.0.0.1:1", "zmq", "pyzmq"),
    ],
)
def test_a_library_that_is_missing_is_one_line(
    address: str, missing: str, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name == missing or name.startswith(f"{missing}.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(InputError, match=rf"needs .*: pip install '?{re.escape(package)}'?$"):
        open_source(address, SourceDetails())


def test_every_source_has_a_scheme_of_its_own() -> None:
    assert len({kind.scheme for kind in KINDS}) == len(KINDS)
