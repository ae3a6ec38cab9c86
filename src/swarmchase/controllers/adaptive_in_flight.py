"""``adaptive`` where trackers listen while they fly: finds out the channel that nobody told it."""

import math
from dataclasses import dataclass, replace

import torch

from ..batch.array_types import Float, Int, Tensor
from ..batch.selection import join_chases, select_chases
from ..batch.streams import ChaseStreams, chase_keys
from ..formation import Action, displacement_towards, fastest_turn_rad_per_s
from ..observation import Observation, center_m, checked_observation
from ..scenario import NUM_TRACKERS, Scenario
from .condition import Condition
from .explanation import MOST_POINTS, Explanation, share_of_savings
from .level_residuals import LevelResiduals, Noise
from .receiver_models import ReceiverModels
from .shadow_models import STATES, ShadowModels
from .target_motion import STILL, TargetMotion, each, length, slowed

NUM_PARTICLES = 2500
KERNEL_WIDTH = 0.4
"""Standard deviation of the kernel in those of the belief."""
LEAST_KERNEL_M = 0.1
LEAST_KERNEL_MPS = 0.05
EXPONENT_TOLD_SHARE = 0.7
EXPONENT_NEAR, EXPONENT_SPREAD = 0.03, 0.4
LEAST_KERNEL_EXPONENT = 0.02
LEAST_EXPONENT, MOST_EXPONENT = 1.5, 5.0
REMEMBERED_S = 100.0
"""So long what was heard counts for power and offsets, before it has faded to 1 / e."""
FEWEST_SHARE = 0.15
"""Of the particles that must count after an interval; one that says more counts less, as if its noise were larger."""
LEAST_SHARE = 0.01
"""At least so much of an interval counts."""
CHANNEL_LASTS_S = 60.0
"""So long on average errors are constant, or shadowing's, before they may be of another kind."""
NOISE_PARTICLES = 50
"""So many of the particles say how fast the target may fly."""
SURPRISES = 3
IMPROBABLE = 60.0
LEAST_LOG_LIKELIHOOD = -1e6
NEAREST_M = 1.0
LONGEST_S = 60.0
TURN_RAD_PER_S = 1.0


@dataclass(frozen=True)
class InFlightBelief:
    """The belief of each chase: particles of equal weight."""

    position_m: Float[Tensor, "chase 3 particle"]
    velocity_mps: Float[Tensor, "chase 3 particle"]
    mode: Int[Tensor, "chase particle"]
    exponent: Float[Tensor, "chase particle"]
    sums: Float[Tensor, "chase row particle"]
    """s of ``receiver_models``."""
    log_share: Float[Tensor, "chase group particle"]
    """Of constant errors, and of each shadow model."""
    shadow_db: Float[Tensor, "chase model state particle"]
    precision: Float[Tensor, "chase tracker tracker"]
    shadow_covariance_db2: Float[Tensor, "chase model state state"]
    last_m: Float[Tensor, "chase tracker 3"]
    time_s: Float[Tensor, "chase"]
    surprises: Int[Tensor, "chase"]
    condition: Int[Tensor, "chase"]
    streams: ChaseStreams


