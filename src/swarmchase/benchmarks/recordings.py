"""A controller on what real receivers heard: whether it goes the right way, and whether its belief is true.

Coverage alone is passed by an empty belief, so beside the share of decisions whose 95 % region (``controllers.belief``)
holds the truth stand the region's median radius and the belief's median error. A belief is sure and wrong where its
region is below ``SURE_M`` and its error above ``WRONG_M``. Decisions of one path depend on one another.

Controllers are told what fits a recording best (path loss by least squares with the true places; the true distance at
the start), or, ``guessed``, what somebody would say who knows nothing.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch

from ..controllers import load_controller
from ..controllers.belief import Believing
from ..controllers.condition import Condition
from ..errors import InputError
from ..evaluation.statistics import ratio_interval, share_interval
from ..observation import Observation
from ..reports.intervals import shown_share
from ..scenario import Scenario, paper_scenario
from .radio_map import RadioMap, fitted_scenario, read_map
from .recorded_levels import Recording, fitted_path_loss, read_paths, surveys

if TYPE_CHECKING:
    from rich.table import Table

SURE_M, WRONG_M = 5.0, 15.0
REACHED_M = 2.0
NEAREST_M = 6.0
"""The way to a target that is nearer is not judged: that is how well its place was recorded."""
HEIGHT_M = 2.0
"""Of the target above or below the swarm's start, at most."""
MOVEMENTS = 40
SAMPLES = 50
"""Of a window, as in Table I."""
SAMPLING_HZ = 10.0
GUESSED: dict[str, Any] = {"transmit_power_dbm": -15.0, "path_loss_exponent": 2.6, "start_distance_m": 20.0}
"""-45 dBm at 1 m."""

Array = npt.NDArray[np.float64]


@dataclass
class _Seen:
    """Of each decision; of a controller without belief only the ways."""

    held: list[bool] = field(default_factory=list)
    radius_m: list[float] = field(default_factory=list)
    error_m: list[float] = field(default_factory=list)
    off_deg: list[float] = field(default_factory=list)
    last: list[int] = field(default_factory=list)
    """Decisions that were the last of their path."""
    restarts: int = 0


class _Driven:
    """One chase of a controller, window by window."""

    def __init__(self, name: str, told: Scenario, seed: int, chase: int, seen: _Seen) -> None:
        self._controller = load_controller(name, told)
        self._memory = self._controller.begin(1, seed, chase)
        self._seen = seen

    def displacement_m(self, rssi_dbm: Array, position_m: Array, target_m: Array) -> tuple[Array, float]:
        """How far it moves after this window [sample, tracker], and its spacing; ``target_m`` is the truth."""
        observation = Observation(torch.from_numpy(rssi_dbm)[None].float(), torch.from_numpy(position_m)[None])
        action, self._memory = self._controller.decide(observation, self._memory)
        displacement_m = action.displacement_m[0].numpy()
        seen, target = self._seen, torch.from_numpy(target_m)[None]
        if isinstance(self._controller, Believing):
            belief = self._controller.belief(self._memory)
            seen.held.append(bool(belief.holds(target)[0]))
            seen.radius_m.append(float(belief.radius_m[0]))
            seen.error_m.append(float(belief.error_m(target)[0]))
        way_m = (target_m - position_m[-1].mean(axis=0))[:2]
        if np.linalg.norm(way_m) > NEAREST_M:
            seen.off_deg.append(_angle_deg(displacement_m[:2], way_m))
        condition = getattr(self._memory, "condition", None)
        seen.restarts += condition is not None and int(condition[0]) == Condition.LOST
        return displacement_m, float(action.spacing_m[0])

    def ended(self) -> None:
        """That was the last decision."""
        self._seen.last.append(len(self._seen.radius_m) - 1)


