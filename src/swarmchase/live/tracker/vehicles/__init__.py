"""What carries a tracker's receiver, all behind one protocol."""

from .autopilot import AutopilotVehicle
from .frames import GlobalFrame, LocalFrame
from .protocol import Vehicle
from .simulated import SimulatedVehicle, VehicleLimits
from .transports import SerialTransport, UdpTransport

__all__ = [
    "AutopilotVehicle",
    "GlobalFrame",
    "LocalFrame",
    "SerialTransport",
    "SimulatedVehicle",
    "UdpTransport",
    "Vehicle",
    "VehicleLimits",
]
