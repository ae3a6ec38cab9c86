"""T movements of a batch of chases under the current policies: what every trainer learns from.

A chase that ends stops there, as in Algorithm 1: its remaining steps are marked invalid (in a batch it moves along
unseen until the rollout ends), and its trainer begins another.
"""

from dataclasses import dataclass

import torch

from ..array_types import Bool, Float, Int, Tensor
from ..environment import Environment, State
from ..formation import action_from_choice
from ..networks import NETWORK_NAMES, SwarmNetworks, sampled_choice
from ..streams import ChaseStreams


@dataclass(frozen=True)
class Rollout:
    """(S_t, A_t, R_{t+1}) of up to T steps."""

    rssi_dbm: Float[Tensor, "step_and_last chase sample tracker"]
    """S_t of every step, and the window after the last one, float32."""
    choice: Int[Tensor, "step chase 4"]
    """A_t as choices 0..4 of d, x, y, z."""
    reward_m: Float[Tensor, "step chase 4"]
    """R_{t+1} of d, x, y, z, float32."""
    valid: Bool[Tensor, "step chase"]
    """False after a chase has ended."""
    reached: Bool[Tensor, "chase"]
    """The chase ended within the rollout at its target: termination."""
    truncated: Bool[Tensor, "chase"]
    """The chase ended within the rollout at MAX_STEPS: truncation."""


def collect(
    environment: Environment, networks: SwarmNetworks, state: State, streams: ChaseStreams, num_steps: int
) -> tuple[Rollout, State]:
    """Let every chase make ``num_steps`` movements with sampled actions, fewer where it ends.

    ``streams`` are the chases' own for sampling actions. Ends early when every chase has ended.
    """
    windows, choices, rewards, valids = [state.rssi_dbm], [], [], []
    reached = torch.zeros(len(streams), dtype=torch.bool, device=state.center_m.device)
    truncated = reached.clone()
    for _ in range(num_steps):
        running = ~(reached | truncated)
        if not running.any():
            break
        choice = _policy_choice(networks, state, streams)
        state, outcome = environment.step(state, action_from_choice(environment.scenario, choice))
        reached, truncated = reached | (outcome.reached & running), truncated | (outcome.truncated & running)
        windows.append(state.rssi_dbm)
        choices.append(choice)
        rewards.append(outcome.reward_m.float())
        valids.append(running)
    rollout = Rollout(
        torch.stack(windows), torch.stack(choices), torch.stack(rewards), torch.stack(valids), reached, truncated
    )
    return rollout, state


def _policy_choice(networks: SwarmNetworks, state: State, streams: ChaseStreams) -> Int[Tensor, "chase 4"]:
    with torch.no_grad():
        logits = networks.policy_logits(state.rssi_dbm.contiguous())
    return sampled_choice(logits, streams.uniform(len(NETWORK_NAMES)).to(logits.device))
