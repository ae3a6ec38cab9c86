"""The losses of Algorithm 1, for one rollout of any number of chases.

Axes are [step, chase, network], networks in the order d, x, y, z. A chase that ends within the rollout leaves its later
steps invalid; they count nowhere.
"""

import dataclasses
from dataclasses import dataclass
from typing import Literal, get_args

import torch

from ..batch.array_types import Bool, Float, Tensor
from ..networks.protocol import DecidingNetworks, ExpectingNetwork, HearingNetworks
from ..observation import mean_power_dbm
from ..ranges import AT_LEAST_ZERO, POSITIVE, SHARE, ranged, require_ranges
from ..scenario import NUM_TRACKERS
from .rollout import Rollout

DISPLACEMENT_SCALE_M = 4.0
"""The unit of rewards in counterfactual regression: the longest displacement on an axis."""
LEAST_VARIANCE = 0.01
"""In dB^2: errors smaller than a tenth of a decibel earn nothing."""

Objective = Literal["actor_critic", "ppo", "all_actions", "counterfactual", "fading"]
"""What the networks learn from.

- ``actor_critic``: the choices taken, weighted by their advantage (Algorithm 1);
- ``ppo``: the same, with the probability ratio clipped (Schulman et al. 2017), for several passes over a rollout;
- ``all_actions``: x, y and z from the expected reward over all five choices, which the simulator knows; d as in
  Algorithm 1;
- ``counterfactual``: regression. Logits of x, y and z are the rewards of the five choices over a temperature; that of
  the chosen spacing is R^d of the movement after, the first that it can influence. No critic;
- ``fading``: regression of the fading in each tracker's mean power, which the simulator knows. No policies.
"""
ValueLoss = Literal["n_step", "one_step"]
"""Algorithm 1 takes the n-step advantage, the text of Section III.B the one-step temporal difference."""


@dataclass(frozen=True)
class LossSettings:
    """The constants of the losses, Table I.

    Raises:
        InputError: a number outside its range.
    """

    objective: Objective = ranged("actor_critic", get_args(Objective))
    """What the networks learn from."""
    discount: float = ranged(0.99, SHARE)
    """gamma."""
    gae_lambda: float = ranged(1.0, SHARE)
    """lambda of the generalised advantage (Schulman et al. 2016); 1 is Algorithm 1's n-step return."""
    entropy_coefficient: float = ranged(0.01, AT_LEAST_ZERO)
    """beta."""
    bootstrap_at_truncation: bool = False
    """Whether a chase cut off at MAX_STEPS keeps the value of its last window; Algorithm 1 cuts it."""
    value_loss: ValueLoss = ranged("n_step", get_args(ValueLoss))
    """L1 of the n-step advantage (Algorithm 1) or of the one-step temporal difference (Section III.B)."""
    clip_range: float = ranged(0.2, POSITIVE)
    """PPO: how far the probability ratio may leave 1 before it earns nothing more."""
    temperature_m: float = ranged(0.2, POSITIVE)
    """Counterfactual regression: a logit is a reward over this, so choices this much better are e times likelier."""

    def __post_init__(self) -> None:
        require_ranges(self)


def lambda_returns(
    reward: Float[Tensor, "step chase 4"],
    value: Float[Tensor, "step chase 4"],
    valid: Bool[Tensor, "step chase"],
    bootstrap_value: Float[Tensor, "chase 4"],
    settings: LossSettings,
) -> Float[Tensor, "step chase 4"]:
    """G_k = R_{k+1} + gamma [lambda G_{k+1} + (1 - lambda) V(S_{k+1})], begun at the value after the last valid step
    (0 where the chase ended). With lambda = 1 the discounted return of Algorithm 1."""
    following_return = following_value = bootstrap_value
    returns = torch.empty_like(reward)
    for step in reversed(range(len(reward))):
        mixed = settings.gae_lambda * following_return + (1 - settings.gae_lambda) * following_value
        running = valid[step][:, None]
        following_return = torch.where(running, reward[step] + settings.discount * mixed, following_return)
        following_value = torch.where(running, value[step], following_value)
        returns[step] = following_return
    return returns


def actor_critic_loss(
    logits: Float[Tensor, "step chase 4 5"],
    value: Float[Tensor, "step chase 4"],
    rollout: Rollout,
    bootstrap_value: Float[Tensor, "chase 4"],
    settings: LossSettings,
) -> Float[Tensor, "4"]:
    """L^n = (1 / (t + 1)) [L_P + L_V - beta H] of Algorithm 1 for each network, averaged over the chases.

    The networks share no parameters, so the sum of the four has each network's own gradient.
    """
    log_policy = logits.log_softmax(dim=-1)
    returns = lambda_returns(rollout.reward_m, value.detach(), rollout.valid, bootstrap_value, settings)
    value_error = _value_error(value, rollout, bootstrap_value, settings)
    entropy = -(log_policy.exp() * log_policy).sum(dim=-1)
    policy_loss = _policy_loss(log_policy, returns - value.detach(), rollout, settings)
    per_step = policy_loss + value_error.abs() - settings.entropy_coefficient * entropy
    return _averaged(per_step, rollout.valid)


