"""The live system's page: what it keeps, who may speak through it, and what a real browser shows of it."""

import base64
import http.client
import io
import json
import re
import shutil
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from importlib.resources import files
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from page_frames import INFO, made_up_frame
from page_publisher import Publisher
from swarmchase.errors import InputError
from swarmchase.live.page import connection as page_connection
from swarmchase.live.page.connection import MOST_OF_ONE_ADDRESS, PageConnection
from swarmchase.live.page.feed import MOST_WORDS, WORDS, Feed
from swarmchase.live.page.history import History, pack, unpack
from swarmchase.live.page.server import MOST_BROWSERS, PageServer

# What is kept


@given(gaps_s=st.lists(st.floats(0, 10), min_size=1, max_size=200), most_frames=st.integers(8, 40))
def test_history_is_bounded_and_finds_the_nearest(gaps_s: list[float], most_frames: int) -> None:
    history = History(most_frames)
    times_s = [sum(gaps_s[: index + 1]) for index in range(len(gaps_s))]
    for time_s in times_s:
        history.add(time_s, pack(str(time_s)))
        assert len(history) <= most_frames
        assert history.span_s == (times_s[0], time_s)
    newest_s = times_s[-(most_frames // 2) :]
    for wanted_s in [-1.0, *newest_s, times_s[-1] + 1]:
        found = history.nearest(wanted_s)
        assert found is not None
        nearest_s = min([times_s[0], *newest_s], key=lambda time_s: abs(time_s - wanted_s))
        assert abs(float(unpack(found)) - wanted_s) <= abs(nearest_s - wanted_s)


@pytest.mark.parametrize("hours", [0.1, 1, 12])
def test_history_keeps_every_part_of_a_long_chase(hours: float) -> None:
    """With room for 400 frames, what is shown for a moment is never further from it than a 100th of what has passed."""
    history, last_s = History(400), 0
    for last_s in range(int(3600 * hours)):
        history.add(float(last_s), str(last_s).encode())
    for wanted_s in range(0, last_s, max(1, last_s // 300)):
        found = history.nearest(float(wanted_s))
        assert found is not None
        assert abs(float(found) - wanted_s) <= 1 + last_s / 100
    assert len(history) >= 200


def test_empty_history() -> None:
    assert History().nearest(1.0) is None
    assert History().span_s is None


def test_history_sorts_what_comes_late() -> None:
    history = History()
    for time_s in (1.0, 3.0, 2.0):
        history.add(time_s, str(time_s).encode())
    assert [history.nearest(time_s) for time_s in (0.9, 2.1, 9.0)] == [b"1.0", b"2.0", b"3.0"]


def test_feed_gives_the_newest_frame_once() -> None:
    feed = Feed(INFO, is_live=True)
    assert feed.newest() is None
    assert feed.past(0.0) is None
    for time_s in (0.5, 1.5, 2.5):
        feed.publish(made_up_frame(time_s))
    newest = feed.newest()
    assert newest is not None
    assert (newest.number, newest.first_s, newest.last_s) == (3, 0.5, 2.5)
    assert json.loads(newest.text) == made_up_frame(2.5)
    assert feed.newest(newest.number) is None
    past = feed.past(1.4)
    assert past is not None
    assert json.loads(past) == made_up_frame(1.5)


def test_a_number_that_is_none_becomes_null() -> None:
    feed = Feed(INFO, is_live=True)
    frame = made_up_frame(1.0)
    frame["trackers"][2]["rssi_dbm"][7] = float("nan")
    frame["center_m"] = [1.0, float("inf"), 2.0]
    feed.publish(frame)
    newest = feed.newest()
    assert newest is not None
    read = json.loads(newest.text)
    assert read["center_m"] == [1.0, None, 2.0]
    assert read["trackers"][2]["rssi_dbm"][7] is None


def test_feed_takes_known_words_of_a_live_chase() -> None:
    live, recorded = Feed(INFO, is_live=True), Feed(INFO, is_live=False)
    for word in ("hold", "explode", "HOLD", "", "abort"):
        live.say(word)
        recorded.say(word)
    assert live.words() == ["hold", "abort"]
    assert live.words() == []
    assert recorded.words() == []


def test_words_that_nobody_reads_are_bounded() -> None:
    feed = Feed(INFO, is_live=True)
    for _ in range(10 * MOST_WORDS):
        feed.say("hold")
    assert len(feed.words()) == MOST_WORDS


def test_the_page_knows_the_words_of_the_loop() -> None:
    from swarmchase.live.service.loop import WORDS as WORDS_OF_THE_LOOP

    assert set(WORDS) == set(WORDS_OF_THE_LOOP)


def test_the_buttons_say_words_of_the_loop() -> None:
    script = (files("swarmchase.live.page") / "static" / "operator.js").read_text()
    labels = re.findall(r"(\w+): \"", re.findall(r"LABELS = {(.*)}", script)[0])
    said = [*labels, *re.findall(r"this\.tell\(\"(\w+)\"\)", script)]
    assert sorted(said) == sorted(set(WORDS) - {"quit"})


# Who may see it and speak


@contextmanager
def served(feed: Feed, token: str | None = None, host: str = "127.0.0.1", port: int = 0) -> Iterator[PageServer]:
    server = PageServer(feed, host, port, token)
    try:
        yield server
    finally:
        server.close()


def port_of(server: PageServer) -> int:
    found = re.search(r":(\d+)/", server.url)
    assert found
    return int(found[1])


def get(server: PageServer, path: str = "/", **headers: str) -> tuple[int, dict[str, str], bytes]:
    """Status, headers, body; "host" replaces the usual one."""
    with closing(http.client.HTTPConnection("127.0.0.1", port_of(server), timeout=60)) as connection:
        connection.putrequest("GET", path, skip_host="host" in headers)
        for name, value in headers.items():
            connection.putheader(name.replace("_", "-"), value)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()


@contextmanager
def spoken_to(server: PageServer, query: str = "", **headers: str) -> Iterator[ClientConnection]:
    """A WebSocket as the page opens it."""
    port = port_of(server)
    headers = {"origin": f"http://127.0.0.1:{port}", **headers}
    address = f"ws://127.0.0.1:{port}/socket{query}"
    with connect(address, additional_headers=headers, compression=None, max_size=None, close_timeout=1) as client:
        yield client


def received(client: ClientConnection, kind: str) -> dict[str, Any]:
    """The next message of this kind."""
    while True:
        message: dict[str, Any] = json.loads(client.recv(timeout=60))
        if message["kind"] == kind:
            return message


def until(condition: Callable[[], Any]) -> Any:
    """What the condition gives, as soon as it is true."""
    pause = threading.Event()
    for _ in range(1000):
        if found := condition():
            return found
        pause.wait(0.01)
    raise AssertionError("it does not happen")


def test_page_and_its_files() -> None:
    with served(Feed(INFO, is_live=True)) as server:
        status, headers, body = get(server)
        assert status == 200
        assert b"swarmchase" in body
        assert headers["content-security-policy"].startswith("default-src 'self';")
        assert "unsafe" not in headers["content-security-policy"]
        status, headers, _ = get(server, "/static/main.js")
        assert (status, headers["content-type"]) == (200, "text/javascript; charset=utf-8")
        assert get(server, "/static/main.js", if_none_match=headers["etag"])[0] == 304
        for path in ("/static/../server.py", "/static/%2e%2e/server.py", "/static//etc/passwd", "/nothing"):
            assert get(server, path)[0] == 404


def test_info_and_newest_frame_come_first() -> None:
    feed = Feed(INFO, is_live=True)
    feed.publish(made_up_frame(1.0))
    feed.publish(made_up_frame(2.0))
    with served(feed) as server, spoken_to(server) as client:
        assert json.loads(client.recv(timeout=60)) == {"kind": "info", **INFO, "is_live": True}
        message = received(client, "frame")
        assert message["frame"] == made_up_frame(2.0)
        assert (message["first_s"], message["last_s"]) == (1.0, 2.0)
        feed.publish(made_up_frame(3.0))
        assert received(client, "frame")["frame"]["time_s"] == 3.0
        client.send('{"seek": 1}')
        assert received(client, "past") == {"kind": "past", "frame": made_up_frame(1.0)}


def test_words_arrive() -> None:
    feed = Feed(INFO, is_live=True)
    with served(feed) as server, spoken_to(server) as client:
        client.send('{"word": "hold"}')
        assert until(feed.words) == ["hold"]


@pytest.mark.parametrize(
    "message",
    [
        "",
        "hold",
        "null",
        "[]",
        '["word", "hold"]',
        '{"word": "explode"}',
        '{"word": ["hold"]}',
        '{"word": null}',
        '{"seek": "1"}',
        '{"seek": true}',
        '{"seek": NaN}',
        '{"seek": 1e999}',
        '{"seek": ' + 900 * "9" + "}",
        950 * "[",
        b'{"word": "hold"}',
        b"\xff\x00",
    ],
)
def test_anything_else_is_ignored(message: str | bytes) -> None:
    feed = Feed(INFO, is_live=True)
    feed.publish(made_up_frame(1.0))
    with served(feed) as server, spoken_to(server) as client:
        client.send(message)
        client.send('{"word": "abort"}')
        assert until(feed.words) == ["abort"]
        client.send('{"seek": 1}')
        assert received(client, "past")["frame"]["time_s"] == 1.0


def test_a_long_message_ends_the_connection() -> None:
    feed = Feed(INFO, is_live=True)
    with served(feed) as server:
        with spoken_to(server) as client:
            client.send('{"word": "hold"}' + 5000 * " ")
            with pytest.raises(ConnectionClosed):
                received(client, "nothing")
        assert feed.words() == []
        with spoken_to(server) as client:
            client.send('{"word": "abort"}')
            assert until(feed.words) == ["abort"]


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://example.org"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1"},  # another port
        {"origin": "http://localhost:{port}"},  # another name for the same: another site to a browser
        {"host": "example.org:{port}", "origin": "http://example.org:{port}"},  # a name that was made to point here
        {"host": "127.0.0.1.example.org:{port}", "origin": "http://127.0.0.1.example.org:{port}"},
    ],
)
def test_another_site_is_refused(headers: dict[str, str]) -> None:
    with served(Feed(INFO, is_live=True)) as server:
        headers = {name: value.format(port=port_of(server)) for name, value in headers.items()}
        assert get(server, "/socket", **_handshake(), **headers)[0] == 403
        assert get(server, **headers)[0] == 403


def _handshake() -> dict[str, str]:
    return {
        "connection": "Upgrade",
        "upgrade": "websocket",
        "sec_websocket_version": "13",
        "sec_websocket_key": base64.b64encode(bytes(16)).decode(),
    }


def test_a_socket_without_origin_is_refused() -> None:
    with served(Feed(INFO, is_live=True)) as server:
        assert get(server, "/socket", **_handshake())[0] == 403
        assert get(server)[0] == 200


@pytest.mark.parametrize("host", ["", "[", "[::1", "\xe4", "example.org"])
def test_broken_hosts_are_refused(host: str) -> None:
    with served(Feed(INFO, is_live=True)) as server:
        assert get(server, host=host)[0] in {400, 403}


@pytest.mark.parametrize("name", ["localhost", "LOCALHOST", "127.0.0.1"])
def test_own_names(name: str) -> None:
    """Also through a tunnel that ends at another port."""
    with served(Feed(INFO, is_live=True)) as server:
        assert get(server, host=f"{name}:9000", origin=f"http://{name}:9000")[0] == 200


def test_token() -> None:
    token = "a b/ü"
    with served(Feed(INFO, is_live=True), token) as server:
        path = server.url[server.url.index("/?") :]
        assert path.endswith("?token=a%20b%2F%C3%BC")
        for wrong in ("/", "/?token=", "/?token=a", "/static/main.js", "/?token=a%20b%2F%C3%BC%20"):
            status, headers, body = get(server, wrong)
            assert (status, "set-cookie" in headers) == (403, False)
            assert b"token" in body
        status, headers, _ = get(server, path)
        assert status == 200
        assert "HttpOnly; SameSite=Strict" in headers["set-cookie"]
        cookie = headers["set-cookie"].split(";")[0]
        assert get(server, "/static/main.js", cookie=cookie)[0] == 200
        assert get(server, "/static/main.js", cookie=f"{cookie}0")[0] == 403
        with spoken_to(server, cookie=cookie) as client:
            received(client, "info")
        for query in ("", "?token=wrong"):
            with pytest.raises(InvalidStatus), spoken_to(server, query):
                pass


def test_other_machines_need_a_token() -> None:
    feed = Feed(INFO, is_live=True)
    for token in (None, ""):
        with pytest.raises(InputError, match="needs a token"):
            PageServer(feed, "0.0.0.0", 0, token)
    with served(feed, "secret", "0.0.0.0") as server:
        assert server.url.endswith("/?token=secret")
        assert "0.0.0.0" not in server.url
        assert get(server, "/?token=secret")[0] == 200


def test_the_machines_own_names_are_served_where_other_machines_come_from(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: "Control-Room.example.org")
    feed = Feed(INFO, is_live=True)
    with served(feed, "secret", "0.0.0.0") as server:
        assert server.url.startswith("http://Control-Room.example.org:")
        for name in ("control-room", "control-room.local", "CONTROL-ROOM.example.org", "192.0.2.7"):
            assert get(server, "/?token=secret", host=f"{name}:{port_of(server)}")[0] == 200, name
        for name in ("other.local", "control-room.example.com", "control-room.local.example.org"):
            assert get(server, "/?token=secret", host=f"{name}:{port_of(server)}")[0] == 403, name
    with served(feed) as server:
        assert get(server, host=f"control-room.local:{port_of(server)}")[0] == 403


def test_who_is_refused_reads_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: "control-room")
    with served(Feed(INFO, is_live=True), "secret", "0.0.0.0") as server:
        address = f"http://control-room:{port_of(server)}/"
        for path, host, why in [
            ("/", "control-room", "the token is missing or wrong"),
            ("/?token=secret", "example.org", "not served under that Host"),
        ]:
            status, headers, body = get(server, path, host=f"{host}:{port_of(server)}")
            text = body.decode()
            assert (status, headers["content-type"]) == (403, "text/plain; charset=utf-8")
            assert headers["x-content-type-options"] == "nosniff"
            assert why in text.splitlines()[0]
            for advice in (f"Open {address} itself", "control-room.local", "?token=...", "The page is at"):
                assert advice in text
            assert "secret" not in text
    with served(Feed(INFO, is_live=True)) as server:
        text = get(server, host="example.org")[2].decode()
        assert f"Open http://127.0.0.1:{port_of(server)}/ itself" in text
        assert "token" not in text


def test_addresses_that_cannot_be_had() -> None:
    feed = Feed(INFO, is_live=True)
    with served(feed) as server, pytest.raises(InputError, match="cannot serve a page on"):
        PageServer(feed, "127.0.0.1", port_of(server))
    for host, port in [("no.such.host.invalid", 0), ("127.0.0.1", 70000), ("x" * 80, 0)]:
        with pytest.raises(InputError, match="cannot serve a page on"):
            PageServer(feed, host, port)


def test_missing_packages_are_told_in_one_line() -> None:
    program = (
        "import sys\n"
        "sys.modules['uvicorn'] = None\n"
        "from swarmchase.errors import InputError\n"
        "import swarmchase.live.page.feed\n"
        "try:\n"
        "    import swarmchase.live.page.server\n"
        "except InputError as error:\n"
        "    print(error)\n"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ran.stdout.endswith("pip install 'swarmchase[live]'\n"), ran.stderr


# Browsers that behave badly


def test_too_many_browsers_are_turned_away() -> None:
    feed = Feed(INFO, is_live=True)
    with served(feed) as server:
        clients = [spoken_to(server) for _ in range(MOST_BROWSERS)]
        opened = [client.__enter__() for client in clients]
        for client in opened:
            received(client, "info")
        with spoken_to(server) as late, pytest.raises(ConnectionClosed):
            late.recv(timeout=60)
        for client in clients:
            client.__exit__(None, None, None)


def test_a_flood_does_not_come_through() -> None:
    feed = Feed(INFO, is_live=True)
    with served(feed) as server, spoken_to(server) as client, spoken_to(server) as other:
        for _ in range(3000):
            client.send('{"word": "hold"}')
        other.send('{"word": "abort"}')
        words: list[str] = []
        until(lambda: words.extend(feed.words()) or "abort" in words)
        assert words.count("hold") < 1000


def test_a_browser_that_never_reads_costs_nothing() -> None:
    """What waits for it is a frame or two, however many are published."""
    feed = Feed(INFO, is_live=True)
    frame = made_up_frame(1.0)
    frame["belief_m"] = [[1.5, 2.5, 3.5]] * 100_000
    with served(feed) as server, socket.socket() as deaf:
        port = port_of(server)
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.connect(("127.0.0.1", port))
        headers = {"host": f"127.0.0.1:{port}", "origin": f"http://127.0.0.1:{port}", **_handshake()}
        lines = "".join(f"{name.replace('_', '-')}: {value}\r\n" for name, value in headers.items())
        deaf.sendall(f"GET /socket HTTP/1.1\r\n{lines}\r\n".encode())
        published = 0
        until(lambda: server._browsers == 1)

        def waiting_bytes() -> int:
            nonlocal published
            published += 1
            feed.publish({**frame, "time_s": float(published)})
            connections = list(server._server.server_state.connections)
            return max(one.transport.get_write_buffer_size() for one in connections)

        until(waiting_bytes)  # its network is full
        most_bytes = max(waiting_bytes() for _ in range(30))
        newest = feed.newest()
        assert newest is not None
        assert newest.number == published
        assert most_bytes < 4 * len(newest.text)
        with spoken_to(server) as client:
            assert received(client, "frame")["frame"]["time_s"] == published


@contextmanager
def silent_connections(server: PageServer, sources: Sequence[str], each: int) -> Iterator[list[socket.socket]]:
    """From so many of this machine's loopback addresses; the oldest first."""
    with ExitStack() as opened:
        yield [
            opened.enter_context(
                socket.create_connection(("127.0.0.1", port_of(server)), source_address=(source, 0), timeout=60)
            )
            for _ in range(each)
            for source in sources
        ]


def is_ended(connection: socket.socket) -> bool:
    """Whether it ends, with or without a word; fails where nothing happens for a minute."""
    try:
        while connection.recv(1000):
            pass
    except ConnectionResetError:
        pass
    return True


@pytest.mark.parametrize("sources", [["127.0.0.1"], ["127.0.0.2"], [f"127.0.1.{number}" for number in range(10)]])
def test_silent_connections_keep_nobody_out(sources: list[str]) -> None:
    """Three hundred of them. Who is there stays, who comes is served, and the oldest silent ones have gone."""
    feed = Feed(INFO, is_live=True)
    feed.publish(made_up_frame(1.0))
    with served(feed) as server, spoken_to(server) as client:
        received(client, "frame")
        with silent_connections(server, sources, 300 // len(sources)) as silent:
            assert all(is_ended(connection) for connection in silent[:190])
            assert get(server)[0] == 200
            with spoken_to(server) as newcomer:
                received(newcomer, "frame")
            feed.publish(made_up_frame(2.0))
            assert received(client, "frame")["frame"] == made_up_frame(2.0)


def test_of_one_address_so_many_and_the_others_keep_theirs() -> None:
    with (
        served(Feed(INFO, is_live=True)) as server,
        silent_connections(server, ["127.0.0.2"], 5) as few,
        silent_connections(server, ["127.0.0.3"], MOST_OF_ONE_ADDRESS + 20) as many,
    ):
        assert all(is_ended(connection) for connection in many[:20])
        for connection in (*few, *many[20:]):
            connection.sendall(b"GET / HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n")
            assert connection.recv(12) == b"HTTP/1.1 200"


@pytest.mark.parametrize(
    ("one", "other", "is_same"),
    [
        ("192.0.2.1", "192.0.2.2", False),
        ("2001:db8::1", "2001:db8::ffff:2", True),  # one machine may choose the last 64 bits
        ("2001:db8:0:1::1", "2001:db8:0:2::1", False),
        ("::ffff:192.0.2.1", "::ffff:192.0.2.2", False),  # IPv4 as a socket for both has it
        ("fe80::1%eth0", "fe80::2%eth0", True),
    ],
)
def test_whose_connections_are_counted_together(one: str, other: str, is_same: bool) -> None:
    assert (page_connection.sender_of((one, 1)) == page_connection.sender_of((other, 2))) is is_same


@pytest.mark.parametrize("said", [b"", b"GET / HTTP/1.1\r\nhost: 127", b"\r\n"])
def test_who_asks_for_nothing_is_hung_up_on(said: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_connection, "REQUEST_S", 0.2)
    with served(Feed(INFO, is_live=True)) as server, silent_connections(server, ["127.0.0.1"], 1) as (connection,):
        connection.sendall(said)
        assert is_ended(connection)


def test_who_does_not_read_a_file_is_hung_up_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """It asks for more than the network between them holds, and a WebSocket outlives the same time."""
    monkeypatch.setattr(page_connection, "LONGEST_S", 0.5)
    feed = Feed(INFO, is_live=True)
    with served(feed) as server, spoken_to(server) as client, socket.socket() as deaf:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.connect(("127.0.0.1", port_of(server)))
        deaf.sendall(b"GET /static/vendor/three.core.min.js HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n" * 30)
        connections = server._server.server_state.connections
        until(lambda: any(isinstance(one, PageConnection) for one in connections))
        until(lambda: not any(isinstance(one, PageConnection) for one in connections))
        received(client, "info")
        client.send('{"word": "hold"}')
        assert until(feed.words) == ["hold"]


def test_it_closes_in_any_state() -> None:
    PageServer(Feed(INFO, is_live=True), "127.0.0.1", 0).close()
    server = PageServer(Feed(INFO, is_live=True), "127.0.0.1", 0)
    with socket.create_connection(("127.0.0.1", port_of(server))) as half_open, spoken_to(server) as client:
        half_open.sendall(b"GET / HTTP/1.1\r\n")
        received(client, "info")
        server.close()
        server.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "page"]
    with served(Feed(INFO, is_live=True), port=port_of(server)) as again:
        assert get(again)[0] == 200


# In a real browser

CHROMIUM = shutil.which("chromium")
QUIET = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
SIZES = [(1280, 800), (1920, 1080)]
WITHOUT_WEBGL = """
const before = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind.startsWith("webgl") ? null : before.call(this, kind, ...rest);
};
"""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("there is no chromium (Debian: apt-get install chromium)")
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install -e '.[dev]'"
    )
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield browser
        browser.close()


class Window:
    """A browser's window, and what went wrong in it."""

    def __init__(self, browser: Any, url: str, size: tuple[int, int] = SIZES[0], script: str = "") -> None:
        self.context = browser.new_context(viewport={"width": size[0], "height": size[1]})
        self.page = self.context.new_page()
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda one: self.errors.append(one.text) if one.type == "error" else None)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("websocket", lambda opened: self.requests.append(opened.url))
        if script:
            self.page.add_init_script(script)
        self.page.goto(url)

    def shows(self, selector: str, text: str | re.Pattern[str] = "", **attributes: str) -> None:
        """It is there, or comes soon."""
        from playwright.sync_api import expect

        place = self.page.locator(selector)
        expect(place).to_be_visible(timeout=60_000)
        if text:
            expect(place).to_contain_text(text, timeout=60_000)
        for name, value in attributes.items():
            expect(place).to_have_attribute(name.replace("_", "-"), value, timeout=60_000)

    def text(self, selector: str) -> str:
        return str(self.page.locator(selector).inner_text())

    def data(self, name: str) -> str:
        return str(self.page.evaluate(f"document.body.dataset.{name}"))

    def box(self, selector: str) -> dict[str, float]:
        found: dict[str, float] = self.page.locator(selector).bounding_box()
        return found


