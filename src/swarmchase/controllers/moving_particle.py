"""``particle`` where trackers listen while they fly: a particle filter over the place and velocity of a target that may
do anything.

Each particle is in one of three modes: the target stands still, flies on as it does, or manoeuvres; at any moment it
may change over to another (a jump Markov system, as of the interacting multiple models of Blom and Bar-Shalom 1988,
in its particle form of McGinnity and Irwin 2000). It is told the scenario's channel and where targets start, not what
they do.

What each tracker has heard since the last decision enters by the fading that is left when the path loss to a particle
is taken out, averaged over the samples in milliwatts. The mean power of Rician fading is nearly gamma distributed, and
the cube root of a gamma variable nearly normal (Wilson and Hilferty 1931), with a shape that grows with the number of
samples that count: at 20 Hz nearly all of them while target and swarm fly against each other, but one or two when they
fly together (``_variance``). So the belief is no surer than it may be.

All particles have the same weight after every decision: resampling is systematic, and moves the copies of a particle
apart by a Gaussian kernel in proportion to the belief (regularised particle filter: Musso, Oudjane and Le Gland 2001).
Far from the target the belief is a part of a shell around the swarm, so the kernel is as wide along the distance as the
distances are, not the places.

It flies to the belief's mean at full speed, with the widest spacing. Missing samples do not count, a silent tracker is
left out; in an interval without any sample the belief goes on by itself, and the swarm to where it expects the target.
When several intervals in a row are improbable wherever the particles are, it begins anew around the swarm.
"""

import itertools
import math
from dataclasses import dataclass, replace

import torch

from ..batch.array_types import Bool, Float, Int, Tensor
from ..batch.selection import join_chases, select_chases
from ..batch.streams import ChaseStreams, chase_keys
from ..channel.propagation import reference_dbm
from ..formation import Action, displacement_towards
from ..observation import NEPERS_PER_DB, Observation, center_m, checked_observation, mean_power_dbm, sample_age_s
from ..scenario import NUM_TRACKERS, Scenario
from .belief import Belief, belief_of_particles
from .condition import Condition
from .described import Described
from .explanation import MOST_POINTS, Explanation, share_of_savings
from .sample_likeness import SampleLikeness, correlation_of_powers, variance_of_power
from .target_motion import CLIMB_SHARE, HOLDS_S, SPEED_SPREAD_MPS, TargetBand, each, length, slowed

NUM_PARTICLES = 3000
"""With half as many a target that flees takes 4 s longer, a decision half as long."""
STILL, STEADY, MANOEUVRING = range(3)
"""The modes."""
START_SHARE = (0.3, 0.4, 0.3)
"""Of the particles that begin in each mode."""
CHANGES_PER_S = (0.05, 0.2, 0.4)
"""How often each mode ends."""
NEXT_MODE = ((STEADY, MANOEUVRING), (MANOEUVRING, STILL), (STEADY, STILL))
"""What follows each mode: mostly the first, else the second."""
FIRST_NEXT_SHARE = 0.75
ACCELERATION_MPS2 = (0.0, 0.3, 3.0)
"""Standard deviation in each mode, on each level axis; it holds for ``HOLDS_S``."""
MOST_PIECES = 5
"""Into so many pieces an interval is cut, in each of which trackers count as standing."""
LEAST_SPREAD_DB = 0.1
"""Standard deviation of a tracker's mean power, at least: no particles would be near enough to one that says more."""
MOST_CORRELATION = 0.99
"""Between trackers, for the same reason."""
KERNEL_WIDTH = 0.25
"""Standard deviation of the kernel in those of the belief."""
LEAST_KERNEL_M = 0.1
LEAST_KERNEL_MPS = 0.05
SURPRISES = 3
"""So many improbable intervals in a row mean that the target is not among the particles."""
IMPROBABLE = 28.0
"""A squared length of the six normals that is exceeded once in 10,000 times where the target is (chi-squared)."""
LEAST_LOG_LIKELIHOOD = -1e6
"""Lower ones count as this: where all particles are impossible, they are equally so."""
NEAREST_M = 1.0
"""After beginning anew distances are log-uniform between this and the farthest start."""


@dataclass(frozen=True)
class MovingParticleMemory:
    """The belief of each chase: particles of equal weight."""

    position_m: Float[Tensor, "chase 3 particle"]
    """In the chase's own frame when the last sample was taken, float32."""
    velocity_mps: Float[Tensor, "chase 3 particle"]
    mode: Int[Tensor, "chase particle"]
    time_s: Float[Tensor, "chase"]
    """Of the last sample, float64; NaN before the first."""
    surprises: Int[Tensor, "chase"]
    """Improbable intervals in a row."""
    condition: Int[Tensor, "chase"]
    """A ``Condition``."""
    streams: ChaseStreams
    """Each chase's own random numbers."""