def counterfactual_loss(
    logits: Float[Tensor, "step chase 4 5"], rollout: Rollout, settings: LossSettings
) -> Float[Tensor, "4"]:
    """Squared error of reward per temperature, in units of ``DISPLACEMENT_SCALE_M``, averaged over the chases.

    A spacing in the last step of a chase's rollout has no movement after it there, and counts nowhere.
    """
    predicted_m = logits * settings.temperature_m
    axis_error_m = (predicted_m[:, :, 1:] - rollout.counterfactual_reward_m).square().mean(dim=-1)
    taken_m = predicted_m[:, :, 0].gather(-1, rollout.choice[:, :, :1])[:-1, :, 0]
    followed = (rollout.valid[:-1] & rollout.valid[1:]).float()
    spacing_error_m = followed * (taken_m - rollout.reward_m[1:, :, 0]).square()
    spacing_loss = spacing_error_m.sum() / followed.sum().clamp(min=1)
    return torch.cat([spacing_loss[None], _averaged(axis_error_m, rollout.valid)]) / DISPLACEMENT_SCALE_M**2


def fading_loss(networks: ExpectingNetwork, rollout: Rollout) -> Float[Tensor, "1"]:
    """What a window of this rollout costs in nats if the errors of the expected fading are taken as Gaussian.

    Errors that trackers make together and those by which they differ have a variance each, estimated from the rollout
    itself: - log likelihood = (5 log v_apart + log v_together) / 2 but for a constant. Plain squared errors would be
    ruled by what trackers fade together, and it is the difference that tells the direction.
    """
    rssi_dbm = rollout.rssi_dbm[:-1].flatten(0, 1)
    fading_db = mean_power_dbm(rssi_dbm) - rollout.unfaded_dbm.flatten(0, 1)
    error_db = networks(rssi_dbm, rollout.memory.repeat(len(rollout.valid), 1)) - fading_db
    counts = error_db.isfinite() & rollout.valid.flatten()[:, None]
    error_db = torch.where(counts, error_db, 0.0)
    num_heard = counts.sum(dim=1)
    together_db = error_db.sum(dim=1) / num_heard.clamp(min=1)
    apart_db = torch.where(counts, error_db - together_db[:, None], 0.0)
    apart_variance = apart_db.square().sum() / (num_heard - 1).clamp(min=0).sum().clamp(min=1)
    together_variance = together_db.square().sum() / (num_heard > 0).sum().clamp(min=1)
    apart_nats, together_nats = torch.stack([apart_variance, together_variance]).add(LEAST_VARIANCE).log() / 2
    nats: Tensor = (NUM_TRACKERS - 1) * apart_nats + together_nats
    return nats[None]


def rollout_loss(networks: HearingNetworks, rollout: Rollout, settings: LossSettings) -> Float[Tensor, "network"]:
    """L^n of one rollout under the networks' present parameters; one forward pass over all of its windows."""
    num_steps, num_chases = rollout.valid.shape
    if isinstance(networks, ExpectingNetwork):
        return fading_loss(networks, rollout)
    assert isinstance(networks, DecidingNetworks)
    if settings.objective == "counterfactual":
        logits = networks.decide_in_sequence(rollout.rssi_dbm[:-1], rollout.tracker_position_m[:-1], rollout.memory)
        return counterfactual_loss(logits, rollout, settings)
    logits, value = networks(rollout.rssi_dbm.flatten(0, 1).contiguous())
    logits = logits.view(num_steps + 1, num_chases, *logits.shape[1:])
    value = value.view(num_steps + 1, num_chases, -1)
    ended = rollout.reached if settings.bootstrap_at_truncation else rollout.reached | rollout.truncated
    # V of the window after each chase's own last step: one cut off early moves along unseen until the rollout ends.
    last_window = rollout.valid.sum(dim=0)
    last_value = value[last_window, torch.arange(num_chases, device=value.device)]
    bootstrap_value = last_value.detach() * ~ended[:, None]
    return actor_critic_loss(logits[:-1], value[:-1], rollout, bootstrap_value, settings)


def _policy_loss(
    log_policy: Float[Tensor, "step chase 4 5"],
    advantage: Float[Tensor, "step chase 4"],
    rollout: Rollout,
    settings: LossSettings,
) -> Float[Tensor, "step chase 4"]:
    """L_P: what the policies are pushed by."""
    chosen = rollout.choice[..., None]
    log_probability = log_policy.gather(-1, chosen)[..., 0]
    if settings.objective == "ppo":
        before = rollout.logits.log_softmax(dim=-1).gather(-1, chosen)[..., 0]
        ratio = (log_probability - before).exp()
        clipped = ratio.clamp(1 - settings.clip_range, 1 + settings.clip_range)
        return -torch.minimum(ratio * advantage, clipped * advantage)
    policy_loss = -log_probability * advantage
    if settings.objective == "all_actions":
        expected_m = (log_policy[:, :, 1:].exp() * rollout.counterfactual_reward_m).sum(dim=-1)
        policy_loss = torch.cat([policy_loss[:, :, :1], -expected_m], dim=-1)
    return policy_loss


def _averaged(per_step: Float[Tensor, "step chase n"], valid: Bool[Tensor, "step chase"]) -> Float[Tensor, "n"]:
    """The mean over each chase's own steps, then over the chases."""
    weight = valid / (valid.sum(dim=0) * valid.shape[1])
    return (per_step * weight[..., None]).sum(dim=(0, 1))


def _value_error(
    value: Float[Tensor, "step chase 4"],
    rollout: Rollout,
    bootstrap_value: Float[Tensor, "chase 4"],
    settings: LossSettings,
) -> Float[Tensor, "step chase 4"]:
    """What L_V is the size of: the n-step advantage or the one-step temporal difference; targets get no gradient."""
    one_step = settings.value_loss == "one_step"
    horizon = dataclasses.replace(settings, gae_lambda=0.0 if one_step else 1.0)
    return lambda_returns(rollout.reward_m, value.detach(), rollout.valid, bootstrap_value, horizon) - value
