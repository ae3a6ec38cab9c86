"""``adaptive`` where trackers listen while they fly: it finds out the channel that nobody told it.

It is told the scenario's channel, but believes none of it for certain (``told_scenario``): the transmit power may be
any within 10 dB and more, receivers may be off by a few dB or one of them by 20, the exponent may be another, and
shadowing may lie over all of it. Particles are places, velocities, modes (``target_motion``) and exponents. Given a
particle's way, all else is linear and Gaussian in dB and integrated out in closed form (a Rao-Blackwellised particle
filter: Doucet, de Freitas, Murphy and Russell 2000): constants of the transmitter and the receivers by the evidence of
each model on the whole way (``receiver_models``), shadowing in Kalman filters (``shadow_models``), both with gains that
all particles share. Each particle carries how likely constant errors and each kind of shadowing are on its own way.

What each tracker has heard enters by its mean power, without the path loss to a particle, in dB: its noise, and how far
trackers have noise in common, follow from the samples that count (``level_residuals``). Where an interval says more
than the particles can take, it counts less, as if its noise were larger (``resampling``): beside the target a single
interval would else leave a few particles, none at the true place.

Resampling moves the copies of a particle by a Gaussian kernel with the belief's own covariance, along the distance by
as much as the distances are apart: the belief may be a shell around the swarm, or a ray.

It flies to the belief's mean at full speed, with the widest spacing and a cross that turns: an offset stays with its
tracker, the direction to the target does not. Where a vehicle cannot turn its cross, nothing else changes: a sample is
heard where its tracker was. Missing samples do not count; stuck receivers are left out; in an interval without any
sample the belief goes on by itself.
"""

import math
from dataclasses import dataclass, replace

import torch

from ..batch.array_types import Bool, Float, Int, Tensor
from ..batch.selection import join_chases, select_chases
from ..batch.streams import ChaseStreams, chase_keys
from ..formation import Action, displacement_towards, fastest_turn_rad_per_s
from ..observation import Observation, center_m, checked_observation, mean_position_m
from ..scenario import NUM_TRACKERS, Scenario
from .belief import Belief, belief_of_particles
from .condition import Condition
from .described import Described
from .explanation import MOST_POINTS, Explanation, FoundChannel, reasons_left_out, share_of_savings
from .level_residuals import LevelResiduals
from .receiver_models import ReceiverModels
from .resampling import is_copy, kernel_root, kernel_spread, parents, share_to_take
from .shadow_models import STATES, ShadowModels
from .stuck_receivers import ReceiverLevels
from .target_motion import STILL, TargetBand, TargetMotion, length, slowed
from .told_scenario import as_told

NUM_PARTICLES = 2500
KERNEL_WIDTH, VELOCITY_KERNEL_WIDTH = 0.2, 0.4
"""Standard deviation of the kernel in those of the belief, of places (and exponents) and of velocities."""
LEAST_KERNEL_M = 0.1
LEAST_KERNEL_MPS = 0.05
LEAST_KERNEL_EXPONENT = 0.02
EXPONENT_TOLD_SHARE = 0.7
"""Of the particles that begin near the told exponent, within ``EXPONENT_NEAR``; the others within ``EXPONENT_SPREAD``
(standard deviations)."""
EXPONENT_NEAR, EXPONENT_SPREAD = 0.03, 0.4
LEAST_EXPONENT, MOST_EXPONENT = 1.5, 5.0
REMEMBERED_S = 100.0
"""So long what was heard counts for power and offsets, until 1 / e of it is left: they may drift."""
CHANNEL_LASTS_S = 60.0
"""So long on average errors are constant, or those of shadowing, before they may be of another kind."""
NOISE_PARTICLES = 50
"""So many of the particles say how fast the target may fly and how near it may be."""
SURPRISES = 3
"""So many improbable intervals in a row mean that the target is not among the particles."""
IMPROBABLE = 60.0
"""Twice the negative logarithm of an interval's likelihood, noise alone being 6 +- 3.5, where the best particle and all
models leave it so improbable."""
LEAST_LOG_LIKELIHOOD = -1e6
"""Lower ones count as this: where all particles are impossible, they are equally so."""
NEAREST_M = 1.0
"""After beginning anew distances are log-uniform between this and the farthest start."""
LONGEST_S = 60.0
"""A longer time between two decisions counts as this."""
TURN_RAD_PER_S = 1.0
"""Of the cross, where it may turn so fast."""


