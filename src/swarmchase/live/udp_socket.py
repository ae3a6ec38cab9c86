"""A UDP socket that is listened on."""

import socket

from ..errors import InputError


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
        raise InputError(f"cannot listen on {host}:{port}: {error}") from error
    return bound
