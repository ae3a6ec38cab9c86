"""What is to go wrong in a simulated live chase, as a person writes it: ``loss=0.15,silent=2@10-20,restart=4@30``.

Shares are of the datagrams of each direction of each tracker's link; seconds count from the start of the chase.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

from ..errors import InputError
from ..scenario import NUM_TRACKERS
from .faulty_path import Faults

HELP = (
    "loss=SHARE, burst=SHARE (in bursts of ten), delay=SECONDS, jitter=SECONDS, duplicate=SHARE, reorder=SHARE, "
    "replay=SHARE, outage=START-END, forge=PER_SECOND (forged datagrams), mute, lands=START-END (a target in flight), "
    "second=METRES (another transmitter, that far east of its start), and for one tracker 0 to 5: silent, stuck, "
    "garbage, wrong, deaf, loud, delayed, intermittent=TRACKER@START[-END] (its receiver), offset, origin, stays, "
    "fence=TRACKER@START[-END] (its vehicle), slow, frozen=TRACKER@START[-END] (its process), kill, "
    "restart=TRACKER@START"
)


class ReceiverFault(StrEnum):
    """What a receiver does; PX4's failure injection has the same words."""

    SILENT = "silent"
    """Reports nothing."""
    STUCK = "stuck"
    """Repeats its last level."""
    GARBAGE = "garbage"
    """Reports, for every second sample, an error value or another number that is no level of the target."""
    WRONG = "wrong"
    """Adds 20 dB."""
    DEAF = "deaf"
    """Reports -200 dBm."""
    LOUD = "loud"
    """Reports 20 dBm."""
    DELAYED = "delayed"
    """Reports half a second late."""
    INTERMITTENT = "intermittent"
    """Is silent every second half second."""


class VehicleFault(StrEnum):
    """What a vehicle does, or says."""

    OFFSET = "offset"
    """Says that it is 29.9 m further east than it is; it flies where it is told."""
    ORIGIN = "origin"
    """Has another origin: it says that it is 1 km further east than it is, and flies by the same frame."""
    STAYS = "stays"
    """Follows no command."""
    FENCE = "fence"
    """Drops commands to places more than 30 m from the origin on any axis: it flies where it was told last."""


class TargetFault(StrEnum):
    """What a target in flight does instead of what its behaviour says."""

    MUTE = "mute"
    """Transmits nothing."""
    LANDS = "lands"
    """Sinks to the lowest altitude at which it flies, and stays there."""


@dataclass(frozen=True)
class TargetSpell:
    """A fault of the target, from ``start_s`` to ``end_s``."""

    fault: TargetFault
    start_s: float
    end_s: float


class ProcessFault(StrEnum):
    """What happens to a tracker's process."""

    SLOW = "slow"
    """It gets a tenth of the time."""
    FROZEN = "frozen"
    """It stands still."""
    KILL = "kill"
    """It is killed, for good."""
    RESTART = "restart"
    """It is killed, and started again two seconds later."""


RESTART_AFTER_S = 2.0


@dataclass(frozen=True)
class TrackerFault:
    """Of one tracker, from ``start_s`` to ``end_s``."""

    fault: ReceiverFault | VehicleFault | ProcessFault
    tracker: int
    start_s: float
    end_s: float = math.inf

    def is_at_work(self, chase_s: float) -> bool:
        """Whether it is, so many seconds into the chase."""
        return self.start_s <= chase_s < self.end_s


@dataclass(frozen=True)
class FaultPlan:
    """All that is to go wrong in one chase. The default is nothing."""

    link: Faults = field(default_factory=Faults)
    forged_hz: float = 0.0
    """Datagrams a second that somebody sends to the controller in the trackers' names."""
    trackers: tuple[TrackerFault, ...] = ()
    target: tuple[TargetSpell, ...] = ()
    second_m: float | None = None
    """So far east of the target's start another transmitter stands, as strong and at the same frequency: receivers
    hear both at once. Where the target is mute, or its only silence has come, this one goes on. None: there is none."""

    def of_target(self, chase_s: float) -> frozenset[TargetFault]:
        """What the target does at this moment."""
        return frozenset(one.fault for one in self.target if one.start_s <= chase_s < one.end_s)

    def of_receiver(self, tracker: int, chase_s: float) -> ReceiverFault | None:
        """What is wrong with this receiver at this moment; the last one named where there are several."""
        receivers = [one for one in self._at_work(tracker, chase_s) if isinstance(one, ReceiverFault)]
        return receivers[-1] if receivers else None

    def of_vehicle(self, tracker: int, chase_s: float) -> VehicleFault | None:
        """What is wrong with this vehicle at this moment; the last one named where there are several."""
        vehicles = [one for one in self._at_work(tracker, chase_s) if isinstance(one, VehicleFault)]
        return vehicles[-1] if vehicles else None

    def _at_work(self, tracker: int, chase_s: float) -> list[ReceiverFault | VehicleFault | ProcessFault]:
        return [fault.fault for fault in self.trackers if fault.tracker == tracker and fault.is_at_work(chase_s)]

    def of_process(self, tracker: int, chase_s: float) -> list[TrackerFault]:
        """What is wrong with this tracker's process at this moment."""
        return [
            fault
            for fault in self.trackers
            if isinstance(fault.fault, ProcessFault) and fault.tracker == tracker and fault.is_at_work(chase_s)
        ]

    def is_dead(self, tracker: int, chase_s: float) -> bool:
        """Whether this tracker has no process at this moment."""
        return any(
            fault.fault is ProcessFault.KILL
            or (fault.fault is ProcessFault.RESTART and chase_s < fault.start_s + RESTART_AFTER_S)
            for fault in self.of_process(tracker, chase_s)
        )


