"""What trackers and the controller say to one another, whatever carries it.

Positions are metres in one local frame that all share: x east, y north, z up, from an agreed origin. Times are
nanoseconds of the sender's own monotonic clock; nobody compares them with another clock without estimating the offset.
"""

import math
from dataclasses import dataclass
from enum import IntEnum

from ...errors import InputError
from ...scenario import NUM_TRACKERS

MOST_SAMPLES = 50
"""Of one RSSI message: the paper's window."""
FARTHEST_M = 100_000.0
"""No tracker is further from the origin than this on any axis."""
FASTEST_MPS = 200.0
LONGEST_FEED_FORWARD_S = 2.0
"""No tracker is sent on for longer without hearing anything."""
HARDEST_MPS2 = 100.0
SPAN_MS = 2**32
"""Milliseconds of 32 bits start anew after so many, 49.7 days."""
PIECE_CHARACTERS = 50
"""MAVLink has room for so many. A shorter piece of a text is its last."""
MOST_PIECES = 8
"""Of a text."""
MOST_NOTICES = 65_535
NOTICE_TIMES = 3
"""Each piece is sent so often: datagrams get lost."""
NOTICE_PERIOD_S = 0.25
"""From one piece to the next, and between the repetitions of all."""
MOST_WAITING_PIECES = 20
"""Of a tracker: a line that comes on top of so many is dropped. An autopilot that does not stop talking must not fill
the link.
"""
SLOWEST_SAMPLING_HZ, FASTEST_SAMPLING_HZ = 0.1, 10_000.0

Metres = tuple[float, float, float]


class TrackerMode(IntEnum):
    """What a tracker's vehicle is doing."""

    HOLDING = 0
    """Holds its position and would follow a set-point."""
    FOLLOWING = 1
    """Follows set-points."""
    MANUAL = 2
    """Its own failsafe or its pilot has taken over: it is not to be commanded."""


@dataclass(frozen=True)
class RssiWindow:
    """The last samples of one tracker's receiver, oldest first; each message repeats earlier ones.

    Raises:
        InputError: a tracker, rate or number of samples that cannot be.
    """

    tracker: int
    time_ns: int
    """When the newest sample was taken."""
    sampling_hz: float
    rssi_dbm: tuple[float, ...]
    """As reported, NaN where nothing was. What is no level (``swarmchase.levels``) is dropped by whoever takes it in;
    the rest of the window counts."""
    obeyed_ms: int | None = None
    """When the newest set-point that the tracker has obeyed was sent: the lowest 32 bits of the controller's
    milliseconds. None before the first."""

    def __post_init__(self) -> None:
        _require_tracker(self.tracker)
        _require_time(self.time_ns)
        if not SLOWEST_SAMPLING_HZ <= self.sampling_hz <= FASTEST_SAMPLING_HZ:
            raise InputError(f"sampling_hz = {self.sampling_hz} is refused")
        if not 1 <= len(self.rssi_dbm) <= MOST_SAMPLES:
            raise InputError(f"{len(self.rssi_dbm)} samples are refused: allowed is 1 to {MOST_SAMPLES}")
        if not (self.obeyed_ms is None or 0 <= self.obeyed_ms < SPAN_MS):
            raise InputError(f"obeyed_ms = {self.obeyed_ms} is refused")


@dataclass(frozen=True)
class PositionReport:
    """Where a tracker is.

    Raises:
        InputError: a tracker, position or velocity that cannot be.
    """

    tracker: int
    time_ns: int
    position_m: Metres
    velocity_mps: Metres = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _require_tracker(self.tracker)
        _require_time(self.time_ns)
        _require_within("position_m", self.position_m, FARTHEST_M)
        _require_within("velocity_mps", self.velocity_mps, FASTEST_MPS)


@dataclass(frozen=True)
class VehicleState:
    """What a tracker's vehicle is and does, beside its mode."""

    is_armed: bool
    """Its motors may turn."""
    is_airborne: bool | None
    """None where it does not say."""
    is_simulated: bool
    """It is computed: nothing can fall on anybody."""


@dataclass(frozen=True)
class Heartbeat:
    """A tracker is alive, and in which mode.

    Raises:
        InputError: a tracker or time that cannot be.
    """

    tracker: int
    time_ns: int
    mode: TrackerMode
    vehicle: VehicleState

    def __post_init__(self) -> None:
        _require_tracker(self.tracker)
        _require_time(self.time_ns)


class Severity(IntEnum):
    """Of a notice, as MAVLink numbers them (MAV_SEVERITY)."""

    EMERGENCY = 0
    ALERT = 1
    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6
    DEBUG = 7


