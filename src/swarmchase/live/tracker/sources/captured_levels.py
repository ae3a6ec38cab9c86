"""The signal levels of the packets of a capture, pcap or pcapng, as its bytes come."""

from ..captures.packet import LINK_TYPE_RADIOTAP, Packet, PacketReader
from ..captures.pcap_packets import TICKS_PER_SECOND, PcapPackets
from ..captures.pcapng_packets import SECTION_HEADER, PcapngPackets
from ..captures.radiotap import parse_radiotap
from ..captures.wifi_frame import transmitter_address, transmitter_names
from .protocol import Sample
from .rejected import Rejected
from .transmitters import Transmitters

MAGIC_BYTES = 4
_PCAPNG = SECTION_HEADER.to_bytes(MAGIC_BYTES, "little")
_CAPTURES = {_PCAPNG} | {
    magic.to_bytes(MAGIC_BYTES, order) for magic in TICKS_PER_SECOND for order in ("little", "big")
}


def is_capture(beginning: bytes) -> bool:
    """Whether a file that begins so is one."""
    return beginning[:MAGIC_BYTES] in _CAPTURES


class CapturedLevels:
    """Takes the bytes of a capture and gives (time in ns of the capturing clock, dBm).

    Args:
        transmitters: whose frames count. Frames without a transmitter's address (ACK, CTS) and damaged ones are
            nobody's: they count only where nobody was chosen and one alone is heard.
    """

    def __init__(self, transmitters: Transmitters) -> None:
        self.rejected = Rejected()
        self._transmitters = transmitters
        self._reader: PacketReader | None = None
        self._beginning = b""

    def feed(self, chunk: bytes) -> list[Sample]:
        """The levels of the packets that are whole now.

        Raises:
            InputError: this is no capture, or one without radiotap headers.
        """
        self._beginning += chunk if self._reader is None else b""
        if self._reader is None:
            if len(self._beginning) < MAGIC_BYTES:
                return []
            self._reader = PcapngPackets() if self._beginning.startswith(_PCAPNG) else PcapPackets()
            chunk, self._beginning = self._beginning, b""
        was_broken = self._reader.is_broken
        samples = [sample for packet in self._reader.feed(chunk) if (sample := self._sample(packet)) is not None]
        if self._reader.is_broken and not was_broken:
            self.rejected.add("broken capture")
        return samples

    def _sample(self, packet: Packet) -> Sample | None:
        if packet.link_type != LINK_TYPE_RADIOTAP:
            self.rejected.add("of an interface without radiotap")
            return None
        if packet.time_ns is None:
            self.rejected.add("without a time")
            return None
        level_dbm = self._level_dbm(packet.content)
        return None if level_dbm is None else (packet.time_ns, level_dbm)

    def _level_dbm(self, content: bytes) -> float | None:
        radiotap = parse_radiotap(content)
        if radiotap is None or radiotap.antenna_signal_dbm is None:
            self.rejected.add("without a signal level")
            return None
        level_dbm = float(radiotap.antenna_signal_dbm)
        frame = b"" if radiotap.bad_fcs else content[radiotap.length :]
        address = transmitter_address(frame)
        sender = None if address is None else address.hex(":")
        if not self._transmitters.counts(sender, transmitter_names(frame), level_dbm):
            is_chosen = self._transmitters.is_chosen
            reason = "of another transmitter" if is_chosen else "of one of several transmitters"
            self.rejected.add(reason, *([] if sender is None else [sender]))
            return None
        return level_dbm
