"""UDP sockets: one that is listened on, and what the links need of one."""

import socket
from typing import Any, Protocol, runtime_checkable

from ...errors import InputError, reason_of

Address = tuple[Any, ...]
"""As the socket module has it: host and port, and two more for IPv6."""


@runtime_checkable
class DatagramSocket(Protocol):
    """What the links use of a non-blocking socket; a simulation has others."""

    def recvfrom(self, size: int, /) -> tuple[bytes, Any]:
        """The next datagram and who sent it; ``OSError`` where none waits."""

    def sendto(self, datagram: bytes, address: Any, /) -> int:
        """Send it, or lose it."""

    def getsockname(self) -> Any:
        """Its own address."""

    def fileno(self) -> int:
        """For ``select``."""

    def close(self) -> None:
        """Give it back."""


def bound_udp_socket(host: str, port: int) -> socket.socket:
    """Non-blocking; port 0 lets the system choose.

    Raises:
        InputError: the address cannot be had.
    """
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    bound.setblocking(False)
    try:
        bound.bind((host, port))
    except (OSError, OverflowError) as error:
        bound.close()
        raise InputError(f"cannot listen on {host}:{port}: {reason_of(error)}") from error
    return bound
