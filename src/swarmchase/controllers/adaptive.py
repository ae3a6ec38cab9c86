"""``adaptive``: one controller for a channel that nobody told it."""

import math
from dataclasses import dataclass, replace

import torch

from ..batch.array_types import Bool, Float, Int, Tensor
from ..batch.streams import ChaseStreams, chase_keys
from ..channel.propagation import reference_dbm
from ..formation import Action, nearest_choice
from ..networks.windows import HeardWindows, WindowsNetwork
from ..observation import Observation, center_m, checked_observation, mean_position_m, mean_power_dbm
from ..scenario import NUM_TRACKERS, Scenario
from .condition import Condition
from .explanation import MOST_POINTS, Explanation, share_of_savings
from .unknown_channel import (
    FIELDS,
    OFFSETS_LIKELY,
    FadingErrors,
    FieldErrors,
    Priors,
    heard,
    residual_and_slope,
)

NUM_PARTICLES = 600
MOST_WINDOWS = 40
FIELD_SHARE = 0.15
NUM_BETWEEN = 10
LEAST_PAIR_LOG_SHARE = -7.0
LEAST_FIELD_LOG_SHARE = -7.0
STUCK_WINDOWS = 3
RESAMPLING_SHARE = 0.5
SWEEPS = 2
SHELL_SHARE = 0.7
SHELL_SPREAD_M = 1.0
FREE_SPREAD = 0.7
WIDEST_STEP = 1.5
NARROWEST_STEP = 0.05
LEAST_STEP_M = 0.2
MIRRORED_SHARE = 0.15
CALIBRATION_WINDOWS = 12
CALIBRATE_FROM = 0.3


@dataclass(frozen=True)
class AdaptiveMemory:
    position_m: Float[Tensor, "chase 3 particle"]
    log_weight: Float[Tensor, "chase particle"]
    log_target: Float[Tensor, "chase particle"]
    num_windows: Int[Tensor, "chase"]
    level_dbm: Float[Tensor, "chase window 6"]
    place_m: Float[Tensor, "chase window 6 3"]
    own: Float[Tensor, "chase window 6 head"]
    together: Float[Tensor, "chase window feature"]
    condition: Int[Tensor, "chase"]
    model_share: Float[Tensor, "chase model"]
    flat: Bool[Tensor, "chase window 6"]
    field_evidence: Float[Tensor, "chase field"]
    streams: ChaseStreams


