"""A real radio map to chase over: what was recorded at places, of several emitters.

It is two tables in a folder, which ``nearness`` reads. A tracker hears, and is said to be, at the place nearest to
where it would be; of the levels recorded there, a window is drawn as they followed one another.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..formation import TRACKER_DIRECTION

FARTHER_THAN_M = 6.7
"""A chase does not start nearer to its emitter: in the furnished hall of 81 places that leaves 44 of 48."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RadioMap:
    """What ``nearness.read_map`` returns."""

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
