"""The radiotap header before a captured 802.11 frame (radiotap.org; the sizes and alignments are those of its table of
defined fields and of Linux's parser)."""

import struct
from dataclasses import dataclass

FLAGS, DBM_ANTSIGNAL = 1, 5
BAD_FCS = 0x40
TLV, RADIOTAP_NAMESPACE, VENDOR_NAMESPACE, ANOTHER_WORD = 28, 29, 30, 31

_ALIGNMENT_AND_SIZE = (
    (8, 8),  # 0: TSFT
    (1, 1),  # flags
    (1, 1),  # rate
    (2, 4),  # channel
    (2, 2),  # FHSS
    (1, 1),  # 5: antenna signal, dBm
    (1, 1),  # antenna noise, dBm
    (2, 2),  # lock quality
    (2, 2),  # transmit attenuation
    (2, 2),  # transmit attenuation, dB
    (1, 1),  # 10: transmit power, dBm
    (1, 1),  # antenna
    (1, 1),  # antenna signal, dB
    (1, 1),  # antenna noise, dB
    (2, 2),  # receive flags
    (2, 2),  # 15: transmit flags
    (1, 1),  # RTS retries
    (1, 1),  # data retries
    (4, 8),  # extended channel
    (1, 3),  # MCS
    (4, 8),  # 20: A-MPDU status
    (2, 12),  # VHT
    (8, 12),  # timestamp
    (2, 12),  # HE
    (2, 12),  # HE-MU
    (2, 6),  # 25: HE-MU of other users
    (1, 1),  # zero-length PSDU
    (2, 4),  # L-SIG
)


@dataclass(frozen=True)
class Radiotap:
    """What is used of a header."""

    length: int
    """Of the whole header, in bytes: the frame begins there."""
    antenna_signal_dbm: int | None
    """The first in the header: where several antennas follow, each with a word of its own, it is all together's."""
    bad_fcs: bool
    """The frame was damaged; its addresses may be wrong."""


def parse_radiotap(packet: bytes) -> Radiotap | None:
    """The header at the beginning of a packet; None where it is broken. Never raises."""
    if len(packet) < 8:
        return None
    version, length = struct.unpack_from("<BxH", packet)
    words = _presence_words(packet[:length])
    if version != 0 or length > len(packet) or not words:
        return None
    signal_dbm, flags = None, 0
    for bit, position in _fields(packet[:length], words):
        if bit == DBM_ANTSIGNAL and signal_dbm is None:
            (signal_dbm,) = struct.unpack_from("<b", packet, position)
        elif bit == FLAGS:
            flags |= packet[position]
    return Radiotap(length, signal_dbm, bool(flags & BAD_FCS))


def _presence_words(header: bytes) -> list[int]:
    """The words that say which fields are present; empty where they go on beyond the header."""
    words: list[int] = []
    for position in range(4, len(header) - 3, 4):
        words.append(struct.unpack_from("<I", header, position)[0])
        if not words[-1] >> ANOTHER_WORD & 1:
            return words
    return []


def _fields(header: bytes, words: list[int]) -> list[tuple[int, int]]:
    """(bit, position in bytes) of every field of radiotap's own namespace, as far as they are known and whole."""
    fields: list[tuple[int, int]] = []
    position = 4 + 4 * len(words)
    first_bit, ours = 0, True
    for word in words:
        for bit in range(TLV + 1):
            if not word >> bit & 1 or not ours:
                continue
            if first_bit + bit >= len(_ALIGNMENT_AND_SIZE):  # of unknown size: nothing behind it can be found
                return fields
            alignment, size = _ALIGNMENT_AND_SIZE[bit]
            position += -position % alignment
            if position + size > len(header):
                return fields
            fields.append((bit, position))
            position += size
        if word >> VENDOR_NAMESPACE & 1:
            position += position % 2
            if position + 6 > len(header):
                return fields
            position += 6 + struct.unpack_from("<H", header, position + 4)[0]
            first_bit, ours = 0, False
        elif word >> RADIOTAP_NAMESPACE & 1:
            first_bit, ours = 0, True
        else:
            first_bit += 32
    return fields
