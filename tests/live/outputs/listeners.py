"""Who listens to outputs: a CoT listener over UDP and over TCP, and as much of an MQTT broker as a publisher needs."""

import socket
import threading
from collections.abc import Callable, Sized
from xml.etree import ElementTree

PATIENCE_S = 60.0
"""Nothing here takes a tenth of it, unless the machine is very busy with something else."""
EVENT_END = b"</event>"


class Listener:
    """A thread that takes what comes at a port of this machine until ``close``."""

    def __init__(self, kind: socket.SocketKind, port: int = 0) -> None:
        self._socket = socket.socket(socket.AF_INET, kind)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.bind(("127.0.0.1", port))
        self._socket.settimeout(0.02)
        if kind is socket.SOCK_STREAM:
            self._socket.listen()
        self.port: int = self._socket.getsockname()[1]
        self._heard, self._is_closing = threading.Condition(), threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._is_closing.set()
        self._thread.join(PATIENCE_S)
        self._socket.close()

    def wait(self, until: Callable[[], bool]) -> None:
        """For something that what has been heard says."""
        with self._heard:
            assert self._heard.wait_for(until, PATIENCE_S)

    def wait_for_more_than(self, number: int, heard: Sized) -> None:
        """Of what it keeps."""
        self.wait(lambda: len(heard) > number)

    def _note(self, heard: Callable[[], None]) -> None:
        with self._heard:
            heard()
            self._heard.notify_all()

    def _listen(self) -> None:
        while not self._is_closing.is_set():
            try:
                self._serve()
            except TimeoutError:
                continue

    def _serve(self) -> None:
        raise NotImplementedError

    def _received(self, connection: socket.socket) -> bytes:
        """More of a stream; nothing at its end, or at ours."""
        while not self._is_closing.is_set():
            try:
                return connection.recv(65_536)
            except TimeoutError:
                continue
        return b""


class CotListener(Listener):
    """Keeps all events, parsed."""

    def __init__(self, kind: socket.SocketKind, port: int = 0) -> None:
        self.events: list[ElementTree.Element] = []
        self._is_stream = kind is socket.SOCK_STREAM
        super().__init__(kind, port)

    def of(self, name: str) -> list[ElementTree.Element]:
        """Those of one thing: swarm, tracker-2, estimate, region."""
        return [event for event in self.events if event.attrib["uid"].endswith(f"-{name}")]

    def _serve(self) -> None:
        if not self._is_stream:
            event = ElementTree.fromstring(self._socket.recv(65_536))
            self._note(lambda: self.events.append(event))
            return
        connection, _ = self._socket.accept()
        with connection:
            connection.settimeout(0.02)
            # A server passes on what others say; nobody has to read it.
            connection.sendall(b"<event/>" * 100)
            buffer = b""
            while data := self._received(connection):
                *whole, buffer = (buffer + data).split(EVENT_END)
                for one in whole:
                    event = ElementTree.fromstring(one.strip() + EVENT_END)
                    self._note(lambda event=event: self.events.append(event))  # type: ignore[misc]


class Broker(Listener):
    """MQTT 3.1.1: answers CONNECT and PINGREQ, and keeps what is published with quality of service 0."""

    def __init__(self, port: int = 0, refusal: int = 0) -> None:
        self.published: list[tuple[str, bytes]] = []
        self.users: list[tuple[str, str]] = []
        self._refusal = refusal
        super().__init__(socket.SOCK_STREAM, port)

    def _serve(self) -> None:
        connection, _ = self._socket.accept()
        with connection:
            connection.settimeout(0.02)
            buffer = b""
            while data := self._received(connection):
                buffer += data
                while packet := _packet(buffer):
                    kind, body, buffer = packet
                    if kind == 1:
                        assert body.startswith(b"\0\4MQTT\4")
                        _, *credentials = _strings(body[10:])
                        self.users += [tuple(credentials)] if credentials else []  # type: ignore[list-item]
                        connection.sendall(bytes([0x20, 2, 0, self._refusal]))
                    elif kind == 12:
                        connection.sendall(bytes([0xD0, 0]))
                    elif kind == 3:
                        length = int.from_bytes(body[:2], "big")
                        topic, payload = body[2 : 2 + length].decode(), body[2 + length :]
                        self._note(lambda: self.published.append((topic, payload)))  # noqa: B023 (called at once)
                if self._refusal:
                    return


def _packet(data: bytes) -> tuple[int, bytes, bytes] | None:
    """Kind, body and what comes after the first packet, if it is all there."""
    length, shift, at = 0, 0, 1
    while at < len(data):
        length |= (data[at] & 127) << shift
        at, shift = at + 1, shift + 7
        if data[at - 1] < 128:
            return (data[0] >> 4, data[at : at + length], data[at + length :]) if len(data) >= at + length else None
    return None


def _strings(data: bytes) -> list[str]:
    """Each after its length in two bytes."""
    found = []
    while data:
        length = int.from_bytes(data[:2], "big")
        found.append(data[2 : 2 + length].decode())
        data = data[2 + length :]
    return found