@contextmanager
def opened(browser: Any, server: PageServer, **options: Any) -> Iterator[Window]:
    """A window in which nothing may go wrong, and from which no request may leave."""
    window = Window(browser, server.url, **options)
    try:
        yield window
        assert window.errors == []
        own = re.compile(rf"(http|ws)://127\.0\.0\.1:{port_of(server)}/")
        assert [url for url in window.requests if not own.match(url)] == []
    finally:
        window.context.close()


@contextmanager
def live_chase(token: str | None = None, **options: Any) -> Iterator[tuple[PageServer, Publisher]]:
    feed = Feed(INFO, is_live=True)
    with Publisher(feed, **options) as publisher, served(feed, token) as server:
        yield server, publisher


@pytest.mark.parametrize("size", SIZES)
def test_page_shows_the_chase(chromium: Any, size: tuple[int, int]) -> None:
    with live_chase("the token", time_s=9.0) as (server, _), opened(chromium, server, size=size) as window:
        window.shows("#state-name", re.compile("sampling|moving"))
        window.shows("body", data_connection="live", data_stale="false")
        window.shows("#title", "particle · 100 Hz · v0.3.0")
        window.shows('[data-tracker="0"] [data-column="status"]', "ok")
        window.shows('[data-tracker="3"] [data-column="status"]', "silent")
        window.shows('[data-tracker="3"] [data-column="loss"]', "37 %")
        window.shows('[data-trace="3"]', re.compile(r"3 silent \d+\.\d s"))
        window.shows("#alarms", "tracker 3 is silent")
        window.shows("#rejected", "rejected 15: unsigned 3, stale 12")
        window.shows("#latency", re.compile(r"\d\.\d ms"))
        window.shows("#distance", " m")
        assert window.page.locator('.bar[data-chosen="true"]').count() == 4
        assert window.page.locator(".bar").count() == 20
        for name in ("#chase-time", "#movements", '[data-tracker="0"]', "#center"):
            assert_it_changes(window, name)
        assert_it_is_laid_out(window, size)
        assert_it_is_drawn(window)


