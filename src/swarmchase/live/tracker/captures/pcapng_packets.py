"""The newer container, as dumpcap and Wireshark write it (IETF draft-ietf-opsawg-pcapng): block after block, each with
its length before and behind it."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from ....errors import InputError
from .packet import LARGEST_PACKET_BYTES, Packet, require_radiotap

SECTION_HEADER, INTERFACE_DESCRIPTION, SIMPLE_PACKET, ENHANCED_PACKET = 0x0A0D0D0A, 1, 3, 6
"""The types of block that are read; all others are jumped over."""
BYTE_ORDER_MAGIC = 0x1A2B3C4D
END_OF_OPTIONS, TIME_RESOLUTION, TIME_OFFSET = 0, 9, 14
LARGEST_BLOCK_BYTES = 2**24
"""Wireshark's own limit: more is no block but a broken file."""
SMALLEST_BLOCK_BYTES = 12


@dataclass(frozen=True)
class Interface:
    """What captured, as its block describes it."""

    link_type: int
    ticks_per_second: int = 1_000_000
    offset_s: int = 0
    """Added to every time."""

    def time_ns(self, ticks: int) -> int:
        """Since 1970."""
        return ticks * 1_000_000_000 // self.ticks_per_second + self.offset_s * 1_000_000_000


class PcapngPackets:
    """A ``PacketReader``. Each section of the capture has its own byte order and interfaces."""

    def __init__(self) -> None:
        self.is_broken = False
        self._rest = b""
        self._byte_order = ""
        self._interfaces: list[Interface] = []

    def feed(self, chunk: bytes) -> list[Packet]:
        """The packets that are whole now.

        Raises:
            InputError: this is no such capture, or one without radiotap headers.
        """
        if self.is_broken:
            return []
        self._rest += chunk
        packets: list[Packet] = []
        position = 0
        while (length := self._block_length(position)) is not None:
            packets += self._packets(position, length)
            position += length
        self._rest = b"" if self.is_broken else self._rest[position:]
        return packets

    def _block_length(self, position: int) -> int | None:
        """Of the block there, in bytes; None until it is whole, and for ever after a broken one."""
        if self.is_broken or len(self._rest) < position + SMALLEST_BLOCK_BYTES:
            return None
        # The type of a section's header reads the same in both byte orders.
        if struct.unpack_from("<I", self._rest, position)[0] == SECTION_HEADER:
            self._read_byte_order(position)
        (length,) = struct.unpack_from(self._byte_order + "I", self._rest, position + 4)
        if not SMALLEST_BLOCK_BYTES <= length <= LARGEST_BLOCK_BYTES or length % 4:
            self.is_broken = True
            return None
        return length if len(self._rest) >= position + length else None

    def _read_byte_order(self, position: int) -> None:
        for byte_order in "<>":
            if struct.unpack_from(byte_order + "I", self._rest, position + 8)[0] == BYTE_ORDER_MAGIC:
                self._byte_order = byte_order
                return
        raise InputError("this is no pcapng capture: a section says no byte order")

    def _packets(self, position: int, length: int) -> list[Packet]:
        """None or one. A block whose own lengths lead beyond its end ends the reading."""
        (kind,) = struct.unpack_from(self._byte_order + "I", self._rest, position)
        body = self._rest[position + 8 : position + length - 4]
        try:
            if kind == SECTION_HEADER:
                self._interfaces = []
            elif kind == INTERFACE_DESCRIPTION:
                self._interfaces.append(self._interface(body))
            elif kind == ENHANCED_PACKET:
                return [self._enhanced_packet(body)]
            elif kind == SIMPLE_PACKET:
                return [self._simple_packet(body)]
        except (struct.error, IndexError):
            self.is_broken = True
        return []

    def _interface(self, body: bytes) -> Interface:
        (link_type,) = struct.unpack_from(self._byte_order + "H", body)
        ticks_per_second, offset_s = 1_000_000, 0
        for code, value in self._options(body[8:]):
            if code == TIME_RESOLUTION:
                # The highest bit says of what the rest is the negative power: 2, or 10.
                ticks_per_second = 2 ** (value[0] & 0x7F) if value[0] & 0x80 else 10 ** value[0]
            elif code == TIME_OFFSET:
                (offset_s,) = struct.unpack(self._byte_order + "q", value)
        return Interface(link_type, ticks_per_second, offset_s)

    def _options(self, content: bytes) -> Iterator[tuple[int, bytes]]:
        position = 0
        while position + 4 <= len(content):
            code, size = struct.unpack_from(self._byte_order + "HH", content, position)
            if code == END_OF_OPTIONS:
                return
            yield code, content[position + 4 : position + 4 + size]
            position += 4 + size + -size % 4

    def _enhanced_packet(self, body: bytes) -> Packet:
        number, high, low, size = struct.unpack_from(self._byte_order + "IIII", body)
        interface = self._interfaces[number]
        require_radiotap([one.link_type for one in self._interfaces])
        return Packet(interface.time_ns(high << 32 | low), interface.link_type, _content(body[20:], size))

    def _simple_packet(self, body: bytes) -> Packet:
        (size,) = struct.unpack_from(self._byte_order + "I", body)
        require_radiotap([one.link_type for one in self._interfaces])
        # Its original size stands there: captured may have been less.
        return Packet(None, self._interfaces[0].link_type, body[4 : 4 + size])


def _content(padded: bytes, size: int) -> bytes:
    if size > min(len(padded), LARGEST_PACKET_BYTES):
        raise IndexError("a packet ends behind its block")
    return padded[:size]
