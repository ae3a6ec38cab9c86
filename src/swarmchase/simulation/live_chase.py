"""``swarmchase live``: one simulated chase in real processes, over real sockets, in real time.

This process holds the controller service, its page and its log, the very ones that ``swarmchase serve`` has; the stage,
a process of its own, plays everything else.
"""

import contextlib
import multiprocessing
import signal
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

from ..controllers.protocol import Controller
from ..errors import WorkerDiedError
from ..live.address import LOOPBACK
from ..live.link.keys import new_keys, write_keys
from ..live.link.mavlink import ControllerMavlinkLink
from ..live.link.messages import Metres
from ..live.link.state_file import CONTROLLER_FILE
from ..live.service.chase_state import IN_FLIGHT, ChaseState, Snapshot
from ..live.service.loop import ServeSummary, Tell, Words
from ..live.service.state_folder import next_epoch
from ..live.session import Assignment, Session
from ..processes.children import start_helper, starting_children
from ..processes.stop_request import StopRequest
from ..processes.temporary_folder import temporary_folder
from .fault_plan import FaultPlan
from .stage import READY_S, Announcement, Failure, Play, Ready, ToldToStop, Truth, run_stage

END_S = 15.0
"""So long the stage may take to end six processes."""


@dataclass(frozen=True)
class LiveSummary(ServeSummary):
    """How it ended, as the service tells it, and what only a simulation knows."""

    reached: bool
    """The service says so, and the centre is within the success radius, or of a target that flies was so in the last
    second."""
    distance_m: float
    """From the centre to the target at the end."""
    movements_to_target: int | None
    """When the centre first was within the success radius; None where it never was."""
    capture_s: float | None
    """The same in seconds since a target that flies began to; None where it never was, or stands."""
    true_following_share: float | None
    """Of the time since then, in which the centre truly was as near as one that follows; None before, and where the
    swarm is not told to follow."""


