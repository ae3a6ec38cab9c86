"""From what a person writes to a vehicle."""

from dataclasses import dataclass
from pathlib import Path

from ....errors import InputError
from ...address import LOOPBACK, host_and_port, kind_and_place
from ...link.messages import Metres, PositionReport
from . import (
    AutopilotVehicle,
    GlobalFrame,
    LocalFrame,
    SerialTransport,
    SimulatedVehicle,
    UdpTransport,
    Vehicle,
)
from .frames import Frame

KINDS = {"simulated": "", "mavlink": "PORT", "mavlink-serial": "PATH"}


@dataclass(frozen=True)
class VehicleDetails:
    """What some vehicles want to know besides."""

    position_m: Metres | None = None
    """Where a simulated vehicle starts, in the shared frame."""
    autopilot_origin_m: Metres | None = None
    """Where an autopilot's own local frame begins, in the shared frame."""
    global_origin: tuple[float, float, float] | None = None
    """Latitude and longitude in degrees and altitude in metres above sea level of the shared frame's origin."""
    autopilot_system: int = 1
    """Its MAVLink system id."""
    autopilot_baud: int = 57_600


def open_vehicle(text: str, details: VehicleDetails) -> Vehicle:
    """The vehicle of ``simulated``, ``mavlink:PORT`` or ``mavlink-serial:PATH``.

    Raises:
        InputError: there is no such vehicle, it cannot be reached, or a detail is missing or out of place.
    """
    kind, place = kind_and_place(text, KINDS, "vehicle")
    if kind == "simulated":
        if details.position_m is None:
            raise InputError("a simulated vehicle starts somewhere: give --position-m X Y Z")
        PositionReport(0, 0, details.position_m)  # refuses what is no position
        return SimulatedVehicle(details.position_m)
    if details.position_m is not None:
        raise InputError("--position-m is for the simulated vehicle: an autopilot knows its position")
    frame = _frame(details)
    if not 1 <= details.autopilot_system <= 255:
        raise InputError(f"autopilot_system = {details.autopilot_system} is refused: allowed is 1 to 255")
    if kind == "mavlink":
        host, port = host_and_port(place, LOOPBACK)
        return AutopilotVehicle(UdpTransport(port, host), frame, details.autopilot_system)
    return AutopilotVehicle(SerialTransport(Path(place), details.autopilot_baud), frame, details.autopilot_system)


def _frame(details: VehicleDetails) -> Frame:
    """Indoors every autopilot's own, measured; outdoors one point of the earth for all. To guess would be dangerous."""
    if (details.autopilot_origin_m is None) == (details.global_origin is None):
        raise InputError(
            "an autopilot needs one of --autopilot-origin-m X Y Z (its own frame's origin in the shared frame) and "
            "--global-origin LATITUDE LONGITUDE ALTITUDE (the shared frame's origin on the earth)"
        )
    if details.global_origin is not None:
        return GlobalFrame(*details.global_origin)
    assert details.autopilot_origin_m is not None
    PositionReport(0, 0, details.autopilot_origin_m)
    return LocalFrame(details.autopilot_origin_m)
