"""Where the target is: anywhere on the sphere around the swarm's start (Section IV)."""

from collections.abc import Sequence

import torch

from ..batch.array_types import Float, Tensor
from ..batch.streams import ChaseKey, ChaseStreams
from ..scenario import Scenario


def draw_target_position_m(scenario: Scenario, keys: Sequence[ChaseKey]) -> Float[Tensor, "chase 3"]:
    """Targets uniform on the sphere of radius |O_0 - U| = 100 m around the centre's start, float64."""
    direction = ChaseStreams.of(keys, "target").standard_normal(3).double()
    length: Tensor = torch.linalg.vector_norm(direction, dim=1, keepdim=True)
    return scenario.start_distance_m * direction / length