def assert_it_changes(window: Window, selector: str) -> None:
    before = window.text(selector)
    until(lambda: window.text(selector) != before)


def assert_it_is_laid_out(window: Window, size: tuple[int, int]) -> None:
    """Everything is inside the window, and nothing lies over anything else."""
    scrolls = window.page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
    assert tuple(scrolls) == size
    parts = ["#brand", "#state", "#figures", "#operator", "#scene-panel", "#trackers-panel", "#traces-panel"]
    boxes = [window.box(part) for part in [*parts, "#decision-panel", "#notices-panel", "#timeline"]]
    for index, one in enumerate(boxes):
        assert one["x"] >= 0
        assert one["x"] + one["width"] <= size[0]
        assert one["y"] + one["height"] <= size[1]
        for other in boxes[index + 1 :]:
            beside = one["x"] + one["width"] <= other["x"] or other["x"] + other["width"] <= one["x"]
            above = one["y"] + one["height"] <= other["y"] or other["y"] + other["height"] <= one["y"]
            assert beside or above
    for table, panel in [("#trackers", "#trackers-panel"), ("#decision", "#decision-panel")]:
        inner, outer = window.box(table), window.box(panel)
        assert inner["x"] + inner["width"] <= outer["x"] + outer["width"]
        assert inner["y"] + inner["height"] <= outer["y"] + outer["height"]


