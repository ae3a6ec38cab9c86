"""One live chase from its head to its end: audience, controller service and loop, put together in one place for real
trackers and simulated ones.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..batch.freed_memory import keep_freed_memory
from ..controllers.protocol import Controller
from ..processes.stop_request import StopRequest
from ..scenario import Scenario
from .audience import Audience, AudienceOptions
from .clock import MonotonicClock
from .link.mavlink import ControllerMavlinkLink
from .link.messages import Metres
from .log.entries import new_head
from .service.loop import ServeLoop, ServeSummary, Tell, Watcher, Words
from .service.safety import SafetyLimits
from .service.service import ControllerService
from .service.settings import ServiceSettings


@dataclass(frozen=True)
class Assignment:
    """What is to be chased, how, and who follows it."""

    scenario: Scenario
    controller: str
    """As given to ``load_controller``: a name or a path."""
    seed: int
    chase: int
    limits: SafetyLimits
    settings: ServiceSettings
    audience: AudienceOptions


class Session:
    """An assignment's page and log are open from construction to ``close``; ``run`` is the chase.

    Args:
        controller: ready to decide.
        epoch: larger than that of any controller that has spoken to these trackers before.
        tell: prints a line.
        target_m: where the target is, if somebody knows.

    Raises:
        InputError: the page's or the log's place cannot be had, an output is refused, or a package is missing.
    """

    def __init__(
        self,
        assignment: Assignment,
        controller: Controller,
        link: ControllerMavlinkLink,
        epoch: int,
        tell: Tell,
        target_m: Callable[[], Metres | None] = lambda: None,
    ) -> None:
        self._assignment, self._controller, self._link = assignment, controller, link
        self._epoch, self._tell, self._clock = epoch, tell, MonotonicClock()
        head = new_head(
            assignment.controller,
            assignment.scenario,
            assignment.seed,
            assignment.chase,
            epoch,
            assignment.limits,
            self._clock.now_ns(),
            assignment.audience.origin,
        )
        self._audience = Audience(assignment.audience, head, link, tell, target_m)

    def run(
        self,
        words: Sequence[Words],
        request: StopRequest,
        *,
        starts: bool,
        overrides: bool = False,
        stay: bool = False,
        watchers: Sequence[Watcher] = (),
    ) -> ServeSummary:
        """Chase until it has ended.

        Args:
            words: where the operator speaks, beside the page.
            starts: begin at once; otherwise the word start begins.
            overrides: begin although the preflight has not passed.
            stay: see ``ServeLoop``.
            watchers: see the service after every step, before the audience does.
        """
        keep_freed_memory()  # a decision would wait for its pages again and again
        assignment, audience = self._assignment, self._audience
        service = ControllerService(
            assignment.scenario,
            self._controller,
            self._link,
            self._clock,
            assignment.limits,
            audience.journal,
            self._epoch,
            assignment.seed,
            assignment.chase,
            assignment.settings,
        )
        if starts:
            service.start()
        if overrides:
            service.override()
        all_words, all_watchers = [*words, *audience.words], [*watchers, *audience.watchers]
        loop = ServeLoop(service, self._link, audience.journal, all_words, request, self._tell, all_watchers, stay)
        self._link.forget_waiting()
        return loop.run()

    def show_recording(self) -> None:
        """The chase has ended: the page, at the same address, looks back at it."""
        self._audience.show_recording()

    def close(self) -> None:
        """End the page and the outputs, and write the rest of the log."""
        self._audience.close()
