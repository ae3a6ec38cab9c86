"""Records that an MQTT broker passes on, from a LoRa gateway, an ESP32 or a bridge: JSON, or text with a level."""

from collections import deque
from typing import Any

from ....errors import InputError
from ...mqtt_address import MqttAddress, mqtt_address, paho_client
from .kind import SourceDetails, SourceKind
from .lines import LineRecords
from .printed_records import PrintedRecords
from .protocol import MOST_PER_READ, Sample
from .rejected import Rejected


class MqttSource:
    """Subscribes to a topic. paho's own thread talks to the broker, again and again where it is away.

    Raises:
        InputError: paho-mqtt is not installed.
    """

    def __init__(self, address: MqttAddress, records: LineRecords) -> None:
        paho = paho_client()
        self._topic, self._records = address.topic, records
        self._place = f"{address.host}:{address.port}"
        self._state = "it has not answered"
        self._waiting: deque[bytes] = deque(maxlen=MOST_PER_READ)
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        if address.user is not None:
            self._client.username_pw_set(address.user, address.password)
        self._client.on_connect = self._on_connect
        self._client.on_connect_fail = self._on_connect_fail
        self._client.on_disconnect = self._on_disconnect
        self._client.on_message = self._on_message
        self._client.reconnect_delay_set(min_delay=1, max_delay=5)
        self._client.connect_async(address.host, address.port)
        self._client.loop_start()

    @property
    def rejected(self) -> Rejected:
        """The messages that were no records."""
        return self._records.rejected

    @property
    def silence(self) -> str:
        """The broker is away, or nobody publishes."""
        return f"no message of {self._topic} has come from the MQTT broker {self._place}: {self._state}"

    def read(self, now_ns: int) -> list[Sample]:
        """The samples that have come.

        Raises:
            InputError: several transmit, and none was chosen.
        """
        found = [self._records.sample(self._waiting.popleft(), now_ns) for _ in range(len(self._waiting))]
        self._records.require_one(self._topic, now_ns)
        return [sample for sample in found if sample is not None]

    def close(self) -> None:
        """Say good-bye and end the thread."""
        self._client.disconnect()
        self._client.loop_stop()

    def _on_connect(self, client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            self._state = f"it refuses: {reason}"
            return
        self._state = "it is connected"
        client.subscribe(self._topic)

    def _on_connect_fail(self, _client: Any, _data: Any) -> None:
        self._state = "it cannot be reached"

    def _on_disconnect(self, _client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if "refuses" not in self._state:
            self._state = f"it was lost: {reason}"

    def _on_message(self, _client: Any, _data: Any, message: Any) -> None:
        self._waiting.append(message.payload)


def _open(place: str, details: SourceDetails) -> MqttSource:
    address = mqtt_address(place, details.mqtt_password_file, "source")
    levels = address.topic.split("/")
    if "#" in "/".join(levels)[:-1] or any(set("+#") & set(level) and len(level) > 1 for level in levels):
        raise InputError(f"topic {address.topic!r} is refused: + is for a whole level, # for all at the end")
    return MqttSource(address, PrintedRecords(details))


KIND = SourceKind(scheme="mqtt", place="HOST/TOPIC", note="or USER@HOST:PORT/TOPIC", open=_open)