class AdaptiveController:
    name = "adaptive"

    def __init__(self, scenario: Scenario, network: WindowsNetwork) -> None:
        self._scenario = scenario
        self._network = network.eval()
        self._displacement_choices_m = torch.tensor(scenario.displacement_choices_m, dtype=torch.float64)

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> AdaptiveMemory:
        streams = ChaseStreams.of(chase_keys(seed, num_chases, first_chase), "policy")
        direction = streams.standard_normal(3, NUM_PARTICLES)
        direction = direction / direction.square().sum(dim=1, keepdim=True).sqrt().clamp(min=1e-9)
        normal = streams.standard_normal(NUM_PARTICLES)
        start_m = self._scenario.start_distance_m
        is_shell = torch.arange(NUM_PARTICLES) < SHELL_SHARE * NUM_PARTICLES
        distance_m = torch.where(is_shell, start_m + SHELL_SPREAD_M * normal, start_m * (FREE_SPREAD * normal).exp())
        position_m = direction * distance_m[:, None].abs()
        nothing = torch.zeros(num_chases, dtype=torch.int64)
        head, feature = self._network.own_part.out_features, self._network.together[2].out_features
        return AdaptiveMemory(
            position_m=position_m,
            log_weight=torch.full((num_chases, NUM_PARTICLES), -math.log(NUM_PARTICLES), dtype=torch.float64),
            log_target=torch.stack([self._log_prior(one) for one in position_m]),
            num_windows=nothing,
            level_dbm=torch.full((num_chases, MOST_WINDOWS, NUM_TRACKERS), math.nan),
            place_m=torch.zeros(num_chases, MOST_WINDOWS, NUM_TRACKERS, 3),
            own=torch.zeros(num_chases, MOST_WINDOWS, NUM_TRACKERS, head),
            together=torch.zeros(num_chases, MOST_WINDOWS, feature),
            condition=nothing.clone(),
            model_share=torch.zeros(num_chases, len(OFFSETS_LIKELY), dtype=torch.float64),
            flat=torch.zeros(num_chases, MOST_WINDOWS, NUM_TRACKERS, dtype=torch.bool),
            field_evidence=torch.zeros(num_chases, len(FIELDS), dtype=torch.float64),
            streams=streams,
        )

    def decide(self, observation: Observation, memory: AdaptiveMemory) -> tuple[Action, AdaptiveMemory]:
        observation = checked_observation(observation, self._scenario)
        with torch.inference_mode():
            memory = self._remembered(observation, memory)
            center = center_m(observation)
            normal = memory.streams.standard_normal(SWEEPS, 3, NUM_PARTICLES)
            uniform = memory.streams.uniform(SWEEPS, 4, NUM_PARTICLES)
            place = memory.streams.uniform(1)
            rows = [
                self._updated(memory, row, center[row].float(), normal[row], uniform[row], place[row])
                for row in range(len(center))
            ]
        position_m, log_weight, log_target, share, field = (torch.stack(part).clone() for part in zip(*rows, strict=True))
        memory = replace(
            memory,
            position_m=position_m,
            log_weight=log_weight,
            log_target=log_target,
            model_share=share,
            field_evidence=field,
        )
        return self._action(memory, center), memory

    def explain(self, observation: Observation, memory: AdaptiveMemory) -> Explanation:
        cumulative = memory.log_weight[0].exp().cumsum(dim=0)
        at = (torch.arange(MOST_POINTS) + 0.5) / MOST_POINTS * cumulative[-1]
        chosen = torch.searchsorted(cumulative, at).clamp_(max=NUM_PARTICLES - 1)
        target_m = memory.position_m[0][:, chosen].T.contiguous()
        left_m = memory.position_m[0] - center_m(observation)[0].float()[:, None]
        return Explanation(share_of_savings(self._scenario, left_m, memory.log_weight[0].exp()), target_m)

    def _remembered(self, observation: Observation, memory: AdaptiveMemory) -> AdaptiveMemory:
        level_dbm = mean_power_dbm(observation.rssi_dbm)
        read = [self._network.heard(one[None]) for one in observation.rssi_dbm]
        level, place, own, together, flat = (
            part.clone() for part in (memory.level_dbm, memory.place_m, memory.own, memory.together, memory.flat)
        )
        is_flat = _flat(observation.rssi_dbm)
        number = memory.num_windows.clone()
        position_m = mean_position_m(observation).float()
        deaf = ~level_dbm.isfinite().any(dim=1)
        for row, count in enumerate(number.tolist()):
            if deaf[row]:
                continue
            if count == MOST_WINDOWS:
                gone = _least_missed(place[row])
                for part in (level, place, own, together, flat):
                    part[row, gone:-1] = part[row, gone + 1 :].clone()
                count -= 1
            level[row, count], place[row, count] = level_dbm[row], position_m[row]
            own[row, count], together[row, count] = read[row].own[0], read[row].together[0]
            flat[row, count] = is_flat[row]
            number[row] = count + 1
        condition = torch.where(deaf, int(Condition.DEAF), int(Condition.TRACKING))
        return replace(
            memory,
            level_dbm=level,
            place_m=place,
            own=own,
            together=together,
            flat=flat,
            num_windows=number,
            condition=condition,
        )

    def _updated(self, memory, row, center, normal, uniform, place):
        number = int(memory.num_windows[row])
        position_m, log_weight, log_target = memory.position_m[row], memory.log_weight[row], memory.log_target[row]
        field_evidence = memory.field_evidence[row]
        if number == 0:
            return position_m, log_weight, log_target, memory.model_share[row], field_evidence
        level_dbm = memory.level_dbm[row, :number]
        level_dbm = level_dbm.masked_fill(_stuck(level_dbm, memory.flat[row, :number]), math.nan)
        windows = HeardWindows(memory.own[row : row + 1, :number], memory.together[row : row + 1, :number])
        law = self._network.law(windows, torch.ones(1, number, dtype=torch.bool))
        excess_db = level_dbm - reference_dbm(self._scenario) - law.mean_db[0]
        all_heard = heard(excess_db, law.apart_db[0], law.together_db[0])
        tracker_m = memory.place_m[row, :number]
        probed = torch.arange(number % NUM_BETWEEN, NUM_PARTICLES, NUM_BETWEEN)
        turn = number % len(FIELDS)
        plain, field = FadingErrors(all_heard), FieldErrors(all_heard, tracker_m, *FIELDS[turn])
        probe = _Posterior(self, all_heard, tracker_m, [(Priors(plain), 1 - FIELD_SHARE), (Priors(field), FIELD_SHARE)])
        (plain_likely, field_likely), _ = probe.parts(position_m[:, probed])
        before = (log_weight - log_target)[probed] + self._log_prior(position_m[:, probed])
        plain_share, field_share = ((likely + before).logsumexp(dim=2).double() for likely in (plain_likely, field_likely))
        field_evidence = field_evidence.clone()
        field_evidence[turn] = field_share.logsumexp(dim=(0, 1)) - plain_share.logsumexp(dim=(0, 1))
        best = int(field_evidence.argmax())
        kinds = [(Priors(plain, _worth(plain_share)), 1 - FIELD_SHARE)]
        has_field = number > len(FIELDS) and field_evidence[best] > LEAST_FIELD_LOG_SHARE
        if has_field:
            field = field if best == turn else FieldErrors(all_heard, tracker_m, *FIELDS[best])
            kinds.append((Priors(field, _worth(field_share)), FIELD_SHARE))
        offsets = plain_share.flatten() if not has_field or field_evidence[best] < 0 else field_share.flatten()
        share = (offsets - offsets.logsumexp(dim=0)).exp()
        posterior = _Posterior(self, all_heard, tracker_m, kinds)
        target = posterior(position_m)
        log_weight = log_weight + target - log_target
        log_weight = log_weight - log_weight.logsumexp(dim=0)
        if 1 / (2 * log_weight).exp().sum() < RESAMPLING_SHARE * NUM_PARTICLES:
            cumulative = log_weight.exp().cumsum(dim=0)
            at = (torch.arange(NUM_PARTICLES) + place) / NUM_PARTICLES
            parent = torch.searchsorted(cumulative, at * cumulative[-1]).clamp_(max=NUM_PARTICLES - 1)
            position_m, target = position_m[:, parent], target[parent]
            log_weight = torch.full_like(log_weight, -math.log(NUM_PARTICLES))
        for sweep in range(SWEEPS):
            proposed_m = self._proposed(position_m, log_weight, center, normal[sweep], uniform[sweep])
            proposed_target = posterior(proposed_m)
            accepted = uniform[sweep, 3].log() < proposed_target - target
            position_m = torch.where(accepted, proposed_m, position_m)
            target = torch.where(accepted, proposed_target, target)
        return position_m, log_weight, target, share, field_evidence

    def _proposed(self, position_m, log_weight, center, normal, uniform):
        weight = log_weight.exp().float()
        mean_m = position_m @ weight
        apart_m = position_m - mean_m[:, None]
        covariance = (apart_m * weight) @ apart_m.T + LEAST_STEP_M**2 * torch.eye(3)
        factor = torch.linalg.cholesky(covariance)
        scale = (NARROWEST_STEP * (uniform[0] * math.log(WIDEST_STEP / NARROWEST_STEP)).exp()).float()
        stepped_m = position_m + scale * (factor @ normal)
        mirrored_m = 2 * center[:, None] - position_m
        axis = (uniform[2] * 4).long()
        flips = (axis == torch.arange(3)[:, None]) | (axis == 3)
        mirrored_m = torch.where(flips, mirrored_m, position_m)
        return torch.where(uniform[1] < MIRRORED_SHARE, mirrored_m, stepped_m)

    def _log_prior(self, position_m):
        distance_m = position_m.double().square().sum(dim=0).sqrt().clamp(min=0.1)
        start_m = self._scenario.start_distance_m
        shell = -((distance_m - start_m) / SHELL_SPREAD_M).square() / 2 - math.log(SHELL_SPREAD_M)
        free = -((distance_m / start_m).log() / FREE_SPREAD).square() / 2 - (FREE_SPREAD * distance_m).log()
        both = torch.logaddexp(shell + math.log(SHELL_SHARE), free + math.log(1 - SHELL_SHARE))
        return both - 2 * distance_m.log()

    def _action(self, memory: AdaptiveMemory, center) -> Action:
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
        distance_m = (left_m.square().sum(dim=1).sqrt() * weight).sum(dim=1)
        spacing_m = nearest_choice(self._scenario.spacing_choices_m, distance_m)
        offsets = memory.model_share[:, OFFSETS_LIKELY].sum(dim=1)
        calibrates = (
            (offsets > CALIBRATE_FROM) & (memory.num_windows < CALIBRATION_WINDOWS) & (memory.num_windows % 2 == 1)
        )
        spacing_m = torch.where(calibrates, min(self._scenario.spacing_choices_m), spacing_m)
        return Action(spacing_m=spacing_m, displacement_m=self._displacement_choices_m[choice])


