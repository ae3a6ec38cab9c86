"""The estimate to an MQTT broker (extra: mqtt), each message as in a file of JSON lines."""

import contextlib
import threading
from typing import Any

from ...errors import InputError
from ..frame import Frame
from ..mqtt_address import mqtt_address, paho_client
from .kind import OutputDetails
from .remote_id import estimate_message

WAIT_S = 3.0
"""For the broker's answer."""


class MqttOutput:
    """To one topic of one broker; a connection that ends is made again with the next frame.

    Raises:
        InputError: paho-mqtt is not installed, or the place is none, or holds a topic that nothing can be sent to.
    """

    def __init__(self, place: str, details: OutputDetails) -> None:
        self._address, self._details = mqtt_address(place, details.mqtt_password_file, "output"), details
        if set(self._address.topic) & set("+#\0"):
            raise InputError(f"topic {self._address.topic!r} is refused: + and # are for those who listen")
        self._paho = paho_client()
        self._client: Any = None

    def send(self, frame: Frame, wall_ns: int) -> None:
        """One message, at most once (quality of service 0), not retained.

        Raises:
            OSError: the broker cannot be reached, refuses, or is gone.
        """
        try:
            if self._client is None:
                self._client = self._connected()
            sent = self._client.publish(self._address.topic, estimate_message(frame, wall_ns, self._details))
            if sent.rc != self._paho.MQTT_ERR_SUCCESS or not self._client.is_connected():
                raise ConnectionError("the broker has closed the connection")
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        """Take leave of the broker."""
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(OSError):
                client.disconnect()
            client.loop_stop()

    def _connected(self) -> Any:
        """A client whose own thread carries what it publishes."""
        answered, refusals = threading.Event(), []
        client = self._paho.Client(self._paho.CallbackAPIVersion.VERSION2, reconnect_on_failure=False)
        client.connect_timeout = WAIT_S
        if self._address.user is not None:
            client.username_pw_set(self._address.user, self._address.password)

        def hear_answer(_client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
            refusals.extend([str(reason)] if reason.is_failure else [])
            answered.set()

        client.on_connect = hear_answer
        client.connect(self._address.host, self._address.port)
        client.loop_start()
        has_answered = answered.wait(WAIT_S)
        if has_answered and not refusals:
            return client
        client.disconnect()
        client.loop_stop()
        raise ConnectionError(f"the broker refuses: {refusals[0]}" if refusals else "the broker does not answer")