def assert_it_is_drawn(window: Window) -> None:
    """The picture and the traces have the trackers' colours in them."""
    assert window.page.locator("#scene-missing").is_hidden()
    picture = Image.open(io.BytesIO(window.page.screenshot())).convert("HSV")
    for part, least_pixels in [("#scene", 20), ("#traces", 100)]:
        box = window.box(part)
        cut = picture.crop((box["x"], box["y"], box["x"] + box["width"], box["y"] + box["height"]))
        hues, saturations, values = np.moveaxis(np.asarray(cut, dtype=np.int64), 2, 0)
        for hue in (143, 24, 112, 182):  # of 255: blue, orange, green, violet
            close = (abs(hues - hue) <= 6) & (saturations > 90) & (values > 110)
            assert close.sum() >= least_pixels, f"{part}: hue {hue}"


def test_the_token_leaves_the_address_bar_and_the_page_goes_on(chromium: Any) -> None:
    with live_chase("the token", time_s=9.0) as (server, publisher):
        assert "?token=the%20token" in server.url
        with opened(chromium, server) as window:
            window.shows("body", data_connection="live")
            assert window.page.url == f"http://127.0.0.1:{port_of(server)}/"
            assert "token" not in window.page.evaluate("document.documentElement.outerHTML + history.state")
            window.page.reload()  # its cookie opens it now
            window.shows("body", data_connection="live")
            window.page.wait_for_timeout(500)
            window.page.locator("#hold").click()
            until(lambda: publisher.heard == ["hold"])


