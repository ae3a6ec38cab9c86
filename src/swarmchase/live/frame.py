"""One moment of a chase as a page shows it and a log keeps it: plain JSON, nothing in it that is not in a snapshot.

All metres are of the shared frame, x east, y north, z up. What is not known is null.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from ..controllers.explanation import Explanation, FoundChannel
from .alarms import Alarm, condition_of, severity_of
from .estimate import EstimateFrame, estimate_of
from .events import Event, Events
from .interception import InterceptionFrame, flown_mps, interception
from .link.messages import Health, Metres
from .service.chase_state import Decision, FollowedShare, PreflightCheck, Snapshot, TrackerSnapshot
from .service.sample_window import Points


class AlarmFrame(TypedDict):
    """Something that is wrong now."""

    text: str
    severity: str
    """warning, critical."""
    tracker: int | None


class EventFrame(TypedDict):
    """Something that has happened."""

    time_s: float
    """Since the service was started."""
    severity: str
    """info, success, warning, critical."""
    text: str


class NoticeFrame(TypedDict):
    """What an autopilot or an agent says."""

    severity: str
    text: str


class HealthFrame(TypedDict):
    """What a tracker's autopilot says: ``Health``. What it does not say is null."""

    battery_percent: int | None
    gps_fix: int | None
    satellites: int | None
    heading_deg: float | None


class PreflightFrame(TypedDict):
    """One thing that must be right before trackers are commanded."""

    name: str
    passed: bool | None
    """Null where it is not known yet."""
    text: str
    tracker: int | None
    """Null where it is about all."""


class TrackerFrame(TypedDict):
    """One tracker."""

    position_m: list[float] | None
    set_point_m: list[float] | None
    """Null where it is not commanded."""
    mode: str | None
    """holding, following, manual."""
    position_age_s: float | None
    rssi_age_s: float | None
    """Of the newest valid sample."""
    is_lost: bool
    """Nobody knows where it is."""
    is_silent: bool
    """It hears nothing, or nothing of what it hears arrives."""
    loss_share: float | None
    """Of its packets in the last seconds; null where the link cannot tell."""
    missing_share: float
    """Of the samples in its last window."""
    rssi_dbm: list[float | None]
    """Its last window, oldest first."""
    condition: str
    """expected, lost, manual, left out, silent, there."""
    left_out: str
    """Why it is left out; empty where it counts."""
    notices: list[NoticeFrame]
    """What its autopilot and its agent said last."""
    dropped: dict[str, int]
    """Samples that were no levels, by reason."""
    health: HealthFrame | None
    """Null where its autopilot says nothing, or it has none."""


class DecisionFrame(TypedDict):
    """The last decision."""

    movement: int
    spacing_m: float
    displacement_m: list[float]
    changed: str
    """What the safety filter made of it; else empty."""
    choice_share: list[list[float]] | None
    """How much speaks for each choice of spacing, x, y, z: ``Explanation.choice_share``."""


class ChannelFrame(TypedDict):
    """What the controller has found out about channel and receivers: ``FoundChannel``."""

    power_db: float
    """Transmit power above what was told."""
    exponent: float
    offset_db: list[float]
    """Of each receiver."""
    left_out: list[str | None]
    """Why each receiver counts for nothing or little: silent, stuck, wrong; null where it counts."""
    fading_db: float | None
    """Null where it is told."""
    shadowing_db: float
    """0 where there is none."""


class TrackFrame(TypedDict):
    """What was believed after each decision of the last minute, oldest first, in columns: only in flight."""

    time_s: list[float]
    """Since the service was started."""
    target_m: list[list[float] | None]
    """The estimate; null where the controller did not say so."""
    radius_m: list[float | None]
    """Of the estimate."""
    share_within: list[float | None]
    """Of the belief, within the success radius of the centre; null where that is not judged."""


class FollowingFrame(TypedDict):
    """How well a target is followed: ``FollowedShare``."""

    seconds: float
    """Since it was first reached."""
    share: float
    """Of them, in which it was believed to be no further than ``within_m`` from the centre."""
    within_m: float


