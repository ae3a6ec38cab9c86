"""A made-up chase for the page's tests: six trackers follow a path to a target 100 m away. No simulator, no service."""

import math
import random
from typing import Any

from swarmchase.live.frame import DecisionFrame, Frame, TrackerFrame

SPACING_CHOICES_M = [1.0, 2.0, 3.0, 4.0, 5.0]
DISPLACEMENT_CHOICES_M = [-4.0, -2.0, 0.0, 2.0, 4.0]
DIRECTIONS = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
START_M = (0.0, 0.0, 20.0)
TARGET_M = (70.0, 60.0, 58.0)
MOVEMENT_S = 1.5
STALE_TRACKER = 3
INFO: dict[str, Any] = {
    "version": "0.3.0",
    "controller": "particle",
    "sampling_hz": 100.0,
    "spatial_correlation": 0.1,
    "window_samples": 50,
    "success_radius_m": 2.0,
    "spacing_choices_m": SPACING_CHOICES_M,
    "displacement_choices_m": DISPLACEMENT_CHOICES_M,
    "fence_m": {"low": [-40.0, -40.0, 2.0], "high": [120.0, 120.0, 90.0]},
    "title": "",
}


def made_up_frame(
    time_s: float, epoch: int = 1, state: str = "", reason: str = "", stale_tracker: int | None = STALE_TRACKER
) -> Frame:
    """The chase ``time_s`` after its start; the same for the same arguments."""
    movements = int(time_s / MOVEMENT_S)
    path_m = _path_m(movements)
    center_m = path_m[-1]
    spacing_m = 5.0 if movements < 4 else 4.0
    draw = random.Random(round(1000 * time_s))
    flies = time_s % MOVEMENT_S > MOVEMENT_S / 2
    return Frame(
        time_s=round(time_s, 3),
        epoch=epoch,
        state=state or ("moving" if flies else "sampling"),
        reason=reason or (f"movement {movements + 1}" if flies else "the trackers are in their places"),
        movements=movements,
        center_m=center_m,
        spacing_m=spacing_m,
        path_m=path_m,
        trackers=[_tracker(number, center_m, spacing_m, draw, number == stale_tracker) for number in range(6)],
        decision=None if movements == 0 else _decision(movements, path_m),
        belief_m=_belief_m(center_m, draw),
        target_m=list(TARGET_M),
        rejected={"unsigned": 3, "stale": 12},
        decision_latency_ms=3.2 + draw.random(),
        alarms=[] if stale_tracker is None else [f"tracker {stale_tracker} is silent"],
    )


def _path_m(movements: int) -> list[list[float]]:
    path_m = [list(START_M)]
    for _ in range(movements):
        path_m.append([place + _choice_m(end - place) for place, end in zip(path_m[-1], TARGET_M, strict=True)])
    return path_m


def _choice_m(wanted_m: float) -> float:
    return min(DISPLACEMENT_CHOICES_M, key=lambda choice_m: abs(choice_m - wanted_m))


def _tracker(number: int, center_m: list[float], spacing_m: float, draw: random.Random, is_stale: bool) -> TrackerFrame:
    place_m = [center + spacing_m * axis for center, axis in zip(center_m, DIRECTIONS[number], strict=True)]
    level_dbm = -40 - 20 * math.log10(max(1.0, math.dist(place_m, TARGET_M)))
    rssi_dbm: list[float | None] = [round(level_dbm + draw.gauss(0, 2.5), 2) for _ in range(50)]
    if is_stale:
        rssi_dbm[20:] = [None] * 30
    for lost in draw.sample(range(50), 2):
        rssi_dbm[lost] = None
    return TrackerFrame(
        position_m=[round(one + draw.gauss(0, 0.15), 3) for one in place_m],
        set_point_m=[one + 0.8 for one in place_m],
        mode="holding" if is_stale else "following",
        position_age_s=0.1,
        rssi_age_s=4.3 if is_stale else round(draw.uniform(0.01, 0.12), 2),
        is_lost=False,
        is_silent=is_stale,
        loss_share=0.37 if is_stale else round(draw.uniform(0, 0.04), 3),
        missing_share=0.62 if is_stale else 0.04,
        rssi_dbm=rssi_dbm,
        dropped={},
    )


def _decision(movements: int, path_m: list[list[float]]) -> DecisionFrame:
    displacement_m = [now - before for now, before in zip(path_m[-1], path_m[-2], strict=True)]
    shares = []
    for choices_m, taken_m in [(SPACING_CHOICES_M, 4.0), *((DISPLACEMENT_CHOICES_M, one) for one in displacement_m)]:
        weights = [math.exp(-abs(choice_m - taken_m) / (1.0 + 0.4 * len(shares))) for choice_m in choices_m]
        shares.append([round(weight / sum(weights), 4) for weight in weights])
    return DecisionFrame(
        movement=movements, spacing_m=4.0, displacement_m=displacement_m, changed="", choice_share=shares
    )


def _belief_m(center_m: list[float], draw: random.Random) -> list[list[float]]:
    spread_m = 3.0 + 0.12 * math.dist(center_m, TARGET_M)
    return [[round(draw.gauss(axis, spread_m), 1) for axis in TARGET_M] for _ in range(200)]
