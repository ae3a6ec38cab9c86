"""Which outputs there are, and what they are told besides their address."""

import socket
from dataclasses import dataclass, field
from pathlib import Path

from ...errors import InputError
from ..address import AddressKind
from ..earth import EarthOrigin, GlobalPosition
from ..link.messages import Metres

ORIGIN_OPTION = "--global-origin LATITUDE LONGITUDE ALTITUDE"
"""How a person says where x, y, z are 0."""


@dataclass(frozen=True)
class OutputDetails:
    """What outputs want to know besides their address."""

    origin: EarthOrigin | None = None
    """Where x, y, z are 0; None where nobody has said so."""
    geoid_height_m: float = 0.0
    """Of the sea level above the ellipsoid of WGS 84, at the origin."""
    is_simulated: bool = False
    """Nothing of it flies: whoever sees it is to know that."""
    mqtt_password_file: Path | None = None
    """Holds the password of the broker's user."""
    station: str = field(default_factory=socket.gethostname)
    """Tells chases of several ground stations on one network apart."""

    def require_origin(self, what: str) -> EarthOrigin:
        """The origin.

        Raises:
            InputError: there is none.
        """
        if self.origin is None:
            raise InputError(f"{what} is refused: it shows places on the earth; give {ORIGIN_OPTION}")
        return self.origin

    def on_ellipsoid(self, position_m: Metres) -> GlobalPosition | None:
        """Latitude, longitude, and the height above the ellipsoid of WGS 84; None without an origin."""
        if self.origin is None:
            return None
        latitude_deg, longitude_deg, altitude_m = self.origin.global_position(position_m)
        return latitude_deg, longitude_deg, altitude_m + self.geoid_height_m


@dataclass(frozen=True, kw_only=True)
class OutputKind(AddressKind):
    """One kind of output."""

    home: str
    """The module beside this one, and the class in it. It is imported when it is asked for: help needs none."""


KINDS = (
    OutputKind(
        scheme="cot-udp", place="HOST:PORT", note="Cursor-on-Target for ATAK and WinTAK", home="cot_udp.CotUdpOutput"
    ),
    OutputKind(scheme="cot-tcp", place="HOST:PORT", note="the same for a TAK server", home="cot_tcp.CotTcpOutput"),
    OutputKind(
        scheme="jsonl",
        place="FILE",
        note="the estimate in the terms of Remote ID, in a new file",
        home="json_lines.JsonLinesOutput",
    ),
    OutputKind(
        scheme="mqtt",
        place="HOST/TOPIC",
        note="the same to a broker; or USER@HOST:PORT/TOPIC",
        home="mqtt.MqttOutput",
    ),
)
"""Of all outputs there are. A new one is a module beside this one, and its name here."""