def test_old_data_are_greyed(chromium: Any) -> None:
    feed = Feed(INFO, is_live=True)
    with served(feed) as server, opened(chromium, server) as window:
        window.shows("#banner", "No data yet")
        with Publisher(feed):
            window.shows("body", data_stale="false")
            assert window.page.locator("#banner").is_hidden()
        window.shows("body", data_stale="true", data_connection="stale")
        window.shows("#banner", re.compile(r"No data for 1\.\d s: the service sends nothing"))
        window.shows('[data-tracker="0"]', data_stale="stale")
        window.shows('[data-trace="0"]', "stale")
        assert_it_changes(window, '[data-tracker="0"] [data-column="rssi-age"]')
        window.page.reload()  # what was old stays old
        window.shows("#banner", "No data for")
        with Publisher(feed, time_s=30.0):
            window.shows("body", data_stale="false", data_connection="live")
            window.shows('[data-tracker="0"]', data_stale="")


def test_hold_and_resume(chromium: Any) -> None:
    with live_chase(state="idle") as (server, publisher), opened(chromium, server) as window:
        for label, word, state in [
            ("Start", "start", re.compile("sampling|moving")),
            ("Hold", "hold", "holding"),
            ("Resume", "resume", re.compile("sampling|moving")),
        ]:
            window.shows("#hold", label, data_word=word)
            window.page.wait_for_timeout(500)  # a button that has just changed its meaning takes no click
            window.page.locator("#hold").click()
            window.shows("#state-name", state)
        assert publisher.heard == ["start", "hold", "resume"]
        window.shows("#said", "sent: resume")


