"""Where chases of trained networks spend their movements: python docs/last_metres.py runs/fast/best.safetensors

Prints a row of docs/results.md for each weights file, of networks of the paper's form: 200 chases of seed 0 in the
scenario that they were trained in, with sampled actions.
"""

import argparse
from pathlib import Path

import numpy as np
import torch

from swarmchase.controllers.learned import LearnedController, LearnedMemory
from swarmchase.evaluation.play import play
from swarmchase.formation import Action
from swarmchase.networks.protocol import DecidingNetworks
from swarmchase.networks.weights import load_weights
from swarmchase.observation import Observation
from swarmchase.scenario import Scenario

CHASES = 200
NEAR_M = 8.0
"""Two of the largest displacements."""
BESIDE_M = 1.0
"""On an axis: whoever moves is then farther from the target on it, or as far."""
WHOLE = (0, 4)
"""The largest displacements among the five choices."""


class Watched(LearnedController):
    """Keeps the logits [chase, network, choice] of its last decision."""

    logits: torch.Tensor

    def decide(self, observation: Observation, memory: LearnedMemory) -> tuple[Action, LearnedMemory]:
        """As the learned controller."""
        action, following = super().decide(observation, memory)
        self.logits = following.logits
        return action, following


def main() -> None:
    """Play and print."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("weights", type=Path, nargs="+", help="weights files")
    torch.set_num_threads(1)
    print(f"| weights | mean | until {NEAR_M:g} m | after | {BESIDE_M:g} m beside it, 0 or 2 m likeliest |")
    print("|---|---|---|---|---|")
    for path in options.parse_args().weights:
        until, after, inner = movements(path)
        print(f"| {path} | {until + after:.1f} | {until:.1f} | {after:.1f} | {100 * inner:.0f} % |")


def movements(path: Path) -> tuple[float, float, float]:
    """Mean movements until the centre is first within ``NEAR_M`` of the target, and after; and how often, within
    ``BESIDE_M`` of the target on an axis, the likeliest displacement on it is not one of the largest."""
    networks, configuration = load_weights(path)
    assert isinstance(networks, DecidingNetworks)
    scenario = Scenario.from_dict(configuration["scenarios"][0])
    controller = Watched(scenario, networks, str(path))
    until, ended = np.full(CHASES, np.inf), np.full(CHASES, np.inf)
    beside = inner = 0
    for step in play(scenario, controller, 0, range(CHASES), CHASES):
        offset_m = step.before.target_position_m - step.before.center_m
        is_near = (offset_m.norm(dim=1) < NEAR_M).numpy()
        made, chases = step.before.movements.numpy(), np.array(step.chases)
        until[chases[is_near]] = np.minimum(until[chases[is_near]], made[is_near])
        ended[chases] = made + 1
        likeliest = controller.logits[:, 1:].argmax(dim=2)
        is_beside = offset_m.abs() < BESIDE_M
        beside += int(is_beside.sum())
        inner += int((is_beside & ~torch.isin(likeliest, torch.tensor(WHOLE))).sum())
    until = np.minimum(until, ended)
    return float(until.mean()), float((ended - until).mean()), inner / beside


if __name__ == "__main__":
    main()
