"""What every output of a chase does."""

from typing import Protocol, runtime_checkable

from ..frame import Frame


@runtime_checkable
class Output(Protocol):
    """Shows frames to somebody else. Only the thread of its ``Publisher`` calls it, so it may wait."""

    def send(self, frame: Frame, wall_ns: int) -> None:
        """Show this frame, of so many nanoseconds since 1970.

        Raises:
            OSError: whoever should see it cannot be reached; the next frame is tried again.
        """

    def close(self) -> None:
        """Nothing more will come."""
