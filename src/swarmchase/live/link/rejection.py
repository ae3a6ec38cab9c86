"""Why an end of a link drops what comes in. The words are what ``Link.rejected`` counts by; docs/link.md lists them."""

from enum import StrEnum


class Reason(StrEnum):
    """In the order in which a datagram is looked at: the first that applies is counted."""

    GIANT = "giant"
    """Longer than the longest MAVLink 2 packet."""
    MALFORMED = "malformed"
    """Not one MAVLink 2 packet: another first byte, unknown incompatibility flags, or bytes after its end."""
    TRUNCATED = "truncated"
    """Shorter than its own header says."""
    UNSIGNED = "unsigned"
    """Not signed, where signatures are asked for."""
    UNKNOWN_SENDER = "unknown sender"
    """A system, component or link id that has nothing to say here, or a tracker without a key."""
    UNKNOWN_MESSAGE = "unknown message"
    """A message id that this end does not take."""
    OVERFLOW = "overflow"
    """More of one sender than a call takes: the oldest give way."""
    BAD_CHECKSUM = "bad checksum"
    """The bytes are not those that were sent."""
    WRONG_KEY = "wrong key"
    """The signature was not made with the key of the system that it claims to be from."""
    REPLAYED = "replayed"
    """The signature's timestamp is not newer than the newest that was accepted, in this run or an earlier one."""
    TOO_OLD = "too old"
    """Signed before this end was opened: maybe recorded while nobody listened, maybe the sender's clock is behind."""
    WRONG_LAYOUT = "wrong layout"
    """Fields that say how to read the others are not as the message map has them."""
    REFUSED_VALUE = "refused value"
    """A time, level, position or number that cannot be."""


class RejectedError(Exception):
    """This datagram is to be dropped and counted; nobody outside the link ever sees it."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(str(reason))
        self.reason = reason
