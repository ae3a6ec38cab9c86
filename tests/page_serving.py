"""A page's server for a test."""

import re
import threading
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


def until(condition: Callable[[], Any]) -> Any:
    """What the condition gives, as soon as it is true."""
    pause = threading.Event()
    for _ in range(1000):
        if found := condition():
            return found
        pause.wait(0.01)
    raise AssertionError("it does not happen")
