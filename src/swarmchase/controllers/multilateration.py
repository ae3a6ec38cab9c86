"""``multilateration``: robust non-linear least squares on the target's position over the windows of the chase.

After each window it fits the position that explains the mean powers of the last ``MOST_WINDOWS`` windows, and goes
there. Residuals are whitened by the fading's spread and correlation (``fading_law``): what trackers fade together says
little of the direction. Cauchy's loss, minimised by re-weighted Levenberg-Marquardt steps, keeps deep fades and a wrong
start distance from ruling the fit. It is what localisation from RSSI usually does (Zanella 2016, "Best practice in RSS
measurements and ranging"), with memory.

Missing samples do not count, and a tracker without any is left out of its window. In a window without any sample it
holds still. Where the fit leaves the finite numbers it begins anew.

Where trackers stop to listen the target is taken to stand still. In flight the fit has the target's velocity too, and
what was heard counts less the older it is, since the target may have changed its velocity meanwhile: by
``VELOCITY_WALK_MPS`` in a second, so that a standard deviation of ``VELOCITY_WALK_MPS`` t^1.5 / sqrt(3) metres of its
place t seconds ago is unknown. At the distance that its own levels tell this is so many decibels, which are added to
the fading's variance: what was heard from far away counts for long, what was heard nearby for a second. An interval
enters in two halves, in each of which target and trackers count as standing.

``multilateration-unknown-power`` also fits the transmit power, which it knows to within ``POWER_SPREAD_DB``.
"""

import itertools
import math
from dataclasses import dataclass, replace

import torch

from ..batch.array_types import Float, Int, Tensor
from ..channel.fading_law import FadingLaw, fading_law
from ..channel.propagation import reference_dbm, slope_db
from ..formation import Action, displacement_towards, spacing_towards
from ..observation import (
    Observation,
    center_m,
    checked_observation,
    mean_position_m,
    mean_power_dbm,
    sample_age_s,
)
from ..scenario import NUM_TRACKERS, Scenario, doppler_spread_from_speed_hz
from .condition import Condition
from .described import Described
from .explanation import Explanation
from .particle import POWER_SPREAD_DB
from .target_motion import CLIMB_SHARE, SPEED_SPREAD_MPS

MOST_WINDOWS = 128
"""Older windows are forgotten."""
MOST_WINDOWS_IN_FLIGHT = 80
"""20 s, when decisions are half a second apart: what is older hardly counts."""
PIECES_IN_FLIGHT = 2
"""Windows that an interval in flight is cut into: in half a second the swarm flies 5 m, too far for one place."""
RECENT_WINDOWS = 8
"""In flight the fit also begins at the distance that these tell on average, in all directions from where it is."""
VELOCITY_WALK_MPS = 3.5
"""Standard deviation of what a target's velocity changes by in a second."""
ITERATIONS = 12
DAMPING = 1e-2
"""Levenberg-Marquardt: this share of the diagonal is added to it."""
VELOCITY_SPREAD_MPS = SPEED_SPREAD_MPS * torch.tensor([1.0, 1.0, CLIMB_SHARE], dtype=torch.float64)
"""Standard deviation of a target's velocity when nothing is known of it."""
FASTEST_DOPPLER_HZ = 1000.0
"""Faster than any sampling, so that samples have nothing in common."""
FARTHEST_M = 1e4
"""A level that tells more counts as this."""
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
    age_s: Float[Tensor, "chase window"]
    """How long before the last sample, float64; 0 where targets are taken to stand still."""
    trust: Float[Tensor, "chase window"]
    """Standard deviation of the fading over that of all that is unknown of a window's levels; 1 where targets are taken
    to stand still."""
    time_s: Float[Tensor, "chase"]
    """Of the last sample, float64; NaN before the first, and where targets are taken to stand still."""
    estimate: Float[Tensor, "chase unknown"]
    """Position of the target in metres, its power above the scenario's in dB, and in flight its velocity in metres a
    second, float64."""
    condition: Int[Tensor, "chase"]
    """A ``Condition``."""


