"""Errors that stay while the swarm does and change as it flies: shadowing, model by model, for all particles at once.

Besides its constants x (``receiver_models``) each tracker hears an error that depends on where it is: in part the same
for all, in part a field whose correlation falls with the distance (Gudmundson 1991). The field is kept at six ``NODES``
around the swarm's centre, and forgets itself over the way that the centre flies (a first-order Gauss-Markov process);
what a tracker hears of it is the best linear guess from the nodes, and what that leaves open is noise. So a cross that
turns comes back to the errors that it has heard, and what stays the same is never counted as evidence again.

In a Kalman filter of constants and nodes neither gain nor covariance depends on the particle: all share them, and each
keeps its own mean.
"""

from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Tensor
from ..formation import TRACKER_DIRECTION
from ..scenario import NUM_TRACKERS
from .receiver_models import UNEQUAL_DB, UNKNOWN_POWER_DB, power_of_total_db

COMMON_SHARE = 0.5
"""Of the error's variance, what all trackers have in common."""
STATES = 2 * NUM_TRACKERS
"""The constants of all trackers, then the errors at all nodes."""


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
    """The filters of all models, for a cross of this spacing."""

    def __init__(self, spacing_m: float, models: tuple[ShadowModel, ...] = SHADOW_MODELS) -> None:
        self.models = models
        self._distance_m = torch.tensor([model.distance_m for model in models], dtype=torch.float64)[:, None, None]
        spread_db = torch.tensor([model.spread_db for model in models], dtype=torch.float64)
        self._variance_db2 = spread_db.square()[:, None, None]
        self._nodes_m = spacing_m * TRACKER_DIRECTION
        self._node_db2 = self._covariance_db2(self._nodes_m, self._nodes_m)
        self._constants_db2 = UNKNOWN_POWER_DB**2 + UNEQUAL_DB**2 * torch.eye(NUM_TRACKERS, dtype=torch.float64)
        self.start_db2 = torch.zeros(len(models), STATES, STATES, dtype=torch.float64)
        self.start_db2[:, :NUM_TRACKERS, :NUM_TRACKERS] = self._constants_db2
        self.start_db2[:, NUM_TRACKERS:, NUM_TRACKERS:] = self._node_db2

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
        """Mean and covariance when the centre has flown so far and trackers, here as seen from it, have heard this; and
        the log density of what they have heard.
        """
        num_chases, num_models, _, num_particles = mean_db.shape
        kept = (-moved_m[:, None, None, None] / self._distance_m).exp()
        factor = torch.ones(num_chases, num_models, STATES, 1, dtype=torch.float64)
        factor[..., NUM_TRACKERS:, :] = kept
        before = covariance_db2 * factor * factor.mT
        before[..., NUM_TRACKERS:, NUM_TRACKERS:] += (1 - kept.square()) * self._node_db2
        hears, open_db2 = self._heard_of_nodes(tracker_m)
        heard = before @ hears.mT
        spread = hears @ heard + open_db2 + noise_db2[:, None]
        root = torch.linalg.cholesky((spread + spread.mT) / 2)
        inverse = torch.linalg.inv(root)
        whitened_gain = heard @ inverse.mT
        after = before - whitened_gain @ whitened_gain.mT
        mean_db = mean_db * factor.float()
        flat = (num_chases * num_models, -1)
        each_db = residual_db[:, None].expand(-1, num_models, -1, -1).reshape(-1, NUM_TRACKERS, num_particles)
        white = torch.bmm(inverse.float().view(*flat, NUM_TRACKERS), each_db)
        states_db = mean_db.view(*flat, num_particles)
        white = torch.baddbmm(white, (inverse @ hears).float().view(*flat, STATES), states_db, alpha=-1)
        gain = whitened_gain.float().view(*flat, NUM_TRACKERS)
        mean_db = torch.baddbmm(states_db, gain, white).view(mean_db.shape)
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

    def _heard_of_nodes(
        self, tracker_m: Float[Tensor, "chase tracker 3"]
    ) -> tuple[Float[Tensor, "chase model tracker state"], Float[Tensor, "chase model tracker tracker"]]:
        """What trackers at these places, seen from the centre, hear of constants and nodes, and the covariance that the
        nodes leave open.
        """
        tracker_m = tracker_m[:, None]
        across_db2 = self._covariance_db2(tracker_m, self._nodes_m)
        weight = torch.linalg.solve(self._node_db2, across_db2.mT).mT
        open_db2 = self._covariance_db2(tracker_m, tracker_m) - weight @ across_db2.mT
        constants = torch.eye(NUM_TRACKERS, dtype=torch.float64).expand(weight.shape)
        return torch.cat([constants, weight], dim=3), open_db2

    def _covariance_db2(
        self, one_m: Float[Tensor, "*batch place 3"], other_m: Float[Tensor, "*#batch node 3"]
    ) -> Tensor:
        """Of the errors at these places, for each model."""
        apart_m = (one_m[..., :, None, :] - other_m[..., None, :, :]).norm(dim=-1)
        covariance_db2: Tensor = self._variance_db2 * (
            COMMON_SHARE + (1 - COMMON_SHARE) * (-apart_m / self._distance_m).exp()
        )
        return covariance_db2
