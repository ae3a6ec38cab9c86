"""T movements of a batch of chases under the current policies: what every trainer learns from.

A chase that ends stops there, as in Algorithm 1: its remaining steps are marked invalid (in a batch it moves along
unseen until the rollout ends), and its trainer begins another. It does not play as evaluation does
(``evaluation.play``): it drives networks, not controllers, keeps a batch of one size for a fixed number of steps, and
asks the simulator what no controller may know.
"""

from dataclasses import dataclass

import torch

from ..batch.array_types import Bool, Float, Int, Tensor
from ..batch.streams import ChaseStreams
from ..formation import action_from_choice, tracker_position_m
from ..networks.actor_critic import NETWORK_NAMES, NUM_CHOICES, greedy_choice, sampled_choice
from ..networks.protocol import DecidingNetworks, HearingNetworks
from ..world.environment import Environment, State, counterfactual_reward_m, unfaded_dbm


@dataclass(frozen=True)
class Rollout:
    """(S_t, A_t, R_{t+1}) of up to T steps."""

    rssi_dbm: Float[Tensor, "step_and_last chase sample tracker"]
    """S_t of every step, and the window after the last one, float32."""
    tracker_position_m: Float[Tensor, "step_and_last chase 6 3"]
    """Where these windows were heard, float32."""
    memory: Float[Tensor, "chase memory"]
    """What the networks remembered before the first of them."""
    choice: Int[Tensor, "step chase 4"]
    """A_t as choices 0..4 of d, x, y, z."""
    logits: Float[Tensor, "step chase 4 5"]
    """Of the policies that made these choices."""
    reward_m: Float[Tensor, "step chase 4"]
    """R_{t+1} of d, x, y, z, float32."""
    counterfactual_reward_m: Float[Tensor, "step chase 3 5"]
    """R_{t+1} of x, y, z for each of the five choices, float32; only the simulator can know it."""
    unfaded_dbm: Float[Tensor, "step chase tracker"]
    """What the trackers would have heard in S_t if nothing had faded, float32; only the simulator can know it."""
    valid: Bool[Tensor, "step chase"]
    """False after a chase has ended."""
    reached: Bool[Tensor, "chase"]
    """The chase ended within the rollout at its target: termination."""
    truncated: Bool[Tensor, "chase"]
    """The chase ended within the rollout at MAX_STEPS: truncation."""


def collect(
    environment: Environment,
    networks: HearingNetworks,
    state: State,
    memory: Float[Tensor, "chase memory"],
    streams: ChaseStreams,
    num_steps: int,
    spacing_exploration: float | None = None,
) -> tuple[Rollout, State, Float[Tensor, "chase memory"]]:
    """Let every chase make ``num_steps`` movements with sampled actions, fewer where it ends.

    ``memory`` is what the networks remember of them, ``streams`` are the chases' own for sampling actions. With
    ``spacing_exploration`` the spacing is not sampled: it is the most likely one, and any one in this share of the
    movements. Ends early when every chase has ended.
    """
    windows, choices, all_logits, rewards, counterfactuals, unfaded, valids = [state.rssi_dbm], [], [], [], [], [], []
    positions, memory_before = [_tracker_position_m(state)], memory
    reached = torch.zeros(len(streams), dtype=torch.bool, device=state.center_m.device)
    truncated = reached.clone()
    for _ in range(num_steps):
        running = ~(reached | truncated)
        if not running.any():
            break
        with torch.no_grad():
            logits, memory = _policies(networks, windows[-1], positions[-1], memory)
        choice = _explored_choice(logits, streams, spacing_exploration)
        counterfactuals.append(counterfactual_reward_m(environment.scenario, state).float())
        unfaded.append(unfaded_dbm(environment.scenario, state).float())
        state, outcome = environment.step(state, action_from_choice(environment.scenario, choice))
        reached, truncated = reached | (outcome.reached & running), truncated | (outcome.truncated & running)
        windows.append(state.rssi_dbm)
        positions.append(_tracker_position_m(state))
        choices.append(choice)
        all_logits.append(logits)
        rewards.append(outcome.reward_m.float())
        valids.append(running)
    rollout = Rollout(
        rssi_dbm=torch.stack(windows),
        tracker_position_m=torch.stack(positions),
        memory=memory_before,
        choice=torch.stack(choices),
        logits=torch.stack(all_logits),
        reward_m=torch.stack(rewards),
        counterfactual_reward_m=torch.stack(counterfactuals),
        unfaded_dbm=torch.stack(unfaded),
        valid=torch.stack(valids),
        reached=reached,
        truncated=truncated,
    )
    return rollout, state, memory


def _policies(
    networks: HearingNetworks,
    rssi_dbm: Float[Tensor, "chase sample 6"],
    position_m: Float[Tensor, "chase 6 3"],
    memory: Float[Tensor, "chase memory"],
) -> tuple[Float[Tensor, "chase 4 5"], Float[Tensor, "chase memory"]]:
    """The networks' own; the swarm wanders where they decide nothing: fading is the same wherever it is heard."""
    if isinstance(networks, DecidingNetworks):
        return networks.decide(rssi_dbm, position_m, memory)
    return rssi_dbm.new_zeros(len(rssi_dbm), len(NETWORK_NAMES), NUM_CHOICES), memory


def _tracker_position_m(state: State) -> Float[Tensor, "chase 6 3"]:
    return tracker_position_m(state.center_m, state.spacing_m, state.turned_rad).float()


def _explored_choice(
    logits: Float[Tensor, "chase 4 5"], streams: ChaseStreams, spacing_exploration: float | None
) -> Int[Tensor, "chase 4"]:
    uniform = streams.uniform(len(NETWORK_NAMES)).to(logits.device)
    choice = sampled_choice(logits, uniform)
    if spacing_exploration is not None:
        # One uniform number does for both: below the share it is, spread out again, a choice among all.
        anything = (uniform[:, 0] * (logits.shape[-1] / max(spacing_exploration, 1e-9))).long()
        choice[:, 0] = torch.where(anything < logits.shape[-1], anything, greedy_choice(logits[:, 0]))
    return choice
