"""A recorded chase asked again: does the same controller give the same actions, bit for bit?"""

import math
from dataclasses import dataclass
from typing import Any

import torch

from ... import __version__
from ...controllers import Controller, load_controller, weights_sha256
from ...observation import Observation
from ..service.chase_state import Decision
from .entries import LogHead
from .recording import Recording

RecordedAction = tuple[float, float, float, float]
"""Spacing and displacement in metres."""


@dataclass(frozen=True)
class Mismatch:
    """One decision that is another one now."""

    number: int
    """Of the decision in the log, from 1 on."""
    movement: int
    """As in ``Decision``."""
    recorded: RecordedAction
    now: RecordedAction | None
    """None where the controller fails."""
    reason: str
    """Why there is no action now; else empty."""


@dataclass(frozen=True)
class Verification:
    """What asking again has shown."""

    decisions: int
    mismatches: tuple[Mismatch, ...]
    doubts: tuple[str, ...]
    """What speaks against the comparison itself: another version or other weights than recorded, decisions that the
    recorder has lost."""

    @property
    def is_same(self) -> bool:
        """Whether every action is the same."""
        return not self.mismatches


def verify(recording: Recording) -> Verification:
    """Ask the controller that the log names all decisions again, one after another as the service did.

    Raises:
        InputError: the controller cannot be loaded or begun.
    """
    head = recording.head
    controller = load_controller(head.controller, head.scenario)
    memory = controller.begin(1, head.seed, head.chase)
    mismatches = []
    for number, decision in enumerate(recording.decisions, start=1):
        recorded = (decision.spacing_m, *decision.displacement_m)
        now, memory, reason = _ask(controller, decision, memory)
        if now is None or not _is_same(recorded, now):
            mismatches.append(Mismatch(number, decision.movement, recorded, now, reason))
    return Verification(len(recording.decisions), tuple(mismatches), tuple(_doubts(recording, head)))


def _ask(controller: Controller, decision: Decision, memory: Any) -> tuple[RecordedAction | None, Any, str]:
    """The action, the memory after it, and why there is none. As in the service, an action that is no number leaves
    the memory as it was.
    """
    rssi_dbm = torch.from_numpy(decision.rssi_dbm).float()[None]
    time_s = None if decision.time_s is None else torch.from_numpy(decision.time_s)[None]
    observation = Observation(rssi_dbm, torch.from_numpy(decision.tracker_position_m)[None], time_s)
    try:
        action, memory_after = controller.decide(observation, memory)
        x_m, y_m, z_m = action.displacement_m[0].tolist()
        now = (float(action.spacing_m[0]), x_m, y_m, z_m)
    except Exception as error:
        return None, memory, f"the controller failed: {type(error).__name__}: {error}"
    return now, memory_after if all(map(math.isfinite, now)) else memory, ""


def _is_same(one: RecordedAction, other: RecordedAction) -> bool:
    """Bit for bit, -0.0 not being 0.0; any NaN is NaN."""
    return [value.hex() for value in one] == [value.hex() for value in other]


def _doubts(recording: Recording, head: LogHead) -> list[str]:
    doubts = []
    if head.version != __version__:
        doubts.append(f"recorded by version {head.version}, asked with {__version__}")
    weights = weights_sha256(head.controller, head.scenario)
    if weights != head.weights_sha256:
        doubts.append(f"recorded with the weights {head.weights_sha256}, asked with {weights}")
    if recording.lost_entries:
        doubts.append(f"the recorder has lost {recording.lost_entries} transitions, decisions and events")
    return doubts
