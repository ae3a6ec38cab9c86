"""From what a person writes to a vehicle."""

from ....plug_ins import load_plug_in, plug_in_names
from ...address import kind_and_place
from . import mavlink_kinds, simulated
from .kind import VehicleDetails, VehicleKind
from .protocol import Vehicle

KINDS = (simulated.KIND, mavlink_kinds.UDP, mavlink_kinds.SERIAL)
"""Of all vehicles there are."""


def open_vehicle(text: str, details: VehicleDetails) -> Vehicle:
    """The vehicle of ``simulated``, ``mavlink:PORT`` and so on: ``KINDS``.

    Raises:
        InputError: there is no such vehicle, it cannot be reached, or a detail is missing or out of place.
    """
    kind, place = kind_and_place(text, [*KINDS, *_others(text)], "vehicle")
    return kind.open(place, details)


def _others(text: str) -> list[VehicleKind]:
    """What another package offers under the scheme of this address."""
    scheme = text.partition(":")[0]
    names = plug_in_names("vehicles")
    return [load_plug_in("vehicles", scheme, VehicleKind)] if scheme in names else []