def measure(
    controller: str,
    radio_map: Path | None,
    paths: Path | None,
    draws: list[int],
    guessed: bool,
    finished: Callable[[], None],
) -> dict[str, Any]:
    """What is measured of each recording, and of chases over the map; ``finished`` is told of each draw of the map.

    Raises:
        InputError: nothing to measure, no such recordings, or no such controller.
    """
    if radio_map is None and paths is None:
        raise InputError("give a radio map or recorded paths")
    result: dict[str, Any] = {"controller": controller, "told": "guessed" if guessed else "fitted"}
    if radio_map is not None:
        emitter_m, place_m, rssi_dbm = read_map(radio_map)
        distance_m = np.linalg.norm(place_m[:, None] - emitter_m, axis=2)
        told = replace(fitted_scenario(distance_m, rssi_dbm)[0], sampling_hz=SAMPLING_HZ)
        over = RadioMap(emitter_m, place_m, rssi_dbm)
        result |= {"chases": [], "surveys": []}
        for draw in draws:
            result["chases"].append(_chases(controller, over, told, draw, guessed))
            survey = surveys(over, draw, MOVEMENTS, SAMPLING_HZ, SAMPLES)
            result["surveys"].append({"draw": draw} | _driven(controller, survey, told, guessed))
            finished()
    if paths is not None:
        result["paths"] = {}
        recordings = read_paths(paths)
        for recording in recordings:
            at_1_m_dbm, exponent = fitted_path_loss([one for one in recordings if one.path == recording.path])
            table_1 = paper_scenario()
            told = replace(
                table_1,
                transmit_power_dbm=at_1_m_dbm + table_1.reference_path_loss_db,
                path_loss_exponent=exponent,
                sampling_hz=recording.sampling_hz,
            )
            result["paths"][recording.name] = _driven(controller, [recording] * len(draws), told, guessed)
    return result


def _driven(controller: str, recordings: list[Recording], told: Scenario, guessed: bool) -> dict[str, Any]:
    """Along paths that do not heed it."""
    seen = _Seen()
    for chase, recording in enumerate(recordings):
        samples = recording.rssi_dbm.shape[1]
        start_m = float(np.linalg.norm(recording.target_position_m[0]))
        told_here = replace(_told(told, start_m, guessed), sampling_hz=recording.sampling_hz, window_samples=samples)
        driven = _Driven(controller, told_here, 0, chase, seen)
        for rssi_dbm, position_m, target_m in zip(
            recording.rssi_dbm, recording.tracker_position_m, recording.target_position_m, strict=True
        ):
            driven.displacement_m(rssi_dbm, position_m, target_m)
        driven.ended()
    return _summary(seen)


def _chases(controller: str, over: RadioMap, told: Scenario, draw: int, guessed: bool) -> dict[str, Any]:
    """The closed loop: what it hears depends on where it goes."""
    seen = _Seen()
    nearest_m, final_m = [], []
    for chase, (start_m, emitter) in enumerate(over.chases()):
        generator = np.random.default_rng([draw, chase])
        target_m = over.emitter_m[emitter]
        told_here = _told(told, float(np.linalg.norm(target_m - start_m)), guessed)
        driven = _Driven(controller, told_here, draw, chase, seen)
        center_m, spacing_m = start_m.copy(), told.initial_spacing_m
        distance_m = []
        for _ in range(MOVEMENTS):
            rssi_dbm, place_m = over.heard(center_m, spacing_m, emitter, SAMPLES, generator)
            position_m = np.repeat((place_m - start_m)[None], SAMPLES, axis=0)
            displacement_m, spacing_m = driven.displacement_m(rssi_dbm, position_m, target_m - start_m)
            # All places are on one plane, and nobody leaves the hall.
            center_m[:2] = np.clip(center_m[:2] + displacement_m[:2], over.low_m[:2], over.high_m[:2])
            distance_m.append(float(np.linalg.norm(center_m - target_m)))
        driven.ended()
        nearest_m.append(min(distance_m))
        final_m.append(distance_m[-1])
    return {
        "draw": draw,
        "chases": len(final_m),
        "reached_share": float((np.array(nearest_m) <= REACHED_M).mean()),
        "reached_share_ci95": share_interval(int((np.array(nearest_m) <= REACHED_M).sum()), len(nearest_m)),
        "median_final_distance_m": float(np.median(final_m)),
        "p90_final_distance_m": float(np.percentile(final_m, 90)),
    } | _summary(seen)


