"""Vehicles with a MAVLink autopilot, by what carries MAVLink to it."""

from pathlib import Path

from ....errors import InputError
from ...address import LOOPBACK, host_and_port
from ...link.messages import PositionReport
from .autopilot import AutopilotVehicle
from .frames import CoordinateFrame, GlobalFrame, LocalFrame
from .kind import VehicleDetails, VehicleKind
from .transports import SerialTransport, UdpTransport


def _open_udp(place: str, details: VehicleDetails) -> AutopilotVehicle:
    frame, system = _frame(details), _system(details)
    host, port = host_and_port(place, "vehicle mavlink", LOOPBACK)
    return AutopilotVehicle(UdpTransport(port, host), frame, system)


def _open_serial(place: str, details: VehicleDetails) -> AutopilotVehicle:
    frame, system = _frame(details), _system(details)
    return AutopilotVehicle(SerialTransport(Path(place), details.autopilot_baud), frame, system)


def _frame(details: VehicleDetails) -> CoordinateFrame:
    """Indoors every autopilot's own, measured; outdoors one point of the earth for all. To guess would be dangerous."""
    if details.position_m is not None:
        raise InputError("--position-m is for the simulated vehicle: an autopilot knows its position")
    if (details.autopilot_origin_m is None) == (details.global_origin is None):
        raise InputError(
            "an autopilot needs one of --autopilot-origin-m X Y Z (its own frame's origin in the shared frame) and "
            "--global-origin LATITUDE LONGITUDE ALTITUDE (the shared frame's origin on the earth)"
        )
    if details.global_origin is not None:
        return GlobalFrame(*details.global_origin)
    assert details.autopilot_origin_m is not None
    PositionReport(0, 0, details.autopilot_origin_m)  # refuses what is no position
    return LocalFrame(details.autopilot_origin_m)


def _system(details: VehicleDetails) -> int:
    if not 1 <= details.autopilot_system <= 255:
        raise InputError(f"autopilot_system = {details.autopilot_system} is refused: allowed is 1 to 255")
    return details.autopilot_system


UDP = VehicleKind(scheme="mavlink", place="PORT", note="UDP", open=_open_udp)
SERIAL = VehicleKind(scheme="mavlink-serial", place="PATH", open=_open_serial)
