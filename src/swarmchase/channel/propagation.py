"""From distance to mean power: the path loss (Eqs. 1-2), without fading."""

import math

from ..batch.array_types import Float, Tensor
from ..scenario import Scenario


def path_loss_db(scenario: Scenario, distance_m: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Eq. (2): L_0 + 10 n log10(d / d_0), with d clamped at d_0 from below."""
    return scenario.reference_path_loss_db + loss_beyond_reference_db(scenario, distance_m)


def loss_beyond_reference_db(scenario: Scenario, distance_m: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """10 n log10(d / d_0) of Eq. (2), with d clamped at d_0 from below; a tensor of its own."""
    ratio = distance_m.clamp_min(scenario.reference_distance_m) / scenario.reference_distance_m
    return ratio.log10_().mul_(10 * scenario.path_loss_exponent)


def reference_dbm(scenario: Scenario) -> float:
    """What would be heard at d_0 if nothing faded."""
    return scenario.transmit_power_dbm - scenario.reference_path_loss_db


def slope_db(scenario: Scenario) -> float:
    """d times dL / dd of Eq. (2), 10 n / ln 10, the same at all distances: a distance longer by 1 % costs a hundredth
    of it."""
    return 10 * scenario.path_loss_exponent / math.log(10)


def unfaded_dbm(scenario: Scenario, distance_m: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """What would be heard at these distances if nothing faded."""
    return scenario.transmit_power_dbm - path_loss_db(scenario, distance_m)
