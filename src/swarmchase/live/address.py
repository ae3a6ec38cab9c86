"""HOST:PORT as people write it."""

import ipaddress

from ..errors import InputError

LOOPBACK = "127.0.0.1"


def host_and_port(text: str, default_host: str | None = None) -> tuple[str, int]:
    """``127.0.0.1:14550`` and ``[::1]:14550``; ``14550`` alone where there is a default host.

    Raises:
        InputError: it is no such address.
    """
    host, colon, port = text.rpartition(":")
    if not colon and default_host is not None:
        host = default_host
    host = host.removeprefix("[").removesuffix("]")
    is_port = port.isascii() and port.isdigit() and int(port) < 2**16
    if not host or not is_port:
        allowed = "HOST:PORT" if default_host is None else "PORT or HOST:PORT"
        raise InputError(f"{text!r} is refused: allowed is {allowed}, with a port from 0 to {2**16 - 1}")
    return host, int(port)


def kind_and_place(text: str, kinds: dict[str, str], what: str) -> tuple[str, str]:
    """``udp:14555`` in its two parts; a kind whose place is empty in ``kinds`` stands alone.

    Args:
        kinds: what each kind wants after its colon, in the word that help uses.
        what: is asked for, for the refusal.

    Raises:
        InputError: another kind, or its place is missing.
    """
    kind, colon, place = text.partition(":")
    if kind not in kinds or bool(place) != bool(kinds[kind]) or (colon and not place):
        allowed = ", ".join(f"{name}:{wanted}" if wanted else name for name, wanted in kinds.items())
        raise InputError(f"{what} {text!r} is refused: allowed is one of {allowed}")
    return kind, place


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach it; a name counts by what it is known for."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
