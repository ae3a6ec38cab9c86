"""The link that flies: MAVLink 2, signed, over UDP. docs/link.md is its description for strangers.

The controller binds an address and the trackers dial it, because a tracker behind a mobile network can only be
answered. One datagram is one packet. A tracker's set-points go to where its last accepted packet came from.
"""

import contextlib
import ipaddress
import select
import socket
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ...errors import InputError, reason_of
from ...scenario import NUM_TRACKERS
from .codec import (
    CONTROLLER_COMPONENT,
    CONTROLLER_SYSTEM,
    TRACKER_COMPONENT,
    ReportDecoder,
    SetPointDecoder,
    system_of,
)
from .keys import require_keys
from .loss import LossMeter
from .messages import Message, Report, SetPoint
from .packet import LONGEST_PACKET_BYTES, SEQUENCE_PLACE, Header, PacketReader, PacketWriter, Peer
from .protocol import ControllerLink, Link
from .rejection import Reason, RejectedError, Rejections
from .state_file import CONTROLLER_HEARS, TRACKER_HEARS, sender_name
from .timestamps import Timestamps
from .udp_socket import Address, DatagramSocket

MOST_DATAGRAMS = 1024
"""That one call takes from the socket; what is left waits for the next, or is dropped by the system."""
MOST_OF_ONE_SENDER = 32
"""That one call checks and decodes, the newest: a flood in the name of one tracker does not crowd out another."""


class _UdpEnd:
    """What both ends do with their socket."""

    def __init__(self, udp: DatagramSocket, reader: PacketReader, writer: PacketWriter, timestamps: Timestamps) -> None:
        self._socket = udp
        self._reader = reader
        self._writer = writer
        self._timestamps = timestamps
        self.rejections = Rejections()
        self._loss: defaultdict[int, LossMeter] = defaultdict(LossMeter)
        """By system."""

    @property
    def rejected(self) -> Counter[str]:
        """How many datagrams were dropped, by the words of ``Reason``."""
        return self.rejections.by_reason

    @property
    def skew_s(self) -> dict[str, float]:
        """By sender: how much its clock was ahead of this end's when its newest accepted datagram came; what that took
        on the way makes it less.
        """
        return {sender_name(system): skew_s for system, skew_s in self._timestamps.skew_s.items()}

    @property
    def state_errors(self) -> int:
        """How often the state file could not be written: after a restart, replays could then be accepted."""
        return self._timestamps.state_errors

    def close(self) -> None:
        """Give back the socket and the state file."""
        self._socket.close()
        self._timestamps.close()

    def _receive(self) -> list[tuple[Message, Address]]:
        received: list[tuple[Message, Address]] = []
        for _, datagram, header, peer, address in self._newest_datagrams():
            try:
                received.append((self._reader.open(datagram, header, peer), address))
            except RejectedError as rejection:
                self.rejections.add(rejection, sender_name(peer.system))
            else:
                self._loss[peer.system].heard(datagram[SEQUENCE_PLACE])
        return received

    def _newest_datagrams(self) -> list[tuple[int, bytes, Header, Peer, Address]]:
        """The last few of each sender, in the order of their coming."""
        waiting: dict[int, deque[tuple[int, bytes, Header, Peer, Address]]] = {}
        for number in range(MOST_DATAGRAMS):
            try:
                # One byte more than the longest packet, so that a longer one is seen to be longer.
                datagram, address = self._socket.recvfrom(LONGEST_PACKET_BYTES + 1)
            except OSError:
                break  # nothing there (BlockingIOError), or no network: the next call tries again
            try:
                header, peer = self._reader.claim(datagram)
            except RejectedError as rejection:
                self.rejections.add(rejection)
                continue
            queue = waiting.setdefault(peer.system, deque(maxlen=MOST_OF_ONE_SENDER))
            if len(queue) == MOST_OF_ONE_SENDER:
                self.rejections.add(RejectedError(Reason.OVERFLOW), sender_name(peer.system))
            queue.append((number, datagram, header, peer, address))
        return sorted(item for queue in waiting.values() for item in queue)

    def _send(self, message: Message, key: bytes | None, address: Address) -> None:
        datagram = self._writer.datagram(message, key)
        # No network, nobody there, or no room: lost, as on the air; the next message repeats it.
        with contextlib.suppress(OSError):
            self._socket.sendto(datagram, address)


