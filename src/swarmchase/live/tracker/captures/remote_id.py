"""Remote ID in the vendor-specific element of a WiFi beacon (ASTM F3411-22a, 5.4.9; ASD-STAN prEN 4709-002; both as
Open Drone ID writes them down): the OUI of ASD-STAN, an application code, a counter, then one message or a pack."""

IDENTIFIER = b"\xfa\x0b\xbc\x0d"
"""OUI and application code."""
COUNTER_BYTES = 1
MESSAGE_BYTES = 25
BASIC_ID, PACK = 0x0, 0xF
"""Types of message: the upper half of the first byte."""
PACK_HEADER_BYTES = 3
ID_BYTES = 20
SESSION_ID = 4
"""The kind of id that is no text: it is shown in hexadecimal digits."""


def uas_ids(element: bytes) -> list[str]:
    """The ids that the Basic ID messages of an element's content say; empty where it is no Remote ID or says none."""
    if not element.startswith(IDENTIFIER):
        return []
    messages = _messages(element[len(IDENTIFIER) + COUNTER_BYTES :])
    found = [_uas_id(message) for message in messages if message[0] >> 4 == BASIC_ID]
    return [uas_id for uas_id in found if uas_id]


def _messages(content: bytes) -> list[bytes]:
    """The one message, or those of a pack, that are whole."""
    if content and content[0] >> 4 == PACK:
        # After the type: the size of a message, and how many there are.
        if len(content) < PACK_HEADER_BYTES or content[1] != MESSAGE_BYTES:
            return []
        content = content[PACK_HEADER_BYTES : PACK_HEADER_BYTES + content[2] * MESSAGE_BYTES]
    starts = range(0, len(content) - MESSAGE_BYTES + 1, MESSAGE_BYTES)
    return [content[start : start + MESSAGE_BYTES] for start in starts]


def _uas_id(message: bytes) -> str:
    """Of a Basic ID: type and version, kind of id and of aircraft, the id, filled up with zeros."""
    content = message[2 : 2 + ID_BYTES]
    if message[1] >> 4 == SESSION_ID:
        return content.hex()
    text = content.partition(b"\0")[0].decode("ascii", errors="replace").strip()
    return text if text.isprintable() else ""