def test_a_double_click_does_not_hold_and_resume(chromium: Any) -> None:
    with live_chase() as (server, publisher), opened(chromium, server) as window:
        window.shows("#hold", "Hold")
        window.page.wait_for_timeout(500)
        window.page.locator("#hold").dblclick()
        window.shows("#state-name", "holding")
        window.page.wait_for_timeout(300)
        assert set(publisher.heard) == {"hold"}


@pytest.mark.parametrize(("button", "state"), [("abort", "aborted"), ("reached", "reached")])
def test_the_end_needs_two_clicks(chromium: Any, button: str, state: str) -> None:
    with live_chase() as (server, publisher), opened(chromium, server) as window:
        window.shows(f"#{button}", data_armed="false")
        window.page.locator(f"#{button}:enabled").dblclick()
        window.shows(f"#{button}", f"Confirm {button}", data_armed="true")
        assert publisher.heard == []
        window.page.wait_for_timeout(500)
        window.page.locator(f"#{button}").focus()
        window.page.keyboard.press("Enter")
        window.shows("#state-name", state)
        assert publisher.heard == [button]
        assert window.page.locator(f"#{button}").is_disabled()


def test_an_abort_that_is_not_confirmed_is_forgotten(chromium: Any) -> None:
    with live_chase() as (server, publisher), opened(chromium, server) as window:
        window.page.locator("#abort:enabled").click()
        window.shows("#abort", "Confirm abort", data_armed="true")
        window.shows("#abort", "Abort", data_armed="false")
        assert publisher.heard == []