@dataclass(frozen=True)
class AdaptiveInFlightMemory:
    """The belief of each chase: particles of equal weight, float32, and what they share, float64."""

    position_m: Float[Tensor, "chase 3 particle"]
    """In the chase's own frame when the last sample was taken."""
    velocity_mps: Float[Tensor, "chase 3 particle"]
    mode: Int[Tensor, "chase particle"]
    exponent: Float[Tensor, "chase particle"]
    """Of the path loss."""
    sums: Float[Tensor, "chase tracker particle"]
    """s of ``receiver_models``."""
    shadow_db: Float[Tensor, "chase model state particle"]
    """Means of ``shadow_models``."""
    log_share: Float[Tensor, "chase kind particle"]
    """How likely it is on the particle's way that errors are constant, or those of each shadow model."""
    precision: Float[Tensor, "chase tracker tracker"]
    """A of ``receiver_models``."""
    shadow_covariance_db2: Float[Tensor, "chase model state state"]
    """Covariances of ``shadow_models``."""
    receivers: ReceiverLevels
    """What shows a receiver that is stuck."""
    center_m: Float[Tensor, "chase 3"]
    """The swarm's centre when the last sample was taken; NaN before the first."""
    time_s: Float[Tensor, "chase"]
    """Of the last sample; NaN before the first."""
    surprises: Int[Tensor, "chase"]
    """Improbable intervals in a row."""
    condition: Int[Tensor, "chase"]
    """A ``Condition``."""
    streams: ChaseStreams
    """Each chase's own random numbers."""


@dataclass(frozen=True)
class InFlightFindings:
    """What a memory says of target, channel and receivers, float64."""

    velocity_mps: Float[Tensor, "chase 3"]
    """Of the target."""
    exponent: Float[Tensor, "chase"]
    power_db: Float[Tensor, "chase"]
    """Of the transmitter, above the told one."""
    offset_db: Float[Tensor, "chase tracker"]
    """Of each receiver."""
    model_share: Float[Tensor, "chase model"]
    """How likely each model is, in the order of ``model_names``."""
    shadowing_db: Float[Tensor, "chase"]
    """Standard deviation of shadowing: that of each model by its share."""
    is_wrong: Bool[Tensor, "chase tracker"]
    """Receivers that are more likely wrong than not."""


