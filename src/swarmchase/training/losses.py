"""The losses of Algorithm 1, for one rollout of any number of chases.

Axes are [step, chase, network], networks in the order d, x, y, z. A chase that ends within the rollout leaves its later
steps invalid; they count nowhere.
"""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import torch

from ..array_types import Bool, Float, Int, Tensor
from ..errors import InputError
from ..networks import SwarmNetworks
from .rollout import Rollout

ValueLoss = Literal["n_step", "one_step"]
"""Algorithm 1 takes the n-step advantage, the text of Section III.B the one-step temporal difference."""


@dataclass(frozen=True)
class LossSettings:
    """The constants of the losses, Table I.

    Raises:
        InputError: a number outside its range.
    """

    discount: float = 0.99
    """gamma."""
    entropy_coefficient: float = 0.01
    """beta."""
    bootstrap_at_truncation: bool = False
    """Whether a chase cut off at MAX_STEPS keeps the value of its last window; Algorithm 1 cuts it."""
    value_loss: ValueLoss = "n_step"
    """L1 of the n-step advantage (Algorithm 1) or of the one-step temporal difference (Section III.B)."""

    def __post_init__(self) -> None:
        if not 0 <= self.discount <= 1:
            raise InputError(f"discount = {self.discount} is refused: allowed is between 0 and 1")
        if not 0 <= self.entropy_coefficient < math.inf:
            raise InputError(f"entropy_coefficient = {self.entropy_coefficient} is refused: allowed is at least 0")
        if self.value_loss not in get_args(ValueLoss):
            raise InputError(f"value_loss = {self.value_loss!r} is refused: allowed is n_step or one_step")


def discounted_returns(
    reward: Float[Tensor, "step chase 4"],
    valid: Bool[Tensor, "step chase"],
    bootstrap_value: Float[Tensor, "chase 4"],
    discount: float,
) -> Float[Tensor, "step chase 4"]:
    """G_k = R_{k+1} + gamma G_{k+1}, begun at the value after the last valid step (0 where the chase ended)."""
    following = bootstrap_value
    returns = torch.empty_like(reward)
    for step in reversed(range(len(reward))):
        following = torch.where(valid[step][:, None], reward[step] + discount * following, following)
        returns[step] = following
    return returns


def actor_critic_loss(
    logits: Float[Tensor, "step chase 4 5"],
    value: Float[Tensor, "step chase 4"],
    choice: Int[Tensor, "step chase 4"],
    reward: Float[Tensor, "step chase 4"],
    valid: Bool[Tensor, "step chase"],
    bootstrap_value: Float[Tensor, "chase 4"],
    settings: LossSettings,
) -> Float[Tensor, "4"]:
    """L^n = (1 / (t + 1)) [L_P + L_V - beta H] of Algorithm 1 for each network, averaged over the chases.

    The networks share no parameters, so the sum of the four has each network's own gradient.
    """
    log_policy = logits.log_softmax(dim=-1)
    returns = discounted_returns(reward, valid, bootstrap_value, settings.discount)
    advantage = returns - value
    policy_loss = -log_policy.gather(-1, choice[..., None])[..., 0] * advantage.detach()
    value_error = (
        advantage
        if settings.value_loss == "n_step"
        else _one_step_error(value, reward, valid, bootstrap_value, settings.discount)
    )
    entropy = -(log_policy.exp() * log_policy).sum(dim=-1)
    per_step = policy_loss + value_error.abs() - settings.entropy_coefficient * entropy
    weight = valid / (valid.sum(dim=0) * valid.shape[1])
    return (per_step * weight[..., None]).sum(dim=(0, 1))


def rollout_loss(networks: SwarmNetworks, rollout: Rollout, settings: LossSettings) -> Float[Tensor, "4"]:
    """L^n of one rollout under the networks' present parameters; one forward pass over all of its windows."""
    num_windows, num_chases = rollout.rssi_dbm.shape[:2]
    logits, value = networks(rollout.rssi_dbm.flatten(0, 1).contiguous())
    logits = logits.view(num_windows, num_chases, *logits.shape[1:])
    value = value.view(num_windows, num_chases, -1)
    ended = rollout.reached if settings.bootstrap_at_truncation else rollout.reached | rollout.truncated
    # V of the window after each chase's own last step: one cut off early moves along unseen until the rollout ends.
    last_window = rollout.valid.sum(dim=0)
    last_value = value[last_window, torch.arange(num_chases, device=value.device)]
    bootstrap_value = last_value.detach() * ~ended[:, None]
    return actor_critic_loss(
        logits[:-1], value[:-1], rollout.choice, rollout.reward_m, rollout.valid, bootstrap_value, settings
    )


def _one_step_error(
    value: Float[Tensor, "step chase 4"],
    reward: Float[Tensor, "step chase 4"],
    valid: Bool[Tensor, "step chase"],
    bootstrap_value: Float[Tensor, "chase 4"],
    discount: float,
) -> Float[Tensor, "step chase 4"]:
    """R_{t+1} + gamma V(S_{t+1}) - V(S_t); the next value is a target and gets no gradient."""
    following = torch.cat([value[1:].detach(), bootstrap_value[None]])
    is_last = valid & ~torch.cat([valid[1:], torch.zeros_like(valid[:1])])
    following = torch.where(is_last[..., None], bootstrap_value, following)
    return reward + discount * following - value
