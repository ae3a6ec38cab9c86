"""What a log holds, as JSON: its head, the service's transitions and decisions, events, and how much it has lost.

Numbers keep every bit: JSON's decimals are the shortest that read back the same. NaN is null, infinity is a word.
"""

import contextlib
import dataclasses
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Literal, TypedDict, TypeVar

import numpy as np

from ... import __version__
from ...controllers import weights_sha256
from ...errors import InputError
from ...reading import Bounds, DocumentError, parsed_json
from ...scenario import NUM_TRACKERS, Scenario
from ..alarms import Severity
from ..earth import EarthOrigin
from ..events import Event
from ..frame import Frame
from ..service.chase_state import ChaseState, Decision, Transition
from ..service.safety import SafetyLimits
from .json_forms import form_check
from .scene import SceneUpdate

LAYOUT = 5
"""Of these forms. An older one is read (``layouts``), a newer one is not."""

HEAD_TOPIC = "/chase/head"
TRANSITION_TOPIC = "/chase/transition"
DECISION_TOPIC = "/chase/decision"
EVENT_TOPIC = "/chase/event"
FRAME_TOPIC = "/chase/frame"
LOSS_TOPIC = "/chase/loss"
SCENE_TOPIC = "/chase/scene"

Number = float | None | Literal["inf", "-inf"]
"""Any float: null is NaN."""


class HeadForm(TypedDict):
    """The first message: what the controller is, and what it was told."""

    layout: int
    version: str
    """Of swarmchase."""
    controller: str
    weights_sha256: str | None
    scenario: dict[str, Any]
    seed: int
    chase: int
    epoch: int
    limits: dict[str, float]
    started_at: str
    began_ns: int
    global_origin: list[float] | None


class TransitionForm(TypedDict):
    """See ``Transition``."""

    time_ns: int
    before: str
    after: str
    reason: str


class DecisionForm(TypedDict):
    """See ``Decision``."""

    time_ns: int
    movement: int
    rssi_dbm: list[list[Number]]
    tracker_position_m: list[list[list[Number]]]
    spacing_m: Number
    displacement_m: list[Number]
    changed: str
    time_s: list[Number] | None


class EventForm(TypedDict):
    """See ``Event``."""

    time_ns: int
    severity: str
    text: str


class LossForm(TypedDict):
    """What the recorder could not keep up with until now."""

    frames: int
    entries: int
    """Transitions, decisions and events."""


FORMS: dict[str, Any] = {
    HEAD_TOPIC: HeadForm,
    TRANSITION_TOPIC: TransitionForm,
    DECISION_TOPIC: DecisionForm,
    EVENT_TOPIC: EventForm,
    FRAME_TOPIC: Frame,
    LOSS_TOPIC: LossForm,
    SCENE_TOPIC: SceneUpdate,
}

_Form = TypeVar("_Form")


@dataclass(frozen=True)
class LogHead:
    """Enough to ask the same controller again. Two clocks are read at one moment: what is recorded has monotonic times,
    and steps of the wall clock do not disturb them.
    """

    version: str
    """Of swarmchase."""
    controller: str
    """As given to ``load_controller``: a name or a path."""
    weights_sha256: str | None
    """None for a controller without weights."""
    scenario: Scenario
    seed: int
    chase: int
    epoch: int
    limits: SafetyLimits
    started_at: datetime
    """UTC."""
    began_ns: int
    """The service's clock at ``started_at``; frames count their seconds from it."""
    origin: EarthOrigin | None = None
    """Where on the earth x, y, z are 0; None where nobody has said so."""

    def wall_ns(self, time_ns: int) -> int:
        """Nanoseconds since 1970 at this moment of the service's clock."""
        started_us = (self.started_at - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1)
        return max(0, 1000 * started_us + time_ns - self.began_ns)


def new_head(
    controller: str,
    scenario: Scenario,
    seed: int,
    chase: int,
    epoch: int,
    limits: SafetyLimits,
    began_ns: int,
    origin: EarthOrigin | None = None,
) -> LogHead:
    """The head of a chase that begins now, by this version.

    Args:
        controller: As given to ``load_controller``, which has loaded it.
        began_ns: What the service's clock says now.
    """
    return LogHead(
        __version__,
        controller,
        weights_sha256(controller, scenario),
        scenario,
        seed,
        chase,
        epoch,
        limits,
        datetime.now(UTC),
        began_ns,
        origin,
    )


# To JSON


def head_form(head: LogHead) -> HeadForm:
    """The head as JSON."""
    return HeadForm(
        layout=LAYOUT,
        version=head.version,
        controller=head.controller,
        weights_sha256=head.weights_sha256,
        scenario=head.scenario.to_dict(),
        seed=head.seed,
        chase=head.chase,
        epoch=head.epoch,
        limits=dataclasses.asdict(head.limits),
        started_at=head.started_at.isoformat(timespec="microseconds"),
        began_ns=head.began_ns,
        global_origin=None if head.origin is None else list(dataclasses.astuple(head.origin)),
    )


def transition_form(transition: Transition) -> TransitionForm:
    """The transition as JSON."""
    return TransitionForm(
        time_ns=transition.time_ns,
        before=transition.before.value,
        after=transition.after.value,
        reason=transition.reason,
    )