def _told(told: Scenario, start_distance_m: float, guessed: bool) -> Scenario:
    """With the target's height known to within ``HEIGHT_M``."""
    height_m: dict[str, Any] = {
        "lowest_altitude_m": told.start_altitude_m - HEIGHT_M,
        "highest_altitude_m": told.start_altitude_m + HEIGHT_M,
    }
    start_m: dict[str, Any] = {"start_distance_m": start_distance_m}
    return replace(told, **height_m, **(GUESSED if guessed else start_m))


def _angle_deg(moved_m: Array, way_m: Array) -> float:
    """Between them; 180 where it did not move."""
    length_m = np.linalg.norm(moved_m) * np.linalg.norm(way_m)
    return math.degrees(math.acos(np.clip(moved_m @ way_m / length_m, -1, 1))) if length_m > 0 else 180.0


def _summary(seen: _Seen) -> dict[str, Any]:
    off_deg = np.array(seen.off_deg)
    summary: dict[str, Any] = {
        **{f"within_{limit}_deg_share": float((off_deg <= limit).mean()) for limit in (90, 45)},
        **{
            f"within_{limit}_deg_share_ci95": share_interval(int((off_deg <= limit).sum()), len(off_deg))
            for limit in (90, 45)
        },
        "judged_ways": len(off_deg),
        "restarts": seen.restarts,
    }
    if seen.held:
        radius_m, error_m = np.array(seen.radius_m), np.array(seen.error_m)
        summary |= {
            "decisions": len(radius_m),
            "coverage": float(np.mean(seen.held)),
            "coverage_ci95": _coverage_interval(seen),
            "median_radius_m": float(np.median(radius_m)),
            "median_final_radius_m": float(np.median(radius_m[seen.last])),
            "median_error_m": float(np.median(error_m)),
            "median_final_error_m": float(np.median(error_m[seen.last])),
            "sure_and_wrong": int(((radius_m < SURE_M) & (error_m > WRONG_M)).sum()),
        }
    return summary


def _coverage_interval(seen: _Seen) -> list[float] | None:
    """Of whole chases: decisions of one are alike."""
    chases = np.split(np.array(seen.held), [last + 1 for last in seen.last[:-1]])
    return ratio_interval(np.array([chase.sum() for chase in chases]), np.array([len(chase) for chase in chases]))


def table(result: dict[str, Any]) -> "Table":
    """What ``measure`` returned, for people."""
    from rich.table import Table

    shown = Table(title=f"{result['controller']} on recordings, told what is {result['told']}")
    columns = (
        "recording",
        "within 2 m",
        "final m: median, 90 %",
        "within 90 degrees",
        "within 45 degrees",
        "truth inside",
        "radius m: all, final",
        "error m: all, final",
        "sure and wrong",
        "restarts",
    )
    for column in columns:
        shown.add_column(column)
    rows = [(f"chases, draw {row['draw']}", row) for row in result.get("chases", [])]
    rows += [(f"surveys, draw {row['draw']}", row) for row in result.get("surveys", [])]
    for name, row in [*rows, *result.get("paths", {}).items()]:
        chased, believed = "reached_share" in row, "coverage" in row
        shown.add_row(
            name,
            shown_share(row["reached_share"], row["reached_share_ci95"], 0) if chased else "",
            f"{row['median_final_distance_m']:.1f}, {row['p90_final_distance_m']:.1f}" if chased else "",
            shown_share(row["within_90_deg_share"], row["within_90_deg_share_ci95"], 0),
            shown_share(row["within_45_deg_share"], row["within_45_deg_share_ci95"], 0),
            shown_share(row["coverage"], row["coverage_ci95"], 0) if believed else "",
            f"{row['median_radius_m']:.1f}, {row['median_final_radius_m']:.1f}" if believed else "",
            f"{row['median_error_m']:.1f}, {row['median_final_error_m']:.1f}" if believed else "",
            str(row["sure_and_wrong"]) if believed else "",
            str(row["restarts"]),
        )
    return shown
