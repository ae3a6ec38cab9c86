"""What a vehicle says of itself, so that a person can name it."""

from collections.abc import Callable
from dataclasses import dataclass

from ...address import AddressKind
from ...link.messages import Metres
from .protocol import Vehicle


@dataclass(frozen=True)
class VehicleDetails:
    """What some vehicles want to know besides their address."""

    position_m: Metres | None = None
    """Where a simulated vehicle starts, in the shared frame."""
    autopilot_origin_m: Metres | None = None
    """Where an autopilot's own local frame begins, in the shared frame."""
    global_origin: tuple[float, float, float] | None = None
    """Latitude and longitude in degrees and altitude in metres above sea level of the shared frame's origin."""
    autopilot_system: int = 1
    """Its MAVLink system id."""
    autopilot_baud: int = 57_600


@dataclass(frozen=True, kw_only=True)
class VehicleKind(AddressKind):
    """One kind of vehicle."""

    open: Callable[[str, VehicleDetails], Vehicle]
    """The vehicle at a place; ``InputError`` where it cannot be reached, or a detail is missing or out of place."""
