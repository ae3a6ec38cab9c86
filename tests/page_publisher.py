"""A live chase behind a page: the real service, on a made clock that goes with the wall's, obeys what the page says."""

import threading
from typing import Any, Self

from page_frames import ShownChase, head_for
from swarmchase.live.page.feed import Feed
from swarmchase.live.page.info import page_info
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.simulation.virtual_chase import TICK_S


class LiveChase:
    """Flies from a thread of its own until it is stopped, ``rate`` times as fast as the wall's clock."""

    def __init__(
        self,
        ahead_s: float = 0.0,
        rate: float = 2.0,
        controller: str = "particle",
        limits: SafetyLimits | None = None,
        **options: Any,
    ) -> None:
        """Args: ahead_s: so much has passed already."""
        limits = limits or SafetyLimits()
        self.heard: list[str] = []
        self.feed = Feed(page_info(head_for(controller, limits)), is_live=True)
        self.shown = ShownChase(self.feed.publish, controller, limits=limits, **options)
        self._pause_s = TICK_S / rate
        while self.shown.seconds() < ahead_s:
            self.shown.chase.tick()
        self._stops = threading.Event()
        self._thread = threading.Thread(target=self._run, name="chase", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        self._stops.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stops.wait(self._pause_s):
            for word in self.feed.words():
                self.heard.append(word)
                self.shown.say(word)
            self.shown.chase.tick()
