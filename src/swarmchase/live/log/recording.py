"""A log, read back: whole, or as far as it is whole."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ...errors import InputError
from ..alarms import Severity
from ..events import MOST_SHOWN, Event
from ..frame import EventFrame, Frame, event_frame
from ..service.chase_state import ChaseState, Decision, Transition
from .entries import (
    DECISION_TOPIC,
    EVENT_TOPIC,
    FRAME_TOPIC,
    HEAD_TOPIC,
    LOSS_TOPIC,
    TRANSITION_TOPIC,
    DecisionForm,
    EventForm,
    HeadForm,
    LogHead,
    LossForm,
    TransitionForm,
    decision_of,
    event_of,
    from_json,
    head_of,
    transition_of,
)
from .layouts import renewal, renewed_decision, renewed_head
from .mcap_messages import CutError, LogMessage, messages

MOST_ENTRY_BYTES = 512 * 2**20
"""Of transitions, decisions and events, which are held in memory: a hundred times those of the longest chase."""


@dataclass(frozen=True)
class Recording:
    """What a log holds. Its frames stay on disk."""

    path: Path
    layout: int
    head: LogHead
    transitions: tuple[Transition, ...]
    decisions: tuple[Decision, ...]
    events: tuple[Event, ...]
    """None in logs of layout 1."""
    num_frames: int
    seconds: float
    """From the head to whatever is the last."""
    lost_frames: int
    """So many the recorder could not keep up with;"""
    lost_entries: int
    """and so many transitions, decisions and events."""
    cut: str
    """Where and why it is not whole; else empty."""

    @property
    def is_cut(self) -> bool:
        """Whether something is missing at its end."""
        return bool(self.cut)

    @property
    def state(self) -> ChaseState:
        """At its end."""
        return self.transitions[-1].after if self.transitions else ChaseState.IDLE

    @property
    def reason(self) -> str:
        """Of the last transition; empty before the first."""
        return self.transitions[-1].reason if self.transitions else ""

    @property
    def movements(self) -> int:
        """That were made."""
        return max((decision.movement for decision in self.decisions), default=0)

    def frames(self) -> Iterator[Frame]:
        """All of them, read one by one, with the events that each was shown with.

        Raises:
            InputError: the file cannot be read any more, or a frame has another form.
        """
        renew, began_ns = renewal(self.layout), self.head.began_ns
        newest: deque[EventFrame] = deque(maxlen=MOST_SHOWN)
        try:
            for message in messages(self.path):
                if message.topic == FRAME_TOPIC:
                    frame = from_json(message.data, Frame, renew)
                    frame["events"] = frame["events"] or list(newest)
                    yield frame
                elif message.topic == EVENT_TOPIC:
                    event = event_of(from_json(message.data, EventForm))
                    if event.severity is not Severity.ROUTINE:
                        newest.append(event_frame(event, began_ns))
        except CutError:
            return


def read_recording(path: Path) -> Recording:
    """The log in this file; one that is cut as far as it is whole.

    Raises:
        InputError: the file cannot be read, is no log, ends before its head is whole, or has another layout.
    """
    reading = _Reading(path)
    cut = ""
    try:
        for message in messages(path):
            reading.take(message)
    except CutError as error:
        cut = str(error)
    return reading.recording(cut)


class _Reading:
    """What has been read so far."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._head: LogHead | None = None
        self._transitions: list[Transition] = []
        self._decisions: list[Decision] = []
        self._events: list[Event] = []
        self._layout = 0
        self._num_frames = self._entry_bytes = self._last_ns = 0
        self._loss = LossForm(frames=0, entries=0)

    def take(self, message: LogMessage) -> None:
        """The next message."""
        try:
            self._take(message)
        except InputError as error:
            raise InputError(f"cannot read the log {self._path}: {error}") from None

    def _take(self, message: LogMessage) -> None:
        topic, data = message.topic, message.data
        self._last_ns = max(self._last_ns, message.log_time_ns)
        if self._head is None:
            if topic != HEAD_TOPIC:
                raise InputError("it does not begin with the head of a chase")
            form = from_json(data, HeadForm, renewed_head)
            self._head, self._layout = head_of(form), form["layout"]
        elif topic == FRAME_TOPIC:
            self._num_frames += 1
        elif topic == LOSS_TOPIC:
            self._loss = from_json(data, LossForm)
        elif topic in {TRANSITION_TOPIC, DECISION_TOPIC, EVENT_TOPIC}:
            self._entry_bytes += len(data)
            if self._entry_bytes > MOST_ENTRY_BYTES:
                raise InputError(f"its transitions, decisions and events have more than {MOST_ENTRY_BYTES} bytes")
            if topic == TRANSITION_TOPIC:
                self._transitions.append(transition_of(from_json(data, TransitionForm)))
            elif topic == EVENT_TOPIC:
                self._events.append(event_of(from_json(data, EventForm)))
            else:
                renew = renewed_decision if self._layout < 3 else None
                decision_form = from_json(data, DecisionForm, renew)
                self._decisions.append(decision_of(decision_form, self._head.scenario.samples_a_decision))

    def recording(self, cut: str) -> Recording:
        """All that was read."""
        if self._head is None:
            raise InputError(f"the log {self._path} holds no chase: {cut or 'it is empty'}")
        began_ns = self._head.wall_ns(self._head.began_ns)
        return Recording(
            self._path,
            self._layout,
            self._head,
            tuple(self._transitions),
            tuple(self._decisions),
            tuple(self._events),
            self._num_frames,
            max(0, self._last_ns - began_ns) / 1e9,
            self._loss["frames"],
            self._loss["entries"],
            cut,
        )
