"""The parts of the mcap package that a log needs, or one clear line if it is not installed."""

from ...errors import InputError

try:
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError
    from mcap.opcode import Opcode
    from mcap.records import Channel, Chunk, Message
    from mcap.stream_reader import breakup_chunk
    from mcap.well_known import MessageEncoding, SchemaEncoding
    from mcap.writer import MCAP0_MAGIC, Writer
    from zstandard import ZstdError, get_frame_parameters
except ImportError as error:
    raise InputError("the log needs mcap: pip install 'swarmchase[live]'") from error

__all__ = [
    "Channel",
    "Chunk",
    "MCAP0_MAGIC",
    "McapError",
    "Message",
    "MessageEncoding",
    "Opcode",
    "ReadDataStream",
    "SchemaEncoding",
    "Writer",
    "ZstdError",
    "breakup_chunk",
    "get_frame_parameters",
]
