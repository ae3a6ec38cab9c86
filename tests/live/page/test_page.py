"""The live system's page: what it keeps, and who may speak through it. ``test_in_browser`` looks at it."""

import base64
import http.client
import json
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from importlib.resources import files
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from page_frames import frame_at, head_for
from page_serving import port_of, served, until
from swarmchase.errors import InputError
from swarmchase.live.page import connection as page_connection
from swarmchase.live.page.connection import MOST_OF_ONE_ADDRESS, PageConnection
from swarmchase.live.page.feed import MOST_WORDS, WORDS, Feed
from swarmchase.live.page.history import History, pack, unpack
from swarmchase.live.page.info import page_info
from swarmchase.live.page.server import MOST_BROWSERS, PageServer
from swarmchase.live.service.safety import SafetyLimits

INFO = page_info(head_for("particle", SafetyLimits()))

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
        feed.publish(frame_at(time_s))
    newest = feed.newest()
    assert newest is not None
    assert (newest.number, newest.first_s, newest.last_s) == (3, 0.5, 2.5)
    assert json.loads(newest.text) == frame_at(2.5)
    assert feed.newest(newest.number) is None
    past = feed.past(1.4)
    assert past is not None
    assert json.loads(past) == frame_at(1.5)


def test_a_number_that_is_none_becomes_null() -> None:
    feed = Feed(INFO, is_live=True)
    frame = frame_at(1.0)
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


def test_the_buttons_say_words_of_the_loop() -> None:
    folder = files("swarmchase.live.page") / "static"
    script = (folder / "operator.js").read_text()
    labels = re.findall(r"(\w+): \"", re.findall(r"LABELS = {(.*)}", script)[0])
    said = {*labels, *re.findall(r"this\.tell\(\"(\w+)\"\)", script)}
    said |= set(re.findall(r"const WORD = \"(\w+)\"", (folder / "preflight.js").read_text()))
    assert said == set(WORDS) - {"quit"}


# Who may see it and speak


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
    feed.publish(frame_at(1.0))
    feed.publish(frame_at(2.0))
    with served(feed) as server, spoken_to(server) as client:
        assert json.loads(client.recv(timeout=60)) == {"kind": "info", **INFO, "is_live": True}
        message = received(client, "frame")
        assert message["frame"] == frame_at(2.0)
        assert (message["first_s"], message["last_s"]) == (1.0, 2.0)
        feed.publish(frame_at(3.0))
        assert received(client, "frame")["frame"]["time_s"] == 3.0
        client.send('{"seek": 1}')
        assert received(client, "past") == {"kind": "past", "frame": frame_at(1.0)}


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
    feed.publish(frame_at(1.0))
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
    with (
        served(feed) as server,
        pytest.raises(InputError, match=r"cannot serve a page on 127.0.0.1:\d+: Address already"),
    ):
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
    frame = frame_at(1.0)
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
    feed.publish(frame_at(1.0))
    with served(feed) as server, spoken_to(server) as client:
        received(client, "frame")
        with silent_connections(server, sources, 300 // len(sources)) as silent:
            assert all(is_ended(connection) for connection in silent[:190])
            assert get(server)[0] == 200
            with spoken_to(server) as newcomer:
                received(newcomer, "frame")
            feed.publish(frame_at(2.0))
            assert received(client, "frame")["frame"] == frame_at(2.0)


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
