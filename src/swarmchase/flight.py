"""How anything moves that flies, swarm and target alike: its velocity goes straight to the wanted one at a limited
acceleration, and stays there. In closed form, so that a place within an interval is as exact as the one at its end.
"""

import math

import torch

from .batch.array_types import Float, Tensor

FLIGHT_STEP_S = 0.05
"""So often a target that flies looks where the swarm is, and decides where to fly."""

_SHORTEST_S = torch.finfo(torch.float64).tiny


def flown(
    position_m: Float[Tensor, "chase 3"],
    velocity_mps: Float[Tensor, "chase 3"],
    wanted_mps: Float[Tensor, "chase 3"],
    seconds: Float[Tensor, "chase *moment"],
    acceleration_mps2: float | None,
) -> tuple[Float[Tensor, "chase *moment 3"], Float[Tensor, "chase *moment 3"]]:
    """Positions in metres and velocities in metres a second, each moment so many seconds after the start, float64.

    ``acceleration_mps2 = None`` changes the velocity at once. After 0 seconds nothing has changed, to the last bit.
    """
    at_all_moments = (len(position_m), *(1,) * (seconds.dim() - 1), 3)
    position_m, velocity_mps, wanted_mps = (
        vector.reshape(at_all_moments) for vector in (position_m, velocity_mps, wanted_mps)
    )
    turn_s = length(wanted_mps - velocity_mps) / (math.inf if acceleration_mps2 is None else acceleration_mps2)
    # The shortest time there is stands for none: 0 seconds of it are none of it, any more are all of it.
    turn_s = turn_s.clamp_min_(_SHORTEST_S)
    share = (seconds / turn_s).clamp_max_(1.0)[..., None]
    turning_s = share * turn_s[..., None]
    velocity_after_mps = torch.lerp(velocity_mps, wanted_mps, share)
    turned_m = (velocity_mps + velocity_after_mps) * (turning_s / 2)
    return position_m + turned_m + wanted_mps * (seconds[..., None] - turning_s), velocity_after_mps


def first_within_s(
    offset_m: Float[Tensor, "chase moment 3"], time_s: Float[Tensor, "chase moment"], radius_m: float
) -> Float[Tensor, "chase"]:
    """When the offset between two that fly is first at most ``radius_m`` long; infinite where it never is.

    ``offset_m`` is what lies between them at each of two or more moments, ``time_s``; from moment to moment it changes
    evenly, which over a flight step errs by a few millimetres.
    """
    before_m, after_m = offset_m[:, :-1], offset_m[:, 1:]
    way_m = after_m - before_m
    # |before + share way|^2 = radius^2: the smaller root, in the form that does not cancel.
    nearing = -(before_m * way_m).sum(dim=-1)
    excess = before_m.square().sum(dim=-1) - radius_m**2
    discriminant = nearing.square() - way_m.square().sum(dim=-1) * excess
    share = excess / (nearing + discriminant.clamp_min(0.0).sqrt())
    passes = (discriminant >= 0) & (nearing > 0) & (share <= 1)
    is_there = excess <= 0
    # The end is looked at by itself: rounding must not lose who just reaches it.
    arrives = length(after_m) <= radius_m
    share = torch.where(is_there, 0.0, torch.where(passes, share, 1.0))
    reached_s = torch.lerp(time_s[:, :-1], time_s[:, 1:], share)
    first_s: Tensor = torch.where(is_there | passes | arrives, reached_s, torch.inf).amin(dim=1)
    return first_s


def least_m(offset_m: Float[Tensor, "chase moment 3"]) -> Float[Tensor, "chase"]:
    """The least length of an offset that changes evenly from each moment to the next."""
    before_m, way_m = offset_m[:, :-1], offset_m.diff(dim=1)
    nearing = -(before_m * way_m).sum(dim=-1)
    share = (nearing / way_m.square().sum(dim=-1).clamp_min(_SHORTEST_S)).clamp(0.0, 1.0)
    return length(before_m + share[..., None] * way_m).amin(dim=1)


def intercept_s(
    offset_m: Float[Tensor, "chase 3"], velocity_mps: Float[Tensor, "chase 3"], speed_mps: float
) -> Float[Tensor, "chase"]:
    """When one that flies at ``speed_mps``, in whatever direction, first meets what is at this offset from it and keeps
    this velocity: |offset + velocity t| = speed t. Infinite where it never does.
    """
    a = velocity_mps.square().sum(dim=-1) - speed_mps**2
    b = (offset_m * velocity_mps).sum(dim=-1)
    c = offset_m.square().sum(dim=-1)
    root = (b.square() - a * c).sqrt()
    # Both roots of a t^2 + 2 b t + c = 0, in the form that stands a = 0.
    times_s = torch.stack([c / (root - b), c / (-root - b)])
    first_s = torch.where((times_s >= 0) & times_s.isfinite(), times_s, torch.inf).amin(dim=0)
    return torch.where(c == 0, 0.0, first_s)


def length(vector: Float[Tensor, "*batch xyz"]) -> Float[Tensor, "*batch"]:
    """Of each vector."""
    lengths: Tensor = torch.linalg.vector_norm(vector, dim=-1)
    return lengths


def direction(vector: Float[Tensor, "*batch xyz"]) -> Float[Tensor, "*batch xyz"]:
    """The unit vector of each; of nothing it is nothing."""
    return vector / length(vector).clamp_min_(_SHORTEST_S)[..., None]
