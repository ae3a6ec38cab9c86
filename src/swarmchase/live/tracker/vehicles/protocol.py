"""What every vehicle is to the tracker agent."""

from typing import Protocol, runtime_checkable

from ...link.messages import Metres, TrackerMode


@runtime_checkable
class Vehicle(Protocol):
    """Carries one tracker's receiver. Positions are metres in the frame that all trackers share: x east, y north, z up.

    No method ever blocks. While ``mode`` is MANUAL, ``go_to`` and ``hold`` do nothing.
    """

    @property
    def position_m(self) -> Metres | None:
        """Where it is; None while that is not known."""

    @property
    def velocity_mps(self) -> Metres:
        """Zero while that is not known."""

    @property
    def mode(self) -> TrackerMode:
        """What it is doing; MANUAL while a pilot or a failsafe has it, or it cannot be commanded for another reason."""

    def go_to(self, position_m: Metres) -> None:
        """Fly there, and stay there, until told otherwise."""

    def hold(self) -> None:
        """Stop, and stay there."""

    def update(self, now_ns: int) -> None:
        """Do what is due now."""

    def close(self) -> None:
        """Give back what it holds."""
