"""Cursor-on-Target over UDP, an event a datagram: a phone with ATAK, or a multicast group that all listen to."""

import contextlib
import select
import socket

from ..address import host_and_port
from ..frame import Frame
from .cot_events import cot_events
from .kind import OutputDetails

REFUSAL_S = 0.2
"""So long after its events a host may say that nobody listens there."""


class CotUdpOutput:
    """To one address.

    Raises:
        InputError: the place is no address, or there is no origin.
    """

    def __init__(self, place: str, details: OutputDetails) -> None:
        self._host, self._port = host_and_port(place, "output cot-udp")
        details.require_origin("output cot-udp")
        self._details = details
        self._socket: socket.socket | None = None

    def send(self, frame: Frame, wall_ns: int) -> None:
        """One datagram an event.

        Raises:
            OSError: the name is unknown, there is no way there, or the host says that nobody listens.
        """
        try:
            connected = self._connected()
            for event in cot_events(frame, wall_ns, self._details):
                connected.send(event)
            if select.select([connected], [], [], REFUSAL_S)[0]:
                connected.recv(1)
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        """Give the socket back."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connected(self) -> socket.socket:
        """Only a connected socket hears that nobody listens."""
        if self._socket is None:
            family, kind, protocol, _, address = socket.getaddrinfo(self._host, self._port, type=socket.SOCK_DGRAM)[0]
            with contextlib.ExitStack() as stack:
                made = stack.enter_context(socket.socket(family, kind, protocol))
                made.connect(address)
                stack.pop_all()
            self._socket = made
        return self._socket