def test_live_chase_is_looked_back_at(chromium: Any) -> None:
    feed = Feed(INFO, is_live=True)
    for tenth in range(300):
        feed.publish(made_up_frame(tenth / 10))
    with Publisher(feed, time_s=30.0), served(feed) as server, opened(chromium, server) as window:
        window.shows("#live", aria_pressed="true")
        window.page.locator("#slider").press("Home")
        window.shows("body", data_past="true", data_time_s="0")
        window.shows("#shown-time", "PAST")
        window.shows("#decision-number", "none yet")
        assert_it_changes(window, "#chase-time")  # the state beside the buttons stays the live one
        assert window.data("timeS") == "0"
        window.page.locator("#slider").fill("15")
        window.shows("#decision-number", "movement 10")
        window.page.locator("#live").click()
        window.shows("body", data_past="false")
        window.shows("#decision-number", re.compile("movement 2"))


def test_replay(chromium: Any) -> None:
    feed = Feed({**INFO, "title": "a recorded chase"}, is_live=False)
    for tenth in range(301):
        feed.publish(made_up_frame(tenth / 10))
    with served(feed) as server, opened(chromium, server) as window:
        window.shows("body", data_connection="replay", data_stale="false")
        window.shows("#title", "a recorded chase")
        for absent in ("#hold", "#abort", "#reached", "#live", "#banner"):
            assert window.page.locator(absent).is_hidden()
        window.shows("#play", "Pause")
        until(lambda: 0.3 < float(window.data("timeS")) < 10)
        window.page.locator("#play").click()
        window.shows("#play", "Play")
        window.page.locator("#slider").fill("15")
        window.shows("body", data_time_s="15")
        window.shows("#shown-time", "0:15.0 of 0:30.0")
        window.shows("#movements", "10")
        window.page.locator("#rate").select_option("16")
        window.page.locator("#play").click()
        window.shows("body", data_time_s="30")
        window.shows("#play", "Play")
        assert feed.words() == []