class ControllerMavlinkLink(_UdpEnd, ControllerLink):
    """The controller's end.

    Args:
        host, port: the UDP address to bind; port 0 lets the system choose.
        keys: by tracker; a tracker without a key is not listened to.
        state_path: remembers timestamps over restarts, so that no replay is accepted even from trackers whose
            clocks are ahead; see ``timestamps``.
        unsigned: do without keys; only on the loopback interface.
        wall_time_ns, monotonic_ns: see ``RealTime``.
        udp: instead of a socket of its own.

    Raises:
        InputError: the address cannot be bound, keys, state file or clock are refused, or ``unsigned`` is not allowed.
    """

    def __init__(
        self,
        host: str,
        port: int,
        keys: Mapping[int, bytes] | None = None,
        *,
        state_path: Path | None = None,
        unsigned: bool = False,
        wall_time_ns: Callable[[], int] = time.time_ns,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        udp: DatagramSocket | None = None,
    ) -> None:
        family, address = _resolve(host, port)
        _require_keys_or_loopback(address, keys, unsigned)
        self._keys: Mapping[int, bytes | None] = keys or dict.fromkeys(range(NUM_TRACKERS))
        self._addresses: dict[int, Address] = {}
        peers = [Peer(tracker, system_of(tracker), TRACKER_COMPONENT, key) for tracker, key in self._keys.items()]
        udp = udp or _new_socket(family, address)
        try:
            timestamps = Timestamps(CONTROLLER_HEARS, state_path, wall_time_ns, monotonic_ns)
        except InputError:
            udp.close()
            raise
        writer = PacketWriter(CONTROLLER_SYSTEM, CONTROLLER_COMPONENT, timestamps)
        super().__init__(udp, PacketReader(peers, ReportDecoder(), timestamps), writer, timestamps)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that trackers dial."""
        host, port = self._socket.getsockname()[:2]
        return host, port

    def wait(self, seconds: float) -> bool:
        """Until something comes, and no longer than this; whether it has come."""
        return bool(select.select([self._socket], [], [], max(seconds, 0.0))[0])

    def clocks_ahead_s(self) -> list[float | None]:
        """Of each tracker: how far its clock was ahead when it last spoke; None where it never did or does not sign."""
        skew_s = self._timestamps.skew_s
        return [skew_s.get(system_of(tracker)) for tracker in range(NUM_TRACKERS)]

    def loss_share(self) -> list[float | None]:
        """Of each tracker's last packets, which share got lost on their way here; None where that is not known."""
        return [self._loss[system_of(tracker)].share for tracker in range(NUM_TRACKERS)]

    def send(self, message: Message) -> None:
        """Send a set-point to where its tracker was last heard; drop it if it never was.

        Raises:
            TypeError: not a set-point.
        """
        if not isinstance(message, SetPoint):
            raise TypeError(f"a controller does not send a {type(message).__name__}")
        if message.tracker in self._addresses:
            self._send(message, self._keys[message.tracker], self._addresses[message.tracker])

    def forget_waiting(self) -> None:
        """What has come before anybody listened is old: it is dropped unseen, and is no flood."""
        with contextlib.suppress(OSError):
            for _ in range(MOST_DATAGRAMS):
                self._socket.recvfrom(LONGEST_PACKET_BYTES)

    def receive(self) -> Sequence[Message]:
        """What trackers have said since the last call."""
        received = self._receive()
        for message, address in received:
            self._addresses[message.tracker] = address
        return [message for message, _ in received]


