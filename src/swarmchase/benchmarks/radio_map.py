"""A real radio map to chase over: what was recorded at places, of several emitters.

It is two tables in a folder: ``sensors.csv`` (sensor, x_m, y_m, z_m) and ``radio_map.csv`` (x_m, y_m, z_m, sensor,
rssi_dbm: levels in order of time, separated by blanks), made of set 1 of the Position-Annotated BLE RSSI Dataset
(F. S. Danis et al., Pervasive and Mobile Computing 81, 2022). By reciprocity each sensor is an emitter and each place
a receiver. A tracker hears, and is said to be, at the place nearest to
where it would be; of the levels recorded there, a window is drawn as they followed one another.
"""

import csv
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..errors import InputError
from ..formation import TRACKER_DIRECTION
from ..scenario import Scenario, paper_scenario

FARTHER_THAN_M = 6.7
"""A chase does not start nearer to its emitter: in the furnished hall of 81 places that leaves 44 of 48."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RadioMap:
    """What ``read_map`` returns."""

    emitter_m: Array
    """[emitter, xyz]."""
    place_m: Array
    """[place, xyz]."""
    rssi_dbm: Array
    """[place, emitter, sample]."""

    @property
    def low_m(self) -> Array:
        """The least coordinates of all places [xyz]."""
        low_m: Array = self.place_m.min(axis=0)
        return low_m

    @property
    def high_m(self) -> Array:
        """The greatest coordinates of all places [xyz]."""
        high_m: Array = self.place_m.max(axis=0)
        return high_m

    def chases(self) -> Iterator[tuple[Array, int]]:
        """The places next to the four corners, each with every emitter that is far enough from there."""
        for corner_m in itertools.product(*zip(self.low_m[:2], self.high_m[:2], strict=True)):
            start_m = self.place_m[np.linalg.norm(self.place_m[:, :2] - corner_m, axis=1).argmin()]
            for emitter, emitter_m in enumerate(self.emitter_m):
                if np.linalg.norm(emitter_m - start_m) > FARTHER_THAN_M:
                    yield start_m, emitter

    def heard(
        self, center_m: Array, spacing_m: float, emitter: int, samples: int, generator: np.random.Generator
    ) -> tuple[Array, Array]:
        """A window [sample, tracker] of a swarm around there, and the places of its trackers [tracker, xyz]."""
        wanted_m = center_m + spacing_m * TRACKER_DIRECTION.numpy()
        place = np.linalg.norm(wanted_m[:, None] - self.place_m, axis=2).argmin(axis=1)
        first = generator.integers(self.rssi_dbm.shape[2] - samples + 1, size=len(place))
        at = first[:, None] + np.arange(samples)
        return self.rssi_dbm[place[:, None], emitter, at].T, self.place_m[place]


def read_map(folder: Path) -> tuple[Array, Array, Array]:
    """Emitters [emitter, xyz], places [place, xyz] and levels in dBm [place, emitter, sample].

    Raises:
        InputError: a table is missing, or holds something else.
    """
    try:
        with open(folder / "sensors.csv", newline="", encoding="utf-8") as file:
            emitters = {row["sensor"]: _point_m(row) for row in csv.DictReader(file)}
        with open(folder / "radio_map.csv", newline="", encoding="utf-8") as file:
            heard = {
                (_point_m(row), row["sensor"]): [float(level) for level in row["rssi_dbm"].split()]
                for row in csv.DictReader(file)
            }
        places = sorted({place for place, _ in heard})
        samples = min(len(levels) for levels in heard.values())
        rssi_dbm = [[heard[place, sensor][:samples] for sensor in emitters] for place in places]
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"{folder} holds no radio map: {type(error).__name__}: {error}") from error
    return np.array(list(emitters.values())), np.array(places), np.array(rssi_dbm)


def _point_m(row: dict[str, str]) -> tuple[float, float, float]:
    return float(row["x_m"]), float(row["y_m"]), float(row["z_m"])


def fitted_scenario(distance_m: Array, rssi_dbm: Array) -> tuple[Scenario, float]:
    """Table I with the path loss that fits the mean levels best (least squares), and the deviation that stays."""
    log_distance = np.log10(np.maximum(distance_m, 1.0)).ravel()
    level_dbm = rssi_dbm.mean(axis=2).ravel()
    slope, at_1_m_dbm = np.polyfit(log_distance, level_dbm, 1)
    scenario = paper_scenario(
        transmit_power_dbm=paper_scenario().reference_path_loss_db + float(at_1_m_dbm),
        path_loss_exponent=-float(slope) / 10,
    )
    return scenario, float(np.std(level_dbm - at_1_m_dbm - slope * log_distance))
