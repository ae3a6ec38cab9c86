"""``particle``: a particle filter over the target's position that keeps its belief from movement to movement.

It is told the scenario: path loss, fading, correlation and the distance at the start. A window enters by its six mean
powers, whose joint law under the scenario's fading is ``channel.fading_law.FadingLaw``, the correlation between
trackers included. Resampling is systematic, followed by a Gaussian kernel in proportion to the belief's own covariance
(regularised particle filter: Musso, Oudjane and Le Gland 2001), so that the particles never collapse to copies of one.
On each axis it takes the displacement that leaves the least expected distance.

Most particles keep to the known distance from the start, and resampling moves them on that sphere alone; the others may
be at any distance, for a scenario that is wrong about it. Missing samples do not count, a silent tracker is left out,
and in a window without any sample it holds still. When several windows in a row are less likely than any of 20,000
should be, it begins anew around the swarm.

``recurrent`` is this filter with a learned likelihood: a window enters by its mean powers less the fading that a
network expects from the shape of the samples (``networks.fading``), whose joint law is narrower.

``particle-unknown-power`` also estimates the transmit power, which it knows to within ``POWER_SPREAD_DB``.
"""

import math
from dataclasses import dataclass, replace

import torch

from ..batch.array_types import Bool, Float, Int, Tensor
from ..batch.selection import join_chases, select_chases
from ..batch.streams import ChaseStreams, chase_keys
from ..channel.fading_law import WindowPower, fading_law
from ..channel.propagation import loss_beyond_reference_db, reference_dbm
from ..formation import Action, nearest_choice
from ..observation import Observation, center_m, checked_observation, mean_position_m, mean_power_dbm
from ..scenario import Scenario
from .belief import Belief, belief_of_particles
from .condition import Condition
from .described import Described
from .explanation import MOST_POINTS, Explanation, share_of_savings

NUM_PARTICLES = 1000
NUM_PARTICLES_UNKNOWN_POWER = 2000
"""A fourth dimension needs more: with 1000 its estimate is a decibel off."""
FREE_SHARE = 0.25
"""Share of the particles that may be at any distance from the start."""
FREE_SPREAD = 0.4
"""Standard deviation of their log distance."""
POWER_SPREAD_DB = 6.0
"""Standard deviation of an unknown transmit power around the scenario's."""
RESAMPLING_SHARE = 0.5
"""Particles are resampled when fewer than this share of them are effective."""
KERNEL_WIDTH = 0.25
"""Standard deviation of the kernel in those of the belief; the rule for three dimensions and 1000 particles says
0.36."""
LEAST_KERNEL_M = 0.1
SURPRISES = 3
"""So many improbable windows in a row mean that the target is not among the particles."""
NEAREST_M = 1.0
"""After beginning anew distances are log-uniform between this and twice the distance at the start."""


@dataclass(frozen=True)
class ParticleMemory:
    """The belief of each chase."""

    position_m: Float[Tensor, "chase 3 particle"]
    """In the chase's own frame, float32."""
    keeps_distance: Bool[Tensor, "chase particle"]
    """Whether a particle keeps to its distance from the start."""
    excess_power_db: Float[Tensor, "chase particle"]
    """Transmit power above the scenario's, float32; 0 where it is known."""
    log_weight: Float[Tensor, "chase particle"]
    """Normalised, float64."""
    surprises: Int[Tensor, "chase"]
    """Improbable windows in a row."""
    condition: Int[Tensor, "chase"]
    """A ``Condition``."""
    streams: ChaseStreams
    """Each chase's own random numbers."""


