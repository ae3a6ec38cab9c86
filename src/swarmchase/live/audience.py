"""Who follows a live chase: a page, a log, a terminal, maps, brokers. They never hold up what flies."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from .address import host_and_port
from .alarms import Alarm, Alarms
from .chronicle import Chronicle, FrameTaker
from .earth import EarthOrigin
from .events import Event, Events, EventTaker
from .link.mavlink import ControllerMavlinkLink
from .link.messages import Metres
from .link.news import LinkNews
from .log.entries import LogHead
from .outputs.kind import OutputDetails
from .service.chase_state import Decision, Transition
from .service.loop import Journal, Tell, Watcher, Words
from .service.service import Recorder

EntryTaker = Callable[[Transition | Decision | Event], None]
"""Of a log."""


@dataclass(frozen=True)
class AudienceOptions:
    """What is to be shown and kept; None is not."""

    page: str | None = None
    """HOST:PORT of the page."""
    log: Path | None = None
    """A new MCAP file."""
    outputs: tuple[str, ...] = ()
    """Where else: ``outputs.address``."""
    output_details: OutputDetails = field(default_factory=OutputDetails)

    @property
    def origin(self) -> EarthOrigin | None:
        """Where on the earth x, y, z are 0."""
        return self.output_details.origin


class Audience:
    """Of one chase, from construction to ``close``.

    Args:
        head: what page and log say of the chase.
        tell: prints a line.
        target_m: where the target is, if somebody knows.

    Raises:
        InputError: the page's address cannot be had, the log exists or cannot be written, an output is refused, or a
            package is missing.
    """

    def __init__(
        self,
        options: AudienceOptions,
        head: LogHead,
        link: ControllerMavlinkLink,
        tell: Tell,
        target_m: Callable[[], Metres | None] = lambda: None,
    ) -> None:
        self.words: list[Words] = []
        """Where people at the page speak."""
        self._closers: list[Callable[[], None]] = []
        self._alarms: list[Callable[[], list[Alarm]]] = []
        self._page: _Page | None = None
        takers: list[FrameTaker] = []
        event_takers: list[EventTaker] = [lambda event: tell(_line(event, head.began_ns))]
        recorders: list[Recorder] = []
        places: list[str] = []
        """Where the chase is shown and kept: told once all of them can be had."""
        try:
            # In this order: where an output is refused, or the page cannot be had, no log is begun.
            for name in options.outputs:
                takers.append(self._open_output(name, options.output_details, head, places.append))
            if options.page is not None:
                takers.append(self._open_page(options.page, head, places.append))
            if options.log is not None:
                take_frame, take_entry = self._open_log(options.log, head, places.append)
                takers.append(take_frame)
                event_takers.append(take_entry)
                recorders.append(take_entry)
        except Exception:
            self.close()
            raise
        for line in places:
            tell(line)
        events = Events(Alarms(link, self._all_alarms), event_takers, LinkNews(link).lines)
        self.journal = Journal([*recorders, events.record])
        """The service's recorder."""
        chronicle = Chronicle(link, head.began_ns, takers, events, target_m)
        self.watchers: list[Watcher] = [events, *([chronicle] if takers else [])]
        """Want to see the service after every step."""

    def show_recording(self) -> None:
        """The chase has ended: the page, at the same address, looks back at it."""
        if self._page is not None:
            self._page.look_back()

    def close(self) -> None:
        """End the page and the outputs, and write the rest of the log."""
        while self._closers:
            self._closers.pop()()

    def _open_log(self, path: Path, head: LogHead, tell: Tell) -> tuple[FrameTaker, EntryTaker]:
        from .log.recorder import ChaseRecorder

        recorder = ChaseRecorder(path, head)
        self._closers.append(recorder.close)
        self._alarms.append(lambda: recorder.alarms)
        tell(f"The log is {path}.")
        return recorder.record_frame, recorder.record

    def _open_page(self, address: str, head: LogHead, tell: Tell) -> FrameTaker:
        self._page = _Page(address, head)
        self._closers.append(self._page.close)
        self.words.append(self._page.feed.words)
        tell(f"The page is at {self._page.url}")
        return self._page.feed.publish

    def _open_output(self, name: str, details: OutputDetails, head: LogHead, tell: Tell) -> FrameTaker:
        from .outputs.address import open_output
        from .outputs.publisher import Publisher

        publisher = Publisher(name, open_output(name, details), head)
        self._closers.append(publisher.close)
        self._alarms.append(lambda: publisher.alarms)
        where = "" if details.origin is not None else "; without --global-origin it says no place on the earth"
        tell(f"The chase is shown at {name}{where}.")
        return publisher.take

    def _all_alarms(self) -> list[Alarm]:
        return [alarm for alarms in self._alarms for alarm in alarms()]


def _line(event: Event, began_ns: int) -> str:
    """As a terminal shows it."""
    return f"{(event.time_ns - began_ns) / 1e9:7.1f} s  {event.text}"


class _Page:
    """A page's server and what it shows.

    Raises:
        InputError: the address cannot be had, or a package is missing.
    """

    def __init__(self, address: str, head: LogHead) -> None:
        from .page.feed import Feed
        from .page.info import page_info
        from .page.server import PageServer
        from .page.token import new_token

        self._host, port = host_and_port(address, "--page")
        self._token = new_token(self._host)
        self.feed = Feed(page_info(head), is_live=True)
        self._server = PageServer(self.feed, self._host, port, self._token)

    @property
    def url(self) -> str:
        return self._server.url

    def look_back(self) -> None:
        """Browsers find the new server by themselves, and it tells them that the chase is a recording."""
        from .page.server import PageServer

        port = self._server.port
        self._server.close()
        self.feed.is_live = False
        self._server = PageServer(self.feed, self._host, port, self._token)

    def close(self) -> None:
        self._server.close()
