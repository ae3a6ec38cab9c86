"""Who sends an 802.11 frame, and what it calls itself (IEEE 802.11-2020, 9.2.3, 9.3.3.2 and 9.4.2)."""

from collections.abc import Iterator

from .remote_id import uas_ids

MANAGEMENT, CONTROL = 0, 1
CTS, ACK = 12, 13
PROBE_RESPONSE, BEACON = 5, 8
HEADER_BYTES, FIXED_FIELDS_BYTES = 24, 12
"""Of a beacon: what stands before its elements."""
SSID, VENDOR_SPECIFIC = 0, 221


def transmitter_address(frame: bytes) -> bytes | None:
    """The second address of a frame; None for frames that have none."""
    if len(frame) < 16:
        return None
    kind, subkind = _kind(frame)
    return None if kind == CONTROL and subkind in {CTS, ACK} else frame[10:16]


def transmitter_names(frame: bytes) -> list[str]:
    """The name of the network (SSID) and the UAS ids of Remote ID that a beacon, or a probe's answer, says; empty for
    other frames, and where a name is hidden."""
    if len(frame) < HEADER_BYTES or _kind(frame) not in {(MANAGEMENT, BEACON), (MANAGEMENT, PROBE_RESPONSE)}:
        return []
    names: list[str] = []
    for element, content in _elements(frame[HEADER_BYTES + FIXED_FIELDS_BYTES :]):
        if element == SSID and content.strip(b"\0"):
            names.append(content.decode(errors="replace"))
        elif element == VENDOR_SPECIFIC:
            names += uas_ids(content)
    return names


def _kind(frame: bytes) -> tuple[int, int]:
    return frame[0] >> 2 & 3, frame[0] >> 4


def _elements(content: bytes) -> Iterator[tuple[int, bytes]]:
    """(id, content) of each that is whole."""
    position = 0
    while position + 2 <= len(content) and position + 2 + content[position + 1] <= len(content):
        size = content[position + 1]
        yield content[position], content[position + 2 : position + 2 + size]
        position += 2 + size
