"""Cursor-on-Target over a TCP connection, one event after another: a TAK server, or WinTAK's own input."""

import contextlib
import socket

from ..address import host_and_port
from ..frame import Frame
from .cot_events import cot_events
from .kind import OutputDetails

WAIT_S = 3.0
"""For a connection, and for the other end to take what is sent."""


class CotTcpOutput:
    """To one address; a connection that ends is made again with the next frame.

    Raises:
        InputError: the place is no address, or there is no origin.
    """

    def __init__(self, place: str, details: OutputDetails) -> None:
        self._address = host_and_port(place, "output cot-tcp")
        details.require_origin("output cot-tcp")
        self._details = details
        self._socket: socket.socket | None = None

    def send(self, frame: Frame, wall_ns: int) -> None:
        """Each event, and a line feed.

        Raises:
            OSError: no connection is to be had, or the other end has closed it or takes nothing.
        """
        try:
            if self._socket is None:
                self._socket = socket.create_connection(self._address, WAIT_S)
            _hear(self._socket)
            self._socket.sendall(b"".join(event + b"\n" for event in cot_events(frame, wall_ns, self._details)))
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        """End the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _hear(connected: socket.socket) -> None:
    """A server passes on what others say: it is thrown away, so that the server does not wait for us.

    Raises:
        ConnectionError: the other end has closed.
    """
    connected.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while connected.recv(65_536):
            pass
        raise ConnectionError("the other end has closed the connection")
    connected.settimeout(WAIT_S)