class AdaptiveInFlightController(Described):
    """Flies at full speed to where its particles are on average, with a cross that turns."""

    name = "adaptive"

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = told = as_told(scenario)
        self._widest_m = max(told.spacing_choices_m)
        self._nearest_m = told.start_distance_m
        self._farthest_m = told.farthest_start_m or told.start_distance_m
        self._band = TargetBand(told)
        self._motion = TargetMotion(told)
        self._levels = LevelResiduals(told)
        self._constants = ReceiverModels()
        self._shadows = ShadowModels(self._widest_m)
        self._turn_rad = min(TURN_RAD_PER_S, fastest_turn_rad_per_s(told)) * told.decision_s
        shadow_weight = torch.tensor([model.weight for model in self._shadows.models])
        self._start_log_share = torch.cat([1 - shadow_weight.sum(dim=0, keepdim=True), shadow_weight]).log()[:, None]

    @property
    def model_names(self) -> tuple[str, ...]:
        """Of constant errors, then of shadowing."""
        names = [model.name for model in self._constants.models]
        return (*names, *(model.name for model in self._shadows.models))

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> AdaptiveInFlightMemory:
        """Particles wherever a target may start."""
        streams = ChaseStreams.of(chase_keys(seed, num_chases, first_chase), "policy")
        share = streams.uniform(NUM_PARTICLES)[:, None].float()
        return self._spread(streams, self._nearest_m + (self._farthest_m - self._nearest_m) * share)

    def decide(self, observation: Observation, memory: AdaptiveInFlightMemory) -> tuple[Action, AdaptiveInFlightMemory]:
        """Move the particles on, weigh them by what was heard, resample them, act on the belief."""
        observation = checked_observation(observation, self._scenario)
        center = center_m(observation)
        receivers = memory.receivers.after(observation)
        rssi_dbm = observation.rssi_dbm.masked_fill(receivers.stuck[:, None], torch.nan)
        observation = replace(observation, rssi_dbm=rssi_dbm)
        memory, age_s = self._moved(replace(memory, receivers=receivers), observation, center)
        memory, log_weight, improbable = self._weighed(memory, observation, age_s)
        deaf = ~rssi_dbm.isfinite().flatten(1).any(dim=1)
        surprises = torch.where(improbable & ~deaf, memory.surprises + 1, 0)
        condition = torch.where(deaf, int(Condition.DEAF), int(Condition.TRACKING))
        memory = self._resampled(replace(memory, surprises=surprises, condition=condition), log_weight, center)
        rows = (surprises >= SURPRISES).nonzero()[:, 0].tolist()
        if rows:
            memory = _replaced(memory, self._begun_anew(memory, center, rows), rows)
        way_m = memory.position_m.double().mean(dim=2) - center
        spacing_m = torch.full((len(way_m),), self._widest_m, dtype=torch.float64)
        turn_rad = torch.full_like(spacing_m, self._turn_rad)
        return Action(spacing_m, displacement_towards(self._scenario, way_m), turn_rad), memory

    def belief(self, memory: AdaptiveInFlightMemory) -> Belief:
        """As ``belief.Believing``."""
        return belief_of_particles(memory.position_m, velocity_mps=memory.velocity_mps)

    def findings(self, memory: AdaptiveInFlightMemory) -> InFlightFindings:
        """What the memory that ``decide`` returned says of each chase besides the target's place."""
        kind_share = memory.log_share.double().exp()
        log_evidence = self._constants.log_evidence(memory.precision, memory.sums).double()
        constant_share = log_evidence.softmax(dim=1) * kind_share[:, :1]
        model_share = torch.cat([constant_share, kind_share[:, 1:]], dim=1).mean(dim=2)
        power_db, offset_db = self._constants.estimates(memory.precision, memory.sums, constant_share)
        shadow_db = (memory.shadow_db[:, :, :NUM_TRACKERS].double() * kind_share[:, 1:, None]).mean(dim=3).sum(dim=1)
        shadow_power_db, shadow_offset_db = self._shadows.estimates(shadow_db)
        spread_db = torch.tensor([model.spread_db for model in self._shadows.models], dtype=torch.float64)
        return InFlightFindings(
            velocity_mps=memory.velocity_mps.double().mean(dim=2),
            exponent=memory.exponent.double().mean(dim=1),
            power_db=power_db + shadow_power_db,
            offset_db=offset_db + shadow_offset_db,
            model_share=model_share,
            shadowing_db=kind_share[:, 1:].mean(dim=2) @ spread_db,
            is_wrong=self._constants.is_wrong(model_share),
        )

    def explain(self, observation: Observation, memory: AdaptiveInFlightMemory) -> Explanation:
        """Some of the particles, what each choice is worth to all of them, and the channel as it is found."""
        chosen = torch.arange(MOST_POINTS) * NUM_PARTICLES // MOST_POINTS
        target_m = memory.position_m[0][:, chosen].T.contiguous()
        left_m = memory.position_m[0] - center_m(observation)[0].float()[:, None]
        even = torch.full((NUM_PARTICLES,), 1 / NUM_PARTICLES)
        found = self.findings(memory)
        is_silent = ~observation.rssi_dbm[0].isfinite().any(dim=0)
        return Explanation(
            share_of_savings(self._scenario, left_m, even),
            target_m,
            FoundChannel(
                power_db=float(found.power_db[0]),
                exponent=float(found.exponent[0]),
                offset_db=tuple(found.offset_db[0].tolist()),
                left_out=reasons_left_out(is_silent, memory.receivers.stuck[0], found.is_wrong[0]),
                fading_db=None,
                shadowing_db=float(found.shadowing_db[0]),
            ),
            found.velocity_mps[0],
        )

    def _moved(
        self, memory: AdaptiveInFlightMemory, observation: Observation, center: Float[Tensor, "chase 3"]
    ) -> tuple[AdaptiveInFlightMemory, Float[Tensor, "chase sample"]]:
        """The particles when the last sample was taken, and how long before that each was."""
        num_chases, num_samples = observation.rssi_dbm.shape[:2]
        if observation.time_s is None:
            age_s = torch.arange(num_samples - 1, -1, -1, dtype=torch.float64).expand(num_chases, -1)
            age_s = age_s / self._scenario.sampling_hz
            time_s = memory.time_s.nan_to_num(nan=0.0) + num_samples / self._scenario.sampling_hz
        else:
            time_s = observation.time_s[:, -1].double()
            age_s = (time_s[:, None] - observation.time_s.double()).nan_to_num(nan=0.0).clamp(0.0, LONGEST_S)
        lasted_s = time_s - memory.time_s
        lasted_s = torch.where(lasted_s.isfinite(), lasted_s, self._scenario.decision_s).clamp(0.0, LONGEST_S)
        position_m, velocity_mps, mode = self._motion.moved(
            memory.position_m, memory.velocity_mps, memory.mode, center, lasted_s, memory.streams
        )
        kept = (-lasted_s / REMEMBERED_S).exp()[:, None, None]
        stays = (-lasted_s / CHANNEL_LASTS_S).exp()[:, None, None].float()
        memory = replace(
            memory,
            position_m=position_m,
            velocity_mps=velocity_mps,
            mode=mode,
            sums=memory.sums * kept.float(),
            precision=memory.precision * kept,
            log_share=torch.logaddexp(memory.log_share + stays.log(), self._start_log_share + (1 - stays).log()),
            time_s=time_s,
        )
        return memory, age_s

    def _weighed(
        self, memory: AdaptiveInFlightMemory, observation: Observation, age_s: Float[Tensor, "chase sample"]
    ) -> tuple[AdaptiveInFlightMemory, Float[Tensor, "chase particle"], Bool[Tensor, "chase"]]:
        """The memory with what was heard, the log weight of each particle, and whether all are improbable."""
        residual_db = self._levels.residual_db(
            observation, memory.position_m, memory.velocity_mps, memory.exponent, age_s
        )
        some = torch.arange(NOISE_PARTICLES) * NUM_PARTICLES // NOISE_PARTICLES
        noise = self._levels.noise(observation, memory.position_m[:, :, some], memory.velocity_mps[:, :, some], age_s)
        residual_db = residual_db - noise.bias_db[..., None]
        center = center_m(observation)
        moved_m = (center - memory.center_m).norm(dim=1).nan_to_num(nan=0.0)
        memory = replace(memory, center_m=center)
        tracker_m = mean_position_m(observation)
        tracker_m = tracker_m - tracker_m.mean(dim=1, keepdim=True)
        before = self._constants.log_evidence(memory.precision, memory.sums).logsumexp(dim=1)
        heard, log_weight, surprise = self._heard(memory, before, residual_db, noise.covariance_db2, moved_m, tracker_m)
        share = share_to_take(log_weight)
        if (share < 1).any():
            heard, log_weight, _ = self._heard(
                memory, before, residual_db, noise.covariance_db2 / share[:, None, None], moved_m, tracker_m
            )
        return heard, log_weight.clamp(min=LEAST_LOG_LIKELIHOOD), surprise > IMPROBABLE

    def _heard(
        self,
        memory: AdaptiveInFlightMemory,
        before: Float[Tensor, "chase particle"],
        residual_db: Float[Tensor, "chase tracker particle"],
        covariance_db2: Float[Tensor, "chase tracker tracker"],
        moved_m: Float[Tensor, "chase"],
        tracker_m: Float[Tensor, "chase tracker 3"],
    ) -> tuple[AdaptiveInFlightMemory, Float[Tensor, "chase particle"], Float[Tensor, "chase"]]:
        """The memory with these residuals of this noise, each particle's log likelihood, and how little even the best
        explains: a squared length in units of the noise. ``before`` is the log evidence for constant errors without.
        """
        root = torch.linalg.cholesky(covariance_db2)
        whitening = torch.linalg.inv(root)
        inverse = whitening.mT @ whitening
        sums = torch.baddbmm(memory.sums, inverse.float(), residual_db)
        precision = memory.precision + inverse
        after = self._constants.log_evidence(precision, sums).logsumexp(dim=1)
        squared = torch.bmm(whitening.float(), residual_db).square_().sum(dim=1)
        log_det = root.diagonal(dim1=1, dim2=2).log().sum(dim=1).float()[:, None]
        constant = after - before - squared / 2 - log_det
        shadow_db, shadow_covariance_db2, shadowed = self._shadows.updated(
            memory.shadow_db, memory.shadow_covariance_db2, moved_m, tracker_m, residual_db, covariance_db2
        )
        joint = memory.log_share + torch.cat([constant[:, None], shadowed], dim=1)
        log_weight = joint.logsumexp(dim=1)
        memory = replace(
            memory,
            sums=sums,
            precision=precision,
            log_share=joint - log_weight[:, None],
            shadow_db=shadow_db,
            shadow_covariance_db2=shadow_covariance_db2,
        )
        return memory, log_weight, -2 * (log_weight + log_det).amax(dim=1)

    def _resampled(
        self,
        memory: AdaptiveInFlightMemory,
        log_weight: Float[Tensor, "chase particle"],
        center: Float[Tensor, "chase 3"],
    ) -> AdaptiveInFlightMemory:
        """Particles of equal weight; all copies of one but the first are moved by the kernel."""
        parent = parents(log_weight, memory.streams)
        shadow_shape = memory.shadow_db.shape
        parts = [
            memory.position_m,
            memory.velocity_mps,
            memory.exponent[:, None],
            memory.sums,
            memory.log_share,
            memory.shadow_db.flatten(1, 2),
        ]
        rows = torch.cat(parts, dim=1)
        rows = rows.gather(2, parent[:, None].expand(rows.shape))
        position_m, velocity_mps, exponent, sums, log_share, shadow_db = torch.split(
            rows, [part.shape[1] for part in parts], dim=1
        )
        mode = memory.mode.gather(1, parent)
        normal = memory.streams.standard_normal(8, NUM_PARTICLES)
        left_m = position_m - center.float()[..., None]
        distance_m = length(left_m)
        moved_m = left_m + torch.bmm(kernel_root(left_m, KERNEL_WIDTH, LEAST_KERNEL_M), normal[:, :3])
        farther_m = distance_m + normal[:, 3:4] * kernel_spread(distance_m, KERNEL_WIDTH, LEAST_KERNEL_M)
        moved_m = moved_m * (farther_m.clamp(min=0.0) / length(moved_m).clamp(min=1e-3))
        moved_mps = velocity_mps + normal[:, 4:7] * kernel_spread(velocity_mps, VELOCITY_KERNEL_WIDTH, LEAST_KERNEL_MPS)
        other = exponent + normal[:, 7:] * kernel_spread(exponent, KERNEL_WIDTH, LEAST_KERNEL_EXPONENT)
        copy = is_copy(parent)[:, None]
        moved_m = self._band.inside_m(moved_m + center.float()[..., None])
        return replace(
            memory,
            position_m=torch.where(copy, moved_m, position_m),
            velocity_mps=torch.where(copy & (mode != STILL)[:, None], slowed(moved_mps), velocity_mps),
            mode=mode,
            exponent=torch.where(copy, other.clamp(LEAST_EXPONENT, MOST_EXPONENT), exponent)[:, 0],
            sums=sums.contiguous(),
            log_share=log_share.contiguous(),
            shadow_db=shadow_db.reshape(shadow_shape),
        )

    def _begun_anew(
        self, memory: AdaptiveInFlightMemory, center: Float[Tensor, "chase 3"], rows: list[int]
    ) -> AdaptiveInFlightMemory:
        """Particles all around the swarm, at any distance."""
        old = select_chases(memory, rows)
        share = old.streams.uniform(NUM_PARTICLES)[:, None].float()
        anew = self._spread(old.streams, NEAREST_M * (share * math.log(self._farthest_m / NEAREST_M)).exp())
        return replace(
            anew,
            position_m=self._band.inside_m(anew.position_m + center[rows].float()[..., None]),
            receivers=old.receivers,
            center_m=old.center_m,
            time_s=old.time_s,
            condition=torch.full_like(anew.condition, int(Condition.LOST)),
        )

    def _spread(self, streams: ChaseStreams, distance_m: Float[Tensor, "chase 1 particle"]) -> AdaptiveInFlightMemory:
        """Particles at these distances from the origin, wherever the scenario lets targets start, of any channel."""
        num_chases = len(streams)
        position_m = self._band.drawn_m(streams, distance_m)
        velocity_mps, mode = self._motion.begun(streams, NUM_PARTICLES)
        is_near = streams.uniform(NUM_PARTICLES) < EXPONENT_TOLD_SHARE
        spread = torch.where(is_near, EXPONENT_NEAR, EXPONENT_SPREAD).float()
        exponent = self._scenario.path_loss_exponent + spread * streams.standard_normal(NUM_PARTICLES)
        nothing = torch.zeros(num_chases, dtype=torch.int64)
        return AdaptiveInFlightMemory(
            position_m=position_m,
            velocity_mps=velocity_mps,
            mode=mode,
            exponent=exponent.clamp(LEAST_EXPONENT, MOST_EXPONENT),
            sums=torch.zeros(num_chases, NUM_TRACKERS, NUM_PARTICLES),
            shadow_db=torch.zeros(num_chases, len(self._shadows.models), STATES, NUM_PARTICLES),
            log_share=self._start_log_share.expand(num_chases, -1, NUM_PARTICLES).contiguous(),
            precision=torch.zeros(num_chases, NUM_TRACKERS, NUM_TRACKERS, dtype=torch.float64),
            shadow_covariance_db2=self._shadows.start_db2.expand(num_chases, -1, -1, -1).contiguous(),
            receivers=ReceiverLevels.unheard(num_chases),
            center_m=torch.full((num_chases, 3), math.nan, dtype=torch.float64),
            time_s=torch.full((num_chases,), math.nan, dtype=torch.float64),
            surprises=nothing,
            condition=nothing.clone(),
            streams=streams,
        )


def _replaced(
    memory: AdaptiveInFlightMemory, others: AdaptiveInFlightMemory, rows: list[int]
) -> AdaptiveInFlightMemory:
    """The memory with these chases' rows taken from ``others``."""
    others_rows = {row: len(memory.condition) + place for place, row in enumerate(rows)}
    order = [others_rows.get(row, row) for row in range(len(memory.condition))]
    return select_chases(join_chases(memory, others), order)
