"""A packet as a capture holds it, whatever the container."""

from collections.abc import Collection
from typing import NamedTuple, Protocol, runtime_checkable

from ....errors import InputError

LINK_TYPE_RADIOTAP = 127
"""Of tcpdump.org's list: 802.11 frames, each behind a radiotap header."""
LARGEST_PACKET_BYTES = 262_144
"""libpcap's own limit: more is no packet but a broken file."""


class Packet(NamedTuple):
    """One of them."""

    time_ns: int | None
    """Of the capturing clock; None where the container has none for it."""
    link_type: int
    content: bytes


@runtime_checkable
class PacketReader(Protocol):
    """Takes the bytes of a capture as they come."""

    is_broken: bool
    """Something is no packet: where the next one begins is not known any more."""

    def feed(self, chunk: bytes) -> list[Packet]:
        """The packets that are whole now.

        Raises:
            InputError: this is no such capture, or one without radiotap headers.
        """


def require_radiotap(link_types: Collection[int]) -> None:
    """Of the interfaces of a capture.

    Raises:
        InputError: none has radiotap headers.
    """
    if LINK_TYPE_RADIOTAP not in link_types:
        found = ", ".join(map(str, link_types))
        raise InputError(f"link type {found} is refused: allowed is {LINK_TYPE_RADIOTAP}, radiotap")
