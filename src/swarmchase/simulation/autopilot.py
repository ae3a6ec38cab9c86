"""A simulated ArduPilot copter, armed and in the air, that a tracker agent commands over UDP as it would a real one."""

import socket
from typing import Any

from ..live.address import LOOPBACK
from ..live.link.dialect import mavlink
from ..live.ticker import next_moment_ns
from ..live.tracker.vehicles import SimulatedVehicle
from .vehicles_gone_wrong import FailingVehicle

HEARTBEAT_HZ = 1.0
POSITION_HZ = 20.0
LOITER, GUIDED = 5, 4
"""Copter's modes."""
MOST_DATAGRAMS = 100


class SimulatedAutopilot:
    """Flies ``vehicle`` and speaks to the agent that listens at ``port`` of this machine."""

    def __init__(self, vehicle: SimulatedVehicle | FailingVehicle, port: int) -> None:
        self.has_companion = False
        """Whether an agent has ever spoken."""
        self._vehicle = vehicle
        self._mode = LOITER
        self._mavlink: Any = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._parser: Any = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._last_ns: dict[str, int] = {}
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect((LOOPBACK, port))

    def step(self, now_ns: int) -> None:
        """Hear, and say what is due."""
        for message in self._heard():
            self._obey(message)
        if self._is_due("heartbeat", HEARTBEAT_HZ, now_ns):
            armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            copter, ardupilot = mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
            self._say(self._mavlink.heartbeat_encode(copter, ardupilot, armed, self._mode, mavlink.MAV_STATE_ACTIVE))
        if self._is_due("position", POSITION_HZ, now_ns):
            east_m, north_m, up_m = self._vehicle.position_m
            east_mps, north_mps, up_mps = self._vehicle.velocity_mps
            boot_ms = now_ns // 10**6 % 2**32
            self._say(
                self._mavlink.local_position_ned_encode(boot_ms, north_m, east_m, -up_m, north_mps, east_mps, -up_mps)
            )

    def close(self) -> None:
        """Give the socket back."""
        self._socket.close()

    def _heard(self) -> list[Any]:
        messages: list[Any] = []
        for _ in range(MOST_DATAGRAMS):
            try:
                datagram = self._socket.recv(65536)
            except OSError:  # nothing waits, or the agent has gone
                break
            messages += self._parser.parse_buffer(datagram) or []
        return messages

    def _obey(self, message: Any) -> None:
        self.has_companion = True
        kind = message.get_type()
        if kind == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_DO_SET_MODE:
            self._mode = int(message.param2)
            self._say(self._mavlink.command_ack_encode(message.command, mavlink.MAV_RESULT_ACCEPTED))
            self._last_ns.pop("heartbeat", None)
        elif kind == "SET_POSITION_TARGET_LOCAL_NED" and self._mode == GUIDED:
            # It keeps to the last one for ever: so does ArduPilot.
            self._vehicle.go_to((message.y, message.x, -message.z))

    def _say(self, message: Any) -> None:
        try:
            self._socket.send(message.pack(self._mavlink))
        except OSError:  # nobody listens
            return

    def _is_due(self, what: str, rate_hz: float, now_ns: int) -> bool:
        last_ns = self._last_ns.get(what)
        if last_ns is None:
            self._last_ns[what] = now_ns
            return True
        next_ns = next_moment_ns(last_ns, round(1e9 / rate_hz), now_ns)
        if next_ns > now_ns:
            return False
        self._last_ns[what] = next_ns
        return True