class Frame(TypedDict):
    """The chase at one moment."""

    time_s: float
    """Since the service was started."""
    epoch: int
    state: str
    """Of ``ChaseState``."""
    reason: str
    """Of the last transition."""
    movements: int
    center_m: list[float] | None
    spacing_m: float | None
    path_m: list[list[float]]
    """The centres of the formation from the first on, one a movement; of very many the newest, in flight those of the
    last minute."""
    trackers: list[TrackerFrame]
    """Six."""
    decision: DecisionFrame | None
    belief_m: list[list[float]] | None
    """Points of equal weight where the target may be."""
    target_m: list[float] | None
    """Where the target is: only a simulation knows."""
    rejected: dict[str, int]
    """Datagrams that the link dropped, by reason."""
    decision_latency_ms: float | None
    """Of the last decision."""
    alarms: list[AlarmFrame]
    """What is wrong now, the worst first."""
    events: list[EventFrame]
    """What has happened until now, besides routine, oldest first; of very many the newest."""
    estimate: EstimateFrame | None
    """Where the controller takes the target to be; null where it does not say so."""
    channel: ChannelFrame | None
    """What the controller has found out about the radio; null where it does not say so."""
    ended_s: float | None
    """When the chase was reached, lost or aborted, since the service was started."""
    preflight: list[PreflightFrame]
    """What was looked at before the start."""
    interception: InterceptionFrame | None
    """Null where the trackers stop to listen, or the controller does not say how fast the target is."""
    share_within: float | None
    """Of the belief, within the success radius of the centre at the last decision; null where that is not judged."""
    track: TrackFrame
    """Empty where the trackers stop to listen."""
    following: FollowingFrame | None
    """Null before a target that is to be followed was reached."""


@dataclass(frozen=True)
class TrackPoint:
    """What was believed after one decision."""

    time_ns: int
    estimate: EstimateFrame | None
    share_within: float | None


def track_point(snapshot: Snapshot) -> TrackPoint:
    """Of this moment."""
    belief_m = _belief_m(snapshot.explanation, snapshot.origin_m)
    return TrackPoint(snapshot.time_ns, estimate_of(belief_m, snapshot.center_m), snapshot.share_within)


def frame_of(
    snapshot: Snapshot,
    began_ns: int,
    path_m: Iterable[Metres],
    loss_share: Sequence[float | None],
    rejected: Counter[str],
    decision_latency_s: float | None,
    events: Events,
    ended_ns: int | None = None,
    target_m: Metres | None = None,
    track: Iterable[TrackPoint] = (),
) -> Frame:
    """The frame of this snapshot, of which ``events`` has been told."""
    explanation = snapshot.explanation
    belief_m = _belief_m(explanation, snapshot.origin_m)
    estimate = estimate_of(belief_m, snapshot.center_m, _velocity_mps(explanation))
    return Frame(
        time_s=_seconds(snapshot.time_ns, began_ns),
        epoch=snapshot.epoch,
        state=snapshot.state.value,
        reason=snapshot.reason,
        movements=snapshot.movements,
        center_m=_metres(snapshot.center_m),
        spacing_m=snapshot.spacing_m,
        path_m=[_rounded(center_m) for center_m in path_m],
        trackers=[_tracker(*pair) for pair in zip(snapshot.trackers, loss_share, strict=True)],
        decision=None if snapshot.last_decision is None else _decision(snapshot.last_decision, explanation),
        belief_m=None if belief_m is None else [[round(one, 1) for one in point] for point in belief_m.tolist()],
        target_m=_metres(target_m),
        rejected={str(reason): count for reason, count in sorted(rejected.items())},
        decision_latency_ms=None if decision_latency_s is None else round(1000 * decision_latency_s, 3),
        alarms=[_alarm(alarm) for alarm in events.alarms],
        events=[event_frame(event, began_ns) for event in events.newest],
        estimate=estimate,
        channel=None if explanation is None or explanation.found is None else _channel(explanation.found),
        ended_s=None if ended_ns is None else _seconds(ended_ns, began_ns),
        preflight=[_check(check) for check in snapshot.preflight],
        interception=_interception(snapshot, estimate),
        share_within=_share(snapshot.share_within),
        track=_track(track, began_ns),
        following=None if snapshot.following is None else _following(snapshot.following),
    )


def _track(points: Iterable[TrackPoint], began_ns: int) -> TrackFrame:
    points = list(points)
    return TrackFrame(
        time_s=[round((point.time_ns - began_ns) / 1e9, 1) for point in points],
        target_m=[None if point.estimate is None else point.estimate["position_m"] for point in points],
        radius_m=[None if point.estimate is None else point.estimate["radius_m"] for point in points],
        share_within=[_share(point.share_within) for point in points],
    )


