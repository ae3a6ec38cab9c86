"""What every vehicle is to the tracker agent."""

from typing import Protocol, runtime_checkable

from ...link.messages import Health, Metres, Severity, TrackerMode, VehicleState

Said = tuple[Severity, str]
"""A line for people, and how much it matters."""


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

    @property
    def position_age_s(self) -> float:
        """How long before the last ``update`` it was there; anything while that is not known."""

    @property
    def state(self) -> VehicleState:
        """Beside the mode; not armed while that is not known."""

    def health(self, tracker: int) -> Health | None:
        """What its autopilot says of battery, satellites and heading, in this tracker's name; None where it has none or
        says nothing of late.
        """

    def said(self) -> list[Said]:
        """What it or its autopilot has told people since the last call: bounded, whatever an autopilot sends."""

    def go_to(self, position_m: Metres) -> None:
        """Fly there, and stay there, until told otherwise."""

    def hold(self) -> None:
        """Stop, and stay there."""

    def update(self, now_ns: int) -> None:
        """Do what is due now."""

    def close(self) -> None:
        """Give back what it holds."""


@runtime_checkable
class LedVehicle(Vehicle, Protocol):
    """A vehicle that is told more than the place where to rest, while that moves on."""

    def lead(self, rest_m: Metres, braking_mps2: float) -> None:
        """Fly towards this place, as fast as it can brake from before it; there will be another one in a moment."""
