"""Who may see the page and speak through it.

A browser on the operator's machine also shows other people's websites, and those can make it send requests here. What
they cannot forge is the request's Origin, and its Host where a name of theirs has been made to point here (DNS
rebinding). Both must be the page's own; a token, where there is one, must come along.
"""

import hashlib
import hmac
import ipaddress
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

SECURITY_HEADERS = {
    "content-security-policy": "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
}
"""Nothing from elsewhere, no inline script, and no other site may frame the page and lure clicks onto it."""


class Gate:
    """Refuses what does not come from the page itself.

    Args:
        names: host names, besides IP addresses and localhost, under which the page may be asked for, in lower case.
        token: what the first request's query must hold; the browser then keeps a cookie. None: not asked for.
        port: for the cookie's name, because cookies do not tell ports apart.
        address: of the page, without a token, for people who are refused.
    """

    def __init__(self, app: ASGIApp, names: frozenset[str], token: str | None, port: int, address: str) -> None:
        self._app, self._names, self._token, self._address = app, names, token, address
        self._cookie = f"swarmchase-page-{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the request through, or refuse it."""
        connection = HTTPConnection(scope)
        refusal = self._refusal(connection)
        is_socket = scope["type"] == "websocket"
        if refusal is not None and is_socket:
            await WebSocketClose(1008, refusal)(scope, receive, send)
        elif refusal is not None:
            answer = PlainTextResponse(f"swarmchase: {refusal}.\n\n{self._advice()}\n", 403)
            await answer(scope, receive, self._with_headers(send, sets_cookie=False))
        elif is_socket:
            await self._app(scope, receive, send)
        else:
            await self._app(scope, receive, self._with_headers(send, self._came_with_token(connection)))

    def _refusal(self, connection: HTTPConnection) -> str | None:
        host = connection.headers.get("host", "").lower()
        origin = connection.headers.get("origin")
        if not self._is_own_host(host):
            return "this page is not served under that Host"
        if origin is None and connection.scope["type"] == "websocket":
            return "a WebSocket needs an Origin"
        if origin is not None and origin.lower() not in {f"http://{host}", f"https://{host}"}:
            return "another Origin than this page"
        if not (self._token is None or self._came_with_token(connection) or self._came_with_cookie(connection)):
            return "the token is missing or wrong"
        return None

    def _advice(self) -> str:
        """What a person who is refused can do. It is the same whatever was asked for, and says no token."""
        lines = [
            f"Open {self._address} itself, in the address bar and not from another page.",
            "Instead of its name there may stand the machine's IP address, localhost on the machine itself, or: "
            f"{', '.join(sorted(self._names))}.",
            "For another name, start swarmchase with it: --page NAME:PORT.",
        ]
        if self._token is not None:
            lines.insert(
                1,
                'Its address has to end in ?token=... when it is first opened in a browser: take the whole line "The '
                'page is at ..." that swarmchase printed when it started. Each start has another token.',
            )
        return "\n".join(lines)

    def _is_own_host(self, host: str) -> bool:
        """An address cannot be made to point elsewhere; a name can, so it must be one of ours."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        return name in self._names or name == "localhost" or _is_address(name)

    def _came_with_token(self, connection: HTTPConnection) -> bool:
        return self._token is not None and _equal(connection.query_params.get("token", ""), self._token)

    def _came_with_cookie(self, connection: HTTPConnection) -> bool:
        return self._token is not None and _equal(connection.cookies.get(self._cookie, ""), _digest(self._token))

    def _with_headers(self, send: Send, sets_cookie: bool) -> Send:
        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(SECURITY_HEADERS)
                if sets_cookie and self._token is not None:
                    cookie = f"{self._cookie}={_digest(self._token)}; Path=/; HttpOnly; SameSite=Strict"
                    headers.append("set-cookie", cookie)
            await send(message)

        return send_with_headers


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _equal(given: str, wanted: str) -> bool:
    """Takes as long for a wrong one as for the right one."""
    return hmac.compare_digest(given.encode(errors="replace"), wanted.encode(errors="replace"))


def _digest(token: str) -> str:
    """What the cookie holds: a token may have characters that a cookie may not."""
    return hashlib.sha256(f"swarmchase page {token}".encode(errors="replace")).hexdigest()
