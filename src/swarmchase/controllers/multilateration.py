"""``multilateration``: robust non-linear least squares on the target's position over the windows of the chase.

After each window it fits the position that explains the mean powers of the last ``MOST_WINDOWS`` windows, and goes
there. Residuals are whitened by the fading's spread and correlation (``fading_law``): what trackers fade together says
little of the direction. Cauchy's loss, minimised by re-weighted Levenberg-Marquardt steps, keeps deep fades and a wrong
start distance from ruling the fit. It is what localisation from RSSI usually does (Zanella 2016, "Best practice in RSS
measurements and ranging"), with memory.

Missing samples do not count, and a tracker without any is left out of its window. In a window without any sample it
holds still. Where the fit leaves the finite numbers it begins anew. The target is taken to stand still; one
that flies is not caught.

``multilateration-unknown-power`` also fits the transmit power, which it knows to within ``POWER_SPREAD_DB``.
"""

import itertools
import math
from dataclasses import dataclass, replace

import torch

from ..batch.array_types import Bool, Float, Int, Tensor
from ..channel.fading_law import fading_law
from ..channel.propagation import reference_dbm, slope_db
from ..formation import Action, displacement_towards, nearest_choice
from ..observation import Observation, center_m, checked_observation, mean_position_m, mean_power_dbm
from ..scenario import NUM_TRACKERS, Scenario
from .condition import Condition
from .explanation import Explanation
from .particle import POWER_SPREAD_DB

MOST_WINDOWS = 128
"""Older windows are forgotten."""
ITERATIONS = 12
DAMPING = 1e-2
"""Levenberg-Marquardt: this share of the diagonal is added to it."""
CAUCHY_SCALE = 2.0
"""A residual of this many standard deviations counts half."""
START_SPREAD = 0.05
"""Standard deviation of the log distance from the start."""
LONGEST_STEP_M = 30.0
"""Of one iteration."""
CANDIDATE_DIRECTION = torch.tensor(
    [direction for direction in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(direction)], dtype=torch.float64
)
"""The fit begins at the best of these, at the distance from the start, and of its last result."""


@dataclass(frozen=True)
class MultilaterationMemory:
    """What each chase has heard so far and what it makes of it; row = chase."""

    power_dbm: Float[Tensor, "chase window tracker"]
    """Mean powers, the newest window first; NaN where nothing was heard."""
    tracker_position_m: Float[Tensor, "chase window tracker 3"]
    estimate: Float[Tensor, "chase 4"]
    """Position of the target in metres, and its power above the scenario's in dB, float64."""
    condition: Int[Tensor, "chase"]
    """A ``Condition``."""


