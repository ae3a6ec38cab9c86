"""The level at which a Kismet server hears one device, asked over its REST interface.

Kismet's documentation, "Devices": ``/devices/by-mac/{MAC}/devices.json`` with field simplification; "Logins": the API
token, of the role readonly, in the cookie ``KISMET``. Kismet sees a level with each packet, and this sees the last one
of each poll.
"""

import json
import threading
from collections import deque
from pathlib import Path
from typing import Any

from ....errors import InputError
from ....reading import read_bytes
from .kind import SourceDetails, SourceKind
from .mac import mac_address
from .protocol import Sample
from .rejected import Rejected

MOST_WAITING = 100
LARGEST_ANSWER_BYTES = 1_000_000
MOST_TOKEN_BYTES = 4096
TIMEOUT_S = 2.0
_FIELDS = {
    "rssi_dbm": "kismet.device.base.signal/kismet.common.signal.last_signal",
    "last_time_s": "kismet.device.base.last_time",
    "packets": "kismet.device.base.packets.total",
}


class KismetSource:
    """Polls in a thread of its own, so that ``read`` never waits for the network. An answer in which the device has
    sent nothing since the one before is no sample. A failed poll is counted and tried again at the next.

    Args:
        url: of the server, ``http://127.0.0.1:2501``.
        mac: of the device that is chased, ``aa:bb:cc:dd:ee:ff``.
        token: the API key; None where the server wants none.
        interval_s: between polls.

    Raises:
        InputError: ``mac`` is no MAC address or ``url`` no web address.
    """

    def __init__(self, url: str, mac: str, token: str | None = None, interval_s: float = 0.1) -> None:
        mac_address(mac)
        if not url.startswith(("http://", "https://")):
            raise InputError(f"{url!r} is refused: allowed is the http:// or https:// address of a Kismet server")
        self.rejected = Rejected()
        self._mac = mac
        self._url = f"{url.rstrip('/')}/devices/by-mac/{mac}/devices.json"
        self._token = token
        self._interval_s = interval_s
        self._waiting: deque[float] = deque(maxlen=MOST_WAITING)
        self._seen: tuple[Any, Any] | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._poll, name="kismet", daemon=True)
        self._thread.start()

    @property
    def silence(self) -> str:
        """The server answers, and the device sends nothing."""
        return f"Kismet has heard nothing new of {self._mac}"

    def read(self, now_ns: int) -> list[Sample]:
        """The levels that have come; Kismet's own times are whole seconds and of no use here."""
        return [(now_ns, self._waiting.popleft()) for _ in range(len(self._waiting))]

    def close(self) -> None:
        """End the thread."""
        self._closing.set()
        self._thread.join(timeout=2 * TIMEOUT_S)

    def _poll(self) -> None:
        while not self._closing.wait(self._interval_s):
            try:
                record = parse_answer(self._ask())
            except (OSError, ValueError) as error:
                self.rejected.add(f"no answer: {type(error).__name__}", str(error))
                continue
            if record is None:
                self.rejected.add("no such device in the answer")
                continue
            rssi_dbm, seen = record
            if seen != self._seen:
                self._seen = seen
                self._waiting.append(rssi_dbm)

    def _ask(self) -> bytes:
        from http.client import HTTPException
        from urllib.parse import urlencode
        from urllib.request import ProxyHandler, Request, build_opener

        fields = [[path, name] for name, path in _FIELDS.items()]
        request = Request(self._url, urlencode({"json": json.dumps({"fields": fields})}).encode())
        if self._token is not None:
            request.add_header("Cookie", f"KISMET={self._token}")
        try:
            # Kismet runs beside the receiver: no proxy that the environment names lies between.
            with build_opener(ProxyHandler({})).open(request, timeout=TIMEOUT_S) as answer:
                found: bytes = answer.read(LARGEST_ANSWER_BYTES)
        except HTTPException as error:
            raise ConnectionError(str(error)) from error
        return found


def parse_answer(answer: bytes) -> tuple[float, tuple[Any, Any]] | None:
    """(rssi_dbm, what changes with each packet), or None where the answer holds no such device. Never raises."""
    try:
        devices = json.loads(answer)
    except (ValueError, RecursionError):
        return None
    device = devices[0] if isinstance(devices, list) and devices else devices
    if not isinstance(device, dict) or not isinstance(device.get("rssi_dbm"), int | float):
        return None
    if isinstance(device["rssi_dbm"], bool) or abs(device["rssi_dbm"]) > 1e6:
        return None
    return float(device["rssi_dbm"]), (device.get("last_time_s"), device.get("packets"))


def _open(url: str, details: SourceDetails) -> KismetSource:
    if details.transmitter_mac is None:
        raise InputError("Kismet hears many devices: say which one with --transmitter-mac")
    return KismetSource(url, details.transmitter_mac, _token(details.kismet_token_file))


def _token(path: Path | None) -> str | None:
    if path is None:
        return None
    content = read_bytes(path, "token", MOST_TOKEN_BYTES)
    if not content.isascii():
        raise InputError(f"cannot read token {path}: it is no ASCII text")
    return content.decode("ascii").strip()


KIND = SourceKind(scheme="kismet", place="URL", open=_open)
