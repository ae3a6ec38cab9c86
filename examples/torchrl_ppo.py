"""TorchRL's PPO learns to chase: python examples/torchrl_ppo.py --frames 300000

Needs: pip install torchrl. The environment comes by its name, the loss and the advantage are TorchRL's own.
"""

import argparse

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical, Independent
from torchrl.collectors import Collector
from torchrl.envs import Compose, GymEnv, InitTracker, ObservationNorm, StepCounter, TransformedEnv
from torchrl.modules import ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

NAME = "swarmchase.gym:swarmchase/Chase-v0"
WORLD = {"sampling_hz": 10, "spatial_correlation": 0.9, "start_distance_m": 30.0, "max_movements": 60}


class FourChoices(Independent):
    """One of five choices for spacing, x, y and z each."""

    def __init__(self, logits: torch.Tensor) -> None:
        super().__init__(Categorical(logits=logits), 1)

    @property
    def deterministic_sample(self) -> torch.Tensor:
        return self.base_dist.logits.argmax(dim=-1)


def network(outputs: int) -> nn.Module:
    return nn.Sequential(
        nn.Flatten(-2), nn.Linear(300, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh(), nn.Linear(128, outputs)
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=300_000)
    parser.add_argument("--frames-per-batch", type=int, default=2048)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()

    torch.manual_seed(options.seed)
    # Levels are around -70 dBm, and differ by some dB.
    transforms = Compose(ObservationNorm(loc=7.0, scale=0.1, in_keys=["observation"]), InitTracker(), StepCounter())
    chase = TransformedEnv(GymEnv(NAME, categorical_action_encoding=True, **WORLD), transforms)
    chase.set_seed(options.seed)
    logits = TensorDictModule(
        nn.Sequential(network(20), nn.Unflatten(-1, (4, 5))), in_keys=["observation"], out_keys=["logits"]
    )
    actor = ProbabilisticActor(logits, in_keys=["logits"], distribution_class=FourChoices, return_log_prob=True)
    critic = ValueOperator(network(1), in_keys=["observation"])
    advantage = GAE(gamma=0.9, lmbda=0.9, value_network=critic)
    loss_module = ClipPPOLoss(actor, critic, entropy_coeff=0.01)
    adam = torch.optim.Adam(loss_module.parameters(), lr=3e-4)
    collector = Collector(chase, actor, frames_per_batch=options.frames_per_batch, total_frames=options.frames)
    for number, batch in enumerate(collector, start=1):
        for _ in range(4):
            advantage(batch)
            for rows in torch.randperm(len(batch)).chunk(8):
                losses = loss_module(batch[rows])
                loss = sum(value for name, value in losses.items() if name.startswith("loss_"))
                adam.zero_grad()
                loss.backward()
                adam.step()
        steps = batch["next", "step_count"][batch["next", "done"]]
        print(f"batch {number}: {steps.float().mean():.1f} movements")
    collector.shutdown()


if __name__ == "__main__":
    main()
