"""``swarmchase tracker``: the agent beside one tracker's receiver. It needs neither torch nor numpy."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from ..errors import InputError
from ..live.address import help_of
from ..live.tracker.sources.address import KINDS as SOURCES
from ..live.tracker.sources.address import open_source
from ..live.tracker.sources.kind import SourceDetails
from ..live.tracker.vehicles.address import KINDS as VEHICLES
from ..live.tracker.vehicles.address import open_vehicle
from ..live.tracker.vehicles.kind import VehicleDetails
from .configuration import ConfigurationOptions
from .link_options import LinkOptions, fields_from
from .terminal import line_printer, print_json

if TYPE_CHECKING:
    from ..live.link.mavlink import TrackerMavlinkLink
    from ..live.tracker.agent import AgentSettings
    from ..live.tracker.loop import TrackerSummary
    from ..processes.stop_request import StopRequest


@dataclass(frozen=True, kw_only=True)
class TrackerCommand(LinkOptions, ConfigurationOptions):
    """Report what one tracker's receiver hears and where its vehicle is, and fly where the controller says, until
    Ctrl-C or SIGTERM: then the vehicle is told to hold."""

    number: int
    """0 to 5: at +x, -x, +y, -y, +z, -z of the swarm's centre (x east, y north, z up)."""
    source: Annotated[
        str, arg(help=f"Where RSSI samples come from: {help_of(SOURCES)}; docs/sources.md describes them.")
    ]
    vehicle: Annotated[str, arg(help=f"One of {help_of(VEHICLES)}.")]
    service: Annotated[str, arg(aliases=["--controller"])] = "127.0.0.1:14550"
    """HOST:PORT of swarmchase serve; --controller is what it was called."""
    sampling_hz: float = 10.0
    """F, RSSI samples a second: the same as the controller's."""
    calibration_offset_db: float = 0.0
    """Added to every level: what this receiver reports too little."""
    rssi_column: str = "rssi_dbm"
    """Levels in a replayed .csv or .json and in JSON records, there also a way: rxInfo.0.rssi."""
    time_column: str = "time_s"
    """Times in the same: seconds or ISO 8601; empty: the rows of a .csv are 1/F apart."""
    rssi_unit: Literal["dbm", "sik"] = "dbm"
    """Of a replayed .csv or .json: dBm, or the numbers of a SiK radio."""
    mac_column: str = "mac"
    """Whose transmission it is, in JSON records."""
    transmitter_mac: str | None = None
    """The device that is chased: needed by kismet, and where several are heard."""
    transmitter_name: str | None = None
    """The same by the UAS id of its Remote ID or the name of its network (pcap, airodump-ng, serial, mqtt)."""
    frequency_hz: tuple[float, float] | None = None
    """LOW HIGH of the band whose power rtl_power's sweeps give."""
    mqtt_password_file: Path | None = None
    """Holds the password of the broker's USER."""
    kismet_token_file: Path | None = None
    """Holds the API key of the Kismet server."""
    serial_baud: int = 115_200
    """Of serial and of a SiK radio's port."""
    same_clock: bool = False
    """Times in JSON records are of this machine's monotonic clock: they come from another process here."""
    position_m: tuple[float, float, float] | None = None
    """X Y Z where a simulated vehicle starts."""
    autopilot_origin_m: tuple[float, float, float] | None = None
    """X Y Z of the place where the autopilot's local frame begins (LOCAL_POSITION_NED set-points)."""
    global_origin: tuple[float, float, float] | None = None
    """Latitude and longitude in degrees, altitude in m above sea level where x, y, z are 0 (global set-points)."""
    autopilot_system: int = 1
    """MAVLink system id of the autopilot."""
    autopilot_baud: int = 57_600
    """Of mavlink-serial."""
    window_hz: float = 10.0
    """RSSI messages a second; each holds up to 50 samples."""
    position_hz: float = 10.0
    """Position messages a second."""
    heartbeat_hz: float = 1.0
    """Heartbeats a second."""
    hold_after_s: float = 1.0
    """After the sending of the controller's last set-point the vehicle holds."""
    return_after_s: float = 60.0
    """After it the vehicle returns to where it first followed; 0: it never does."""
    json: bool = False
    """Print what the tracker did as one JSON object on standard output."""

    def run(self) -> None:
        """Be the tracker, and say what it did."""
        from ..live.address import host_and_port
        from ..live.link.mavlink import TrackerMavlinkLink
        from ..live.link.state_file import tracker_file
        from ..live.tracker.agent import AgentSettings
        from ..processes.stop_request import stop_request

        host, port = host_and_port(self.service, "--service")
        settings, key = AgentSettings(**fields_from(self, AgentSettings)), self._key()
        state_path = self.folder() / tracker_file(self.number)
        with line_printer() as tell, stop_request() as request:
            link = TrackerMavlinkLink(self.number, host, port, key, state_path=state_path, unsigned=self.unsigned)
            try:
                summary = self._fly(link, settings, request, tell)
            finally:
                link.close()
            dropped = ", ".join(f"{count} {reason}" for reason, count in summary.dropped.items())
            tell(f"Tracker {self.number} heard {summary.levels} levels; dropped: {dropped or 'none'}.")
        if self.json:
            print_json(dataclasses.asdict(summary))

    def _fly(
        self, link: "TrackerMavlinkLink", settings: "AgentSettings", request: "StopRequest", tell: Callable[[str], None]
    ) -> "TrackerSummary":
        from ..live.clock import MonotonicClock
        from ..live.tracker.agent import TrackerAgent
        from ..live.tracker.loop import run_tracker
        from ..live.tracker.sources import CalibratedSource

        vehicle = open_vehicle(self.vehicle, VehicleDetails(**fields_from(self, VehicleDetails)))
        source = open_source(self.source, SourceDetails(**fields_from(self, SourceDetails)))
        calibrated = CalibratedSource(source, self.calibration_offset_db)
        agent = TrackerAgent(self.number, calibrated, vehicle, link, MonotonicClock(), self.sampling_hz, settings)
        tell(f"Tracker {self.number} dials {self.service}.")
        return run_tracker(self.number, agent, source, vehicle, link, request, tell)

    def _key(self) -> bytes | None:
        """This tracker's own; others in the file are left alone."""
        keys = self.read_keys()
        if keys is None:
            return None
        if self.number not in keys:
            raise InputError(f"key file {self.keys} holds no key of tracker {self.number}")
        return keys[self.number]
