"""What a live chase is doing: its states, what is recorded of it, and what a page shows."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from ...controllers.condition import Condition
from ...controllers.explanation import Explanation
from ..link.messages import Health, Metres, Severity, TrackerMode, VehicleState
from .sample_window import Levels, Points


class ChaseState(Enum):
    """Of the controller service."""

    IDLE = "idle"
    """Listens; commands nobody."""
    CONNECTING = "connecting"
    """Waits for enough trackers."""
    SAMPLING = "sampling"
    """The trackers stay in their places and fill a window."""
    MOVING = "moving"
    """They are on their way."""
    PURSUING = "pursuing"
    """They fly and are listened to at once."""
    FOLLOWING = "following"
    """The same, with a target that has been reached: they stay with it."""
    SEARCHING = "searching"
    """The same, looking for a target that is lost."""
    HOLDING = "holding"
    """They stay where they are told to be until the cause is gone."""
    REACHED = "reached"
    """The target is reached; they stay there."""
    LOST = "lost"
    """The movements are spent and the target is not reached; they stay there."""
    ABORTED = "aborted"
    """Told to stay, then told nothing any more: their own fallback takes over."""


ENDED = frozenset({ChaseState.REACHED, ChaseState.LOST, ChaseState.ABORTED})
"""In these a chase has a result."""
IN_FLIGHT = frozenset({ChaseState.PURSUING, ChaseState.FOLLOWING, ChaseState.SEARCHING})
"""In these trackers never stop to listen."""
LED = IN_FLIGHT | {ChaseState.SAMPLING, ChaseState.MOVING}
"""In these trackers are led towards the target."""
UNDER_WAY = LED | {ChaseState.CONNECTING, ChaseState.HOLDING}
"""From these a chase can still be held or declared reached."""
NOT_ONE_TRANSMITTER = "what is heard does not fit one transmitter"
"""Why nothing counts as reached: in reasons and alarms."""


@dataclass(frozen=True)
class Transition:
    """From one state to the next, and why."""

    time_ns: int
    before: ChaseState
    after: ChaseState
    reason: str


@dataclass(frozen=True, eq=False)
class Decision:
    """What a controller saw and what it decided: enough to ask it again, decision by decision.

    An action that is no number leaves the controller's memory as it was before.
    """

    time_ns: int
    movement: int
    """1 for the first; 0 where the action was not carried out."""
    rssi_dbm: Levels
    """[sample, tracker], float32 values; NaN where nothing valid came."""
    tracker_position_m: Points
    """[sample, tracker, 3] in the chase's own frame."""
    spacing_m: float
    displacement_m: Metres
    changed: str
    """Where something else was done than the action says: what and why; else empty."""
    time_s: Levels | None = None
    """When each sample was taken [sample], since the chase began; None where trackers stop to listen."""


@dataclass(frozen=True)
class TrackerLine:
    """What a tracker's autopilot, receiver or agent has said to people."""

    number: int
    """As the tracker counts them."""
    severity: Severity
    text: str


@dataclass(frozen=True)
class TrackerSnapshot:
    """One tracker at one moment. Metres are of the shared frame; what is not known is None."""

    position_m: Metres | None
    set_point_m: Metres | None
    """None where it is not commanded."""
    mode: TrackerMode | None
    position_age_s: float
    """Infinite before the first."""
    rssi_age_s: float
    """Of the newest valid sample; infinite before the first."""
    is_lost: bool
    is_silent: bool
    """Nothing valid has come of what it hears, for a while; of one that has just come nobody says so."""
    missing_share: float
    """Of its last window."""
    rssi_dbm: tuple[float, ...]
    """Its last window, oldest first; NaN where nothing valid came."""
    left_out: str = ""
    """Why it is left out; empty where it counts."""
    vehicle: VehicleState | None = None
    position_hz: float | None = None
    """How often it said where it was, of late; None where that is not known."""
    notices: tuple[TrackerLine, ...] = ()
    """The newest, oldest first."""
    dropped: Mapping[str, int] = field(default_factory=dict)
    """Samples that it reported and that are no levels, by reason."""
    health: Health | None = None
    """What its autopilot has said of late; None where it says nothing."""


@dataclass(frozen=True)
class PreflightCheck:
    """One thing that is looked at before the trackers are led."""

    name: str
    passed: bool | None
    """None where nobody can say: that holds up nothing."""
    text: str
    """What was found."""
    tracker: int | None = None
    """None where it is about all."""
    may_be_overridden: bool = True
    """By the operator's word."""


@dataclass(frozen=True)
class FollowedShare:
    """How well a target is followed."""

    seconds: float
    """Since it was first reached."""
    share: float
    """Of them, in which it was believed to be no further than ``within_m`` from the centre."""
    within_m: float
    is_near: bool
    """Whether it was so at the last decision."""


@dataclass(frozen=True)
class Snapshot:
    """The service at one moment."""

    time_ns: int
    epoch: int
    state: ChaseState
    reason: str
    """Of the last transition."""
    movements: int
    origin_m: Metres | None
    """Where the chase's own frame begins, in the shared frame; None before it has begun."""
    center_m: Metres | None
    """Of the formation as commanded, in the shared frame."""
    spacing_m: float | None
    trackers: tuple[TrackerSnapshot, ...]
    last_decision: Decision | None
    explanation: Explanation | None
    """Of the last movement, where the controller can explain itself."""
    window_since_ns: int | None
    """In SAMPLING: the window begins with the first valid sample taken then or later. IN_FLIGHT: so does the first of
    all windows."""
    recorder_failures: int
    """How often the recorder has failed."""
    preflight: tuple[PreflightCheck, ...] = ()
    """What is looked at before the trackers are led; empty from then on."""
    pulled_back: int = 0
    """In how many steps a set-point was pulled back, or in flight moved away, since somebody had come into its
    tracker's way."""
    condition: Condition = Condition.TRACKING
    """What the controller says of itself, after its last decision."""
    share_within: float | None = None
    """Of the belief, within the success radius of the centre, after the last decision in flight."""
    turned_rad: float = 0.0
    """How far the formation's cross has turned."""
    following: FollowedShare | None = None
    """Since a target that is followed was first reached; None before."""
    asked_m: Metres = (0.0, 0.0, 0.0)
    """By the last decision, the way of the centre until the next one, before limits change it: the controller's, or the
    course's in flight."""
    hears_two: bool = False
    """Whether what is heard in flight does not fit one transmitter, and none is followed yet: nothing counts as reached
    but by the operator's word."""
    looks_again: bool = False
    """Whether the swarm flies around the target at a distance, once, to hear whether it is two."""
