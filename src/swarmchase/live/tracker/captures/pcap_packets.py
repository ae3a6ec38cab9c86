"""The classic container of libpcap (pcap-savefile(5)): a header, then packet after packet."""

import struct

from ....errors import InputError
from .packet import LARGEST_PACKET_BYTES, Packet, require_radiotap

FILE_HEADER_BYTES, PACKET_HEADER_BYTES = 24, 16
TICKS_PER_SECOND = {0xA1B2C3D4: 1_000_000, 0xA1B23C4D: 1_000_000_000}
"""By the number with which the file begins, in the byte order of who wrote it."""


class PcapPackets:
    """A ``PacketReader``."""

    def __init__(self) -> None:
        self.is_broken = False
        self._rest = b""
        self._byte_order = ""
        self._ticks_per_second = 0
        self._link_type = 0

    def feed(self, chunk: bytes) -> list[Packet]:
        """The packets that are whole now.

        Raises:
            InputError: this is no such capture, or one without radiotap headers.
        """
        if self.is_broken:
            return []
        self._rest += chunk
        if not self._byte_order and not self._read_file_header():
            return []
        packets: list[Packet] = []
        position = 0
        while (header := self._packet_header(position)) is not None:
            time_ns, size = header
            begin = position + PACKET_HEADER_BYTES
            packets.append(Packet(time_ns, self._link_type, self._rest[begin : begin + size]))
            position = begin + size
        self._rest = b"" if self.is_broken else self._rest[position:]
        return packets

    def _read_file_header(self) -> bool:
        if len(self._rest) < FILE_HEADER_BYTES:
            return False
        for byte_order in "<>":
            magic, link_type = struct.unpack_from(byte_order + "I16xI", self._rest)
            if magic in TICKS_PER_SECOND:
                # The upper bits say how long the frame check sequence is.
                self._link_type = link_type & 0xFFFF
                require_radiotap([self._link_type])
                self._byte_order, self._ticks_per_second = byte_order, TICKS_PER_SECOND[magic]
                self._rest = self._rest[FILE_HEADER_BYTES:]
                return True
        raise InputError("this is no pcap capture")

    def _packet_header(self, position: int) -> tuple[int, int] | None:
        """(time in ns, size in bytes) of the packet there; None until it is whole, and for ever after a broken one."""
        if len(self._rest) < position + PACKET_HEADER_BYTES:
            return None
        seconds, ticks, size = struct.unpack_from(self._byte_order + "III", self._rest, position)
        if size > LARGEST_PACKET_BYTES:
            self.is_broken = True
            return None
        if len(self._rest) < position + PACKET_HEADER_BYTES + size:
            return None
        return seconds * 1_000_000_000 + ticks * (1_000_000_000 // self._ticks_per_second), size
