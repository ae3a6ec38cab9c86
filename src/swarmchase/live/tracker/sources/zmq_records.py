"""JSON records that somebody publishes over ZeroMQ, as the decoders of Remote ID around DragonSync do;
``json_records`` says what a record is.
"""

from .json_records import JsonRecords
from .kind import SourceDetails, SourceKind
from .protocol import Sample
from .rejected import Rejected
from .zmq_subscriber import ZmqSubscriber


class ZmqSource:
    """A message is a record.

    Raises:
        InputError: pyzmq is not installed, the endpoint is none, or the address of the device that is chased is none.
    """

    def __init__(self, endpoint: str, details: SourceDetails) -> None:
        self._endpoint, self._records = endpoint, JsonRecords(details)
        self._subscriber = ZmqSubscriber(endpoint)

    @property
    def rejected(self) -> Rejected:
        """The messages that were no records."""
        return self._records.rejected

    @property
    def silence(self) -> str:
        """Nobody is there, or publishes."""
        return f"no message has come from {self._endpoint}"

    def read(self, now_ns: int) -> list[Sample]:
        """The samples that have come.

        Raises:
            InputError: several transmit, and none was chosen.
        """
        samples = [self._records.sample(message, now_ns) for message in self._subscriber.messages()]
        self._records.require_one(self._endpoint, now_ns)
        return [sample for sample in samples if sample is not None]

    def close(self) -> None:
        """Close the socket."""
        self._subscriber.close()


KIND = SourceKind(scheme="zmq", place="ENDPOINT", note="JSON records, tcp://HOST:PORT", open=ZmqSource)
