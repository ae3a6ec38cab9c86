"""PPO in one file, in CleanRL's way, on chases in a batch: python examples/cleanrl_ppo.py --steps 1000000

All there is to the algorithm stands below, to be changed. ``ChaseVectorEnv`` moves all chases at once, which costs
much less than one by one. It begins near the target, as the other examples do.
"""

import argparse

import gymnasium
import numpy as np
import torch
from torch import nn

NAME = "swarmchase.gym:swarmchase/Chase-v0"
WORLD = {"sampling_hz": 10, "spatial_correlation": 0.9, "start_distance_m": 30.0, "max_movements": 60}


class Agent(nn.Module):
    """Four decisions of five choices and one value, from a window of 50 samples of six trackers."""

    def __init__(self) -> None:
        super().__init__()
        self.body = nn.Sequential(nn.Linear(300, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh())
        self.policy, self.value = nn.Linear(128, 20), nn.Linear(128, 1)

    def forward(self, window_dbm):
        # What tells the direction are differences between trackers; the level itself tells the distance.
        level_dbm = window_dbm.mean(dim=(1, 2), keepdim=True)
        hidden = self.body(((window_dbm - level_dbm) / 10).flatten(1))
        logits = self.policy(hidden).unflatten(1, (4, 5))
        return torch.distributions.Categorical(logits=logits), self.value(hidden)[:, 0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--chases", type=int, default=128)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    steps_per_update, epochs, minibatches = 16, 4, 4
    gamma, gae_lambda, clip, entropy_share, value_share = 0.9, 0.9, 0.2, 0.01, 0.5

    torch.manual_seed(options.seed)
    chases = gymnasium.make_vec(NAME, num_envs=options.chases, vectorization_mode="vector_entry_point", **WORLD)
    agent = Agent()
    adam = torch.optim.Adam(agent.parameters(), lr=1e-3)
    window_dbm = torch.from_numpy(chases.reset(seed=options.seed)[0])
    is_idle = torch.zeros(options.chases, dtype=torch.bool)  # its chase has ended: this step begins the next
    lengths: list[int] = []

    for update in range(1, options.steps // (options.chases * steps_per_update) + 1):
        rollout = []
        for _ in range(steps_per_update):
            with torch.no_grad():
                policy, value = agent(window_dbm)
                choice = policy.sample()
            following_dbm, reward, terminated, truncated, info = chases.step(choice.numpy())
            ended = torch.from_numpy(terminated | truncated)
            reward = torch.from_numpy(reward).float() / 10
            rollout.append((window_dbm, choice, policy.log_prob(choice).sum(1), value, reward, ended, is_idle))
            lengths += info["movements"][ended.numpy()].tolist()
            window_dbm, is_idle = torch.from_numpy(following_dbm), ended
        windows, choices, log_probs, values, rewards, endings, idles = map(torch.stack, zip(*rollout, strict=True))

        with torch.no_grad():
            next_value, advantage = agent(window_dbm)[1], torch.zeros(options.chases)
        advantages = torch.zeros_like(values)
        for step in reversed(range(steps_per_update)):
            goes_on = (~endings[step]).float()
            error = rewards[step] + gamma * next_value * goes_on - values[step]
            advantage = error + gamma * gae_lambda * goes_on * advantage
            advantages[step], next_value = advantage, values[step]
        returns = advantages + values

        counted = torch.nonzero(~idles.flatten())[:, 0]
        flat = [part.flatten(0, 1)[counted] for part in (windows, choices, log_probs, advantages, returns)]
        for _ in range(epochs):
            for rows in torch.randperm(len(counted)).chunk(minibatches):
                seen_dbm, chosen, old_log_prob, gained, returned = (part[rows] for part in flat)
                policy, value = agent(seen_dbm)
                ratio = (policy.log_prob(chosen).sum(1) - old_log_prob).exp()
                gained = (gained - gained.mean()) / (gained.std() + 1e-8)
                policy_loss = -torch.min(ratio * gained, ratio.clamp(1 - clip, 1 + clip) * gained).mean()
                value_loss = (value - returned).square().mean()
                loss = policy_loss + value_share * value_loss - entropy_share * policy.entropy().sum(1).mean()
                adam.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                adam.step()
        if update % 20 == 0 or update == 1:
            print(f"update {update}: {np.mean(lengths[-500:]) if lengths else float('nan'):.1f} movements")


if __name__ == "__main__":
    main()