class MultilaterationController(Described):
    """Goes to where the target explains best what was heard."""

    def __init__(self, scenario: Scenario, power_is_known: bool = True) -> None:
        self.name = "multilateration" if power_is_known else "multilateration-unknown-power"
        self._scenario = scenario
        self._in_flight = scenario.pace == "listen_in_flight"
        self._law = _law_in_flight(scenario) if self._in_flight else fading_law(scenario)
        self._slope_db = slope_db(scenario)
        self._median_dbm = reference_dbm(scenario) + self._law.median_db
        self._free = torch.tensor([True, True, True, not power_is_known, *([True] * 3 if self._in_flight else [])])
        # Where a start is anywhere in a range, or the target has left it, nothing is known of it.
        knows_start = scenario.farthest_start_m is None and not self._in_flight
        self._start_spread = START_SPREAD if knows_start else math.inf
        direction = CANDIDATE_DIRECTION / CANDIDATE_DIRECTION.norm(dim=1, keepdim=True)
        self._candidate = torch.nn.functional.pad(direction, (0, len(self._free) - 3))

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> MultilaterationMemory:
        """Nothing heard."""
        most = MOST_WINDOWS_IN_FLIGHT if self._in_flight else MOST_WINDOWS
        return MultilaterationMemory(
            power_dbm=torch.full((num_chases, most, NUM_TRACKERS), math.nan, dtype=torch.float64),
            tracker_position_m=torch.zeros(num_chases, most, NUM_TRACKERS, 3, dtype=torch.float64),
            age_s=torch.zeros(num_chases, most, dtype=torch.float64),
            trust=torch.ones(num_chases, most, dtype=torch.float64),
            time_s=torch.full((num_chases,), math.nan, dtype=torch.float64),
            estimate=(self._scenario.start_distance_m * self._candidate[:1]).repeat(num_chases, 1),
            condition=torch.zeros(num_chases, dtype=torch.int64),
        )

    def decide(self, observation: Observation, memory: MultilaterationMemory) -> tuple[Action, MultilaterationMemory]:
        """Fit, and take the displacement that comes nearest to the fitted position."""
        observation = checked_observation(observation, self._scenario)
        memory = self._heard(observation, memory)
        center = center_m(observation)
        estimate = self._fitted(memory, center)
        lost = ~estimate.isfinite().all(dim=1)
        nowhere_else = torch.nn.functional.pad(center, (0, len(self._free) - 3))
        estimate = torch.where(lost[:, None], nowhere_else, estimate)
        condition = torch.where(lost, int(Condition.LOST), int(Condition.TRACKING))
        deaf = ~observation.rssi_dbm.isfinite().flatten(1).any(dim=1)
        # In flight it goes on to where it expects the target, if it has ever heard it.
        holds = ~memory.power_dbm.isfinite().flatten(1).any(dim=1) if self._in_flight else deaf
        left_m = torch.where(holds[:, None], 0.0, estimate[:, :3] - center)
        action = Action(
            spacing_m=spacing_towards(self._scenario, left_m),
            displacement_m=displacement_towards(self._scenario, left_m),
        )
        condition = torch.where(deaf, int(Condition.DEAF), condition)
        return action, replace(memory, estimate=estimate, condition=condition)

    def explain(self, observation: Observation, memory: MultilaterationMemory) -> Explanation:
        """One point: it knows of no other."""
        return Explanation(None, memory.estimate[:1, :3])

    def _heard(self, observation: Observation, memory: MultilaterationMemory) -> MultilaterationMemory:
        """The memory with this window; in flight with the windows of this interval, at whose end the target is farther
        on.
        """
        time_s, lasted_s, age_s = sample_age_s(observation, self._scenario, memory.time_s)
        estimate, num_pieces = memory.estimate, 1
        if self._in_flight:
            flown_m = estimate[:, 4:] * lasted_s[:, None]
            estimate = torch.cat([estimate[:, :3] + flown_m, estimate[:, 3:]], dim=1)
            num_pieces = min(PIECES_IN_FLIGHT, age_s.shape[1])
        else:
            time_s, lasted_s, age_s = memory.time_s, torch.zeros_like(lasted_s), torch.zeros_like(age_s)
        memory = replace(memory, age_s=memory.age_s + lasted_s[:, None], time_s=time_s, estimate=estimate)
        edge = [piece * age_s.shape[1] // num_pieces for piece in range(num_pieces + 1)]
        for first, end in itertools.pairwise(edge):
            window = Observation(observation.rssi_dbm[:, first:end], observation.tracker_position_m[:, first:end])
            memory = replace(
                memory,
                power_dbm=_pushed(memory.power_dbm, mean_power_dbm(window.rssi_dbm).double()),
                tracker_position_m=_pushed(memory.tracker_position_m, mean_position_m(window)),
                age_s=_pushed(memory.age_s, age_s[:, first:end].mean(dim=1)),
            )
        return replace(memory, trust=self._trust(memory)) if self._in_flight else memory

    def _fitted(
        self, memory: MultilaterationMemory, center: Float[Tensor, "chase 3"]
    ) -> Float[Tensor, "chase unknown"]:
        # Rows of windows that no chase of the batch has heard yet need not be computed.
        heard = memory.power_dbm.isfinite()
        longest = int(heard.any(dim=2).any(dim=0).nonzero().max()) + 1 if heard.any() else 1
        memory = replace(
            memory,
            power_dbm=memory.power_dbm[:, :longest],
            tracker_position_m=memory.tracker_position_m[:, :longest],
            age_s=memory.age_s[:, :longest],
            trust=memory.trust[:, :longest],
        )
        estimate = self._best_start(memory, center)
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

    def _best_start(
        self, memory: MultilaterationMemory, center: Float[Tensor, "chase 3"]
    ) -> Float[Tensor, "chase unknown"]:
        num_chases = len(memory.estimate)
        if self._in_flight:
            around_m = torch.nn.functional.pad(center, (0, len(self._free) - 3))
            recent_m = self._told_distance_m(memory)[:, :RECENT_WINDOWS].nanmean(dim=1)
            recent_m = recent_m.nan_to_num(nan=self._scenario.start_distance_m)
            others = around_m + recent_m[:, None] * self._candidate[:, None]
        else:
            others = (self._scenario.start_distance_m * self._candidate)[:, None].expand(-1, num_chases, -1)
        starts = torch.cat([memory.estimate[None], others])
        from_each = MultilaterationMemory(
            power_dbm=memory.power_dbm.repeat(len(starts), 1, 1),
            tracker_position_m=memory.tracker_position_m.repeat(len(starts), 1, 1, 1),
            age_s=memory.age_s.repeat(len(starts), 1),
            trust=memory.trust.repeat(len(starts), 1),
            time_s=memory.time_s.repeat(len(starts)),
            estimate=starts.flatten(0, 1),
            condition=memory.condition.repeat(len(starts)),
        )
        cost = _total((self._residuals(from_each, from_each.estimate) / CAUCHY_SCALE).square().log1p())
        return starts[cost.view(-1, num_chases).argmin(dim=0), torch.arange(num_chases)]

    def _residuals(
        self, memory: MultilaterationMemory, estimate: Float[Tensor, "chase unknown"]
    ) -> Float[Tensor, "chase residual"]:
        """Of the distance from the start, of the power, whitened of every window and tracker, and of the velocity."""
        distance_m = _length_m(self._offset_m(memory, estimate)).clamp(min=self._scenario.reference_distance_m)
        loss_db = self._slope_db * (distance_m / self._scenario.reference_distance_m).log()
        residual_db = memory.power_dbm.nan_to_num(0.0) + loss_db - self._median_dbm - estimate[:, None, None, 3]
        start_m = _length_m(estimate[:, :3])[:, None].clamp(min=1e-6)
        return torch.cat(
            [
                (start_m / self._scenario.start_distance_m).log() / self._start_spread,
                estimate[:, 3:4] / POWER_SPREAD_DB,
                self._whitened(residual_db[..., None], memory).flatten(1),
                estimate[:, 4:] / VELOCITY_SPREAD_MPS[: len(self._free) - 4],
            ],
            dim=1,
        )

    def _jacobian(
        self, memory: MultilaterationMemory, estimate: Float[Tensor, "chase unknown"]
    ) -> Float[Tensor, "chase residual unknown"]:
        """The residuals' derivatives by the estimate."""
        offset_m = self._offset_m(memory, estimate)
        distance_m = _length_m(offset_m)[..., None].clamp(min=self._scenario.reference_distance_m)
        by_position = self._slope_db * offset_m / distance_m.square()
        by_velocity = -by_position * memory.age_s[:, :, None, None] if self._in_flight else by_position[..., :0]
        by_estimate = torch.cat([by_position, -torch.ones_like(by_position[..., :1]), by_velocity], dim=3) * self._free
        by_prior = torch.zeros(len(estimate), 2, len(self._free), dtype=torch.float64)
        squared_m2 = _length_m(estimate[:, :3])[:, None].square().clamp(min=1e-12)
        by_prior[:, 0, :3] = estimate[:, :3] / squared_m2 / self._start_spread
        by_prior[:, 1, 3] = self._free[3] / POWER_SPREAD_DB
        of_velocity = torch.eye(len(self._free), dtype=torch.float64)[4:]
        of_velocity = of_velocity / VELOCITY_SPREAD_MPS[: len(of_velocity), None]
        whitened = self._whitened(by_estimate, memory)
        return torch.cat([by_prior, whitened.flatten(1, 2), of_velocity.expand(len(estimate), -1, -1)], dim=1)

    def _offset_m(
        self, memory: MultilaterationMemory, estimate: Float[Tensor, "chase unknown"]
    ) -> Float[Tensor, "chase window tracker 3"]:
        position_m = estimate[:, None, None, :3]
        if self._in_flight:
            position_m = position_m - estimate[:, None, None, 4:] * memory.age_s[:, :, None, None]
        return position_m - memory.tracker_position_m

    def _told_distance_m(self, memory: MultilaterationMemory) -> Float[Tensor, "chase window"]:
        """How far away the target is by the level of each window alone; NaN where none was heard."""
        loss_db = self._median_dbm - memory.power_dbm.nanmean(dim=2)
        distance_m = self._scenario.reference_distance_m * (loss_db / self._slope_db).exp()
        return distance_m.clamp(self._scenario.reference_distance_m, FARTHEST_M)

    def _whitened(
        self, value: Float[Tensor, "chase window tracker k"], memory: MultilaterationMemory
    ) -> Float[Tensor, "chase window tracker k"]:
        """Multiplied by the inverse square root of the fading's covariance, and less the more the target may have
        changed its velocity since; nothing where nothing was heard.
        """
        heard = memory.power_dbm.isfinite()
        value = torch.where(heard[..., None], value, 0.0)
        num_heard = heard.sum(dim=2)[..., None, None]
        mean = value.sum(dim=2, keepdim=True) / num_heard.clamp(min=1)
        own, common = 1 - self._law.correlation, 1 + (num_heard - 1) * self._law.correlation
        white = (value - mean) / own**0.5 + mean / common.sqrt()
        white = torch.where(heard[..., None], white, 0.0) / self._law.standard_deviation_db
        return white * memory.trust[:, :, None, None]

    def _trust(self, memory: MultilaterationMemory) -> Float[Tensor, "chase window"]:
        """How much each window counts now, since the target may have changed its velocity."""
        wandered_m = VELOCITY_WALK_MPS / math.sqrt(3) * memory.age_s * memory.age_s.sqrt()
        wandered_db = self._slope_db * (wandered_m / self._told_distance_m(memory)).nan_to_num(nan=0.0)
        return 1 / (1 + (wandered_db / self._law.standard_deviation_db).square()).sqrt()


def _law_in_flight(scenario: Scenario) -> FadingLaw:
    """Of a piece of an interval: a swarm at full speed against a target that is as likely ahead as anywhere."""
    speed_hz = doppler_spread_from_speed_hz(scenario.tracker_speed_mps, scenario.carrier_hz)
    heeds_motion = scenario.continuity == "in_flight"
    return fading_law(
        replace(
            scenario,
            window_samples=max(1, scenario.samples_a_decision // PIECES_IN_FLIGHT),
            doppler_spread_hz=min(speed_hz, FASTEST_DOPPLER_HZ) if heeds_motion else scenario.doppler_spread_hz,
        )
    )


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
