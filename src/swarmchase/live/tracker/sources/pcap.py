"""Signal levels of captured 802.11 packets, from a capture file, finished or growing, or from a pipe.

    tcpdump -i wlan0mon -y IEEE802_11_RADIO -U -w - | swarmchase tracker ...

The format is the classic one of libpcap with link type 127 (pcap-savefile(5)); pcapng is refused, ``editcap -F pcap``
turns it into this one.
"""

import os
import select
import stat
import struct
from collections.abc import Iterator
from pathlib import Path

from ....errors import InputError
from ....reading import open_descriptor, opened, refused
from .kind import SourceDetails, SourceKind
from .mac import mac_address
from .protocol import Row, Sample
from .radiotap import parse_radiotap
from .rejected import Rejected
from .sender_clock import SenderClock

LINK_TYPE_RADIOTAP = 127
LARGEST_PACKET_BYTES = 262_144
"""libpcap's own limit: more is no packet but a broken file."""
READ_BYTES = 262_144
_TICKS_PER_SECOND = {0xA1B2C3D4: 1_000_000, 0xA1B23C4D: 1_000_000_000}
_PCAPNG = 0x0A0D0D0A


class PcapParser:
    """Takes the bytes of a capture as they come and gives (time in ns of the capturing clock, dBm).

    Args:
        transmitter: only frames from this MAC address, ``aa:bb:cc:dd:ee:ff``; None takes every frame. Frames without
            a transmitter's address (ACK, CTS) and damaged ones do not count as anybody's.

    Raises:
        InputError: ``transmitter`` is no MAC address.
    """

    def __init__(self, transmitter: str | None = None) -> None:
        self.rejected = Rejected()
        self._transmitter = None if transmitter is None else mac_address(transmitter)
        self._rest = b""
        self._byte_order = ""
        self._ticks_per_second = 0
        self._broken = False

    def feed(self, chunk: bytes) -> list[Sample]:
        """The levels of the packets that are whole now.

        Raises:
            InputError: this is no capture with radiotap headers.
        """
        if self._broken:
            return []
        self._rest += chunk
        if not self._byte_order and not self._read_file_header():
            return []
        samples: list[Sample] = []
        position = 0
        while (header := self._packet_header(position)) is not None:
            time_ns, size = header
            packet = self._rest[position + 16 : position + 16 + size]
            level_dbm = self._level_dbm(packet)
            if level_dbm is not None:
                samples.append((time_ns, level_dbm))
            position += 16 + size
        self._rest = b"" if self._broken else self._rest[position:]
        return samples

    def _read_file_header(self) -> bool:
        if len(self._rest) < 24:
            return False
        for byte_order in "<>":
            magic, link_type = struct.unpack_from(byte_order + "I16xI", self._rest)
            if magic == _PCAPNG:
                raise InputError("pcapng is refused: turn it into pcap with editcap -F pcap")
            if magic in _TICKS_PER_SECOND:
                # The upper bits say how long the frame check sequence is.
                if link_type & 0xFFFF != LINK_TYPE_RADIOTAP:
                    raise InputError(f"link type {link_type & 0xFFFF} is refused: allowed is 127, radiotap")
                self._byte_order, self._ticks_per_second = byte_order, _TICKS_PER_SECOND[magic]
                self._rest = self._rest[24:]
                return True
        raise InputError("this is no pcap capture")

    def _packet_header(self, position: int) -> tuple[int, int] | None:
        """(time in ns, size in bytes) of the packet there; None until it is whole, and for ever after a broken one."""
        if len(self._rest) < position + 16:
            return None
        seconds, ticks, size = struct.unpack_from(self._byte_order + "III", self._rest, position)
        if size > LARGEST_PACKET_BYTES:
            self.rejected.add("broken capture")
            self._broken = True
            return None
        if len(self._rest) < position + 16 + size:
            return None
        return seconds * 1_000_000_000 + ticks * (1_000_000_000 // self._ticks_per_second), size

    def _level_dbm(self, packet: bytes) -> float | None:
        radiotap = parse_radiotap(packet)
        if radiotap is None or radiotap.antenna_signal_dbm is None:
            self.rejected.add("without a signal level")
            return None
        if self._transmitter is not None:
            sender = None if radiotap.bad_fcs else transmitter_address(packet[radiotap.length :])
            if sender != self._transmitter:
                self.rejected.add("of another transmitter", *([] if sender is None else [sender.hex(":")]))
                return None
        return float(radiotap.antenna_signal_dbm)


class PcapSource:
    """Packets that are being captured: from a growing file, from where it ends now, or from a pipe (/dev/stdin).

    Raises:
        InputError: the file cannot be opened or is no such capture, or ``transmitter`` is no MAC address.
    """

    def __init__(self, path: Path, transmitter: str | None = None) -> None:
        self._path, self._parser = path, PcapParser(transmitter)
        self._clock = SenderClock()
        with refused(path, "capture"):
            self._descriptor = open_descriptor(path, _can_be_captured_to)
        # What a file holds already is not how strong the signal is now.
        while stat.S_ISREG(os.fstat(self._descriptor).st_mode) and (found := os.read(self._descriptor, READ_BYTES)):
            self._parser.feed(found)
        self._parser.rejected = Rejected()

    @property
    def rejected(self) -> Rejected:
        """The packets that gave no level."""
        return self._parser.rejected

    @property
    def silence(self) -> str:
        """Nothing is captured."""
        return f"no packet has been captured in {self._path}"

    def read(self, now_ns: int) -> list[Sample]:
        """The levels of the packets that have come.

        Raises:
            InputError: this is no capture with radiotap headers.
        """
        if not select.select([self._descriptor], [], [], 0)[0]:
            return []
        try:
            found = os.read(self._descriptor, READ_BYTES)
        except OSError:
            return []
        return [(self._clock.local_ns(time_ns, now_ns), level_dbm) for time_ns, level_dbm in self._parser.feed(found)]

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)


def pcap_rows(path: Path, transmitter: str | None = None) -> Iterator[Row]:
    """The levels of a finished capture, for ``ReplaySource``.

    Raises:
        InputError: the file cannot be read, or is no capture with radiotap headers.
    """
    parser = PcapParser(transmitter)
    with opened(path, "recording") as file:
        while chunk := file.read(READ_BYTES):
            for time_ns, level_dbm in parser.feed(chunk):
                yield time_ns / 1e9, level_dbm


def transmitter_address(frame: bytes) -> bytes | None:
    """The second address of an 802.11 frame (IEEE 802.11-2020, 9.2.3); None for frames that have none."""
    if len(frame) < 16:
        return None
    kind, subkind = frame[0] >> 2 & 3, frame[0] >> 4
    is_cts_or_ack = kind == 1 and subkind in {12, 13}
    return None if is_cts_or_ack else frame[10:16]


def _can_be_captured_to(mode: int) -> bool:
    return stat.S_ISREG(mode) or stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)


def _open(place: str, details: SourceDetails) -> PcapSource:
    return PcapSource(Path(place), details.transmitter_mac)


KIND = SourceKind(scheme="pcap", place="FILE", note="growing, or a pipe", open=_open)
