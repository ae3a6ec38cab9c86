"""What real receivers heard, to drive controllers with: paths that were flown or walked, and ways over a radio map.

A path is a file of a folder: a table or JSON of one receiver's levels once a second, with its place and that of the
emitter, as the field tests of IQTLabs/BirdsEye have them (Apache-2.0; geographic degrees). Five of the six trackers
are silent. Controllers that stop to listen take the target to stand still, so a path is cut where the emitter has
gone; the altitude is not recorded, and taken to be the same.

Over a radio map (``radio_map``) the swarm goes ways that do not depend on a controller.
"""

import csv
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import InputError
from ..scenario import NUM_TRACKERS
from .radio_map import RadioMap

WINDOW_LEVELS = 5
"""Of a path once a second: a walker goes as many metres in it."""
TICKS_A_LEVEL = 10
"""Controllers take windows of 50 samples: of ten, one was heard."""
GONE_M = 10.0
"""An emitter that is farther than this from where it was at the beginning has gone. Its GNSS is rounded to 11 m."""
EXPONENTS = 1.5, 4.5
"""Of a path loss that is told: a fit to few distances may give any."""
FEWEST_WINDOWS = 5
"""A shorter piece is left out."""
M_PER_DEGREE = 110_540.0, 111_320.0
"""Of latitude, and of longitude at the equator."""
SURVEY_STEP_M = 4.0
"""Of the swarm over a radio map, as far as it goes along an axis in one movement."""
SURVEY_SPACING_M = 3.0

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Recording:
    """One piece of a path: what was heard at which places, in the frame of its first one."""

    name: str
    path: str
    """Which it is a piece of."""
    rssi_dbm: Array
    """[window, sample, tracker]; NaN where a tracker heard nothing."""
    tracker_position_m: Array
    """[window, sample, tracker, xyz]."""
    target_position_m: Array
    """[window, xyz]."""
    sampling_hz: float

    @property
    def distance_m(self) -> Array:
        """From each sample's place to the target [window, sample, tracker]."""
        distance_m: Array = np.linalg.norm(self.tracker_position_m - self.target_position_m[:, None, None], axis=3)
        return distance_m


def read_paths(folder: Path) -> list[Recording]:
    """The pieces of all paths in a folder; files of another kind are passed over.

    Raises:
        InputError: a file cannot be read, or there is no path.
    """
    recordings = []
    try:
        for file in sorted(folder.iterdir()):
            rows = _rows(file)
            if rows:
                recordings += _pieces(file.stem, np.array(rows))
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{folder} holds no recorded paths: {type(error).__name__}: {error}") from error
    if not recordings:
        raise InputError(f"{folder} holds no recorded paths")
    return recordings


def fitted_path_loss(recordings: list[Recording]) -> tuple[float, float]:
    """Level in dBm at 1 m and exponent of the path loss that fits best, the exponent between those of
    ``EXPONENTS``."""
    rssi_dbm = np.concatenate([recording.rssi_dbm.ravel() for recording in recordings])
    distance_m = np.concatenate([recording.distance_m.ravel() for recording in recordings])
    log_distance = np.log10(np.maximum(distance_m, 1.0))[np.isfinite(rssi_dbm)]
    level_dbm = rssi_dbm[np.isfinite(rssi_dbm)]
    exponent = float(np.clip(np.polyfit(log_distance, level_dbm, 1)[0] / -10, *EXPONENTS))
    return float((level_dbm + 10 * exponent * log_distance).mean()), exponent


def _rows(file: Path) -> list[tuple[float, ...]]:
    """Time in seconds, latitude and longitude of receiver and emitter, level; nothing of a file of another kind."""
    if file.suffix == ".csv":
        columns = ("t_unix", "rx_lat", "rx_lon", "drone_lat", "drone_lon", "rssi_dbm")
        with open(file, newline="", encoding="utf-8") as lines:
            table = csv.DictReader(lines)
            if not set(columns) <= set(table.fieldnames or ()):
                return []
            return [tuple(float(row[name] or "nan") for name in columns) for row in table]
    if file.suffix != ".json":
        return []
    records: dict[str, dict[str, Any]] = json.loads(file.read_text(encoding="utf-8"))
    return [
        tuple(map(float, (time_s, *record["position"], *reversed(record["drone_position"]), record["rssi"])))
        for time_s, record in sorted(records.items(), key=lambda item: float(item[0]))
    ]