@dataclass(frozen=True)
class Notice:
    """A line, or a piece of one, that a tracker's autopilot, receiver or agent has for people. It is repeated, since
    lines get lost.

    Raises:
        InputError: a tracker, number, text or piece that cannot be.
    """

    tracker: int
    number: int
    """Of the line, counted by the tracker from 1 and after the greatest again: by it repetitions are known."""
    severity: Severity
    text: str
    """Printable ASCII."""
    piece: int = 0
    """Which of the line's this is."""

    def __post_init__(self) -> None:
        _require_tracker(self.tracker)
        if not 1 <= self.number <= MOST_NOTICES:
            raise InputError(f"number = {self.number} is refused: allowed is 1 to {MOST_NOTICES}")
        if not 0 <= self.piece < MOST_PIECES:
            raise InputError(f"piece = {self.piece} is refused: allowed is 0 to {MOST_PIECES - 1}")
        # After pieces that are full an empty one says that the text has ended.
        fewest = 0 if self.piece else 1
        if not (fewest <= len(self.text) <= PIECE_CHARACTERS and self.text.isascii() and self.text.isprintable()):
            raise InputError(
                f"a notice is refused: allowed are {fewest} to {PIECE_CHARACTERS} printable ASCII characters"
            )


@dataclass(frozen=True)
class Health:
    """What a tracker's autopilot says of its battery, its satellite receiver and its heading, for people. What it does
    not say is None.

    Raises:
        InputError: a tracker or a number that cannot be.
    """

    tracker: int
    battery_percent: int | None = None
    gps_fix: int | None = None
    """As MAVLink numbers them (GPS_FIX_TYPE): 2 is a fix without height, 3 one with it, 6 the best."""
    satellites: int | None = None
    heading_deg: float | None = None
    """Clockwise from north, 0 to below 360."""

    def __post_init__(self) -> None:
        _require_tracker(self.tracker)
        for name, number, most in (
            ("battery_percent", self.battery_percent, 100),
            ("gps_fix", self.gps_fix, 8),
            ("satellites", self.satellites, 254),
        ):
            if not (number is None or 0 <= number <= most):
                raise InputError(f"{name} = {number} is refused: allowed is 0 to {most}")
        if not (self.heading_deg is None or 0 <= self.heading_deg < 360):
            raise InputError(f"heading_deg = {self.heading_deg} is refused: allowed is 0 to below 360")


def printable(text: str) -> str:
    """As notices carry it: one line in which a question mark stands for what is not printable ASCII."""
    return "".join(one if one.isascii() and one.isprintable() else "?" for one in " ".join(text.split()))


@dataclass(frozen=True)
class FeedForward:
    """How the place to rest at moves on, for a tracker that is led along a way: with this velocity for so long after
    the set-point was sent, whether the tracker hears another one or not.

    Raises:
        InputError: a velocity, time or braking that cannot be.
    """

    velocity_mps: Metres
    valid_s: float
    braking_mps2: float
    """So hard it is to brake before that place: nearer to it it is slower."""

    def __post_init__(self) -> None:
        _require_within("velocity_mps", self.velocity_mps, FASTEST_MPS)
        if not 0 <= self.valid_s <= LONGEST_FEED_FORWARD_S:
            raise InputError(f"valid_s = {self.valid_s} is refused: allowed is 0 to {LONGEST_FEED_FORWARD_S:g}")
        if not 0 < self.braking_mps2 <= HARDEST_MPS2:
            raise InputError(f"braking_mps2 = {self.braking_mps2} is refused: allowed is above 0 to {HARDEST_MPS2:g}")


@dataclass(frozen=True)
class SetPoint:
    """Where a tracker is to be. Set-points are the controller's proof of life: they are repeated all the time, and a
    tracker that has heard none for a while holds.

    Raises:
        InputError: a tracker, epoch or position that cannot be.
    """

    tracker: int
    time_ns: int
    epoch: int
    """Of the controller that says so; trackers obey the newest they have heard of."""
    position_m: Metres
    """Where it is to come to rest."""
    feed_forward: FeedForward | None = None
    """How that place moves on; None: it does not."""

    def __post_init__(self) -> None:
        _require_tracker(self.tracker)
        _require_time(self.time_ns)
        if not 0 <= self.epoch < 2**32:
            raise InputError(f"epoch = {self.epoch} is refused")
        _require_within("position_m", self.position_m, FARTHEST_M)

    def moves_on(self, age_s: float) -> bool:
        """Whether it does so long after this was sent, if nothing was heard since."""
        return self.feed_forward is not None and age_s < self.feed_forward.valid_s

    def rest_m(self, age_s: float) -> Metres:
        """Where it is to come to rest, so long after this was sent."""
        if self.feed_forward is None:
            return self.position_m
        seconds = min(max(age_s, 0.0), self.feed_forward.valid_s)
        east_m, north_m, up_m = (
            place_m + speed_mps * seconds
            for place_m, speed_mps in zip(self.position_m, self.feed_forward.velocity_mps, strict=True)
        )
        return east_m, north_m, up_m


Report = RssiWindow | PositionReport | Heartbeat | Notice | Health
"""What a tracker says."""
Message = Report | SetPoint


def _require_tracker(tracker: int) -> None:
    if not 0 <= tracker < NUM_TRACKERS:
        raise InputError(f"tracker = {tracker} is refused: allowed is 0 to {NUM_TRACKERS - 1}")


def _require_time(time_ns: int) -> None:
    if not 0 <= time_ns < 2**63:
        raise InputError(f"time_ns = {time_ns} is refused")


def _require_within(name: str, vector: Metres, bound: float) -> None:
    if len(vector) != 3 or not all(math.isfinite(value) and abs(value) <= bound for value in vector):
        raise InputError(f"{name} = {vector} is refused")
