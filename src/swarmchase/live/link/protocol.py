"""What carries messages between the controller and its trackers. ``mavlink_link`` is the one that flies."""

from collections import Counter
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from .messages import Message


@runtime_checkable
class Link(Protocol):
    """One end: the controller's, which reaches every tracker that has dialled, or one tracker's.

    Neither method ever blocks. What is malformed, forged, replayed or not the sender's to say is dropped and counted.
    """

    @property
    def rejected(self) -> Counter[str]:
        """How many messages were dropped, by reason."""

    def send(self, message: Message) -> None:
        """Send it if there is anybody to send it to; it may get lost."""

    def receive(self) -> Sequence[Message]:
        """What has come in since the last call, in the order of its coming."""

    def close(self) -> None:
        """Give back what it holds."""


@runtime_checkable
class ControllerLink(Link, Protocol):
    """The controller's end."""

    def clocks_ahead_s(self) -> Sequence[float | None]:
        """Of each tracker: how far its clock was ahead of this machine's when it last spoke; what the message took on
        its way makes it less. None where the link cannot tell.
        """
