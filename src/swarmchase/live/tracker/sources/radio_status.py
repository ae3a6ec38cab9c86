"""The level at which a SiK telemetry radio hears its other end: RADIO_STATUS, which the radio puts into the MAVLink
stream, from a UDP port (mavlink-router, MAVProxy) or from the radio's own serial port.
"""

import math
from pathlib import Path

from ....errors import InputError
from ...address import LOOPBACK, host_and_port
from ..vehicles.mavlink_line import MavlinkLine
from ..vehicles.transports import SerialTransport, Transport, UdpTransport
from .kind import SourceDetails, SourceKind
from .protocol import Sample
from .rejected import Rejected

UNKNOWN = 255
"""MAVLink's common.xml: UINT8_MAX is invalid or unknown."""
OWN_SYSTEM = 254
"""Nothing is said, so nobody sees it."""


def sik_dbm(rssi: float) -> float:
    """What a SiK telemetry radio's RSSI number means: rssi / 1.9 - 127 dBm (ArduPilot's documentation of the 3DR SiK
    radio); 0 is what it reports while it hears nothing."""
    return rssi / 1.9 - 127 if rssi > 0 else math.nan


class RadioStatusSource:
    """Messages of other kinds are not for it, and do not count.

    Raises:
        InputError: pymavlink is not installed.
    """

    def __init__(self, transport: Transport, place: str) -> None:
        self.rejected = Rejected()
        self._place = place
        self._line = MavlinkLine(transport, OWN_SYSTEM)

    @property
    def silence(self) -> str:
        """No radio is there, or it does not report."""
        return f"no RADIO_STATUS has come from {self._place} (SiK: ATS6=1 makes the radio report)"

    def read(self, now_ns: int) -> list[Sample]:
        """The levels that have come; NaN where the radio hears nothing."""
        samples: list[Sample] = []
        for message in self._line.received():
            kind = message.get_type()
            if kind == "RADIO_STATUS":
                samples.append((now_ns, math.nan if message.rssi == UNKNOWN else sik_dbm(float(message.rssi))))
            else:
                self.rejected.add("no RADIO_STATUS", kind)
        return samples

    def close(self) -> None:
        """Close the port."""
        self._line.close()


def _open(place: str, details: SourceDetails) -> RadioStatusSource:
    if "/" in place:
        return RadioStatusSource(SerialTransport(Path(place), details.serial_baud), place)
    try:
        host, port = host_and_port(place, "source radio_status", LOOPBACK)
    except InputError as error:
        raise InputError(f"{error}; or the PATH of a serial port") from None
    return RadioStatusSource(UdpTransport(port, host), f"port {port}")


KIND = SourceKind(scheme="radio_status", place="PORT", note="MAVLink over UDP; or PATH of a SiK radio", open=_open)