def _share(share: float | None) -> float | None:
    return None if share is None else round(share, 3)


def _interception(snapshot: Snapshot, estimate: EstimateFrame | None) -> InterceptionFrame | None:
    decision = snapshot.last_decision
    if estimate is None or estimate["velocity_mps"] is None or decision is None or snapshot.origin_m is None:
        return None
    swarm_mps = flown_mps(decision)
    if swarm_mps is None:
        return None
    center_m = np.mean(decision.tracker_position_m[-1], axis=0) + snapshot.origin_m
    return interception(center_m, swarm_mps, np.array(estimate["position_m"]), np.array(estimate["velocity_mps"]))


def _tracker(tracker: TrackerSnapshot, loss_share: float | None) -> TrackerFrame:
    return TrackerFrame(
        position_m=_metres(tracker.position_m),
        set_point_m=_metres(tracker.set_point_m),
        mode=None if tracker.mode is None else tracker.mode.name.lower(),
        position_age_s=_finite(tracker.position_age_s),
        rssi_age_s=_finite(tracker.rssi_age_s),
        is_lost=tracker.is_lost,
        is_silent=tracker.is_silent,
        loss_share=loss_share,
        missing_share=round(tracker.missing_share, 3),
        rssi_dbm=[_finite(level_dbm) for level_dbm in tracker.rssi_dbm],
        condition=condition_of(tracker).value,
        left_out=tracker.left_out,
        notices=[NoticeFrame(severity=severity_of(one).value, text=one.text) for one in tracker.notices],
        dropped=dict(tracker.dropped),
        health=None if tracker.health is None else _health(tracker.health),
    )


def _health(health: Health) -> HealthFrame:
    return HealthFrame(
        battery_percent=health.battery_percent,
        gps_fix=health.gps_fix,
        satellites=health.satellites,
        heading_deg=health.heading_deg,
    )


def _decision(decision: Decision, explanation: Explanation | None) -> DecisionFrame:
    share = None if explanation is None else explanation.choice_share
    return DecisionFrame(
        movement=decision.movement,
        spacing_m=decision.spacing_m,
        displacement_m=list(decision.displacement_m),
        changed=decision.changed,
        choice_share=None if share is None else [[round(one, 4) for one in row] for row in share.tolist()],
    )


def _channel(found: FoundChannel) -> ChannelFrame:
    return ChannelFrame(
        power_db=round(found.power_db, 1),
        exponent=round(found.exponent, 2),
        offset_db=[round(one_db, 1) for one_db in found.offset_db],
        left_out=list(found.left_out),
        fading_db=None if found.fading_db is None else round(found.fading_db, 1),
        shadowing_db=round(found.shadowing_db, 1),
    )


def _following(followed: FollowedShare) -> FollowingFrame:
    return FollowingFrame(
        seconds=round(followed.seconds, 3), share=round(followed.share, 4), within_m=followed.within_m
    )


def _alarm(alarm: Alarm) -> AlarmFrame:
    return AlarmFrame(text=alarm.text, severity=alarm.severity.value, tracker=alarm.tracker)


def event_frame(event: Event, began_ns: int) -> EventFrame:
    """Of this event in a chase that began then."""
    return EventFrame(time_s=_seconds(event.time_ns, began_ns), severity=event.severity.value, text=event.text)


def _check(check: PreflightCheck) -> PreflightFrame:
    return PreflightFrame(name=check.name, passed=check.passed, text=check.text, tracker=check.tracker)


def _belief_m(explanation: Explanation | None, origin_m: Metres | None) -> Points | None:
    """Points of equal weight in the shared frame [point, 3]."""
    if explanation is None or explanation.target_m is None or origin_m is None:
        return None
    return np.asarray(explanation.target_m.double().numpy() + origin_m)


def _velocity_mps(explanation: Explanation | None) -> Metres | None:
    if explanation is None or explanation.velocity_mps is None:
        return None
    east_mps, north_mps, up_mps = explanation.velocity_mps.tolist()
    return east_mps, north_mps, up_mps


def _seconds(time_ns: int, began_ns: int) -> float:
    return round((time_ns - began_ns) / 1e9, 3)


def _metres(point_m: Metres | None) -> list[float] | None:
    return None if point_m is None else _rounded(point_m)


def _rounded(point_m: Metres) -> list[float]:
    return [round(coordinate, 3) for coordinate in point_m]


def _finite(value: float) -> float | None:
    return round(value, 2) if math.isfinite(value) else None
