"""From what a person writes to a vehicle."""

from ...address import kind_and_place
from . import mavlink_kinds, simulated
from .kind import VehicleDetails
from .protocol import Vehicle

KINDS = (simulated.KIND, mavlink_kinds.UDP, mavlink_kinds.SERIAL)
"""Of all vehicles there are."""


def open_vehicle(text: str, details: VehicleDetails) -> Vehicle:
    """The vehicle of ``simulated``, ``mavlink:PORT`` and so on: ``KINDS``.

    Raises:
        InputError: there is no such vehicle, it cannot be reached, or a detail is missing or out of place.
    """
    kind, place = kind_and_place(text, KINDS, "vehicle")
    return kind.open(place, details)