class MovingParticleController(Described):
    """Flies at full speed to where its particles are on average."""

    name = "particle"

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._widest_m = max(scenario.spacing_choices_m)
        self._farthest_m = scenario.farthest_start_m or scenario.start_distance_m
        self._band = TargetBand(scenario)
        self._likeness = SampleLikeness(scenario)
        self._next_mode = torch.tensor(NEXT_MODE)
        self._changes_per_s = torch.tensor(CHANGES_PER_S)
        self._acceleration_mps2 = torch.tensor(ACCELERATION_MPS2)
        self._axis_share = torch.tensor([1.0, 1.0, CLIMB_SHARE])[:, None]
        self._correlation = min(correlation_of_powers(scenario), MOST_CORRELATION)

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> MovingParticleMemory:
        """Particles wherever a target may start."""
        streams = ChaseStreams.of(chase_keys(seed, num_chases, first_chase), "policy")
        share = streams.uniform(NUM_PARTICLES)[:, None].float()
        nearest_m = self._scenario.start_distance_m
        return self._spread(streams, nearest_m + (self._farthest_m - nearest_m) * share)

    def decide(self, observation: Observation, memory: MovingParticleMemory) -> tuple[Action, MovingParticleMemory]:
        """Move the particles on, weigh them by what was heard, act on the belief, and resample it."""
        observation = checked_observation(observation, self._scenario)
        center = center_m(observation)
        memory, age_s = self._moved(memory, observation)
        log_weight, improbable, deaf = self._weighed(memory, observation, age_s)
        surprises = torch.where(improbable, memory.surprises + 1, 0)
        lost = surprises >= SURPRISES
        condition = torch.where(deaf, int(Condition.DEAF), int(Condition.TRACKING))
        memory = replace(memory, surprises=surprises, condition=condition)
        weight = (log_weight - log_weight.logsumexp(dim=1, keepdim=True)).exp()
        memory = self._resampled(memory, weight, center)
        rows = lost.nonzero()[:, 0].tolist()
        if rows:
            memory = _replaced(memory, self._begun_anew(memory, center, rows), rows)
        way_m = memory.position_m.double().mean(dim=2) - center
        spacing_m = torch.full((len(way_m),), self._widest_m, dtype=torch.float64)
        return Action(spacing_m, displacement_towards(self._scenario, way_m)), memory

    def belief(self, memory: MovingParticleMemory) -> Belief:
        """The particles."""
        return belief_of_particles(memory.position_m, velocity_mps=memory.velocity_mps)

    def explain(self, observation: Observation, memory: MovingParticleMemory) -> Explanation:
        """Some of the particles, what each choice is worth to all of them, and how fast they are."""
        chosen = torch.arange(MOST_POINTS) * NUM_PARTICLES // MOST_POINTS
        target_m = memory.position_m[0][:, chosen].T.contiguous()
        left_m = memory.position_m[0] - center_m(observation)[0].float()[:, None]
        even = torch.full((NUM_PARTICLES,), 1 / NUM_PARTICLES)
        velocity_mps = memory.velocity_mps[0].double().mean(dim=1)
        return Explanation(share_of_savings(self._scenario, left_m, even), target_m, velocity_mps=velocity_mps)

    def _moved(
        self, memory: MovingParticleMemory, observation: Observation
    ) -> tuple[MovingParticleMemory, Float[Tensor, "chase sample"]]:
        """The particles when the last sample was taken, and how long before that each was."""
        time_s, lasted_s, age_s = sample_age_s(observation, self._scenario, memory.time_s)
        return replace(self._predicted(memory, lasted_s.float()[:, None]), time_s=time_s), age_s

    def _predicted(self, memory: MovingParticleMemory, lasted_s: Float[Tensor, "chase 1"]) -> MovingParticleMemory:
        """The particles so many seconds later."""
        mode, streams = memory.mode, memory.streams
        changes = -(-each(self._changes_per_s, mode) * lasted_s).expm1()
        drawn = streams.uniform(NUM_PARTICLES).float()
        change = drawn < changes
        other = (drawn >= FIRST_NEXT_SHARE * changes).long()
        following = torch.where(change, each(self._next_mode.flatten(), 2 * mode + other), mode)
        normal = streams.standard_normal(3, NUM_PARTICLES) * self._axis_share
        # What holds for a short time adds up like a random walk.
        gained_mps = each(self._acceleration_mps2, following) * (lasted_s * HOLDS_S).sqrt()
        starts = (change & (mode == STILL))[:, None]
        spread_mps = torch.where(starts, SPEED_SPREAD_MPS, gained_mps[:, None])
        velocity_mps = slowed(memory.velocity_mps + normal * spread_mps)
        velocity_mps = torch.where((following == STILL)[:, None], 0.0, velocity_mps)
        position_m = memory.position_m + (memory.velocity_mps + velocity_mps) * (lasted_s / 2)[:, None]
        return replace(memory, position_m=self._band.inside_m(position_m), velocity_mps=velocity_mps, mode=following)

    def _weighed(
        self, memory: MovingParticleMemory, observation: Observation, age_s: Float[Tensor, "chase sample"]
    ) -> tuple[Float[Tensor, "chase particle"], Bool[Tensor, "chase"], Bool[Tensor, "chase"]]:
        """The log likelihood of each particle, whether all are improbable, and whether nothing was heard."""
        rssi_dbm = observation.rssi_dbm
        num_heard = rssi_dbm.isfinite().sum(dim=1)
        heard = num_heard > 0
        fading_np = self._fading_np(memory, observation, age_s, num_heard)
        shape = 1 / self._variance(memory, observation, age_s, num_heard)
        root = (fading_np / 3).exp()
        normal = torch.where(heard[..., None], 3 * shape.sqrt() * (root - 1 + 1 / (9 * shape)), 0.0)
        # The correlation matrix (1 - c) I + c 1 1^T of the trackers that have heard something.
        counts = heard.sum(dim=1, keepdim=True)
        mean = normal.sum(dim=1) / counts.clamp(min=1)
        apart = torch.where(heard[..., None], normal - mean[:, None], 0.0).square().sum(dim=1)
        squared = apart / (1 - self._correlation)
        squared = squared + counts * mean.square() / (1 + (counts - 1) * self._correlation)
        log_slope = torch.where(heard[..., None], fading_np / 3 + shape.log() / 2, 0.0).sum(dim=1)
        deaf = ~heard.any(dim=1)
        log_likelihood = (log_slope - squared / 2).clamp(min=LEAST_LOG_LIKELIHOOD).double()
        return log_likelihood, (squared.amin(dim=1) > IMPROBABLE) & ~deaf, deaf

    def _fading_np(
        self,
        memory: MovingParticleMemory,
        observation: Observation,
        age_s: Float[Tensor, "chase sample"],
        num_heard: Int[Tensor, "chase tracker"],
    ) -> Float[Tensor, "chase tracker particle"]:
        """What is left of each tracker's mean power without the path loss to each particle (Eqs. 1-2), in nepers."""
        num_samples = observation.rssi_dbm.shape[1]
        num_pieces = min(MOST_PIECES, num_samples)
        edge = [piece * num_samples // num_pieces for piece in range(num_pieces + 1)]
        least_m2 = self._scenario.reference_distance_m**2
        power = torch.zeros(len(age_s), NUM_TRACKERS, NUM_PARTICLES)
        for first, end in itertools.pairwise(edge):
            rssi_dbm = observation.rssi_dbm[:, first:end]
            share = rssi_dbm.isfinite().sum(dim=1) / num_heard
            excess_np = (mean_power_dbm(rssi_dbm) - reference_dbm(self._scenario)) * NEPERS_PER_DB + share.log()
            excess_np = excess_np.nan_to_num(nan=-math.inf)[..., None]
            tracker_m = observation.tracker_position_m[:, first:end].double().mean(dim=1).float()
            back_s = age_s[:, first:end].mean(dim=1).float()[:, None]
            squared_m2 = torch.zeros_like(power)
            for axis in range(3):
                place_m = memory.position_m[:, axis] - memory.velocity_mps[:, axis] * back_s
                squared_m2 += (place_m[:, None] - tracker_m[..., axis, None]).square_()
            loss_np = squared_m2.clamp_min_(least_m2).mul_(1 / least_m2).log_()
            power += loss_np.mul_(self._scenario.path_loss_exponent / 2).add_(excess_np).exp_()
        return power.clamp_(1e-30, 1e30).log_()

    def _variance(
        self,
        memory: MovingParticleMemory,
        observation: Observation,
        age_s: Float[Tensor, "chase sample"],
        num_heard: Int[Tensor, "chase tracker"],
    ) -> Float[Tensor, "chase tracker particle"]:
        """Of each tracker's mean power relative to its mean, if the target flew as each particle does.

        Of one sample it is (2 K + 1) / (K + 1)^2.
        """
        flown_m = center_m(observation) - observation.tracker_position_m[:, 0].double().mean(dim=1)
        swarm_mps = (flown_m / age_s[:, :1].clamp(min=1e-3)).float()
        speed_mps = length(memory.velocity_mps - swarm_mps[..., None])[:, 0]
        alike = self._likeness.alike(speed_mps, observation.rssi_dbm.shape[1])[:, None]
        number = num_heard.clamp(min=1)[..., None]
        one = variance_of_power(self._scenario)
        return one * ((number - 1) * alike + 1) / number + (LEAST_SPREAD_DB * NEPERS_PER_DB) ** 2

    def _resampled(
        self, memory: MovingParticleMemory, weight: Float[Tensor, "chase particle"], center: Float[Tensor, "chase 3"]
    ) -> MovingParticleMemory:
        """Systematic resampling; all copies of a particle but the first are moved by the kernel."""
        streams = memory.streams
        cumulative = weight.cumsum(dim=1)
        place = (torch.arange(NUM_PARTICLES) + streams.uniform(1)) / NUM_PARTICLES
        parent = torch.searchsorted(cumulative, place * cumulative[:, -1:]).clamp_(max=NUM_PARTICLES - 1)
        by_axis = parent[:, None].expand(-1, 3, -1)
        position_m, velocity_mps = memory.position_m.gather(2, by_axis), memory.velocity_mps.gather(2, by_axis)
        mode = memory.mode.gather(1, parent)
        copy = torch.zeros_like(parent, dtype=torch.bool)
        copy[:, 1:] = parent[:, 1:] == parent[:, :-1]
        normal = streams.standard_normal(7, NUM_PARTICLES)
        left_m = position_m - center.float()[..., None]
        distance_m = length(left_m)
        moved_m = left_m + normal[:, :3] * _kernel(left_m, LEAST_KERNEL_M)
        farther_m = distance_m + normal[:, 3:4] * _kernel(distance_m, LEAST_KERNEL_M)
        moved_m = moved_m * (farther_m.clamp(min=0.0) / length(moved_m).clamp(min=1e-3))
        moved_mps = velocity_mps + normal[:, 4:] * _kernel(velocity_mps, LEAST_KERNEL_MPS)
        flies = copy & (mode != STILL)
        return replace(
            memory,
            position_m=torch.where(copy[:, None], self._band.inside_m(moved_m + center.float()[..., None]), position_m),
            velocity_mps=torch.where(flies[:, None], slowed(moved_mps), velocity_mps),
            mode=mode,
        )

    def _begun_anew(
        self, memory: MovingParticleMemory, center: Float[Tensor, "chase 3"], rows: list[int]
    ) -> MovingParticleMemory:
        """Particles all around the swarm, at any distance."""
        streams = memory.streams.select(rows)
        share = streams.uniform(NUM_PARTICLES)[:, None].float()
        distance_m = NEAREST_M * (share * math.log(self._farthest_m / NEAREST_M)).exp()
        anew = self._spread(streams, distance_m)
        position_m = self._band.inside_m(anew.position_m + center[rows].float()[..., None])
        condition = torch.full_like(anew.condition, int(Condition.LOST))
        return replace(anew, position_m=position_m, time_s=memory.time_s[rows], condition=condition)

    def _spread(self, streams: ChaseStreams, distance_m: Float[Tensor, "chase 1 particle"]) -> MovingParticleMemory:
        """Particles at these distances from the origin, wherever the scenario lets targets start."""
        position_m = self._band.drawn_m(streams, distance_m)
        drawn = streams.uniform(NUM_PARTICLES)
        mode = (drawn >= START_SHARE[STILL]).long() + (drawn >= START_SHARE[STILL] + START_SHARE[STEADY]).long()
        velocity_mps = slowed(streams.standard_normal(3, NUM_PARTICLES) * (SPEED_SPREAD_MPS * self._axis_share))
        nothing = torch.zeros(len(streams), dtype=torch.int64)
        return MovingParticleMemory(
            position_m=position_m,
            velocity_mps=torch.where((mode == STILL)[:, None], 0.0, velocity_mps),
            mode=mode,
            time_s=torch.full((len(streams),), math.nan, dtype=torch.float64),
            surprises=nothing,
            condition=nothing.clone(),
            streams=streams,
        )


def _kernel(value: Float[Tensor, "chase k particle"], least: float) -> Float[Tensor, "chase k 1"]:
    """Standard deviation of the kernel for what has this spread."""
    spread: Tensor = value.double().std(dim=2, keepdim=True)
    return (KERNEL_WIDTH * spread).float().clamp(min=least)


def _replaced(memory: MovingParticleMemory, others: MovingParticleMemory, rows: list[int]) -> MovingParticleMemory:
    """The memory with these chases' rows taken from ``others``."""
    others_rows = {row: len(memory.condition) + place for place, row in enumerate(rows)}
    order = [others_rows.get(row, row) for row in range(len(memory.condition))]
    return select_chases(join_chases(memory, others), order)
