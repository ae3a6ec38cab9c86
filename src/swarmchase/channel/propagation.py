"""From distance to mean power: the path loss (Eqs. 1-2), without fading."""

import torch

from ..batch.array_types import Float, Tensor
from ..scenario import Scenario


def path_loss_db(scenario: Scenario, distance_m: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Eq. (2): L_0 + 10 n log10(d / d_0), with d clamped at d_0 from below."""
    ratio = distance_m.clamp_min(scenario.reference_distance_m) / scenario.reference_distance_m
    return scenario.reference_path_loss_db + 10 * scenario.path_loss_exponent * torch.log10(ratio)


def unfaded_dbm(scenario: Scenario, distance_m: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """What would be heard at these distances if nothing faded."""
    return scenario.transmit_power_dbm - path_loss_db(scenario, distance_m)
