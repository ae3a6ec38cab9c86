"""A page's server for a test."""

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from swarmchase.live.page.feed import Feed
from swarmchase.live.page.server import PageServer


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


def until(condition: Callable[[], Any], patience_s: float = 10.0) -> Any:
    """What the condition gives, as soon as it is true."""
    pause = threading.Event()
    deadline_s = time.monotonic() + patience_s
    while time.monotonic() < deadline_s:
        if found := condition():
            return found
        pause.wait(0.01)
    raise AssertionError("it does not happen")
