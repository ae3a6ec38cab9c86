"""From places to mean power: the path loss (Eqs. 1-2) and the ground's reflection, without fading."""

import math

import torch

from ..batch.array_types import Float, Tensor
from ..scenario import SPEED_OF_LIGHT_MPS, Scenario
from .fading import DEEPEST_FADE_DB


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


def ground_reflection_db(
    scenario: Scenario, target_position_m: Float[Tensor, "*#batch 3"], tracker_position_m: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*#batch"]:
    """What the ray that the ground reflects adds to the direct one: the two-ray model over flat ground.

    20 log10 |1 - g d / d' exp(-j 2 pi (d' - d) f_c / c)|, at least ``DEEPEST_FADE_DB``: g is ``ground_reflection``, d
    the direct way, d' the way by the ground, whose reflection turns the phase (T. S. Rappaport, Wireless
    Communications, section 4.6).

    Args:
        scenario: with ``start_altitude_m``, the altitude of the positions' origin above ground, and ``carrier_hz``.
        target_position_m: float64; what is below ground counts as on it.
        tracker_position_m: float64, likewise.
    """
    along_m: Tensor = torch.linalg.vector_norm((tracker_position_m - target_position_m)[..., :2], dim=-1)
    target_m, tracker_m = (
        (position_m[..., 2] + scenario.start_altitude_m).clamp_min(0)
        for position_m in (target_position_m, tracker_position_m)
    )
    direct_m = torch.hypot(along_m, tracker_m - target_m).clamp_min(scenario.reference_distance_m)
    reflected_m = torch.hypot(along_m, tracker_m + target_m).clamp_min(scenario.reference_distance_m)
    amplitude = scenario.ground_reflection * direct_m / reflected_m
    phase_rad = 2 * math.pi * scenario.carrier_hz / SPEED_OF_LIGHT_MPS * (reflected_m - direct_m)
    power = 1 - 2 * amplitude * phase_rad.cos() + amplitude.square()
    return 10 * power.clamp_min(10 ** (DEEPEST_FADE_DB / 10)).log10()
