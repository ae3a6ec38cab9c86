"""One datagram: is it one whole MAVLink 2 packet, and did the system that it claims to be from sign it?

pymavlink's own check of signatures is not used: it remembers the timestamp before it has checked the signature, so
that one forged packet from the far future would silence a tracker for good (``MAVLink.check_signature``, 2.4.50).
The signature is that of https://mavlink.io/en/guide/message_signing.html.
"""

import hashlib
import hmac
from collections.abc import Sequence
from typing import NamedTuple

from .codec import ReportDecoder, SetPointDecoder, to_mavlink
from .dialect import mavlink
from .messages import Message
from .rejection import Reason, RejectedError
from .timestamps import Timestamps

FIRST_BYTE = b"\xfd"
HEADER_BYTES, CHECKSUM_BYTES, SIGNATURE_BYTES = 10, 2, 13
LONGEST_PACKET_BYTES = HEADER_BYTES + 255 + CHECKSUM_BYTES + SIGNATURE_BYTES
SEQUENCE_PLACE = 4
"""The byte that numbers a sender's packets."""
NO_FLAGS, SIGNED_FLAG = b"\x00", b"\x01"
LINK_ID = 0
"""There is one path between a tracker and the controller."""


class Header(NamedTuple):
    """What a packet says about itself; nothing of it is proven yet."""

    is_signed: bool
    payload_end: int
    """Where the payload ends and the checksum begins, in bytes from the packet's start."""
    system: int
    component: int
    message_id: int


def read_header(datagram: bytes) -> Header:
    """Look at the outside only: cheap enough for a flood.

    Raises:
        RejectedError: giant, malformed or truncated.
    """
    if len(datagram) > LONGEST_PACKET_BYTES:
        raise RejectedError(Reason.GIANT)
    # Slices, because they may be missing.
    first_byte, incompatibility_flags = datagram[:1], datagram[2:3]
    if first_byte not in (b"", FIRST_BYTE) or incompatibility_flags not in (b"", NO_FLAGS, SIGNED_FLAG):
        raise RejectedError(Reason.MALFORMED)
    if len(datagram) < HEADER_BYTES + CHECKSUM_BYTES:
        raise RejectedError(Reason.TRUNCATED)
    is_signed = incompatibility_flags == SIGNED_FLAG
    payload_end = HEADER_BYTES + datagram[1]
    expected_bytes = payload_end + CHECKSUM_BYTES + (SIGNATURE_BYTES if is_signed else 0)
    if len(datagram) < expected_bytes:
        raise RejectedError(Reason.TRUNCATED)
    if len(datagram) > expected_bytes:
        raise RejectedError(Reason.MALFORMED)
    message_id = int.from_bytes(datagram[7:10], "little")
    return Header(is_signed, payload_end, datagram[5], datagram[6], message_id)


def require_checksum(datagram: bytes, header: Header) -> None:
    """CRC-16/MCRF4XX over the packet without its first byte, then the message's own extra byte.

    Raises:
        RejectedError: bad checksum.
    """
    crc = mavlink.x25crc(datagram[1 : header.payload_end])
    crc.accumulate(bytes([mavlink.mavlink_map[header.message_id].crc_extra]))
    if crc.crc != int.from_bytes(datagram[header.payload_end : header.payload_end + CHECKSUM_BYTES], "little"):
        raise RejectedError(Reason.BAD_CHECKSUM)


def link_id(datagram: bytes) -> int:
    """Of a signed packet."""
    return datagram[-SIGNATURE_BYTES]


def timestamp(datagram: bytes) -> int:
    """Of a signed packet, in 10 us since 2015."""
    return int.from_bytes(datagram[-12:-6], "little")


def require_signature(datagram: bytes, key: bytes) -> None:
    """The first 48 bits of SHA-256 over the key and everything before them.

    Raises:
        RejectedError: wrong key.
    """
    if not hmac.compare_digest(hashlib.sha256(key + datagram[:-6]).digest()[:6], datagram[-6:]):
        raise RejectedError(Reason.WRONG_KEY)


class Peer(NamedTuple):
    """Who may speak to this end, or is spoken to."""

    tracker: int
    """The tracker at one end of the path; the other is the controller."""
    system: int
    component: int
    key: bytes | None
    """Of this path; None where nothing is signed."""


class PacketReader:
    """Datagrams of known peers -> messages. It holds no socket, so that tests can feed it anything."""

    def __init__(self, peers: Sequence[Peer], decoder: ReportDecoder | SetPointDecoder, timestamps: Timestamps) -> None:
        self._peers = {(peer.system, peer.component): peer for peer in peers}
        self._wants_signatures = any(peer.key is not None for peer in peers)
        self._decoder = decoder
        self._timestamps = timestamps
        self._parser = mavlink.MAVLink(None)

    def claim(self, datagram: bytes) -> tuple[Header, Peer]:
        """Whom a datagram claims to be from: the cheap checks.

        Raises:
            RejectedError: giant, malformed, truncated, unsigned, unknown sender or unknown message.
        """
        header = read_header(datagram)
        peer = self._peers.get((header.system, header.component))
        if self._wants_signatures and not header.is_signed:
            raise RejectedError(Reason.UNSIGNED)
        if peer is None or (header.is_signed and link_id(datagram) != LINK_ID):
            raise RejectedError(Reason.UNKNOWN_SENDER)
        if header.message_id not in self._decoder.IDS:
            raise RejectedError(Reason.UNKNOWN_MESSAGE)
        return header, peer

    def open(self, datagram: bytes, header: Header, peer: Peer) -> Message:
        """The message, after the expensive checks.

        Raises:
            RejectedError: bad checksum, wrong key, replayed, too old, too far ahead, wrong layout or refused value.
        """
        require_checksum(datagram, header)
        if header.is_signed:
            if peer.key is None:
                raise RejectedError(Reason.WRONG_KEY)
            require_signature(datagram, peer.key)
            self._timestamps.accept(peer.system, timestamp(datagram))
        return self._decoder.decode(peer.tracker, self._parser.decode(bytearray(datagram)))


class PacketWriter:
    """Messages -> signed datagrams."""

    def __init__(self, system: int, component: int, timestamps: Timestamps) -> None:
        self._packer = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self._packer.signing.link_id = LINK_ID
        self._timestamps = timestamps

    def datagram(self, message: Message, key: bytes | None) -> bytes:
        """The next packet, signed if there is a key."""
        self._packer.signing.secret_key = key
        self._packer.signing.sign_outgoing = key is not None
        if key is not None:
            self._packer.signing.timestamp = self._timestamps.next_to_send()
        datagram: bytes = to_mavlink(message).pack(self._packer)
        self._packer.seq = (self._packer.seq + 1) % 256
        return datagram
