"""HOST:PORT, and KIND:PLACE, as people write them."""

import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from ..errors import InputError

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True, kw_only=True)
class AddressKind:
    """One of the kinds of things that an address, ``udp:14555``, may name."""

    scheme: str
    """What its addresses begin with."""
    place: str
    """What they go on with after a colon, in the word that help uses; empty: the scheme stands alone."""
    note: str = ""
    """What help says of it in brackets."""

    @property
    def form(self) -> str:
        """How its addresses read."""
        return f"{self.scheme}:{self.place}" if self.place else self.scheme


_Kind = TypeVar("_Kind", bound=AddressKind)


def host_and_port(text: str, what: str, default_host: str | None = None) -> tuple[str, int]:
    """``127.0.0.1:14550`` and ``[::1]:14550``; ``14550`` alone where there is a default host.

    Args:
        what: asks for it, for the refusal: ``--page``, ``source udp``.

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
        raise InputError(f"{what} {text!r} is refused: allowed is {allowed}, with a port from 0 to {2**16 - 1}")
    return host, int(port)


def kind_and_place(text: str, kinds: Sequence[_Kind], what: str) -> tuple[_Kind, str]:
    """``udp:14555`` as its kind and what follows the colon.

    Args:
        kinds: those there are.
        what: is asked for, for the refusal.

    Raises:
        InputError: another kind, or its place is missing.
    """
    scheme, colon, place = text.partition(":")
    kind = next((one for one in kinds if one.scheme == scheme), None)
    if kind is None or bool(place) != bool(kind.place) or (colon and not place):
        allowed = ", ".join(one.form for one in kinds)
        raise InputError(f"{what} {text!r} is refused: allowed is one of {allowed}")
    return kind, place


def help_of(kinds: Sequence[AddressKind]) -> str:
    """How the addresses of these kinds read, for help."""
    return ", ".join(f"{kind.form} ({kind.note})" if kind.note else kind.form for kind in kinds)


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach it; a name counts by what it is known for."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
