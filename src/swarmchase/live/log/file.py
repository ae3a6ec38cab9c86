"""The MCAP file that a log is: its topics, their schemas, the times of its messages."""

import json
from typing import IO, Any

from ..events import Event
from ..frame import Frame
from ..service.chase_state import Decision, Transition
from .entries import (
    DECISION_TOPIC,
    EVENT_TOPIC,
    FORMS,
    FRAME_TOPIC,
    HEAD_TOPIC,
    LOSS_TOPIC,
    SCENE_TOPIC,
    TRANSITION_TOPIC,
    LogHead,
    LossForm,
    decision_form,
    event_form,
    head_form,
    to_json,
    transition_form,
)
from .json_forms import schema_of
from .mcap_library import MessageEncoding, SchemaEncoding, Writer
from .scene import SCENE_SCHEMA, scene_of

FRAMES_A_SCENE = 2
"""What is drawn in space is drawn every other time: five times a second moves smoothly, and is half as long."""


class LogFile:
    """Writes a log, its head first. What has been written reaches the operating system with ``flush``.

    Raises:
        OSError: by every method: the disk is full or gone. What was flushed before can still be read.
    """

    def __init__(self, file: IO[bytes], head: LogHead) -> None:
        self._file, self._head = file, head
        self._last_ns, self._messages, self._frames = head.began_ns, 0, 0
        self._writer = Writer(file, enable_data_crcs=True)
        self._writer.start(library=f"swarmchase {head.version}")
        self._channel = {topic: self._new_channel(topic, form) for topic, form in FORMS.items()}
        form = head_form(head)
        # Once more where tools show it without reading messages.
        self._writer.add_metadata("swarmchase", {name: _text(value) for name, value in form.items()})
        self._add(HEAD_TOPIC, head.began_ns, to_json(form))
        self.flush()

    def _new_channel(self, topic: str, form: Any) -> int:
        # Foxglove draws what bears its own name.
        name = SCENE_SCHEMA if topic == SCENE_TOPIC else f"swarmchase.{form.__name__}"
        schema = self._writer.register_schema(name, SchemaEncoding.JSONSchema, json.dumps(schema_of(form)).encode())
        return self._writer.register_channel(topic, MessageEncoding.JSON, schema)

    def write(self, item: Transition | Decision | Event | Frame) -> None:
        """One message; every ``FRAMES_A_SCENE``th frame is drawn as well, in one of its own.

        Raises:
            ValueError: a frame that is no JSON.
        """
        if isinstance(item, Transition):
            self._add(TRANSITION_TOPIC, item.time_ns, to_json(transition_form(item)))
        elif isinstance(item, Decision):
            self._add(DECISION_TOPIC, item.time_ns, to_json(decision_form(item)))
        elif isinstance(item, Event):
            self._add(EVENT_TOPIC, item.time_ns, to_json(event_form(item)))
        else:
            time_ns = self._head.began_ns + round(item["time_s"] * 1e9)
            # Events are messages of their own: a hundred of them ten times a second made a tenth of the log.
            self._add(FRAME_TOPIC, time_ns, to_json(item | {"events": []}))
            if self._frames % FRAMES_A_SCENE == 0:
                self._add(SCENE_TOPIC, time_ns, to_json(scene_of(item, self._head.wall_ns(time_ns))))
            self._frames += 1

    def write_loss(self, frames: int, entries: int) -> None:
        """So much is missing until now."""
        self._add(LOSS_TOPIC, self._last_ns, to_json(LossForm(frames=frames, entries=entries)))

    def _add(self, topic: str, time_ns: int, data: bytes) -> None:
        self._last_ns = max(self._last_ns, time_ns)
        wall_ns = self._head.wall_ns(time_ns)
        self._writer.add_message(self._channel[topic], wall_ns, data, publish_time=wall_ns, sequence=self._messages)
        self._messages += 1

    def flush(self) -> None:
        """End the chunk, and hand everything to the operating system."""
        self._writer.flush()

    def finish(self) -> None:
        """Write the index that makes it a whole MCAP file."""
        self._writer.finish()

    def close(self) -> None:
        """Of a file without index all that was flushed can still be read."""
        self._file.close()


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
