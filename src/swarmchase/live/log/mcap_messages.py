"""The messages of an MCAP file one after another, as far as it is whole.

A file that was cut (kill -9, a full disk) has no summary at its end, and mcap's own readers take a record that ends too
early for a shorter one. So records are read here one by one: what is not there whole is not given out, and no size that
a file claims is believed.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO

from ...errors import InputError
from ...reading import opened
from .mcap_library import (
    MCAP0_MAGIC,
    Channel,
    Chunk,
    McapError,
    Message,
    Opcode,
    ReadDataStream,
    ZstdError,
    breakup_chunk,
    get_frame_parameters,
)

MOST_RECORD_BYTES = 64 * 2**20
"""Of one record, and of what a compressed one becomes; those of a log have at most a few MiB."""
RECORD_HEAD = struct.Struct("<BQ")
"""Opcode and length of a record."""
NO_CHECKSUM = bytes(4)


class CutError(Exception):
    """From here on the file is not whole; says where and why."""


@dataclass(frozen=True)
class LogMessage:
    """One message."""

    topic: str
    log_time_ns: int
    """Since 1970."""
    data: bytes


def messages(path: Path) -> Iterator[LogMessage]:
    """All of them, in the order of the file; their sequence numbers must count from 0. Holds one chunk in memory.

    Raises:
        CutError: after the last message that is whole, where the file is cut or damaged.
        InputError: the file cannot be read or is no MCAP file.
    """
    with opened(path, "log") as file:
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise InputError(f"{path} is no MCAP file")
        yield from _messages(file)


def _messages(file: IO[bytes]) -> Iterator[LogMessage]:
    topic: dict[int, str] = {}
    count, checksum = 0, zlib.crc32(MCAP0_MAGIC)
    while True:
        at = file.tell()
        opcode, body = _record(file)
        if opcode == Opcode.DATA_END:
            if body[:4] not in {NO_CHECKSUM, checksum.to_bytes(4, "little")}:
                raise CutError(f"something before byte {at} is damaged or missing")
            return
        checksum = zlib.crc32(body, zlib.crc32(RECORD_HEAD.pack(opcode, len(body)), checksum))
        try:
            records = _read(opcode, body)
        except (McapError, ZstdError, struct.error, ValueError, OverflowError) as error:
            raise CutError(f"it is damaged at byte {at}: {error}") from error
        for record in records:
            if isinstance(record, Channel):
                topic[record.id] = record.topic
            elif record.channel_id not in topic:
                raise CutError(f"it is damaged at byte {at}: a message of no channel")
            elif record.sequence != count:
                # Readers pass over records that they do not know: one flipped bit can make one of a chunk.
                raise CutError(f"messages are missing before byte {at}")
            else:
                count += 1
                yield LogMessage(topic[record.channel_id], record.log_time, record.data)


def _record(file: IO[bytes]) -> tuple[int, bytes]:
    """The next one, whole."""
    at = file.tell()
    head = file.read(RECORD_HEAD.size)
    if len(head) == RECORD_HEAD.size:
        opcode, length = RECORD_HEAD.unpack(head)
        if length > MOST_RECORD_BYTES:
            raise CutError(f"it is damaged at byte {at}: a record of {length} bytes")
        body = file.read(length)
        if len(body) == length:
            return opcode, body
    raise CutError(f"its end is missing, from byte {at} on")


def _read(opcode: int, body: bytes) -> list[Channel | Message]:
    """The channels and messages in a record.

    Raises:
        McapError, ZstdError, struct.error, ValueError, OverflowError: it is damaged.
    """
    stream = ReadDataStream(BytesIO(body))
    if opcode == Opcode.CHANNEL:
        return [Channel.read(stream)]
    if opcode == Opcode.MESSAGE:
        return [Message.read(stream, len(body))]
    if opcode != Opcode.CHUNK:
        return []
    chunk = Chunk.read(stream)
    if chunk.compression == "zstd":
        unpacked_bytes = get_frame_parameters(chunk.data).content_size
    elif not chunk.compression:
        unpacked_bytes = len(chunk.data)
    else:
        raise ValueError(f"compressed by {chunk.compression!r}")
    # zstd allocates what the data says it becomes; the chunk's own word counts only where the data does not say.
    if unpacked_bytes != chunk.uncompressed_size or unpacked_bytes > MOST_RECORD_BYTES:
        raise ValueError(f"a chunk of {unpacked_bytes} bytes")
    return [record for record in breakup_chunk(chunk, validate_crc=True) if isinstance(record, Channel | Message)]
