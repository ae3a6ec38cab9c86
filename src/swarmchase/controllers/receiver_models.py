"""What the transmitter's power and the receivers' offsets may be, model by model, for all particles at once.

A mean level's departure from the told channel is x_u + noise, x_u = power + offset of tracker u: constants, with a
Gaussian prior of covariance C in each model. The noise's covariance R is the same for all particles, so that of all
that was heard a particle needs to keep only

    s = sum R^-1 z    [tracker],    q = sum z^T R^-1 z,    and all particles together    A = sum R^-1,

and the evidence for model m on the particle's whole way is, with B = (I + C A)^-1 C,

    log p = -(log det(I + C A) + q - s^T B s) / 2 + what all models and particles have in common.
"""

from dataclasses import dataclass

import torch

from ..batch.array_types import Bool, Float, Tensor
from ..scenario import NUM_TRACKERS

TOLD_POWER_DB, UNKNOWN_POWER_DB = 0.5, 7.0
"""Standard deviation of the transmit power around the told one, where it is known and where it is not."""
EQUAL_DB, UNEQUAL_DB, WRONG_DB = 0.2, 2.0, 20.0
"""Standard deviation of receivers' offsets, where they are equal, as they usually are, and where one is wrong."""


@dataclass(frozen=True)
class ReceiverModel:
    """A prior of power and offsets."""

    name: str
    weight: float
    power_db: float
    offset_db: tuple[float, ...]

    def covariance_db2(self) -> Float[Tensor, "tracker tracker"]:
        """Of power + offset."""
        offset_db = torch.tensor(self.offset_db, dtype=torch.float64)
        return self.power_db**2 + torch.diag(offset_db.square())


def _one_wrong(tracker: int) -> tuple[float, ...]:
    return tuple(WRONG_DB if other == tracker else UNEQUAL_DB for other in range(NUM_TRACKERS))


RECEIVER_MODELS = (
    ReceiverModel("as told", 0.40, TOLD_POWER_DB, (EQUAL_DB,) * NUM_TRACKERS),
    ReceiverModel("power unknown", 0.15, UNKNOWN_POWER_DB, (EQUAL_DB,) * NUM_TRACKERS),
    ReceiverModel("offsets", 0.10, TOLD_POWER_DB, (UNEQUAL_DB,) * NUM_TRACKERS),
    ReceiverModel("power unknown, offsets", 0.25, UNKNOWN_POWER_DB, (UNEQUAL_DB,) * NUM_TRACKERS),
    *(
        ReceiverModel(f"tracker {tracker + 1} wrong", 0.01, UNKNOWN_POWER_DB, _one_wrong(tracker))
        for tracker in range(NUM_TRACKERS)
    ),
    ReceiverModel("all wrong", 0.01, WRONG_DB, (WRONG_DB,) * NUM_TRACKERS),
)


class ReceiverModels:
    """The evidence of all models."""

    def __init__(self, models: tuple[ReceiverModel, ...] = RECEIVER_MODELS) -> None:
        self.models = models
        self._prior_db2 = torch.stack([model.covariance_db2() for model in models])
        weight = torch.tensor([model.weight for model in models], dtype=torch.float64)
        self._log_weight = (weight / weight.sum()).log()
        self._power_db = torch.tensor([model.power_db for model in models], dtype=torch.float64)
        self._wrong = torch.tensor([model.offset_db for model in models]) >= WRONG_DB

    def log_evidence(
        self,
        precision: Float[Tensor, "chase tracker tracker"],
        sums: Float[Tensor, "chase tracker particle"],
    ) -> Float[Tensor, "chase model particle"]:
        """Of each model with its weight, but for -q / 2, float32; from A and s."""
        posterior_db2, log_det = self._posterior(precision)
        root = torch.linalg.cholesky((posterior_db2 + posterior_db2.mT) / 2).mT.float()
        num_chases, num_models, num_trackers, _ = root.shape
        scaled = torch.bmm(root.reshape(num_chases, num_models * num_trackers, num_trackers), sums)
        squared = scaled.square_().view(num_chases, num_models, num_trackers, -1).sum(dim=2)
        constant = (self._log_weight - log_det / 2).float()
        return squared.mul_(0.5).add_(constant[..., None])

    def estimates(
        self,
        precision: Float[Tensor, "chase tracker tracker"],
        sums: Float[Tensor, "chase tracker particle"],
        share: Float[Tensor, "chase model particle"],
    ) -> tuple[Float[Tensor, "chase"], Float[Tensor, "chase tracker"]]:
        """Power and offsets that are expected if each model and particle is so likely, float64."""
        posterior_db2, _ = self._posterior(precision)
        weighed = torch.einsum("cmp,ctp->cmt", share, sums.double()) / sums.shape[2]
        total_db = (posterior_db2 @ weighed[..., None])[..., 0]
        power_db = power_of_total_db(total_db, self._prior_db2, self._power_db)
        return power_db.sum(dim=1), (total_db - power_db[..., None]).sum(dim=1)

    def is_wrong(self, share: Float[Tensor, "chase model"]) -> Bool[Tensor, "chase tracker"]:
        """Which receivers are more likely wrong than not, if each model is so likely."""
        return share[:, : len(self.models)] @ self._wrong.double() > 0.5

    def _posterior(
        self, precision: Float[Tensor, "chase tracker tracker"]
    ) -> tuple[Float[Tensor, "chase model tracker tracker"], Float[Tensor, "chase model"]]:
        """B and log det(I + C A) of each model, float64."""
        inner = torch.eye(NUM_TRACKERS, dtype=torch.float64) + self._prior_db2 @ precision[:, None]
        return torch.linalg.solve(inner, self._prior_db2.expand_as(inner)), torch.linalg.slogdet(inner).logabsdet


def power_of_total_db(
    total_db: Float[Tensor, "*batch tracker"],
    prior_db2: Float[Tensor, "*model tracker tracker"],
    power_db: Float[Tensor, "*model"],
) -> Float[Tensor, "*batch"]:
    """What power is expected where power + offset is expected to be this: sigma_p^2 1^T C^-1 x."""
    solved: Tensor = torch.linalg.solve(prior_db2, total_db[..., None])[..., 0]
    return power_db.square() * solved.sum(dim=-1)