def fault_plan(text: str) -> FaultPlan:
    """The plan of ``HELP``'s words, divided by commas; an empty text is no fault.

    Raises:
        InputError: another word, or a value that cannot be.
    """
    plan = FaultPlan()
    for item in filter(None, (part.strip() for part in text.split(","))):
        word, equals, value = item.partition("=")
        if not equals or word not in _WORDS:
            raise InputError(f"fault {item!r} is refused: there are {HELP}")
        try:
            plan = _WORDS[word](plan, value)
        except InputError as error:
            raise InputError(f"fault {item!r} is refused: {error}") from error
        except ValueError:
            raise InputError(f"fault {item!r} is refused: there are {HELP}") from None
    return plan


def _of_link(name: str) -> Callable[[FaultPlan, str], FaultPlan]:
    def change(plan: FaultPlan, value: str) -> FaultPlan:
        values: dict[str, Any] = {name: float(value)}
        return replace(plan, link=replace(plan.link, **values))

    return change


def _delay(plan: FaultPlan, value: str) -> FaultPlan:
    # Both words in either order: what is checked is the pair.
    delay_s = float(value)
    delay_s = max(delay_s, plan.link.jitter_s) if delay_s >= 0 else delay_s
    return replace(plan, link=replace(plan.link, delay_s=delay_s))


def _jitter(plan: FaultPlan, value: str) -> FaultPlan:
    jitter_s = float(value)
    return replace(plan, link=replace(plan.link, delay_s=max(jitter_s, plan.link.delay_s), jitter_s=jitter_s))


def _outage(plan: FaultPlan, value: str) -> FaultPlan:
    start, dash, end = value.partition("-")
    if not dash:
        raise ValueError(value)
    return replace(plan, link=replace(plan.link, outages_s=(*plan.link.outages_s, (float(start), float(end)))))


def _of_target(fault: TargetFault) -> Callable[[FaultPlan, str], FaultPlan]:
    def change(plan: FaultPlan, value: str) -> FaultPlan:
        start, dash, end = value.partition("-")
        if not dash or not 0 <= float(start) < float(end):
            raise ValueError(value)
        return replace(plan, target=(*plan.target, TargetSpell(fault, float(start), float(end))))

    return change


def _second(plan: FaultPlan, value: str) -> FaultPlan:
    second_m = float(value)
    if not 0 < second_m < math.inf:
        raise InputError(f"second = {value} is refused: allowed is greater than 0")
    return replace(plan, second_m=second_m)


def _forge(plan: FaultPlan, value: str) -> FaultPlan:
    forged_hz = float(value)
    if not 0 <= forged_hz <= MOST_FORGED_HZ:
        raise InputError(f"forge = {value} is refused: allowed is 0 to {MOST_FORGED_HZ:g} a second")
    return replace(plan, forged_hz=forged_hz)


MOST_FORGED_HZ = 100_000.0


def _of_tracker(fault: ReceiverFault | VehicleFault | ProcessFault) -> Callable[[FaultPlan, str], FaultPlan]:
    def change(plan: FaultPlan, value: str) -> FaultPlan:
        tracker, at, times = value.partition("@")
        start, dash, end = times.partition("-")
        takes_an_end = fault not in {ProcessFault.KILL, ProcessFault.RESTART}
        start_s, end_s = float(start), float(end) if dash else math.inf
        if not (at and tracker.isdigit() and int(tracker) < NUM_TRACKERS and 0 <= start_s < end_s):
            raise ValueError(value)
        if dash and not takes_an_end:
            raise ValueError(value)
        return replace(plan, trackers=(*plan.trackers, TrackerFault(fault, int(tracker), start_s, end_s)))

    return change


_WORDS: dict[str, Callable[[FaultPlan, str], FaultPlan]] = {
    "loss": _of_link("loss"),
    "burst": _of_link("burst_loss"),
    "delay": _delay,
    "jitter": _jitter,
    "duplicate": _of_link("duplication"),
    "reorder": _of_link("reordering"),
    "replay": _of_link("replay"),
    "outage": _outage,
    "forge": _forge,
    "second": _second,
    **{str(fault): _of_target(fault) for fault in TargetFault},
    **{str(fault): _of_tracker(fault) for kind in (ReceiverFault, VehicleFault, ProcessFault) for fault in kind},
}