class TrackerMavlinkLink(_UdpEnd, Link):
    """A tracker's end, which dials the controller. It hears nothing until it has sent something.

    Args:
        tracker: 0 to 5.
        host, port: of the controller.
        key: this tracker's.
        state_path: remembers timestamps over restarts: see ``timestamps``.
        unsigned: do without a key; only if the controller is on the loopback interface.
        wall_time_ns, monotonic_ns: see ``RealTime``.
        udp: instead of a socket of its own.

    Raises:
        InputError: no such tracker or address, key, state file or clock are refused, or ``unsigned`` is not allowed.
    """

    def __init__(
        self,
        tracker: int,
        host: str,
        port: int,
        key: bytes | None = None,
        *,
        state_path: Path | None = None,
        unsigned: bool = False,
        wall_time_ns: Callable[[], int] = time.time_ns,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        udp: DatagramSocket | None = None,
    ) -> None:
        if not 0 <= tracker < NUM_TRACKERS:
            raise InputError(f"tracker = {tracker} is refused: allowed is 0 to {NUM_TRACKERS - 1}")
        family, self._controller = _resolve(host, port)
        _require_keys_or_loopback(self._controller, None if key is None else {tracker: key}, unsigned)
        self._tracker = tracker
        self._key = key
        timestamps = Timestamps(TRACKER_HEARS, state_path, wall_time_ns, monotonic_ns)
        peers = [Peer(tracker, CONTROLLER_SYSTEM, CONTROLLER_COMPONENT, key)]
        writer = PacketWriter(system_of(tracker), TRACKER_COMPONENT, timestamps)
        # Without keys it is bound to the loopback interface: nothing from outside may reach it.
        udp = udp or _new_socket(family, (self._controller[0], 0) if unsigned else None)
        super().__init__(udp, PacketReader(peers, SetPointDecoder(), timestamps), writer, timestamps)

    def send(self, message: Message) -> None:
        """Send a report to the controller.

        Raises:
            TypeError: not a report.
            ValueError: another tracker's.
        """
        if not isinstance(message, Report):
            raise TypeError(f"a tracker does not send a {type(message).__name__}")
        if message.tracker != self._tracker:
            raise ValueError(f"tracker {self._tracker} does not speak for tracker {message.tracker}")
        self._send(message, self._key, self._controller)

    def receive(self) -> Sequence[Message]:
        """What the controller has said since the last call."""
        return [message for message, _ in self._receive()]


def _resolve(host: str, port: int) -> tuple[socket.AddressFamily, Address]:
    if not 0 <= port < 2**16:
        raise InputError(f"UDP port {port} is refused: allowed is 0 to {2**16 - 1}")
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError) as error:
        raise InputError(f"cannot find host {host!r}: {reason_of(error)}") from error
    return family, address


def _require_keys_or_loopback(address: Address, keys: Mapping[int, bytes] | None, unsigned: bool) -> None:
    if not unsigned:
        if keys is None:
            raise InputError(
                "the link needs keys; only on the loopback interface, and if asked for, does it go without"
            )
        require_keys(keys)
    elif keys is not None:
        raise InputError("keys are given, and unsigned is asked for: only one of them")
    elif not ipaddress.ip_address(str(address[0]).partition("%")[0]).is_loopback:
        raise InputError(f"without keys only the loopback interface is allowed, not {address[0]}")


def _new_socket(family: socket.AddressFamily, bind_to: Address | None) -> socket.socket:
    udp = socket.socket(family, socket.SOCK_DGRAM)
    udp.setblocking(False)
    try:
        if bind_to:
            udp.bind(bind_to)
    except OSError as error:
        udp.close()
        host, port = bind_to[:2] if bind_to else ("", 0)
        raise InputError(f"cannot bind UDP port {port} of {host}: {error.strerror or error}") from error
    return udp
