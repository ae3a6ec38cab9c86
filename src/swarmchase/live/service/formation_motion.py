"""How a formation moves as a whole: its velocity goes to a wanted one as in the environment, its spacing and its cross
change beside that, and its goals are where its trackers come to rest if they brake now.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch

from ...flight import flown
from .orders import LONGEST_VALID_S, Braking
from .safety import formation_m
from .sample_window import Point, Points

SPREADING_MPS = 2.0
"""No faster does the spacing change."""


@dataclass(frozen=True, eq=False)
class FormationMotion:
    """At one moment. Metres are of the shared frame."""

    braking: Braking
    center_m: Point
    velocity_mps: Point
    spacing_m: float
    turned_rad: float = 0.0
    """How far the cross has turned,"""
    turn_rad_per_s: float = 0.0
    """and how fast it does."""

    @property
    def speed_mps(self) -> float:
        """Of the centre."""
        return float(np.linalg.norm(self.velocity_mps))

    @property
    def rest_m(self) -> Point:
        """Where the centre comes to rest if all brake now."""
        return np.asarray(self.center_m + self.braking.rest_m(self.velocity_mps))

    @property
    def rest_rad(self) -> float:
        """How far the cross has turned then, which takes v / 2 b at the speed of now."""
        return self.turned_rad + self.turn_rad_per_s * self.speed_mps / (2 * self.braking.nominal_mps2)

    @property
    def places_m(self) -> Points:
        """Of its trackers [tracker, 3]."""
        return formation_m(self.center_m, self.spacing_m, self.turned_rad)

    @property
    def goals_m(self) -> Points:
        """Where they come to rest [tracker, 3]."""
        return formation_m(self.rest_m, self.spacing_m, self.rest_rad)

    def goals_mps(self, wanted_mps: Point) -> Point:
        """With which the goals move on, as it is meant now: on average over as long as a set-point may be valid."""
        after = self._changed(wanted_mps, LONGEST_VALID_S, self.braking.most_mps2)
        return np.asarray((after.rest_m - self.rest_m) / LONGEST_VALID_S)

    def flown(
        self, wanted_mps: Point, wanted_spacing_m: float, elapsed_s: float, turn_share: float
    ) -> "FormationMotion":
        """So much later, with this share of its acceleration."""
        most_m = SPREADING_MPS * elapsed_s
        spread_m = min(max(wanted_spacing_m - self.spacing_m, -most_m), most_m)
        return replace(
            self._changed(wanted_mps, elapsed_s, turn_share * self.braking.most_mps2),
            spacing_m=self.spacing_m + spread_m,
            turned_rad=self.turned_rad + self.turn_rad_per_s * elapsed_s,
        )

    def braked(self, elapsed_s: float) -> "FormationMotion":
        """So much later; the goals stay where they are."""
        after = self._changed(np.zeros(3), elapsed_s, self.braking.nominal_mps2)
        return replace(after, turned_rad=self.turned_rad + self.rest_rad - after.rest_rad)

    def _changed(self, wanted_mps: Point, elapsed_s: float, acceleration_mps2: float) -> "FormationMotion":
        before_m, before_mps, wanted = (
            torch.from_numpy(vector)[None] for vector in (self.center_m, self.velocity_mps, wanted_mps)
        )
        seconds = torch.tensor([elapsed_s], dtype=torch.float64)
        center_m, velocity_mps = flown(before_m, before_mps, wanted, seconds, acceleration_mps2)
        return replace(self, center_m=center_m[0].numpy(), velocity_mps=velocity_mps[0].numpy())