def _pieces(name: str, row: Array) -> list[Recording]:
    """Windows of ``WINDOW_LEVELS`` one after another, cut where the emitter has gone."""
    row = row[: len(row) // WINDOW_LEVELS * WINDOW_LEVELS]
    scale = np.array([math.cos(math.radians(row[0, 1])) * M_PER_DEGREE[1], M_PER_DEGREE[0]])
    receiver_m, emitter_m = (row[:, at][:, ::-1] * scale for at in (slice(1, 3), slice(3, 5)))
    window = len(row) // WINDOW_LEVELS
    target_m = emitter_m.reshape(window, WINDOW_LEVELS, 2)[:, -1]
    starts = [0]
    for at in range(1, window):
        if np.linalg.norm(target_m[at] - target_m[starts[-1]]) > GONE_M:
            starts.append(at)
    recordings = []
    for first, end in zip(starts, [*starts[1:], window], strict=True):
        if end - first < FEWEST_WINDOWS:
            continue
        rows = slice(first * WINDOW_LEVELS, end * WINDOW_LEVELS)
        here_m = receiver_m[rows] - receiver_m[rows][0]
        rssi_dbm = np.full((end - first, WINDOW_LEVELS * TICKS_A_LEVEL, NUM_TRACKERS), np.nan)
        rssi_dbm[:, ::TICKS_A_LEVEL, 0] = row[rows, 5].reshape(end - first, WINDOW_LEVELS)
        place_m = np.pad(here_m, ((0, 0), (0, 1))).reshape(end - first, WINDOW_LEVELS, 1, 3)
        recordings.append(
            Recording(
                name=f"{name}-{first}",
                path=name,
                rssi_dbm=rssi_dbm,
                tracker_position_m=np.repeat(np.repeat(place_m, TICKS_A_LEVEL, axis=1), NUM_TRACKERS, axis=2),
                target_position_m=np.pad(target_m[first:end] - receiver_m[rows][0], ((0, 0), (0, 1))),
                sampling_hz=float(TICKS_A_LEVEL),
            )
        )
    return recordings


def surveys(radio_map: RadioMap, draw: int, num_windows: int, sampling_hz: float, samples: int) -> list[Recording]:
    """From each start to each emitter that is far enough: to and fro over the whole map, row by row."""
    recordings = []
    for chase, (start_m, emitter) in enumerate(radio_map.chases()):
        generator = np.random.default_rng([draw, chase])
        way_m = _to_and_fro(start_m, radio_map.low_m, radio_map.high_m)[:num_windows]
        heard = [radio_map.heard(center_m, SURVEY_SPACING_M, emitter, samples, generator) for center_m in way_m]
        target_m = radio_map.emitter_m[emitter] - start_m
        recordings.append(
            Recording(
                name=f"survey-{chase}",
                path="survey",
                rssi_dbm=np.array([rssi_dbm for rssi_dbm, _ in heard]),
                tracker_position_m=np.array([np.repeat((at_m - start_m)[None], samples, axis=0) for _, at_m in heard]),
                target_position_m=np.repeat(target_m[None], len(way_m), axis=0),
                sampling_hz=sampling_hz,
            )
        )
    return recordings


def _to_and_fro(start_m: Array, low_m: Array, high_m: Array) -> Array:
    """[window, xyz] in rows along x, the first one from the start, in the plane of the start."""
    xs, ys = (np.arange(low, high + 1e-9, SURVEY_STEP_M) for low, high in zip(low_m[:2], high_m[:2], strict=True))
    middle_m = (low_m + high_m) / 2
    xs = xs if start_m[0] < middle_m[0] else xs[::-1]
    ys = ys if start_m[1] < middle_m[1] else ys[::-1]
    return np.array([(x, y, start_m[2]) for row, y in enumerate(ys) for x in (xs if row % 2 == 0 else xs[::-1])])
