"""What carries MAVLink between the agent and the autopilot beside it."""

import os
import select
from pathlib import Path
from typing import Protocol, runtime_checkable

from ...link.udp_socket import bound_udp_socket
from ...serial_port import open_serial_port

MOST_DATAGRAMS_PER_READ = 200
READ_BYTES = 65536


@runtime_checkable
class Transport(Protocol):
    """Bytes to and from one autopilot. Neither method blocks; what cannot be sent is lost."""

    def read(self) -> list[bytes]:
        """What has come: datagrams, or pieces of a stream."""

    def write(self, data: bytes) -> None:
        """Send it."""

    def close(self) -> None:
        """Give back what it holds."""


class UdpTransport:
    """Waits for the autopilot, or the router before it, to send, and answers to where the last datagram came from.

    The link is not signed, and whoever reaches the port speaks for the autopilot: it is on loopback unless told
    otherwise.

    Raises:
        InputError: the address cannot be had.
    """

    def __init__(self, port: int, host: str = "127.0.0.1") -> None:
        self._peer: tuple[str, int] | None = None
        self._socket = bound_udp_socket(host, port)

    @property
    def port(self) -> int:
        """Where it listens: found by the system where 0 was asked for."""
        return int(self._socket.getsockname()[1])

    def read(self) -> list[bytes]:
        """The datagrams that have come."""
        datagrams: list[bytes] = []
        for _ in range(MOST_DATAGRAMS_PER_READ):
            try:
                datagram, self._peer = self._socket.recvfrom(READ_BYTES)
            except BlockingIOError:
                break
            except OSError:  # what was sent before found nobody there
                continue
            datagrams.append(datagram)
        return datagrams

    def write(self, data: bytes) -> None:
        """Send it to who spoke last."""
        if self._peer is not None:
            try:
                self._socket.sendto(data, self._peer)
            except OSError:
                return

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class SerialTransport:
    """The autopilot's telemetry port.

    Raises:
        InputError: there is no such port.
    """

    def __init__(self, path: Path, baud: int = 57_600) -> None:
        self._descriptor = open_serial_port(path, baud)

    def read(self) -> list[bytes]:
        """The bytes that have come."""
        try:
            if not select.select([self._descriptor], [], [], 0)[0]:
                return []
            return [os.read(self._descriptor, READ_BYTES)]
        except OSError:  # unplugged: the autopilot has fallen silent
            return []

    def write(self, data: bytes) -> None:
        """Send what the port takes."""
        try:
            os.write(self._descriptor, data)
        except OSError:
            return

    def close(self) -> None:
        """Close the port."""
        os.close(self._descriptor)