def test_page_goes_on_when_the_service_comes_back(chromium: Any) -> None:
    first, second = Feed(INFO, is_live=True), Feed({**INFO, "controller": "gradient"}, is_live=True)
    publisher = Publisher(first, epoch=1, time_s=20.0)
    server = PageServer(first, "127.0.0.1", 0)
    window = Window(chromium, server.url)
    try:
        window.shows("body", data_epoch="1", data_connection="live")
        window.page.locator("#slider").press("Home")
        window.shows("body", data_past="true")
        server.close()
        publisher.stop()
        window.shows("body", data_connection="none", data_stale="true")
        window.shows("#banner", "not connected")
        assert window.page.locator("#hold").is_disabled()
        publisher = Publisher(second, epoch=2)
        server = PageServer(second, "127.0.0.1", port_of(server))
        window.shows("body", data_epoch="2", data_connection="live", data_stale="false", data_past="false")
        window.shows("#title", "gradient")
        window.page.locator("#hold:enabled").click()
        until(lambda: publisher.heard == ["hold"])
        assert [error for error in window.errors if "WebSocket connection" not in error] == []
    finally:
        window.context.close()
        server.close()
        publisher.stop()


def test_without_webgl_the_rest_is_there(chromium: Any) -> None:
    with live_chase() as (server, _):
        window = Window(chromium, server.url, script=WITHOUT_WEBGL)
        window.shows("#scene-missing", "no WebGL")
        window.shows("body", data_connection="live")
        assert_it_changes(window, "#chase-time")
        window.context.close()


def test_what_is_not_known_is_left_out(chromium: Any) -> None:
    """The first frame of a service that has heard nobody, and a controller that explains nothing."""
    feed = Feed({**INFO, "fence_m": None}, is_live=True)
    frame = made_up_frame(3.0)
    for tracker in frame["trackers"]:
        tracker.update(position_m=None, set_point_m=None, mode=None, position_age_s=None, rssi_age_s=None)
        tracker.update(is_lost=True, is_silent=True, loss_share=None, rssi_dbm=[])
    assert frame["decision"] is not None
    frame["decision"].update(choice_share=None, changed="clipped at the fence")
    frame.update(center_m=None, spacing_m=None, path_m=[], belief_m=None, target_m=None, decision_latency_ms=None)
    frame.update(rejected={}, alarms=[])
    with served(feed) as server, opened(chromium, server) as window:
        feed.publish(frame)
        window.shows("#decision-note", "this controller gives none")
        window.shows("#decision-note", "clipped at the fence")
        window.shows('[data-tracker="5"] [data-column="status"]', "lost")
        window.shows("#alarms", "no alarms")
        window.shows("#rejected", "rejected 0")
        for absent in ("#key-belief", "#key-target", "#key-fence", "#distance-figure"):
            assert window.page.locator(absent).is_hidden()
        text = window.text("body")
        assert not re.search("NaN|undefined|null|Infinity", text)
