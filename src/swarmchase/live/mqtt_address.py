"""A topic of an MQTT broker, as people write it: [USER@]HOST[:PORT]/TOPIC."""

import importlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..reading import read_bytes
from .address import host_and_port

DEFAULT_PORT = 1883
MOST_PASSWORD_BYTES = 4096
_PLACE = re.compile(r"(?:(?P<user>[^@/]+)@)?(?P<host>\[[^\]]+\]|[^:/\[\]]+)(?::(?P<port>\d+))?/(?P<topic>.+)")


@dataclass(frozen=True)
class MqttAddress:
    """Where a topic is, and who may ask for it."""

    host: str
    port: int
    topic: str
    user: str | None = None
    password: str | None = None


def mqtt_address(place: str, password_file: Path | None, what: str) -> MqttAddress:
    """The topic at this place.

    Args:
        password_file: holds the user's.
        what: asks for it, for the refusal: ``source`` or ``output``.

    Raises:
        InputError: it is no such place, or a password without a user or that cannot be read.
    """
    found = _PLACE.fullmatch(place)
    if found is None:
        raise InputError(f"{what} 'mqtt:{place}' is refused: allowed is mqtt:[USER@]HOST[:PORT]/TOPIC")
    host, port = host_and_port(f"{found['host']}:{found['port'] or DEFAULT_PORT}", f"{what} mqtt")
    if password_file is not None and found["user"] is None:
        raise InputError("a password is of a user: mqtt:USER@HOST[:PORT]/TOPIC says whose --mqtt-password-file holds")
    return MqttAddress(host, port, found["topic"], found["user"], _password(password_file))


def paho_client() -> Any:
    """The module ``paho.mqtt.client``.

    Raises:
        InputError: it is not installed.
    """
    try:
        return importlib.import_module("paho.mqtt.client")
    except ImportError as error:
        raise InputError("MQTT needs paho-mqtt: pip install 'paho-mqtt>=2'") from error


def _password(path: Path | None) -> str | None:
    return None if path is None else read_bytes(path, "password", MOST_PASSWORD_BYTES).decode(errors="replace").strip()