class ParticleController(Described):
    """Goes where its particles' expected distance on each axis is least."""

    def __init__(
        self,
        scenario: Scenario,
        name: str = "particle",
        power_is_known: bool = True,
        window_power: WindowPower = mean_power_dbm,
    ) -> None:
        self.name = name
        self._scenario = scenario
        self._power_is_known = power_is_known
        self._num_particles = NUM_PARTICLES if power_is_known else NUM_PARTICLES_UNKNOWN_POWER
        self._window_power = window_power
        self._law = fading_law(scenario, window_power)
        self._displacement_choices_m = torch.tensor(scenario.displacement_choices_m, dtype=torch.float64)

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> ParticleMemory:
        """Particles all around the start."""
        streams = ChaseStreams.of(chase_keys(seed, num_chases, first_chase), "policy")
        number = self._num_particles
        keeps_distance = (torch.arange(number) >= FREE_SHARE * number).expand(num_chases, -1)
        log_spread = FREE_SPREAD * streams.standard_normal(number)
        distance_m = self._scenario.start_distance_m * torch.where(keeps_distance, 0.0, log_spread).exp()
        nothing = torch.zeros(num_chases, dtype=torch.int64)
        return ParticleMemory(
            position_m=_drawn_direction(streams, number) * distance_m[:, None],
            keeps_distance=keeps_distance.clone(),
            excess_power_db=self._drawn_excess_power_db(streams),
            log_weight=_even_log_weight(num_chases, number),
            surprises=nothing,
            condition=nothing.clone(),
            streams=streams,
        )

    def decide(self, observation: Observation, memory: ParticleMemory) -> tuple[Action, ParticleMemory]:
        """Weigh the particles by the window, act on the belief, then resample where few of them are left."""
        observation = checked_observation(observation, self._scenario)
        power_dbm = self._window_power(observation.rssi_dbm)
        heard = power_dbm.isfinite()
        log_likelihood = self._log_likelihood(memory, power_dbm, mean_position_m(observation), heard)
        memory = self._weighed(memory, log_likelihood, heard)
        center = center_m(observation)
        lost = (memory.surprises >= SURPRISES).nonzero()[:, 0].tolist()
        if lost:
            memory = _replaced(memory, self._begun_anew(memory, center, lost), lost)
        action = self._action(memory, center)
        effective = 1 / (2 * memory.log_weight).exp().sum(dim=1)
        depleted = (effective < RESAMPLING_SHARE * self._num_particles).nonzero()[:, 0].tolist()
        if depleted:
            memory = _replaced(memory, self._resampled(memory, depleted), depleted)
        return action, memory

    def belief(self, memory: ParticleMemory) -> Belief:
        """The particles in proportion to their weights."""
        return belief_of_particles(memory.position_m, memory.log_weight.exp())

    def explain(self, observation: Observation, memory: ParticleMemory) -> Explanation:
        """Particles in proportion to their weights, and what each choice is worth to them."""
        cumulative = memory.log_weight[0].exp().cumsum(dim=0)
        at = (torch.arange(MOST_POINTS) + 0.5) / MOST_POINTS * cumulative[-1]
        chosen = torch.searchsorted(cumulative, at).clamp_(max=self._num_particles - 1)
        target_m = memory.position_m[0][:, chosen].T.contiguous()
        left_m = memory.position_m[0] - center_m(observation)[0].float()[:, None]
        return Explanation(share_of_savings(self._scenario, left_m, memory.log_weight[0].exp()), target_m)

    def _log_likelihood(
        self,
        memory: ParticleMemory,
        power_dbm: Float[Tensor, "chase tracker"],
        tracker_position_m: Float[Tensor, "chase tracker 3"],
        heard: Bool[Tensor, "chase tracker"],
    ) -> Float[Tensor, "chase particle"]:
        """Of this window if the target were where each particle is (Eqs. 1-2 and the law of the fading)."""
        offset_m = memory.position_m[:, None] - tracker_position_m.float()[..., None]
        loss_db = loss_beyond_reference_db(self._scenario, offset_m.square_().sum(dim=2).sqrt_())
        excess_db = (
            power_dbm.nan_to_num(0.0)[..., None] - reference_dbm(self._scenario) - memory.excess_power_db[:, None]
        )
        return self._law.log_likelihood(loss_db.add_(excess_db), heard).double()

    def _weighed(
        self,
        memory: ParticleMemory,
        log_likelihood: Float[Tensor, "chase particle"],
        heard: Bool[Tensor, "chase tracker"],
    ) -> ParticleMemory:
        log_weight = memory.log_weight + log_likelihood
        evidence = log_weight.logsumexp(dim=1)
        improbable = evidence < self._law.least_log_likelihood
        deaf = ~heard.any(dim=1)
        return replace(
            memory,
            log_weight=log_weight - evidence[:, None],
            surprises=torch.where(improbable & ~deaf, memory.surprises + 1, 0),
            condition=torch.where(deaf, int(Condition.DEAF), int(Condition.TRACKING)),
        )

    def _action(self, memory: ParticleMemory, center: Float[Tensor, "chase 3"]) -> Action:
        left_m = memory.position_m - center.float()[..., None]
        weight = memory.log_weight.exp()
        expected_m = torch.stack(
            [
                ((left_m - choice_m).abs() * weight[:, None]).sum(dim=2)
                for choice_m in self._displacement_choices_m.tolist()
            ],
            dim=2,
        )
        holds = (memory.condition == Condition.DEAF)[:, None]
        choice = torch.where(holds, self._displacement_choices_m.abs().argmin(), expected_m.argmin(dim=2))
        distance_m = (_length_m(left_m)[:, 0] * weight).sum(dim=1)
        return Action(
            spacing_m=nearest_choice(self._scenario.spacing_choices_m, distance_m),
            displacement_m=self._displacement_choices_m[choice],
        )

    def _resampled(self, memory: ParticleMemory, rows: list[int]) -> ParticleMemory:
        """Systematic resampling of these chases, and the kernel that spreads what it copied."""
        one, number = select_chases(memory, rows), self._num_particles
        cumulative = one.log_weight.exp().cumsum(dim=1)
        position = (torch.arange(number) + one.streams.uniform(1)) / number
        parent = torch.searchsorted(cumulative, position * cumulative[:, -1:]).clamp_(max=number - 1)
        at_m = one.position_m.gather(2, parent[:, None].expand(-1, 3, -1))
        keeps_distance = one.keeps_distance.gather(1, parent)
        excess_db = one.excess_power_db.gather(1, parent)
        moved_m = at_m + KERNEL_WIDTH * _like_the_belief(at_m, one.streams)
        ratio = _length_m(at_m) / _length_m(moved_m).clamp(min=1e-3)
        if not self._power_is_known:
            spread_db = excess_db.std(dim=1, keepdim=True)
            excess_db = excess_db + KERNEL_WIDTH * spread_db * one.streams.standard_normal(number)
        return replace(
            one,
            position_m=torch.where(keeps_distance[:, None], moved_m * ratio, moved_m),
            keeps_distance=keeps_distance,
            excess_power_db=excess_db,
            log_weight=_even_log_weight(len(rows), number),
        )

    def _begun_anew(self, memory: ParticleMemory, center: Float[Tensor, "chase 3"], rows: list[int]) -> ParticleMemory:
        """Particles all around the swarm, at any distance."""
        streams, number = memory.streams.select(rows), self._num_particles
        share = streams.uniform(number).float()
        farthest_m = 2 * self._scenario.start_distance_m
        distance_m = NEAREST_M * (share * math.log(farthest_m / NEAREST_M)).exp()
        nothing = torch.zeros(len(rows), dtype=torch.int64)
        return ParticleMemory(
            position_m=center[rows].float()[..., None] + _drawn_direction(streams, number) * distance_m[:, None],
            keeps_distance=torch.zeros(len(rows), number, dtype=torch.bool),
            excess_power_db=self._drawn_excess_power_db(streams),
            log_weight=_even_log_weight(len(rows), number),
            surprises=nothing,
            condition=torch.full_like(nothing, int(Condition.LOST)),
            streams=streams,
        )

    def _drawn_excess_power_db(self, streams: ChaseStreams) -> Float[Tensor, "chase particle"]:
        if self._power_is_known:
            return torch.zeros(len(streams), self._num_particles)
        return POWER_SPREAD_DB * streams.standard_normal(self._num_particles)


