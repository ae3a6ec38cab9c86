"""One connection to the page, which gives way: nobody closes the page to others by holding connections open.

A request comes at once or never, a whole file takes a minute at most, and where an address has too many connections,
or all together are, the oldest idle one ends. What has become a WebSocket is counted by the page's server instead.
"""

import asyncio
import ipaddress
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

REQUEST_S = 5.0
"""From a connection's beginning to the end of its first request's headers."""
LONGEST_S = 60.0
"""For all of its requests and answers: a browser then opens another one."""
MOST_OF_ONE_ADDRESS = 24
"""A browser opens six; behind a tunnel all browsers have one address."""
MOST_CONNECTIONS = 100
"""Of all addresses."""
IPV6_PREFIX_BITS = 64
"""Of IPv6, one machine may have all addresses that begin alike."""


class PageConnection(H11Protocol):
    """HTTP with limits; uvicorn makes one for each connection."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._timers: list[asyncio.TimerHandle] = []
        self.sender = ""
        """Whose it is, for counting."""
        self.began_s = self.loop.time()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """It has been taken; another one may have to go."""
        super().connection_made(transport)
        self.sender = sender_of(self.client)
        self._timers = [
            self.loop.call_later(REQUEST_S, self._require_request),
            self.loop.call_later(LONGEST_S, transport.abort),
        ]
        self._make_room()

    def connection_lost(self, exc: Exception | None) -> None:
        """It is gone."""
        self._stop_timers()
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """From now on it is a WebSocket, with limits of its own."""
        self._stop_timers()
        super().handle_websocket_upgrade(event)

    @property
    def is_busy(self) -> bool:
        """Whether it is being answered."""
        return self.cycle is not None and not self.cycle.response_complete

    def _make_room(self) -> None:
        there = [one for one in self.connections if isinstance(one, PageConnection) and not one.transport.is_closing()]
        of_sender = [one for one in there if one.sender == self.sender]
        crowd = of_sender if len(of_sender) > MOST_OF_ONE_ADDRESS else there if len(there) > MOST_CONNECTIONS else []
        if crowd:
            min(crowd, key=lambda one: (one.is_busy, one.began_s)).transport.abort()

    def _require_request(self) -> None:
        if not self.headers:
            self.transport.abort()

    def _stop_timers(self) -> None:
        for timer in self._timers:
            timer.cancel()


def sender_of(client: tuple[str, int] | None) -> str:
    """What its connections are counted under, of a client's host and port."""
    if client is None:
        return ""
    address = ipaddress.ip_address(client[0].partition("%")[0])
    if address.version == 4 or address.ipv4_mapped is not None:
        return str(address)
    return str(ipaddress.ip_network((address, IPV6_PREFIX_BITS), strict=False))
