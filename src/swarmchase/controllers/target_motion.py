"""Where a target that may do anything may be, and how it moves on: the modes of a jump Markov system.

Each particle stands still, flies on as it does, manoeuvres, or flees straight away from the swarm; at any moment it may
change over to another (as of the interacting multiple models of Blom and Bar-Shalom 1988, in its particle form of
McGinnity and Irwin 2000). ``particle`` knows the same modes but the last, and has its own rates.
"""

import math

import torch

from ..batch.array_types import Float, Int, Tensor
from ..batch.streams import ChaseStreams
from ..scenario import Scenario

STILL, STEADY, MANOEUVRING, FLEEING = range(4)
"""The modes."""
START_SHARE = (0.3, 0.3, 0.2, 0.2)
"""Of the particles that begin in each mode."""
CHANGES_PER_S = (0.05, 0.2, 0.4, 0.1)
"""How often each mode ends."""
NEXT_SHARE = ((0.0, 0.5, 0.25, 0.25), (0.2, 0.0, 0.6, 0.2), (0.2, 0.6, 0.0, 0.2), (0.2, 0.2, 0.6, 0.0))
"""What follows each mode."""
ACCELERATION_MPS2 = (0.0, 0.3, 3.0, 0.3)
"""Standard deviation in each mode, on each level axis; it holds for ``HOLDS_S``."""
HOLDS_S = 0.5
SPEED_SPREAD_MPS = 4.0
"""Standard deviation of a flying target's velocity on each level axis, when nothing is known of it."""
CLIMB_SHARE = 0.4
"""Of all that, on the vertical axis."""
FASTEST_MPS = 10.0


class TargetBand:
    """The places at which the scenario lets targets start and fly."""

    def __init__(self, scenario: Scenario) -> None:
        self.lowest_m, self.highest_m = (
            default if altitude_m is None else altitude_m - scenario.start_altitude_m
            for altitude_m, default in (
                (scenario.lowest_altitude_m, -math.inf),
                (scenario.highest_altitude_m, math.inf),
            )
        )
        self._highest_sine = math.sin(math.radians(scenario.highest_elevation_deg))

    def drawn_m(
        self, streams: ChaseStreams, distance_m: Float[Tensor, "chase 1 particle"]
    ) -> Float[Tensor, "chase 3 particle"]:
        """At these distances from the origin, wherever targets may start."""
        towards = streams.standard_normal(3, distance_m.shape[2])
        towards = towards / length(towards).clamp(min=1e-9)
        # The height of a place that is uniform on a sphere is uniform (Archimedes), and so it is on any belt of it.
        highest_m = distance_m * self._highest_sine
        lowest_m, highest_m = (-highest_m).clamp(min=self.lowest_m), highest_m.clamp(max=self.highest_m)
        z_m = torch.lerp(lowest_m, highest_m, (towards[:, 2:] + 1) / 2)
        level = towards[:, :2] / towards[:, :2].square().sum(dim=1, keepdim=True).sqrt().clamp(min=1e-9)
        level_m = level * (distance_m.square() - z_m.square()).clamp(min=0.0).sqrt()
        return torch.cat([level_m, z_m], dim=1)

    def inside_m(self, position_m: Float[Tensor, "chase 3 particle"]) -> Float[Tensor, "chase 3 particle"]:
        """At the altitudes at which targets fly; changes what it is given."""
        position_m[:, 2].clamp_(self.lowest_m, self.highest_m)
        return position_m


class TargetMotion:
    """What particles do between two decisions."""

    def __init__(self, scenario: Scenario) -> None:
        self._band = TargetBand(scenario)
        self._changes_per_s = torch.tensor(CHANGES_PER_S)
        self._acceleration_mps2 = torch.tensor(ACCELERATION_MPS2)
        self._axis_share = torch.tensor([1.0, 1.0, CLIMB_SHARE])[:, None]
        self._next_edge = torch.tensor(NEXT_SHARE).cumsum(dim=1)[:, :3].contiguous()
        self._start_edge = torch.tensor(START_SHARE).cumsum(dim=0)[:3]

    def begun(
        self, streams: ChaseStreams, num_particles: int
    ) -> tuple[Float[Tensor, "chase 3 particle"], Int[Tensor, "chase particle"]]:
        """Velocities and modes of targets of which nothing is known."""
        drawn = streams.uniform(num_particles).float()
        mode = (drawn[..., None] >= self._start_edge).sum(dim=2)
        velocity_mps = slowed(streams.standard_normal(3, num_particles) * (SPEED_SPREAD_MPS * self._axis_share))
        return torch.where((mode == STILL)[:, None], 0.0, velocity_mps), mode

    def moved(
        self,
        position_m: Float[Tensor, "chase 3 particle"],
        velocity_mps: Float[Tensor, "chase 3 particle"],
        mode: Int[Tensor, "chase particle"],
        center_m: Float[Tensor, "chase 3"],
        lasted_s: Float[Tensor, "chase"],
        streams: ChaseStreams,
    ) -> tuple[Float[Tensor, "chase 3 particle"], Float[Tensor, "chase 3 particle"], Int[Tensor, "chase particle"]]:
        """Place, velocity and mode of particles so many seconds later, the swarm's centre being here."""
        lasted = lasted_s.float()[:, None]
        drawn = streams.uniform(2, mode.shape[1]).float()
        change = drawn[:, 0] < -(-each(self._changes_per_s, mode) * lasted).expm1()
        edge = self._next_edge.index_select(0, mode.flatten()).view(*mode.shape, 3)
        following = torch.where(change, (drawn[:, 1, :, None] >= edge).sum(dim=2), mode)
        # What holds for a short time adds up like a random walk.
        gained_mps = each(self._acceleration_mps2, following) * (lasted * HOLDS_S).sqrt()
        starts = (change & (mode == STILL))[:, None]
        spread_mps = torch.where(starts, SPEED_SPREAD_MPS, gained_mps[:, None])
        normal = streams.standard_normal(3, mode.shape[1]) * self._axis_share
        away_m = position_m - center_m.float()[..., None]
        fled_mps = away_m * (length(velocity_mps) / length(away_m).clamp(min=1e-3))
        wanted_mps = torch.where((following == FLEEING)[:, None], fled_mps, velocity_mps)
        later_mps = slowed(wanted_mps + normal * spread_mps)
        later_mps = torch.where((following == STILL)[:, None], 0.0, later_mps)
        position_m = position_m + (velocity_mps + later_mps) * (lasted / 2)[:, None]
        return self._band.inside_m(position_m), later_mps, following


def each(table: Tensor, index: Int[Tensor, "chase particle"]) -> Tensor:
    """``table[index]``; five times as fast."""
    return table.index_select(0, index.flatten()).view(index.shape)


def length(vector: Float[Tensor, "chase 3 particle"]) -> Float[Tensor, "chase 1 particle"]:
    """Of each vector."""
    return vector.square().sum(dim=1, keepdim=True).sqrt()


def slowed(velocity_mps: Float[Tensor, "chase 3 particle"]) -> Float[Tensor, "chase 3 particle"]:
    """To ``FASTEST_MPS`` where it is faster."""
    return velocity_mps * (FASTEST_MPS / length(velocity_mps).clamp(min=FASTEST_MPS))
