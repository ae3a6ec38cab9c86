"""The world has no preferred direction: a rollout seen in a mirror is as good a rollout."""

from dataclasses import replace

import torch

from ..batch.array_types import Bool, Float
from .rollout import Rollout


def mirrored(rollout: Rollout, axes: Bool[torch.Tensor, "chase 3"]) -> Rollout:
    """The rollout with these axes of each chase turned round: trackers change places, choices their sign.

    The displacements of a scenario must lie symmetrically about 0. For networks that look at nothing but windows:
    places and memories stay as they were.
    """
    opposite = torch.arange(6, device=axes.device) ^ 1
    tracker = torch.where(axes.repeat_interleave(2, dim=1), opposite, torch.arange(6, device=axes.device))
    rssi_dbm = rollout.rssi_dbm.gather(3, tracker[None, :, None, :].expand(rollout.rssi_dbm.shape))
    choice = rollout.choice.clone()
    choice[:, :, 1:] = torch.where(axes, rollout.logits.shape[-1] - 1 - choice[:, :, 1:], choice[:, :, 1:])
    logits = rollout.logits.clone()
    logits[:, :, 1:] = _turned(logits[:, :, 1:], axes)
    counterfactual_reward_m = _turned(rollout.counterfactual_reward_m, axes)
    return replace(
        rollout,
        rssi_dbm=rssi_dbm,
        choice=choice,
        logits=logits,
        counterfactual_reward_m=counterfactual_reward_m,
        unfaded_dbm=rollout.unfaded_dbm.gather(2, tracker[None].expand(rollout.unfaded_dbm.shape)),
    )


def _turned(
    by_choice: Float[torch.Tensor, "step chase 3 choice"], axes: Bool[torch.Tensor, "chase 3"]
) -> Float[torch.Tensor, "step chase 3 choice"]:
    return torch.where(axes[..., None], by_choice.flip(-1), by_choice)
