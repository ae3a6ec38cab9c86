"""Why an end of a link drops what comes in. The words are what ``Link.rejected`` counts by; docs/link.md lists them."""

from collections import Counter, defaultdict
from dataclasses import dataclass
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
    """Signed too long ago, or before this end was opened: held back, recorded, or the sender's clock is behind."""
    TOO_FAR_AHEAD = "too far ahead"
    """Signed at a time that is not yet: the sender's clock is ahead, or this end's is behind."""
    WRONG_LAYOUT = "wrong layout"
    """Fields that say how to read the others are not as the message map has them."""
    REFUSED_VALUE = "refused value"
    """A time, level, position or number that cannot be."""


class RejectedError(Exception):
    """This datagram is to be dropped and counted; nobody outside the link ever sees it.

    Args:
        skew_s: where the signature's time is the reason: how much it was ahead (behind: negative) of this end's real
            time, or of the newest accepted where it is ``REPLAYED``.
    """

    def __init__(self, reason: Reason, skew_s: float | None = None) -> None:
        super().__init__(str(reason))
        self.reason, self.skew_s = reason, skew_s


@dataclass
class Tally:
    """How often one reason has applied to datagrams in one name."""

    count: int = 0
    skew_s: float | None = None
    """Of the newest."""


class Rejections:
    """What one end of a link has dropped."""

    def __init__(self) -> None:
        self.by_reason: Counter[str] = Counter()
        self.tallies: defaultdict[tuple[Reason, str], Tally] = defaultdict(Tally)
        """By reason and the name of the sender that is claimed; empty where none is."""

    def add(self, rejection: RejectedError, sender: str = "") -> None:
        """One more."""
        self.by_reason[rejection.reason] += 1
        tally = self.tallies[rejection.reason, sender]
        tally.count += 1
        tally.skew_s = rejection.skew_s

    def skew_s(self) -> dict[str, dict[str, float]]:
        """The newest skew by reason and sender, where time was the reason."""
        skews: defaultdict[str, dict[str, float]] = defaultdict(dict)
        for (reason, sender), tally in self.tallies.items():
            if tally.skew_s is not None:
                skews[str(reason)][sender] = round(tally.skew_s, 3)
        return dict(skews)
