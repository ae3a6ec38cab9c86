"""A stand-in for the controller service: publishes made-up frames and obeys what the page says."""

import threading
from typing import Self

from page_frames import made_up_frame
from swarmchase.live.page.feed import Feed

PACE_S = 0.05


class Publisher:
    """Publishes from a thread of its own until it is stopped."""

    def __init__(self, feed: Feed, epoch: int = 1, time_s: float = 0.0, state: str = "") -> None:
        self.heard: list[str] = []
        self._feed, self._epoch, self._time_s = feed, epoch, time_s
        self._state = state
        self._reason = ""
        self._stops = threading.Event()
        self._thread = threading.Thread(target=self._run, name="publisher", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        self._stops.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stops.wait(PACE_S):
            for word in self._feed.words():
                self._obey(word)
            self._time_s += PACE_S
            self._feed.publish(made_up_frame(self._time_s, self._epoch, self._state, self._reason))

    def _obey(self, word: str) -> None:
        self.heard.append(word)
        self._state, self._reason = {
            "hold": ("holding", "the operator holds"),
            "abort": ("aborted", "the operator aborts"),
            "reached": ("reached", "the operator says so"),
        }.get(word, ("", ""))
