"""Stable-Baselines3's PPO learns to chase: python examples/stable_baselines3_ppo.py --steps 300000

Needs: pip install stable-baselines3. It begins near the target, where 60,000 steps show that it learns;
docs/guides/train.md has the package's own trainers, which move many chases in one batch.
"""

import argparse

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize

NAME = "swarmchase.gym:swarmchase/Chase-v0"
WORLD = {"sampling_hz": 10, "spatial_correlation": 0.9, "start_distance_m": 30.0, "max_movements": 60}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--steps-per-update", type=int, default=256, help="of each of eight chases")
    parser.add_argument("--episodes", type=int, default=100, help="chases of each evaluation")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()

    torch.set_num_threads(1)  # everything here is small: more are no faster, and where others compute much slower

    # Levels are around -70 dBm: normalised, a plain network learns from them.
    chases = VecNormalize(make_vec_env(NAME, n_envs=8, seed=options.seed, env_kwargs=WORLD), clip_obs=5.0)
    model = PPO("MlpPolicy", chases, n_steps=options.steps_per_update, gamma=0.9, seed=options.seed, device="cpu")
    print(f"untrained: {mean_movements(model, chases, options.episodes):.1f} movements")
    model.learn(options.steps)
    print(f"trained:   {mean_movements(model, chases, options.episodes):.1f} movements")


def mean_movements(model: PPO, chases: VecNormalize, episodes: int) -> float:
    chases.training = False
    _, lengths = evaluate_policy(model, chases, episodes, deterministic=False, return_episode_rewards=True)
    chases.training = True
    return sum(lengths) / len(lengths)


if __name__ == "__main__":
    main()
