"""A socket of ZeroMQ that is subscribed to whatever somebody publishes."""

from collections.abc import Iterator

from ....errors import InputError
from .protocol import MOST_PER_READ

ENDPOINTS = ("tcp://", "ipc://")


class ZmqSubscriber:
    """Connects, again and again where nobody is there: ZeroMQ does so itself.

    Args:
        endpoint: ``tcp://127.0.0.1:5556``.

    Raises:
        InputError: pyzmq is not installed, or the endpoint is none.
    """

    def __init__(self, endpoint: str) -> None:
        try:
            import zmq
        except ModuleNotFoundError as error:
            raise InputError("ZeroMQ needs pyzmq: pip install pyzmq") from error
        if not endpoint.startswith(ENDPOINTS):
            raise InputError(f"endpoint {endpoint!r} is refused: allowed is tcp://HOST:PORT or ipc://PATH")
        self._again: type[Exception] = zmq.Again
        self._no_wait = int(zmq.NOBLOCK)
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.RCVHWM, MOST_PER_READ)
        self._socket.setsockopt(zmq.SUBSCRIBE, b"")
        try:
            self._socket.connect(endpoint)
        except zmq.ZMQError as error:
            self.close()
            raise InputError(f"cannot connect to {endpoint}: {error}") from error

    def messages(self) -> Iterator[bytes]:
        """Those that have come; of one in several parts the last: the first is its topic."""
        for _ in range(MOST_PER_READ):
            try:
                yield self._socket.recv_multipart(self._no_wait)[-1]
            except self._again:
                return

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
        self._context.term()