class MultilaterationController:
    """Goes to where the target explains best what was heard."""

    def __init__(self, scenario: Scenario, power_is_known: bool = True) -> None:
        self.name = "multilateration" if power_is_known else "multilateration-unknown-power"
        self._scenario = scenario
        self._law = fading_law(scenario)
        self._slope_db = slope_db(scenario)
        self._free = torch.tensor([True, True, True, not power_is_known])
        # Where a start is anywhere in a range, nothing is known of it.
        self._start_spread = START_SPREAD if scenario.farthest_start_m is None else math.inf
        direction = CANDIDATE_DIRECTION / CANDIDATE_DIRECTION.norm(dim=1, keepdim=True)
        self._candidate = torch.nn.functional.pad(scenario.start_distance_m * direction, (0, 1))

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> MultilaterationMemory:
        """Nothing heard."""
        return MultilaterationMemory(
            power_dbm=torch.full((num_chases, MOST_WINDOWS, NUM_TRACKERS), math.nan, dtype=torch.float64),
            tracker_position_m=torch.zeros(num_chases, MOST_WINDOWS, NUM_TRACKERS, 3, dtype=torch.float64),
            estimate=self._candidate[:1].repeat(num_chases, 1),
            condition=torch.zeros(num_chases, dtype=torch.int64),
        )

    def decide(self, observation: Observation, memory: MultilaterationMemory) -> tuple[Action, MultilaterationMemory]:
        """Fit, and take the displacement that comes nearest to the fitted position."""
        observation = checked_observation(observation, self._scenario)
        power_dbm = mean_power_dbm(observation.rssi_dbm).double()
        deaf = ~power_dbm.isfinite().any(dim=1)
        memory = replace(
            memory,
            power_dbm=_pushed(memory.power_dbm, power_dbm),
            tracker_position_m=_pushed(memory.tracker_position_m, mean_position_m(observation)),
        )
        estimate = self._fitted(memory)
        lost = ~estimate.isfinite().all(dim=1)
        center = center_m(observation)
        estimate = torch.where(lost[:, None], torch.nn.functional.pad(center, (0, 1)), estimate)
        condition = torch.where(lost, int(Condition.LOST), int(Condition.TRACKING))
        left_m = torch.where(deaf[:, None], 0.0, estimate[:, :3] - center)
        action = Action(
            spacing_m=nearest_choice(self._scenario.spacing_choices_m, left_m.norm(dim=1)),
            displacement_m=displacement_towards(self._scenario, left_m),
        )
        condition = torch.where(deaf, int(Condition.DEAF), condition)
        return action, replace(memory, estimate=estimate, condition=condition)

    def explain(self, observation: Observation, memory: MultilaterationMemory) -> Explanation:
        """One point: it knows of no other."""
        return Explanation(None, memory.estimate[:1, :3])

    def _fitted(self, memory: MultilaterationMemory) -> Float[Tensor, "chase 4"]:
        # Rows of windows that no chase of the batch has heard yet need not be computed.
        heard = memory.power_dbm.isfinite()
        longest = int(heard.any(dim=2).any(dim=0).nonzero().max()) + 1 if heard.any() else 1
        memory = replace(
            memory,
            power_dbm=memory.power_dbm[:, :longest],
            tracker_position_m=memory.tracker_position_m[:, :longest],
        )
        estimate = self._best_start(memory)
        for _ in range(ITERATIONS):
            residual, jacobian = self._residuals(memory, estimate), self._jacobian(memory, estimate)
            weight = 1 / (1 + (residual / CAUCHY_SCALE).square())
            normal = _total(jacobian[..., None] * (weight[:, :, None] * jacobian)[:, :, None])
            diagonal = normal.diagonal(dim1=1, dim2=2)
            normal = normal + torch.diag_embed(DAMPING * diagonal + 1e-9 + (~self._free).double())
            step = torch.linalg.solve(normal, -_total((weight * residual)[..., None] * jacobian))
            length_m = _length_m(step[:, :3])[:, None]
            estimate = estimate + step * (LONGEST_STEP_M / length_m).clamp(max=1)
        return estimate

    def _best_start(self, memory: MultilaterationMemory) -> Float[Tensor, "chase 4"]:
        num_chases = len(memory.estimate)
        starts = torch.stack([memory.estimate, *(one.expand(num_chases, -1) for one in self._candidate)])
        from_each = MultilaterationMemory(
            power_dbm=memory.power_dbm.repeat(len(starts), 1, 1),
            tracker_position_m=memory.tracker_position_m.repeat(len(starts), 1, 1, 1),
            estimate=starts.flatten(0, 1),
            condition=memory.condition.repeat(len(starts)),
        )
        cost = _total((self._residuals(from_each, from_each.estimate) / CAUCHY_SCALE).square().log1p())
        return starts[cost.view(-1, num_chases).argmin(dim=0), torch.arange(num_chases)]

    def _residuals(
        self, memory: MultilaterationMemory, estimate: Float[Tensor, "chase 4"]
    ) -> Float[Tensor, "chase residual"]:
        """Of the distance from the start, of the power, and whitened of every window and tracker."""
        distance_m = _length_m(self._offset_m(memory, estimate)).clamp(min=self._scenario.reference_distance_m)
        loss_db = self._slope_db * (distance_m / self._scenario.reference_distance_m).log()
        gain_dbm = reference_dbm(self._scenario) + self._law.median_db
        residual_db = memory.power_dbm.nan_to_num(0.0) + loss_db - gain_dbm - estimate[:, None, None, 3]
        start_m = _length_m(estimate[:, :3])[:, None].clamp(min=1e-6)
        return torch.cat(
            [
                (start_m / self._scenario.start_distance_m).log() / self._start_spread,
                estimate[:, 3:] / POWER_SPREAD_DB,
                self._whitened(residual_db[..., None], memory.power_dbm.isfinite()).flatten(1),
            ],
            dim=1,
        )

    def _jacobian(
        self, memory: MultilaterationMemory, estimate: Float[Tensor, "chase 4"]
    ) -> Float[Tensor, "chase residual 4"]:
        """The residuals' derivatives by the estimate."""
        offset_m = self._offset_m(memory, estimate)
        distance_m = _length_m(offset_m)[..., None].clamp(min=self._scenario.reference_distance_m)
        by_position = self._slope_db * offset_m / distance_m.square()
        by_estimate = torch.cat([by_position, -torch.ones_like(by_position[..., :1])], dim=3) * self._free
        by_prior = torch.zeros(len(estimate), 2, 4, dtype=torch.float64)
        squared_m2 = _length_m(estimate[:, :3])[:, None].square().clamp(min=1e-12)
        by_prior[:, 0, :3] = estimate[:, :3] / squared_m2 / self._start_spread
        by_prior[:, 1, 3] = self._free[3] / POWER_SPREAD_DB
        whitened = self._whitened(by_estimate, memory.power_dbm.isfinite())
        return torch.cat([by_prior, whitened.flatten(1, 2)], dim=1)

    def _offset_m(
        self, memory: MultilaterationMemory, estimate: Float[Tensor, "chase 4"]
    ) -> Float[Tensor, "chase window tracker 3"]:
        return estimate[:, None, None, :3] - memory.tracker_position_m

    def _whitened(
        self, value: Float[Tensor, "chase window tracker k"], heard: Bool[Tensor, "chase window tracker"]
    ) -> Float[Tensor, "chase window tracker k"]:
        """Multiplied by the inverse square root of the fading's covariance; nothing where nothing was heard."""
        value = torch.where(heard[..., None], value, 0.0)
        num_heard = heard.sum(dim=2)[..., None, None]
        mean = value.sum(dim=2, keepdim=True) / num_heard.clamp(min=1)
        own, common = 1 - self._law.correlation, 1 + (num_heard - 1) * self._law.correlation
        white = (value - mean) / own**0.5 + mean / common.sqrt()
        return torch.where(heard[..., None], white, 0.0) / self._law.standard_deviation_db


def _length_m(vector_m: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Written out: a norm of one row alone would be summed in another order than one of many rows."""
    x_m, y_m, z_m = vector_m.unbind(dim=-1)
    return (x_m.square() + y_m.square() + z_m.square()).sqrt()


def _pushed(rows: Float[Tensor, "chase window ..."], newest: Float[Tensor, "chase ..."]) -> Tensor:
    return torch.cat([newest[:, None], rows[:, :-1]], dim=1)


def _total(rows: Float[Tensor, "chase row ..."]) -> Tensor:
    """The sum of the rows, bit by bit the same whatever number of rows of zeros follows: half onto half."""
    missing = (1 << (rows.shape[1] - 1).bit_length()) - rows.shape[1]
    rows = torch.cat([rows, rows.new_zeros(len(rows), missing, *rows.shape[2:])], dim=1)
    while rows.shape[1] > 1:
        half = rows.shape[1] // 2
        rows = rows[:, :half] + rows[:, half:]
    return rows[:, 0]