class StageProcess:
    """This side of the stage's process.

    Args:
        request: is made where a process of the site is told to stop.

    Raises:
        WorkerDiedError: it could not begin, or has ended by itself.
    """

    def __init__(self, play: Play, request: StopRequest) -> None:
        self._request = request
        start_helper()
        context = multiprocessing.get_context("spawn")
        self._connection, other_end = context.Pipe()
        self._process = context.Process(target=run_stage, args=(play, other_end), name="stage")
        with starting_children():
            self._process.start()
        other_end.close()
        self.truth: Truth | None = None
        self._is_ready = False
        self._announced: tuple[int | None, float | None, float] | None = None

    def wait(self) -> None:
        """Until all trackers are there, or the request is made."""
        deadline_s = time.monotonic() + 2 * READY_S
        while not (self._is_ready and self.truth) and not self._request.made:
            self._hear(0.1)
            if time.monotonic() > deadline_s:
                raise WorkerDiedError(f"the simulated site was not ready after {2 * READY_S:g} s")

    def watch(self, snapshot: Snapshot, decision_latency_s: float | None) -> None:
        """Hear what it says, and tell it where the service's window begins."""
        self._hear(0.0)
        since_ns, center_m, spacing_m = snapshot.window_since_ns, snapshot.center_m, snapshot.spacing_m
        told = since_ns, spacing_m, snapshot.turned_rad
        if told != self._announced and since_ns is not None and center_m is not None and spacing_m is not None:
            self._announced = told
            with self._telling_its_death():
                self._connection.send(Announcement(since_ns, center_m, spacing_m, snapshot.turned_rad))

    def close(self) -> None:
        """End it and all of its processes."""
        self._connection.close()
        self._process.join(END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()

    def _hear(self, wait_s: float) -> None:
        with self._telling_its_death():
            while self._connection.poll(wait_s):
                wait_s = 0.0
                message = self._connection.recv()
                if isinstance(message, Failure):
                    raise WorkerDiedError(f"the simulated site has ended: {message.reason}")
                if isinstance(message, Truth):
                    self.truth = message
                if isinstance(message, ToldToStop):
                    self._request.note(signal.SIGTERM)
                self._is_ready |= isinstance(message, Ready)

    @contextlib.contextmanager
    def _telling_its_death(self) -> Iterator[None]:
        try:
            yield
        except (EOFError, OSError):  # not all of a message, or nobody to send one to
            self._process.join(END_S)
            raise WorkerDiedError(
                f"the simulated site has died with exit code {self._process.exitcode} (a negative one is the signal "
                "that killed it)"
            ) from None


class _Progress:
    """Notes when the target was reached first, whoever knows of it."""

    def __init__(self, stage: StageProcess) -> None:
        self._stage = stage
        self.movements_to_target: int | None = None
        self.is_said_rightly: bool | None = None
        """Whether it was reached when the service said so; None where it has not. A target that flies soon is not."""

    def __call__(self, snapshot: Snapshot, decision_latency_s: float | None) -> None:
        truth = self._stage.truth
        listens = snapshot.state is ChaseState.SAMPLING or snapshot.state in IN_FLIGHT
        if self.movements_to_target is None and listens and truth is not None:
            self.movements_to_target = snapshot.movements if truth.is_reached else None
        says_so = snapshot.state in {ChaseState.REACHED, ChaseState.FOLLOWING}
        if not says_so and snapshot.following is None:
            self.is_said_rightly = None
        elif says_so and self.is_said_rightly is None and truth is not None:
            self.is_said_rightly = truth.is_reached


def run_live_chase(
    assignment: Assignment,
    plan: FaultPlan,
    controller: Controller,
    words: Sequence[Words],
    request: StopRequest,
    tell: Tell,
    linger: bool,
) -> LiveSummary:
    """Chase until it has ended.

    Args:
        plan: what goes wrong.
        controller: ready to decide.
        linger: go on showing the page after the end, until the request is made.

    Raises:
        InputError: the page's or the log's place cannot be had.
        WorkerDiedError: a process of the simulated site has died.
    """
    scenario, seed, chase = assignment.scenario, assignment.seed, assignment.chase
    with temporary_folder("swarmchase-live-") as folder:
        keys = new_keys()
        for tracker, key in keys.items():
            write_keys(folder / f"tracker-{tracker}.keys", {tracker: key})
        epoch = next_epoch(folder / "controller.epoch")
        link = ControllerMavlinkLink(LOOPBACK, 0, keys, state_path=folder / CONTROLLER_FILE)
        stage: StageProcess | None = None
        session: Session | None = None
        try:
            session = Session(assignment, controller, link, epoch, tell, lambda: _target_m(stage))
            stage = StageProcess(Play(scenario, seed, chase, plan, link.address[1], folder), request)
            tell("Six trackers are starting.")
            stage.wait()
            progress = _Progress(stage)
            summary = session.run(
                words,
                request,
                starts=not request.made,
                overrides=plan != FaultPlan(),  # whoever has ordered faults wants to see them
                watchers=[stage.watch, progress],
            )
            told = _summary(summary, stage.truth, progress, assignment.settings.follow)
            stage.close()
            stage = None
            if linger and not request.made:
                session.show_recording()
                tell("The page looks back at the chase until Ctrl-C.")
                while not request.made:
                    time.sleep(0.1)
            return told
        finally:
            if session is not None:
                session.close()
            if stage is not None:
                stage.close()
            link.close()


def _target_m(stage: StageProcess | None) -> Metres | None:
    return None if stage is None or stage.truth is None else stage.truth.target_m


def _summary(summary: ServeSummary, truth: Truth | None, progress: _Progress, follows: bool) -> LiveSummary:
    return LiveSummary(
        **asdict(summary),
        reached=bool(progress.is_said_rightly),
        distance_m=float("inf") if truth is None else round(truth.distance_m, 3),
        movements_to_target=progress.movements_to_target,
        capture_s=None if truth is None or truth.capture_s is None else round(truth.capture_s, 3),
        true_following_share=None
        if truth is None or truth.following_share is None or not follows
        else round(truth.following_share, 4),
    )
