"""JSON records in UDP datagrams; ``json_records`` says what a record is."""

from ...address import LOOPBACK, host_and_port
from ...link.udp_socket import bound_udp_socket
from .json_records import JsonRecords
from .kind import DEFAULT_DETAILS, SourceDetails, SourceKind
from .protocol import MOST_PER_READ, Sample
from .rejected import Rejected

READ_BYTES = 65536


class JsonDatagramSource:
    """Datagrams of one record or of several lines, from anybody who can reach the port.

    Raises:
        InputError: the address cannot be had, or that of the device that is chased is none.
    """

    def __init__(self, port: int, host: str = LOOPBACK, details: SourceDetails = DEFAULT_DETAILS) -> None:
        self._records = JsonRecords(details)
        self._socket = bound_udp_socket(host, port)

    @property
    def port(self) -> int:
        """Where it listens: found by the system where 0 was asked for."""
        return int(self._socket.getsockname()[1])

    @property
    def rejected(self) -> Rejected:
        """The lines that were no records."""
        return self._records.rejected

    @property
    def silence(self) -> str:
        """Nobody sends to this port."""
        return f"no datagram has come to port {self.port}"

    def read(self, now_ns: int) -> list[Sample]:
        """The samples that have come.

        Raises:
            InputError: several transmit, and none was chosen.
        """
        samples: list[Sample] = []
        for line in self._lines():
            sample = self._records.sample(line, now_ns)
            if sample is not None:
                samples.append(sample)
        self._records.require_one(f"port {self.port}", now_ns)
        return samples

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _lines(self) -> list[bytes]:
        """Of as many datagrams as make up so many lines; the rest waits for the next call."""
        lines: list[bytes] = []
        while len(lines) < MOST_PER_READ:
            try:
                # A datagram without a line counts as one, or a flood of them would be read for ever.
                lines.extend(self._socket.recv(READ_BYTES).strip().split(b"\n"))
            except OSError:  # nothing waits
                break
        return lines


def _open(place: str, details: SourceDetails) -> JsonDatagramSource:
    host, port = host_and_port(place, "source udp", LOOPBACK)
    return JsonDatagramSource(port, host, details)


KIND = SourceKind(scheme="udp", place="PORT", open=_open)
