"""What a controller with a belief says of it for the whole batch: where the target is, and how sure it is of that.

Its 95 % region is an ellipsoid about the mean, shaped like the covariance, and so large that 95 % of the belief is
inside. Of a Gaussian belief that is the ellipsoid of the chi-squared distribution; of particles it is the one that
holds 95 % of their weight, so that a belief of any shape is held to what it says itself.
"""

import functools
import math
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray

from ..batch.array_types import Bool, Float, Tensor
from ..flight import least_m

REGION_SHARE = 0.95
"""Of the belief, inside its region."""
GAUSSIAN_REACH = 7.814728
"""The quantile of the chi-squared distribution with three degrees of freedom: squared standard deviations."""
LEAST_VARIANCE_M2 = 1e-6
"""On every axis: what is known better than to a millimetre counts as known to a millimetre."""
SHARE_POINTS, SHARE_SEED = 500, 1 << 61
"""Points of a standard normal by which it is counted how much of a belief lies somewhere; always the same ones."""


@dataclass(frozen=True)
class Belief:
    """Where the target was when the last sample was taken, in the chase's own frame, float64."""

    mean_m: Float[Tensor, "chase 3"]
    covariance_m2: Float[Tensor, "chase 3 3"]
    """Positive definite."""
    reach: Float[Tensor, "chase"]
    """What squared Mahalanobis distance from the mean the region goes to; ``GAUSSIAN_REACH`` of a Gaussian belief."""
    velocity_mps: Float[Tensor, "chase 3"] | None = None
    """Of the target, on average; None where it is taken to stand."""

    def holds(self, position_m: Float[Tensor, "chase 3"]) -> Bool[Tensor, "chase"]:
        """Whether these places are inside the region."""
        apart_m = (position_m - self.mean_m)[..., None]
        is_held: Tensor = _squared_distance(self.covariance_m2, apart_m)[:, 0] <= self.reach
        return is_held

    def error_m(self, position_m: Float[Tensor, "chase 3"]) -> Float[Tensor, "chase"]:
        """From the mean to these places."""
        error_m: Tensor = torch.linalg.vector_norm(position_m - self.mean_m, dim=1)
        return error_m

    def from_target_m(
        self, center_m: Float[Tensor, "chase moment 3"], age_s: Float[Tensor, "chase moment"]
    ) -> Float[Tensor, "chase moment 3"]:
        """How far a way through these places, so long ago, was from a target at the mean that has flown straight on."""
        apart_m = center_m - self.mean_m[:, None]
        return apart_m if self.velocity_mps is None else apart_m + self.velocity_mps[:, None] * age_s[..., None]

    def share_passed(
        self, center_m: Float[Tensor, "chase moment 3"], age_s: Float[Tensor, "chase moment"], radius_m: float
    ) -> Float[Tensor, "chase"]:
        """How much of the belief was at some moment at most so far from a way, as if the belief were Gaussian.

        Args:
            center_m: the way, straight between two or more places.
            age_s: how long before the last sample it was at each of them. Until then the target has flown straight.
        """
        points_m = _normal_points() @ torch.linalg.cholesky(self.covariance_m2).mT
        apart_m = self.from_target_m(center_m, age_s)[:, None] - points_m[:, :, None]
        within: Tensor = least_m(apart_m.flatten(0, 1)) <= radius_m
        return within.view(len(center_m), -1).double().mean(dim=1)

    @property
    def radius_m(self) -> Float[Tensor, "chase"]:
        """The longest half axis of the region."""
        longest_m2: Tensor = torch.linalg.eigvalsh(self.covariance_m2)[:, -1]
        return (longest_m2 * self.reach).sqrt()


@runtime_checkable
class Believing(Protocol):
    """A controller that can say its belief; not all have one."""

    def belief(self, memory: Any) -> Belief:
        """What it believes, from the memory that ``decide`` returned."""


def belief_of_particles(
    position_m: Float[Tensor, "chase 3 particle"],
    weight: Float[Tensor, "chase particle"] | None = None,
    velocity_mps: Float[Tensor, "chase 3 particle"] | None = None,
) -> Belief:
    """The belief of particles with these weights, which add up to 1; None where all weigh the same.

    Args:
        velocity_mps: of particles that fly, which all weigh the same.
    """
    position_m = position_m.double()
    share = torch.full_like(position_m[:, 0], 1 / position_m.shape[2]) if weight is None else weight.double()
    # Sums of products throughout: a product of matrices rounds otherwise in another batch. In double precision: where
    # two particles far apart weigh nearly all, single precision rounds by more than the least variance.
    mean_m = (position_m * share[:, None]).sum(dim=2)
    apart_m = position_m - mean_m[..., None]
    weighed_m = apart_m * share[:, None]
    rows_m2 = [(weighed_m * apart_m[:, axis, None]).sum(dim=2) for axis in range(3)]
    covariance_m2 = torch.stack(rows_m2, dim=1)
    covariance_m2 = (covariance_m2 + covariance_m2.mT) / 2
    covariance_m2 = covariance_m2 + LEAST_VARIANCE_M2 * torch.eye(3, dtype=torch.float64, device=position_m.device)
    squared = _squared_distance(covariance_m2, apart_m.float()).cpu().numpy()
    reach = _quantile(squared if weight is None else _each_as_often(squared, weight.cpu().numpy()))
    mean_mps = None if velocity_mps is None else velocity_mps.double().mean(dim=2)
    return Belief(mean_m, covariance_m2, torch.from_numpy(reach).to(covariance_m2), mean_mps)


@functools.cache
def _normal_points() -> Float[Tensor, "point 3"]:
    drawn = np.random.default_rng(SHARE_SEED).standard_normal((SHARE_POINTS, 3))
    return torch.from_numpy(drawn)


def _quantile(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """What ``REGION_SHARE`` of each row do not exceed; eight times as fast as torch's ``kthvalue``."""
    rank = math.ceil(REGION_SHARE * values.shape[1] - 1e-9) - 1
    quantile: NDArray[np.float32] = np.partition(values, rank, axis=1)[:, rank]
    return quantile


def _each_as_often(values: NDArray[np.float32], weight: NDArray[np.float64]) -> NDArray[np.float32]:
    """As many values, each as often as its weight says: what systematic resampling would choose."""
    number = values.shape[1]
    cumulative = weight.cumsum(axis=1)
    edge = np.rint(cumulative * (number / cumulative[:, -1:])).astype(np.int64)
    times = np.diff(edge, axis=1, prepend=0)
    return np.repeat(values.ravel(), times.ravel()).reshape(values.shape)


def _squared_distance(
    covariance_m2: Float[Tensor, "chase 3 3"], apart_m: Float[Tensor, "chase 3 point"]
) -> Float[Tensor, "chase point"]:
    """Mahalanobis' of places so far apart from the mean, in their own precision."""
    whitening = torch.linalg.inv(torch.linalg.cholesky(covariance_m2)).to(apart_m)
    squared: Tensor = torch.zeros_like(apart_m[:, 0])
    for row in range(3):
        whitened = apart_m[:, 0] * whitening[:, row, 0, None]
        for column in range(1, row + 1):
            whitened += apart_m[:, column] * whitening[:, row, column, None]
        squared += whitened.square_()
    return squared
