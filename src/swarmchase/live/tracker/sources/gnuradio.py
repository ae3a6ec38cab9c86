"""Levels that a flow graph of GNU Radio publishes with its block ZMQ PUB Sink: bare floats of 32 bits, little-endian.

Complex to Mag^2, Moving Average, Log10 (n = 10), Keep 1 in N down to --sampling-hz, ZMQ PUB Sink without tags. The
levels are no dBm: see ``--calibration-offset-db``.
"""

import struct

from .kind import SourceDetails, SourceKind
from .protocol import Sample
from .rejected import Rejected
from .zmq_subscriber import ZmqSubscriber

FLOAT_BYTES = 4


class GnuRadioSource:
    """Of the floats of one message the last counts: the others were computed at some time before.

    Raises:
        InputError: pyzmq is not installed, or the endpoint is none.
    """

    def __init__(self, endpoint: str) -> None:
        self.rejected = Rejected()
        self._endpoint = endpoint
        self._subscriber = ZmqSubscriber(endpoint)

    @property
    def silence(self) -> str:
        """The flow graph is not running."""
        return f"no message has come from {self._endpoint}"

    def read(self, now_ns: int) -> list[Sample]:
        """The samples that have come."""
        samples: list[Sample] = []
        for message in self._subscriber.messages():
            if not message or len(message) % FLOAT_BYTES:
                self.rejected.add("no floats of 32 bits", f"{len(message)} bytes")
                continue
            samples.append((now_ns, struct.unpack("<f", message[-FLOAT_BYTES:])[0]))
        return samples

    def close(self) -> None:
        """Close the socket."""
        self._subscriber.close()


def _open(place: str, _details: SourceDetails) -> GnuRadioSource:
    return GnuRadioSource(place)


KIND = SourceKind(scheme="gnuradio", place="ENDPOINT", note="floats of a ZMQ PUB Sink, tcp://HOST:PORT", open=_open)
