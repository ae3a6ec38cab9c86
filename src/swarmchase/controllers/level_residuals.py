"""What is left of each tracker's mean power when the path loss to a particle is taken out, and how noisy that is.

The mean power of Rician fading is nearly gamma distributed; its logarithm has the mean digamma(a) - ln a and the
variance trigamma(a) of the shape a, which grows with the number of samples that count (``noise``).
"""

import itertools
import math
from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Tensor
from ..channel.propagation import reference_dbm, slope_db
from ..observation import NEPERS_PER_DB, Observation, mean_power_dbm
from ..scenario import Scenario
from .sample_likeness import SampleLikeness, correlation_of_powers, variance_of_power

MOST_PIECES = 5
"""Into so many pieces an interval is cut, in each of which trackers count as standing."""
LEAST_SPREAD_DB = 0.3
"""Standard deviation of a tracker's mean power, at least: of what no model here says."""
PLACE_ERROR_M = 0.3
"""Standard deviation of a tracker's place: nobody knows it better, and close to the target it is what counts."""
UNHEARD_DB2 = 1e8
"""Variance of what a tracker that has heard nothing says."""


@dataclass(frozen=True)
class Noise:
    """Of the mean levels of an interval; the same for all particles."""

    covariance_db2: Float[Tensor, "chase tracker tracker"]
    """float64."""
    bias_db: Float[Tensor, "chase tracker"]
    """What the mean level says too much, float32."""


class LevelResiduals:
    """By the scenario's channel."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._likeness = SampleLikeness(scenario)
        self._correlation = correlation_of_powers(scenario)

    def residual_db(
        self,
        observation: Observation,
        position_m: Float[Tensor, "chase 3 particle"],
        velocity_mps: Float[Tensor, "chase 3 particle"],
        exponent: Float[Tensor, "chase particle"],
        age_s: Float[Tensor, "chase sample"],
    ) -> Float[Tensor, "chase tracker particle"]:
        """Of each tracker's mean power, averaged in milliwatts over pieces of the interval; 0 of a deaf tracker.

        A particle x with velocity v was |x - v b - r|^2 from a tracker at r, b ago: a product of what depends on the
        particle alone and what does on the tracker alone, so that all distances are one product of matrices.
        """
        num_chases, num_samples = observation.rssi_dbm.shape[:2]
        heard = observation.rssi_dbm.isfinite()
        num_heard = heard.sum(dim=1)
        center_m = observation.tracker_position_m[:, -1].double().mean(dim=1)
        x_m, v_mps = position_m - center_m.float()[..., None], velocity_mps
        by_particle = torch.cat(
            [
                x_m,
                v_mps,
                x_m.square().sum(dim=1, keepdim=True),
                (x_m * v_mps).sum(dim=1, keepdim=True),
                v_mps.square().sum(dim=1, keepdim=True),
                torch.ones_like(exponent)[:, None],
            ],
            dim=1,
        )
        num_pieces = min(MOST_PIECES, num_samples)
        edge = [piece * num_samples // num_pieces for piece in range(num_pieces + 1)]
        by_tracker, weight_np = [], []
        for first, end in itertools.pairwise(edge):
            share = heard[:, first:end].sum(dim=1) / num_heard
            power_dbm = mean_power_dbm(observation.rssi_dbm[:, first:end])
            weight_np.append((power_dbm - reference_dbm(self._scenario)) * NEPERS_PER_DB + share.log())
            r_m = (observation.tracker_position_m[:, first:end].double().mean(dim=1) - center_m[:, None]).float()
            b_s = age_s[:, first:end].mean(dim=1).float()[:, None, None].expand(-1, r_m.shape[1], 1)
            one = torch.ones_like(b_s)
            square_m2 = r_m.square().sum(dim=2, keepdim=True)
            by_tracker.append(torch.cat([-2 * r_m, 2 * b_s * r_m, one, -2 * b_s, b_s.square(), square_m2], dim=2))
        squared_m2 = torch.bmm(torch.cat(by_tracker, dim=1), by_particle)
        least_m2 = self._scenario.reference_distance_m**2
        loss_np = squared_m2.clamp_min_(least_m2).mul_(1 / least_m2).log_().mul_((exponent / 2)[:, None])
        loss_np += torch.cat(weight_np, dim=1).nan_to_num(nan=-math.inf)[..., None]
        by_piece = loss_np.view(num_chases, num_pieces, -1, loss_np.shape[2])
        total_np = by_piece.exp_().sum(dim=1).clamp_(1e-30, 1e30).log_()
        return torch.where((num_heard > 0)[..., None], total_np / NEPERS_PER_DB, 0.0)

    def noise(
        self,
        observation: Observation,
        position_m: Float[Tensor, "chase 3 particle"],
        velocity_mps: Float[Tensor, "chase 3 particle"],
        age_s: Float[Tensor, "chase sample"],
    ) -> Noise:
        """Of the mean powers, if targets flew as these particles do, averaged over them.

        Two samples of one tracker are ``alike``; of two trackers at one moment the powers are correlated by a factor
        more, and only samples that both have heard can be.
        """
        lasted_s = age_s[:, :1].clamp(min=1e-3)[..., None]
        flown_m = (observation.tracker_position_m[:, -1] - observation.tracker_position_m[:, 0]).double()
        tracker_mps = (flown_m / lasted_s).float()
        speed_mps = (velocity_mps[:, None] - tracker_mps[..., None]).square().sum(dim=2).sqrt()
        alike = self._likeness.alike(speed_mps, observation.rssi_dbm.shape[1]).double().mean(dim=2)
        heard = observation.rssi_dbm.isfinite().double()
        number = heard.sum(dim=1)
        both = heard.transpose(1, 2) @ heard
        pairs = (number[:, :, None] * number[:, None]).clamp(min=1.0)
        between = (alike[:, :, None] + alike[:, None]) / 2
        variance = variance_of_power(self._scenario) * (between + (1 - between) * both / pairs)
        own = variance.diagonal(dim1=1, dim2=2)
        shape = 1 / own
        spread_np2 = torch.polygamma(1, shape) / own
        covariance_np2 = variance * (spread_np2[:, :, None] * spread_np2[:, None]).sqrt()
        deaf = number == 0
        together = ~(deaf[:, :, None] | deaf[:, None])
        correlation = torch.full_like(variance[0], self._correlation).fill_diagonal_(1.0)
        covariance_db2 = torch.where(together, covariance_np2 * correlation / NEPERS_PER_DB**2, 0.0)
        away_m = position_m[:, None] - observation.tracker_position_m[:, -1].float()[..., None]
        nearness = away_m.square().sum(dim=2).clamp(min=self._scenario.reference_distance_m**2).reciprocal()
        misplaced_db2 = (slope_db(self._scenario) * PLACE_ERROR_M) ** 2 * nearness.double().mean(dim=2)
        least_db2 = torch.where(deaf, UNHEARD_DB2, LEAST_SPREAD_DB**2 + misplaced_db2)
        bias_db = torch.where(deaf, 0.0, (shape.digamma() - shape.log()) / NEPERS_PER_DB)
        return Noise(covariance_db2 + torch.diag_embed(least_db2), bias_db.float())
