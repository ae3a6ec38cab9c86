"""Errors that stay while the swarm does and change as it flies: shadowing, model by model, for all particles at once.

Besides its constants x (``receiver_models``) each tracker has an error e that forgets itself over a distance
(Gudmundson 1991), in part the same for all: a first-order Gauss-Markov process in the way flown. In a Kalman filter of
(x, e) neither gain nor covariance depends on the particle, so that all share them and each keeps its own mean. What
stays the same for a while is so never counted as evidence again.
"""

from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Tensor
from ..scenario import NUM_TRACKERS
from .receiver_models import UNEQUAL_DB, UNKNOWN_POWER_DB, power_of_total_db

COMMON_SHARE = 0.5
"""Of the error's variance, what all trackers have in common."""
STATES = 2 * NUM_TRACKERS
"""The constants of all trackers, then their errors."""


@dataclass(frozen=True)
class ShadowModel:
    """Of the error."""

    name: str
    weight: float
    spread_db: float
    distance_m: float


SHADOW_MODELS = (
    ShadowModel("light shadowing", 0.05, 3.0, 12.0),
    ShadowModel("shadowing", 0.05, 6.0, 12.0),
)


class ShadowModels:
    """The filters of all models."""

    def __init__(self, models: tuple[ShadowModel, ...] = SHADOW_MODELS) -> None:
        self.models = models
        self._distance_m = torch.tensor([model.distance_m for model in models], dtype=torch.float64)
        spread_db = torch.tensor([model.spread_db for model in models], dtype=torch.float64)
        self._variance_db2 = spread_db.square()[:, None, None]
        self._constants_db2 = UNKNOWN_POWER_DB**2 + UNEQUAL_DB**2 * torch.eye(NUM_TRACKERS, dtype=torch.float64)
        self.start_db2 = torch.zeros(len(models), STATES, STATES, dtype=torch.float64)
        self.start_db2[:, :NUM_TRACKERS, :NUM_TRACKERS] = self._constants_db2
        self.start_db2[:, NUM_TRACKERS:, NUM_TRACKERS:] = self._variance_db2

    def updated(
        self,
        mean_db: Float[Tensor, "chase model state particle"],
        covariance_db2: Float[Tensor, "chase model state state"],
        moved_m: Float[Tensor, "chase"],
        tracker_m: Float[Tensor, "chase tracker 3"],
        residual_db: Float[Tensor, "chase tracker particle"],
        noise_db2: Float[Tensor, "chase tracker tracker"],
    ) -> tuple[
        Float[Tensor, "chase model state particle"],
        Float[Tensor, "chase model state state"],
        Float[Tensor, "chase model particle"],
    ]:
        """Mean and covariance when the swarm has flown so far and heard this, and the log density of what it heard."""
        num_chases, num_models, _, num_particles = mean_db.shape
        kept = (-moved_m[:, None] / self._distance_m).exp()
        factor = torch.ones(num_chases, num_models, STATES, dtype=torch.float64)
        factor[..., NUM_TRACKERS:] = kept[..., None]
        before = covariance_db2 * factor[..., None] * factor[..., None, :]
        before[..., NUM_TRACKERS:, NUM_TRACKERS:] += (1 - kept.square())[..., None, None] * self._error_db2(tracker_m)
        heard = before[..., :NUM_TRACKERS] + before[..., NUM_TRACKERS:]
        spread = heard[..., :NUM_TRACKERS, :] + heard[..., NUM_TRACKERS:, :] + noise_db2[:, None]
        root = torch.linalg.cholesky((spread + spread.mT) / 2)
        inverse = torch.linalg.inv(root)
        whitened_gain = heard @ inverse.mT
        after = before - whitened_gain @ whitened_gain.mT
        mean_db = mean_db * factor.float()[..., None]
        innovation_db = residual_db[:, None] - mean_db[:, :, :NUM_TRACKERS] - mean_db[:, :, NUM_TRACKERS:]
        flat = num_chases * num_models
        white = torch.bmm(
            inverse.float().view(flat, NUM_TRACKERS, NUM_TRACKERS), innovation_db.view(flat, NUM_TRACKERS, -1)
        )
        gain = whitened_gain.float().view(flat, STATES, NUM_TRACKERS)
        mean_db = torch.baddbmm(mean_db.view(flat, STATES, -1), gain, white).view(mean_db.shape)
        squared = white.square_().sum(dim=1).view(num_chases, num_models, num_particles)
        log_det = root.diagonal(dim1=2, dim2=3).log().sum(dim=2).float()
        return mean_db, (after + after.mT) / 2, squared.mul_(-0.5).sub_(log_det[..., None])

    def estimates(
        self, constants_db: Float[Tensor, "chase tracker"]
    ) -> tuple[Float[Tensor, "chase"], Float[Tensor, "chase tracker"]]:
        """Power and offsets that are expected where their sum is expected to be this, float64."""
        power = torch.tensor(UNKNOWN_POWER_DB, dtype=torch.float64)
        power_db = power_of_total_db(constants_db, self._constants_db2, power)
        return power_db, constants_db - power_db[:, None]

    def _error_db2(self, tracker_m: Float[Tensor, "chase tracker 3"]) -> Float[Tensor, "chase model tracker tracker"]:
        """Covariance of the errors of trackers at these places."""
        apart_m = (tracker_m[:, :, None] - tracker_m[:, None]).norm(dim=3)
        alike = (-apart_m[:, None] / self._distance_m[:, None, None]).exp()
        error_db2: Tensor = self._variance_db2 * (COMMON_SHARE + (1 - COMMON_SHARE) * alike)
        return error_db2
