"""Serves the page: uvicorn in a thread of its own, beside the chase's loop."""

import asyncio
import ipaddress
import socket
import threading
from urllib.parse import quote

from ...errors import InputError, reason_of

try:
    import uvicorn
    import websockets  # noqa: F401  uvicorn needs it
    from starlette.applications import Starlette
    from starlette.middleware import Middleware
    from starlette.routing import Route, WebSocketRoute
    from starlette.websockets import WebSocket
except ImportError as error:
    raise InputError("the page needs starlette, uvicorn and websockets: pip install 'swarmchase[live]'") from error

from .browser import Browser
from .connection import PageConnection
from .feed import Feed
from .gate import Gate
from .static_files import StaticFiles

MOST_BROWSERS = 16
LONGEST_MESSAGE_BYTES = 1000
"""A browser only sends words and times."""
PING_S = 5.0
"""A browser that does not answer a ping for so long is gone."""
CLOSING_S = 1
"""For browsers to say goodbye."""
TRY_AGAIN_LATER = 1013
"""A WebSocket's code for: too many."""


class PageServer:
    """Serves ``feed`` from construction on.

    Args:
        host: where to listen: 127.0.0.1 for this machine alone.
        port: 0 lets the system choose.
        token: must be in the address that is opened; required where ``host`` is not loopback.

    Raises:
        InputError: the address cannot be had, or other machines could reach it without a token.
    """

    def __init__(self, feed: Feed, host: str, port: int, token: str | None = None) -> None:
        self._listening = _listening_socket(host, port)
        address = ipaddress.ip_address(self._listening.getsockname()[0])
        if not token and not address.is_loopback:
            self._listening.close()
            raise InputError(f"other machines can reach {host}: the page needs a token there")
        self._token = token or None
        self._port: int = self._listening.getsockname()[1]
        self._name = socket.gethostname() if address.is_unspecified else host
        self._feed, self._browsers = feed, 0
        names = {self._name} | (set() if address.is_loopback else _names_of_this_machine())
        self._server = uvicorn.Server(self._config(frozenset(name.lower() for name in names)))
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="page", daemon=True)
        self._thread.start()

    @property
    def _address(self) -> str:
        """Without a token."""
        name = f"[{self._name}]" if ":" in self._name else self._name
        return f"http://{name}:{self._port}/"

    @property
    def url(self) -> str:
        """The address to open, with the token if there is one."""
        query = "" if self._token is None else f"?token={quote(self._token, safe='')}"
        return f"{self._address}{query}"

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._port

    def close(self) -> None:
        """End it; browsers look for it again by themselves."""
        self._server.should_exit = True
        self._thread.join()
        self._listening.close()

    def _config(self, names: frozenset[str]) -> uvicorn.Config:
        pages = StaticFiles()
        gate = Middleware(Gate, names=names, token=self._token, port=self._port, address=self._address)
        app = Starlette(
            routes=[
                Route("/", pages.answer),
                Route("/static/{path:path}", pages.answer),
                WebSocketRoute("/socket", self._serve_browser),
            ],
            middleware=[gate],
        )
        return uvicorn.Config(
            app,
            lifespan="off",
            log_config=None,
            log_level="critical",
            access_log=False,
            server_header=False,
            proxy_headers=False,
            timeout_graceful_shutdown=CLOSING_S,
            loop="asyncio",
            http=PageConnection,
            ws="websockets-sansio",
            ws_max_size=LONGEST_MESSAGE_BYTES,
            ws_ping_interval=PING_S,
            ws_ping_timeout=PING_S,
            ws_per_message_deflate=False,
        )

    async def _serve(self) -> None:
        await self._server.serve(sockets=[self._listening])
        # A browser that does not read cannot be told goodbye.
        for connection in list(self._server.server_state.connections):
            if connection.transport is not None:
                connection.transport.abort()
        await asyncio.sleep(0)

    async def _serve_browser(self, browser: WebSocket) -> None:
        if self._browsers >= MOST_BROWSERS:
            await browser.accept()
            await browser.close(TRY_AGAIN_LATER)
            return
        self._browsers += 1
        try:
            await Browser(self._feed, browser).serve()
        finally:
            self._browsers -= 1


def _names_of_this_machine() -> set[str]:
    """Those that it gives itself, and is known by in its own network (mDNS); what a name server calls it is not asked
    for: that may take long, and others could have a say in it.
    """
    name = socket.gethostname()
    first = name.partition(".")[0]
    return {name, first, f"{first}.local"}


def _listening_socket(host: str, port: int) -> socket.socket:
    try:
        family, _, _, _, address = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        raise InputError(f"cannot serve a page on {host}:{port}: {reason_of(error)}") from error
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((address[0], port, *address[2:]))
        listening.listen()
    except (OSError, OverflowError) as error:
        listening.close()
        raise InputError(f"cannot serve a page on {host}:{port}: {reason_of(error)}") from error
    return listening