def _least_missed(place_m):
    """The window nearest to another place; the elder of the two."""
    center_m = place_m.mean(dim=1)
    apart_m = torch.cdist(center_m, center_m) + 1e9 * torch.eye(len(center_m))
    return int(apart_m.amin(dim=1).argmin())


class _Posterior:
    """Log density of places."""

    def __init__(self, controller, all_heard, tracker_m, kinds):
        self._controller, self._heard, self._tracker_m, self._kinds = controller, all_heard, tracker_m, kinds

    def parts(self, position_m):
        scenario = self._controller._scenario
        squared_m2 = sum((position_m[axis] - self._tracker_m[:, :, axis, None]).square_() for axis in range(3))
        log_distance = squared_m2.clamp_(min=scenario.reference_distance_m**2).log10_().mul_(0.5)
        residual, slope = residual_and_slope(self._heard, scenario.path_loss_exponent, log_distance)
        parts = [priors.log_likelihoods(residual, slope).add_(math.log(share)) for priors, share in self._kinds]
        return parts, position_m

    def __call__(self, position_m):
        parts, _ = self.parts(position_m)
        likely = torch.cat([part.flatten(0, 1) for part in parts])
        highest = likely.amax(dim=0)
        return (likely - highest).exp_().sum(dim=0).log_().add_(highest).double() + self._controller._log_prior(position_m)


def _worth(log_share):
    """The pairs of models that are worth a look."""
    by_pair = log_share.logsumexp(dim=1)
    return (by_pair > by_pair.max() + LEAST_PAIR_LOG_SHARE).nonzero()[:, 0]


def _flat(rssi_dbm):
    """Trackers whose samples in a window are all the same."""
    valid = rssi_dbm.isfinite()
    highest = torch.where(valid, rssi_dbm, -math.inf).amax(dim=1)
    lowest = torch.where(valid, rssi_dbm, math.inf).amin(dim=1)
    return (valid.sum(dim=1) >= 10) & (highest == lowest)


def _stuck(level_dbm, flat):
    """Levels of trackers that report one value whatever happens, while others do not."""
    stuck = torch.zeros_like(flat)
    if len(flat) < STUCK_WINDOWS:
        return stuck
    last, last_flat = level_dbm[-STUCK_WINDOWS:], flat[-STUCK_WINDOWS:]
    same = last_flat.all(dim=0) & ((last - last[0]).abs() < 0.01).all(dim=0)
    if same.sum() > NUM_TRACKERS // 2:
        return stuck
    return same & flat & ((level_dbm - last[0]).abs() < 0.01)