def _drawn_direction(streams: ChaseStreams, number: int) -> Float[Tensor, "chase 3 particle"]:
    direction = streams.standard_normal(3, number)
    return direction / _length_m(direction).clamp(min=1e-9)


def _length_m(vector_m: Float[Tensor, "chase 3 particle"]) -> Float[Tensor, "chase 1 particle"]:
    """``torch.linalg.vector_norm`` is ten times as slow along this axis."""
    return vector_m.square().sum(dim=1, keepdim=True).sqrt()


def _even_log_weight(num_chases: int, number: int) -> Float[Tensor, "chase particle"]:
    return torch.full((num_chases, number), -math.log(number), dtype=torch.float64)


def _like_the_belief(position_m: Float[Tensor, "chase 3 particle"], streams: ChaseStreams) -> Tensor:
    """Normals with the covariance of equally likely particles, and at least ``LEAST_KERNEL_M`` across."""
    apart_m = (position_m - position_m.mean(dim=2, keepdim=True)).double()
    covariance = (apart_m[:, :, None] * apart_m[:, None]).mean(dim=3)
    covariance += (LEAST_KERNEL_M / KERNEL_WIDTH) ** 2 * torch.eye(3, dtype=torch.float64)
    factor = torch.linalg.cholesky(covariance).float()
    normal = streams.standard_normal(*position_m.shape[1:])
    spread_m: Tensor = (factor[..., None] * normal[:, None]).sum(dim=2)
    return spread_m


def _replaced(memory: ParticleMemory, others: ParticleMemory, rows: list[int]) -> ParticleMemory:
    """The memory with these chases' rows taken from ``others``."""
    others_rows = {row: len(memory.condition) + place for place, row in enumerate(rows)}
    order = [others_rows.get(row, row) for row in range(len(memory.condition))]
    return select_chases(join_chases(memory, others), order)