class AdaptiveInFlightController:
    """Flies at full speed to where its particles are on average, with a cross that turns."""

    name = "adaptive"

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = told = as_told(scenario)
        self._widest_m = max(told.spacing_choices_m)
        self._farthest_m = told.farthest_start_m or told.start_distance_m
        self._motion = TargetMotion(told)
        self._levels = LevelResiduals(told)
        self._receivers = ReceiverModels()
        self._shadows = ShadowModels()
        self._turn_rad = min(TURN_RAD_PER_S, fastest_turn_rad_per_s(told)) * told.decision_s
        weights = torch.tensor([1 - sum(m.weight for m in self._shadows.models)] + [m.weight for m in self._shadows.models])
        self._start_log_share = weights.log()[:, None]

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> InFlightBelief:
        """Particles wherever a target may start."""
        streams = ChaseStreams.of(chase_keys(seed, num_chases, first_chase), "policy")
        share = streams.uniform(NUM_PARTICLES)[:, None].float()
        nearest_m = self._scenario.start_distance_m
        return self._spread(streams, nearest_m + (self._farthest_m - nearest_m) * share)

    def decide(self, observation: Observation, memory: InFlightBelief) -> tuple[Action, InFlightBelief]:
        """Move the particles on, weigh them by what was heard, act on the belief, and resample it."""
        observation = checked_observation(observation, self._scenario)
        center = center_m(observation)
        memory, age_s = self._moved(memory, observation, center)
        memory, log_weight, improbable = self._weighed(memory, observation, age_s)
        deaf = ~observation.rssi_dbm.isfinite().any(dim=2).any(dim=1)
        surprises = torch.where(improbable & ~deaf, memory.surprises + 1, 0)
        lost = surprises >= SURPRISES
        condition = torch.where(deaf, int(Condition.DEAF), int(Condition.TRACKING))
        memory = replace(memory, surprises=surprises, condition=condition)
        log_weight = log_weight.double()
        weight = (log_weight - log_weight.logsumexp(dim=1, keepdim=True)).exp()
        memory = self._resampled(memory, weight, center)
        rows = lost.nonzero()[:, 0].tolist()
        if rows:
            memory = _replaced(memory, self._begun_anew(memory, center, rows), rows)
        way_m = memory.position_m.double().mean(dim=2) - center
        spacing_m = torch.full((len(way_m),), self._widest_m, dtype=torch.float64)
        turn_rad = torch.full_like(spacing_m, self._turn_rad)
        return Action(spacing_m, displacement_towards(self._scenario, way_m), turn_rad), memory

    def explain(self, observation: Observation, memory: InFlightBelief) -> Explanation:
        """Some of the particles, and what each choice is worth to all of them."""
        chosen = torch.arange(MOST_POINTS) * NUM_PARTICLES // MOST_POINTS
        target_m = memory.position_m[0][:, chosen].T.contiguous()
        left_m = memory.position_m[0] - center_m(observation)[0].float()[:, None]
        even = torch.full((NUM_PARTICLES,), 1 / NUM_PARTICLES)
        return Explanation(share_of_savings(self._scenario, left_m, even), target_m)

    def _moved(
        self, memory: InFlightBelief, observation: Observation, center: Float[Tensor, "chase 3"]
    ) -> tuple[InFlightBelief, Float[Tensor, "chase sample"]]:
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
            memory.position_m, memory.velocity_mps, memory.mode, center, lasted_s.float()[:, None], memory.streams
        )
        kept = (-lasted_s / REMEMBERED_S).exp()
        return replace(
            memory,
            position_m=position_m,
            velocity_mps=velocity_mps,
            mode=mode,
            log_share=self._mixed(memory.log_share, lasted_s),
            sums=memory.sums * kept.float()[:, None, None],
            precision=memory.precision * kept[:, None, None],
            time_s=time_s,
        ), age_s

    def _mixed(self, log_share, lasted_s):
        """What is true of the channel may change."""
        changed = -torch.expm1(-lasted_s / CHANNEL_LASTS_S).float()[:, None, None]
        return torch.logaddexp(log_share + torch.log1p(-changed), self._start_log_share + changed.log())

    def _weighed(self, memory: InFlightBelief, observation: Observation, age_s: Float[Tensor, "chase sample"]):
        """The memory with what was heard in it, the log weights, and where all particles are improbable."""
        residual_db = self._levels.residual_db(
            observation, memory.position_m, memory.velocity_mps, memory.exponent, age_s
        )
        some = torch.arange(NOISE_PARTICLES) * NUM_PARTICLES // NOISE_PARTICLES
        noise = self._levels.noise(observation, memory.position_m[:, :, some], memory.velocity_mps[:, :, some], age_s)
        residual_db = residual_db - noise.bias_db[..., None]
        last_m = observation.tracker_position_m[:, -1].double()
        moved_m = (last_m - memory.last_m).norm(dim=2).mean(dim=1).nan_to_num(nan=0.0)
        memory = replace(memory, last_m=last_m)
        before = self._receivers.log_evidence(memory.precision, memory.sums).logsumexp(dim=1)
        heard, log_weight, surprise = self._heard(memory, residual_db, noise.covariance_db2, before, moved_m)
        share = _share_to_take(log_weight)
        if (share < 1).any():
            covariance_db2 = noise.covariance_db2 / share[:, None, None]
            heard, log_weight, _ = self._heard(memory, residual_db, covariance_db2, before, moved_m)
        return heard, log_weight.clamp(min=LEAST_LOG_LIKELIHOOD), surprise > IMPROBABLE

    def _heard(self, memory, residual_db, covariance_db2, before, moved_m):
        root = torch.linalg.cholesky(covariance_db2)
        whiten = torch.linalg.inv(root)
        log_det = root.diagonal(dim1=1, dim2=2).log().sum(dim=1)
        inverse = whiten.mT @ whiten
        sums = torch.baddbmm(memory.sums, inverse.float(), residual_db)
        precision = memory.precision + inverse
        after = self._receivers.log_evidence(precision, sums).logsumexp(dim=1)
        squared = torch.bmm(whiten.float(), residual_db).square_().sum(dim=1)
        constant = after - before - squared / 2 - log_det.float()[:, None]
        shadow_db, shadow_covariance_db2, shadowed = self._shadows.updated(
            memory.shadow_db, memory.shadow_covariance_db2, moved_m, memory.last_m, residual_db, covariance_db2
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
        return memory, log_weight, -2 * (log_weight.amax(dim=1).double() + log_det)

    def _resampled(
        self, memory: InFlightBelief, weight: Float[Tensor, "chase particle"], center: Float[Tensor, "chase 3"]
    ) -> InFlightBelief:
        """Systematic resampling; all copies of a particle but the first are moved by the kernel."""
        streams = memory.streams
        num_chases = len(weight)
        cumulative = weight.cumsum(dim=1)
        place = (torch.arange(NUM_PARTICLES) + streams.uniform(1)) / NUM_PARTICLES
        parent = torch.searchsorted(cumulative, place * cumulative[:, -1:]).clamp_(max=NUM_PARTICLES - 1)
        shadow = memory.shadow_db.shape
        rows = torch.cat(
            [
                memory.position_m,
                memory.velocity_mps,
                memory.exponent[:, None],
                memory.sums,
                memory.log_share,
                memory.shadow_db.view(num_chases, -1, NUM_PARTICLES),
            ],
            dim=1,
        )
        rows = rows.gather(2, parent[:, None].expand(-1, rows.shape[1], -1))
        sizes = [3, 3, 1, NUM_TRACKERS, memory.log_share.shape[1], shadow[1] * shadow[2]]
        position_m, velocity_mps, exponent, sums, log_share, shadow_db = rows.split(sizes, dim=1)
        exponent = exponent[:, 0]
        mode = memory.mode.gather(1, parent)
        copy = torch.zeros_like(parent, dtype=torch.bool)
        copy[:, 1:] = parent[:, 1:] == parent[:, :-1]
        normal = streams.standard_normal(8, NUM_PARTICLES)
        left_m = position_m - center.float()[..., None]
        distance_m = length(left_m)
        moved_m = left_m + torch.bmm(_kernel_root(left_m), normal[:, :3])
        farther_m = distance_m + normal[:, 3:4] * _kernel(distance_m, LEAST_KERNEL_M)
        moved_m = moved_m * (farther_m.clamp(min=0.0) / length(moved_m).clamp(min=1e-3))
        moved_mps = velocity_mps + normal[:, 4:7] * _kernel(velocity_mps, LEAST_KERNEL_MPS)
        flies = copy & (mode != STILL)
        other = (exponent + normal[:, 7] * _kernel(exponent[:, None], LEAST_KERNEL_EXPONENT)[:, 0]).clamp(LEAST_EXPONENT, MOST_EXPONENT)
        return replace(
            memory,
            position_m=torch.where(
                copy[:, None], self._motion.in_band(moved_m + center.float()[..., None]), position_m
            ),
            velocity_mps=torch.where(flies[:, None], slowed(moved_mps), velocity_mps),
            mode=mode,
            exponent=torch.where(copy, other, exponent),
            sums=sums.contiguous(),
            log_share=log_share.contiguous(),
            shadow_db=shadow_db.reshape(shadow),
        )

    def _begun_anew(
        self, memory: InFlightBelief, center: Float[Tensor, "chase 3"], rows: list[int]
    ) -> InFlightBelief:
        """Particles all around the swarm, at any distance."""
        streams = memory.streams.select(rows)
        share = streams.uniform(NUM_PARTICLES)[:, None].float()
        distance_m = NEAREST_M * (share * math.log(self._farthest_m / NEAREST_M)).exp()
        anew = self._spread(streams, distance_m)
        position_m = self._motion.in_band(anew.position_m + center[rows].float()[..., None])
        condition = torch.full_like(anew.condition, int(Condition.LOST))
        return replace(
            anew, position_m=position_m, time_s=memory.time_s[rows], last_m=memory.last_m[rows], condition=condition
        )

    def _spread(self, streams: ChaseStreams, distance_m: Float[Tensor, "chase 1 particle"]) -> InFlightBelief:
        """Particles at these distances from the origin, wherever the scenario lets targets start."""
        num_chases = len(streams)
        position_m, velocity_mps, mode = self._motion.begun(streams, distance_m)
        told = self._scenario.path_loss_exponent
        drawn = streams.standard_normal(NUM_PARTICLES)
        wide = streams.uniform(NUM_PARTICLES) >= EXPONENT_TOLD_SHARE
        exponent = (told + torch.where(wide, EXPONENT_SPREAD, EXPONENT_NEAR) * drawn).clamp(LEAST_EXPONENT, MOST_EXPONENT)
        nothing = torch.zeros(num_chases, dtype=torch.int64)
        num_shadows = len(self._shadows.models)
        return InFlightBelief(
            position_m=position_m,
            velocity_mps=velocity_mps,
            mode=mode,
            exponent=exponent.float(),
            sums=torch.zeros(num_chases, NUM_TRACKERS, NUM_PARTICLES),
            log_share=self._start_log_share.expand(num_chases, -1, NUM_PARTICLES).contiguous(),
            shadow_db=torch.zeros(num_chases, num_shadows, STATES, NUM_PARTICLES),
            precision=torch.zeros(num_chases, NUM_TRACKERS, NUM_TRACKERS, dtype=torch.float64),
            shadow_covariance_db2=self._shadows.start_db2.expand(num_chases, -1, -1, -1).contiguous(),
            last_m=torch.full((num_chases, NUM_TRACKERS, 3), math.nan, dtype=torch.float64),
            time_s=torch.full((num_chases,), math.nan, dtype=torch.float64),
            surprises=nothing,
            condition=nothing.clone(),
            streams=streams,
        )


def as_told(scenario: Scenario) -> Scenario:
    """The scenario as controllers are told it: without what its world departs from it by, and what the target does."""
    untold = Scenario()
    errors = (
        "receiver_offset_db missing_sample_share missing_burst_s silent_trackers behaviour target_speed_mps "
        "target_acceleration_mps2 alert_distance_m transmit_power_error_db path_loss_exponent_error shadowing_db "
        "shadowing_distance_m shadowing_common_share ground_reflection transmit_duty frame_s silence_s "
        "between_silences_s receiver_step_db receiver_floor_dbm receiver_ceiling_dbm wrong_trackers stuck_trackers "
        "garbage_share"
    )
    return replace(scenario, **{name: getattr(untold, name) for name in errors.split()})


def _share_to_take(log_weight: Float[Tensor, "chase particle"]) -> Float[Tensor, "chase"]:
    """The share of what was heard that leaves at least ``FEWEST_SHARE`` of the particles: 1 where all of it does."""
    relative = log_weight - log_weight.amax(dim=1, keepdim=True)
    fewest = FEWEST_SHARE * log_weight.shape[1]
    low, high = torch.full_like(relative[:, :1], LEAST_SHARE), torch.ones_like(relative[:, :1])
    share = high
    if (_effective(relative) >= fewest).all():
        return high[:, 0].double()
    for _ in range(8):
        leaves_enough = _effective(relative * share)[:, None] >= fewest
        low, high = torch.where(leaves_enough, share, low), torch.where(leaves_enough, high, share)
        share = (low * high).sqrt()
        share = torch.where(low == 1, 1.0, share)
    return low[:, 0].double()


def _effective(log_weight: Float[Tensor, "chase particle"]) -> Float[Tensor, "chase"]:
    """Number of particles that count."""
    weight = log_weight.exp()
    return weight.sum(dim=1).square() / weight.square().sum(dim=1)


def _kernel(value: Float[Tensor, "chase k particle"], least: float) -> Float[Tensor, "chase k 1"]:
    """Standard deviation of the kernel for what has this spread."""
    spread: Tensor = value.double().std(dim=2, keepdim=True)
    return (KERNEL_WIDTH * spread).float().clamp(min=least)


def _kernel_root(left_m: Float[Tensor, "chase 3 particle"]) -> Float[Tensor, "chase 3 3"]:
    """A root of the kernel's covariance for places with this spread."""
    apart_m = (left_m - left_m.mean(dim=2, keepdim=True)).double()
    covariance_m2 = apart_m @ apart_m.mT / left_m.shape[2] * KERNEL_WIDTH**2
    covariance_m2 += LEAST_KERNEL_M**2 * torch.eye(3, dtype=torch.float64)
    return torch.linalg.cholesky(covariance_m2).float()


def _replaced(memory: InFlightBelief, others: InFlightBelief, rows: list[int]) -> InFlightBelief:
    """The memory with these chases' rows taken from ``others``."""
    others_rows = {row: len(memory.condition) + place for place, row in enumerate(rows)}
    order = [others_rows.get(row, row) for row in range(len(memory.condition))]
    return select_chases(join_chases(memory, others), order)
