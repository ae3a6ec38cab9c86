"""From weights to particles of equal weight, which are not to be sure of more than they can be."""

import torch

from ..batch.array_types import Float, Int, Tensor
from ..batch.streams import ChaseStreams

FEWEST_SHARE = 0.15
"""Of the particles that must count after an interval."""
LEAST_SHARE = 0.01
"""At least so much of an interval counts."""
HALVINGS = 8
"""By which the share is found."""


def share_to_take(log_weight: Float[Tensor, "chase particle"]) -> Float[Tensor, "chase"]:
    """The largest share of an interval, as a power of its likelihood, after which ``FEWEST_SHARE`` of the particles
    count, float64: 1 where they do after all of it.

    Beside the target an interval says so much that a few particles would be left, none of them at the true place.
    """
    relative = log_weight - log_weight.amax(dim=1, keepdim=True)
    fewest = FEWEST_SHARE * log_weight.shape[1]
    taken = torch.ones_like(relative[:, :1])
    enough = _number_that_counts(relative) >= fewest
    if enough.all():
        return taken[:, 0].double()
    low, high = torch.full_like(taken, LEAST_SHARE), taken
    for _ in range(HALVINGS):
        middle = (low * high).sqrt()
        leaves_enough = _number_that_counts(relative * middle) >= fewest
        low, high = torch.where(leaves_enough, middle, low), torch.where(leaves_enough, high, middle)
    return torch.where(enough, taken, low)[:, 0].double()


def parents(log_weight: Float[Tensor, "chase particle"], streams: ChaseStreams) -> Int[Tensor, "chase particle"]:
    """Systematic resampling: which particle each is a copy of, in rising order."""
    log_weight = log_weight.double()
    cumulative = (log_weight - log_weight.amax(dim=1, keepdim=True)).exp().cumsum(dim=1)
    number = log_weight.shape[1]
    place = (torch.arange(number) + streams.uniform(1)) / number
    return torch.searchsorted(cumulative, place * cumulative[:, -1:]).clamp_(max=number - 1)


def is_copy(parent: Int[Tensor, "chase particle"]) -> Tensor:
    """All copies of a particle but the first."""
    copy = torch.zeros_like(parent, dtype=torch.bool)
    copy[:, 1:] = parent[:, 1:] == parent[:, :-1]
    return copy


def kernel_spread(value: Float[Tensor, "chase k particle"], width: float, least: float) -> Float[Tensor, "chase k 1"]:
    """Standard deviation of a kernel of this width in those of the belief."""
    spread: Tensor = value.double().std(dim=2, keepdim=True)
    return (width * spread).float().clamp(min=least)


def kernel_root(value: Float[Tensor, "chase k particle"], width: float, least: float) -> Float[Tensor, "chase k k"]:
    """A root of a kernel's covariance, of this width in the belief's: long where the belief is long."""
    apart = (value - value.mean(dim=2, keepdim=True)).double()
    covariance = apart @ apart.mT * (width**2 / value.shape[2])
    root: Tensor = torch.linalg.cholesky(covariance + least**2 * torch.eye(value.shape[1], dtype=torch.float64))
    return root.float()


def _number_that_counts(log_weight: Float[Tensor, "chase particle"]) -> Float[Tensor, "chase 1"]:
    """(sum w)^2 / sum w^2, the highest weight being 1."""
    weight = log_weight.exp()
    return weight.sum(dim=1, keepdim=True).square() / weight.square().sum(dim=1, keepdim=True)