def decision_form(decision: Decision) -> DecisionForm:
    """The decision as JSON."""
    return DecisionForm(
        time_ns=decision.time_ns,
        movement=decision.movement,
        rssi_dbm=[[_number(level) for level in row] for row in decision.rssi_dbm.tolist()],
        tracker_position_m=[
            [[_number(coordinate) for coordinate in point] for point in row]
            for row in decision.tracker_position_m.tolist()
        ],
        spacing_m=_number(decision.spacing_m),
        displacement_m=[_number(coordinate) for coordinate in decision.displacement_m],
        changed=decision.changed,
        time_s=None if decision.time_s is None else [_number(time_s) for time_s in decision.time_s.tolist()],
    )


def event_form(event: Event) -> EventForm:
    """The event as JSON."""
    return EventForm(time_ns=event.time_ns, severity=event.severity.value, text=event.text)


def _number(value: float) -> Number:
    if math.isfinite(value):
        return value
    if math.isnan(value):
        return None
    return "inf" if value > 0 else "-inf"


def to_json(form: HeadForm | TransitionForm | DecisionForm | EventForm | LossForm | Frame | SceneUpdate) -> bytes:
    """One message.

    Raises:
        ValueError: a number in it that JSON has no word for.
    """
    return json.dumps(form, allow_nan=False, separators=(",", ":")).encode()


# From JSON

MESSAGE_BOUNDS = Bounds(most_bytes=16 * 2**20, most_values=2**20)
"""Of one message: a decision on the longest window that a scenario may have needs a quarter of it."""


def from_json(data: bytes, form: Callable[..., _Form], renew: Callable[[Any], Any] | None = None) -> _Form:
    """One message of this form.

    Args:
        renew: makes this form of an older one; what it raises says that it is none.

    Raises:
        InputError: it has another form, or is no JSON.
    """
    try:
        value = parsed_json(data, MESSAGE_BOUNDS)
    except DocumentError as error:
        raise InputError(f"a message is no JSON within bounds: {error}") from None
    with contextlib.suppress(AttributeError, KeyError, TypeError, ValueError):
        value = value if renew is None else renew(value)
    if not form_check(form)(value):
        raise InputError(f"a message is no {form.__name__}")
    read: _Form = value
    return read


def head_of(form: HeadForm) -> LogHead:
    """The head that this is the JSON of.

    Raises:
        InputError: another layout, or a value that is refused.
    """
    if not 1 <= form["layout"] <= LAYOUT:
        raise InputError(f"its layout is {form['layout']}; this version reads 1 to {LAYOUT}")
    unknown = form["limits"].keys() - {field.name for field in dataclasses.fields(SafetyLimits)}
    if unknown:
        raise InputError(f"there is no limit {min(unknown)!r}")
    return LogHead(
        form["version"],
        form["controller"],
        form["weights_sha256"],
        Scenario.from_dict(form["scenario"]),
        form["seed"],
        form["chase"],
        form["epoch"],
        SafetyLimits(**{name: float(limit) for name, limit in form["limits"].items()}),
        _utc(form["started_at"]),
        form["began_ns"],
        None if form["global_origin"] is None else _origin([float(value) for value in form["global_origin"]]),
    )


def _origin(values: list[float]) -> EarthOrigin:
    if len(values) != 3:
        raise InputError(f"global_origin = {values} is not latitude, longitude and altitude")
    return EarthOrigin(*values)


def _utc(text: str) -> datetime:
    try:
        return datetime.fromisoformat(text).astimezone(UTC)
    except (ValueError, OverflowError):
        raise InputError(f"started_at = {text!r} is no time") from None


def transition_of(form: TransitionForm) -> Transition:
    """The transition that this is the JSON of.

    Raises:
        InputError: there is no such state.
    """
    try:
        return Transition(form["time_ns"], ChaseState(form["before"]), ChaseState(form["after"]), form["reason"])
    except ValueError as error:
        raise InputError(f"a transition is refused: {error}") from None


def decision_of(form: DecisionForm, window_samples: int) -> Decision:
    """The decision that this is the JSON of.

    Raises:
        InputError: a window of another length or of other trackers, or a displacement not of x, y and z.
    """
    x_m, y_m, z_m = _array(form["displacement_m"], (3,), "displacement_m").tolist()
    return Decision(
        form["time_ns"],
        form["movement"],
        _array(form["rssi_dbm"], (window_samples, NUM_TRACKERS), "rssi_dbm"),
        _array(form["tracker_position_m"], (window_samples, NUM_TRACKERS, 3), "tracker_position_m"),
        float(_array(form["spacing_m"], (), "spacing_m")),
        (x_m, y_m, z_m),
        form["changed"],
        None if form["time_s"] is None else _array(form["time_s"], (window_samples,), "time_s"),
    )


def event_of(form: EventForm) -> Event:
    """The event that this is the JSON of.

    Raises:
        InputError: there is no such severity.
    """
    try:
        return Event(form["time_ns"], Severity(form["severity"]), form["text"])
    except ValueError as error:
        raise InputError(f"an event is refused: {error}") from None


def _array(values: Any, shape: tuple[int, ...], name: str) -> Any:
    """Null becomes NaN, a word what it says."""
    try:
        array = np.array(values, dtype=np.float64)
    except ValueError:  # rows of different lengths
        array = None
    if array is None or array.shape != shape:
        raise InputError(f"{name} of a decision is not of the shape {list(shape)}")
    return array
