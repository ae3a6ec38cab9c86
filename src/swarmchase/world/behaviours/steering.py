"""What all targets that fly have in common: limits of speed, acceleration and altitude, and when they draw."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch

from ...batch.array_types import Bool, Float, Tensor
from ...batch.streams import ChaseStreams
from ...errors import InputError
from ...flight import direction, flown, length
from ...scenario import Scenario
from .protocol import Target

VERTICAL_SHARE = 0.5
"""Of the acceleration that a target may have, what it brakes with before an end of its altitude band."""
STEEPEST = 0.1
"""A course without an aim climbs or sinks at most this much of the way that it leads sideways."""


@dataclass(frozen=True)
class Band:
    """Where a target may fly: z in the chase's own frame, infinite where there is no limit."""

    lowest_m: float
    highest_m: float

    @classmethod
    def of(cls, scenario: Scenario) -> "Band":
        """The scenario's.

        Raises:
            InputError: the band has no height.
        """
        lowest_m, highest_m = scenario.lowest_altitude_m, scenario.highest_altitude_m
        band = cls(
            -math.inf if lowest_m is None else lowest_m - scenario.start_altitude_m,
            math.inf if highest_m is None else highest_m - scenario.start_altitude_m,
        )
        if band.lowest_m >= band.highest_m:
            raise InputError(
                f"lowest_altitude_m = {lowest_m:g} is refused: allowed is less than highest_altitude_m = {highest_m:g}"
            )
        return band

    @property
    def is_limited(self) -> bool:
        """Whether there is any limit."""
        return math.isfinite(self.lowest_m) or math.isfinite(self.highest_m)

    def inside_m(self, z_m: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """The nearest heights within the band."""
        return z_m.clamp(self.lowest_m, self.highest_m)


class Steering:
    """Flies targets to the velocities that they want, within the scenario's limits.

    Speed and acceleration are those of the whole vector. No target leaves the altitude band: it brakes in time, with
    ``VERTICAL_SHARE`` of its acceleration. One that starts outside flies no farther out.

    Raises:
        InputError: the scenario gives the target no speed, or an altitude band without height.
    """

    def __init__(self, scenario: Scenario) -> None:
        if scenario.target_speed_mps == 0:
            raise InputError(f"behaviour = {scenario.behaviour!r} needs a target_speed_mps that is greater than 0")
        self.speed_mps = scenario.target_speed_mps
        self.acceleration_mps2 = scenario.target_acceleration_mps2
        self.band = Band.of(scenario)
        self._alert_m = math.inf if scenario.alert_distance_m is None else scenario.alert_distance_m

    def if_alert(
        self, wanted_mps: Float[Tensor, "chase 3"], away_m: Float[Tensor, "chase 3"]
    ) -> Float[Tensor, "chase 3"]:
        """What a target wants that is so far away from the swarm's centre: to hover, until that is near enough."""
        return wanted_mps * (length(away_m) <= self._alert_m)[:, None]

    def flown(
        self, target: Target, wanted_mps: Float[Tensor, "chase 3"], seconds: Float[Tensor, "chase"], plan: Any = None
    ) -> Target:
        """The targets after they have flown towards these velocities, no faster than the scenario allows."""
        speed_mps = length(wanted_mps)[:, None]
        wanted_mps = wanted_mps * (self.speed_mps / speed_mps.clamp_min(self.speed_mps))
        if self.band.is_limited:
            wanted_mps = self._within_band_mps(target, wanted_mps, seconds)
        position_m, velocity_mps = flown(
            target.position_m, target.velocity_mps, wanted_mps, seconds, self.acceleration_mps2
        )
        return Target(position_m, velocity_mps, plan, target.streams)

    def _within_band_mps(
        self, target: Target, wanted_mps: Float[Tensor, "chase 3"], seconds: Float[Tensor, "chase"]
    ) -> Float[Tensor, "chase 3"]:
        """The velocities at the end of the step from which it still can brake within the band.

        Braking comes first; whatever acceleration it leaves goes sideways.
        """
        most_mps = self.acceleration_mps2 * seconds
        change_mps = wanted_mps - target.velocity_mps
        change_mps = change_mps * (most_mps / length(change_mps).clamp_min_(1e-12)).clamp_max_(1.0)[:, None]
        sideways_mps, z_m, climb_mps = change_mps[:, :2], target.position_m[:, 2], target.velocity_mps[:, 2]
        most_climb_mps, is_high = self._most_mps(climb_mps, self.band.highest_m - z_m, seconds)
        most_sink_mps, is_low = self._most_mps(-climb_mps, z_m - self.band.lowest_m, seconds)
        wanted_climb_mps = torch.minimum(climb_mps + change_mps[:, 2], most_climb_mps).maximum(-most_sink_mps)
        braking_mps = (wanted_climb_mps - climb_mps).abs()
        # Who must brake turns aside no farther than lets it brake with its share from the first moment on.
        most_mps = torch.where(is_high | is_low, torch.minimum(most_mps, braking_mps / VERTICAL_SHARE), most_mps)
        left_mps = (most_mps.square() - braking_mps.square()).clamp_min_(0.0).sqrt_()
        share = (left_mps / length(sideways_mps).clamp_min_(1e-12)).clamp_max_(1.0)
        sideways_mps = target.velocity_mps[:, :2] + sideways_mps * share[:, None]
        return torch.cat([sideways_mps, wanted_climb_mps[:, None]], dim=1)

    def _most_mps(
        self, speed_mps: Float[Tensor, "chase"], room_m: Float[Tensor, "chase"], seconds: Float[Tensor, "chase"]
    ) -> tuple[Float[Tensor, "chase"], Bool[Tensor, "chase"]]:
        """The most speed towards an end of the band, ``room_m`` away, after this step, and whether it must brake.

        v t + v^2 / 2 b = room where it flies no faster. Who does brakes with b, and had room for that before.
        """
        braking_mps2 = VERTICAL_SHARE * self.acceleration_mps2
        braking_mps = braking_mps2 * seconds
        safe_mps = (braking_mps.square() + 2 * braking_mps2 * room_m.clamp_min(0.0)).sqrt_() - braking_mps
        must_brake = speed_mps > safe_mps
        return torch.where(must_brake, (speed_mps - braking_mps).clamp_min_(0.0), safe_mps), must_brake


def drawn_course(drawn: Float[Tensor, "chase 2"]) -> Float[Tensor, "chase 3"]:
    """Unit vectors in any bearing, climbing or sinking a little, from numbers in [0, 1)."""
    heading_rad = 2 * math.pi * drawn[:, 0]
    climb = STEEPEST * (2 * drawn[:, 1] - 1)
    return direction(torch.stack([heading_rad.cos(), heading_rad.sin(), climb], dim=1))


def turned(
    vector: Float[Tensor, "chase 2"], angle_rad: Float[Tensor, "chase"]
) -> tuple[Float[Tensor, "chase"], Float[Tensor, "chase"]]:
    """x and y of vectors after a turn to the left."""
    x, y = vector[:, 0], vector[:, 1]
    cosine, sine = angle_rad.cos(), angle_rad.sin()
    return x * cosine - y * sine, x * sine + y * cosine


def drawn_where(
    due: Bool[Tensor, "chase"], streams: ChaseStreams, draw: Callable[[ChaseStreams], Float[Tensor, "due number"]]
) -> Float[Tensor, "chase number"]:
    """What the chases that are due draw, float64; zeros for the others, whose random numbers stay where they are."""
    rows = due.nonzero()[:, 0]
    drawn = draw(streams.select(rows.tolist())).to(due.device, torch.float64)
    return drawn.new_zeros(len(due), drawn.shape[1]).index_copy_(0, rows, drawn)
