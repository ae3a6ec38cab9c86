"""``adaptive``: a filter over the target's place that finds out what the channel and the receivers are like.

It is told path loss, power and the distance at the start, and believes none of it unconditionally: power, exponent and
receivers' offsets are integrated out, and models in which they are as told, or not, are weighed by their evidence
(``unknown_channel``). So is shadowing, as a field over the places where trackers have been. How strong and how fast the
fading is, a network reads in all windows so far, and reads them anew with each (``networks.windows``).

The belief is particles of places. Each decision weighs them by everything that was heard since the beginning, as it is
read now, and resamples them where few are left; then every particle may move, by steps that leave the belief as it is
(Metropolis-Hastings; Chopin 2002, A sequential particle filter method for static models). Steps are of all sizes in the
belief's own shape, and reflections at the swarm's centre: near the target the levels do not tell its sides apart. So
particles never freeze beside the truth.

On each axis it takes the displacement that leaves the least expected distance; where that leads nowhere although the
belief is wide, it explores (``exploration``). Heights at which targets fly are believed where they are told. While
offsets are likely, every other of the first windows is heard with the trackers close together: what differs there is
not the distance. Missing samples do not count, a silent or stuck tracker is left out, and in a window without any
sample it holds still.
"""

import math
from dataclasses import dataclass, replace

import torch

from ..batch.array_types import Float, Int, Tensor
from ..batch.streams import ChaseStreams, chase_keys
from ..channel.propagation import reference_dbm
from ..formation import Action, nearest_choice
from ..networks.windows import WindowsNetwork
from ..observation import Observation, center_m, checked_observation
from ..scenario import Scenario
from .belief import Belief, belief_of_particles
from .condition import Condition
from .described import Described
from .explanation import MOST_POINTS, Explanation, FoundChannel, reasons_left_out, share_of_savings
from .exploration import Exploration, explored, no_exploration
from .remembered_windows import ReadWindows, RememberedWindows, no_windows, read_windows, remembered
from .target_motion import TargetBand, length
from .unknown_channel import (
    FIELD_TRUST,
    FIELDS,
    LOG_FIELD,
    LOG_PLAIN,
    PAIRS,
    Eliminated,
    FadingErrors,
    FieldErrors,
    has_offsets,
    levels,
    power_db,
    residual_and_slope,
    wrong_receiver,
)

NUM_PARTICLES = 600
"""With 300 as good in the paper's world."""
RESAMPLING_SHARE = 0.5
"""Particles are resampled when fewer than this share of them are effective."""
SWEEPS = 2
"""Steps that every particle may make at a decision."""
SHELL_SHARE = 0.7
"""Probability that the target is as far at the start as is told, to within ``SHELL_SPREAD_M``."""
SHELL_SPREAD_M = 1.0
FREE_SPREAD = 0.7
"""Otherwise: standard deviation of the logarithm of its distance."""
SHORTEST_STEP, LONGEST_STEP = 0.05, 1.5
"""In standard deviations of the belief, log-uniform between these."""
LEAST_SPREAD_M = 0.2
"""Of the belief, for its steps."""
ROUNDING_SHARE = 2e-7
"""Of a belief's variance, by which single precision is off: less is nothing to step by."""
MIRRORED_SHARE = 0.15
"""Of the steps, those that are reflections."""
WIDE_SHARE = 0.1
"""Of the steps, those that are as wide as the distance at the start, whatever the belief's shape; half of them on the
level. A belief that has shrunk at a wrong place finds another so."""
PROBED_EVERY = 10
"""Of so many particles one probes all models; the others heed those that are worth it."""
LEAST_LOG_SHARE = -7.0
"""A model that has less than this of the best one's evidence is not worth it."""
CALIBRATION_WINDOWS = 12
"""The first so many windows may be heard close together."""
CALIBRATION_SHARE = 0.3
"""Where offsets are as likely as this."""
LEFT_OUT_SHARE = 0.5
"""A receiver is said to be wrong when it is more likely than this."""
OUTSIDE = -1e4
"""The logarithm of the density where the target does not fly."""
NEAREST_M = 0.1
"""For the logarithm of a distance."""


@dataclass(frozen=True)
class AdaptiveMemory:
    """The belief of each chase, and what it is made of."""

    position_m: Float[Tensor, "chase 3 particle"]
    """In the chase's own frame, float32."""
    log_weight: Float[Tensor, "chase particle"]
    """Normalised, float64."""
    log_density: Float[Tensor, "chase particle"]
    """Of the belief at each particle, as far as it was heard when it was last weighed; not normalised, float64."""
    pair_share: Float[Tensor, "chase pair"]
    """Probability of each of ``PAIRS``."""
    field_log_odds: Float[Tensor, "chase field"]
    """Of shadowing as each of ``FIELDS``, against none."""
    windows: RememberedWindows
    exploration: Exploration
    condition: Int[Tensor, "chase"]
    """A ``Condition``."""
    streams: ChaseStreams
    """Each chase's own random numbers."""


@dataclass(frozen=True)
class _Belief:
    """One chase's part of the memory."""

    position_m: Float[Tensor, "3 particle"]
    log_weight: Float[Tensor, "particle"]
    log_density: Float[Tensor, "particle"]
    pair_share: Float[Tensor, "pair"]
    field_log_odds: Float[Tensor, "field"]


@dataclass(frozen=True)
class _Heeded:
    """The models that are worth heeding, and to what power what they say counts."""

    models: list[Eliminated]
    trust: float


@dataclass(frozen=True)
class _Draws:
    """One chase's random numbers for one decision."""

    normal: Float[Tensor, "sweep 3 particle"]
    uniform: Float[Tensor, "sweep 4 particle"]
    place: Float[Tensor, "1"]


class AdaptiveController(Described):
    """Goes where its particles' expected distance on each axis is least."""

    def __init__(self, scenario: Scenario, network: WindowsNetwork, name: str = "adaptive") -> None:
        self.name = name
        self._scenario = scenario
        self._network = network.eval()
        self._displacement_choices_m = torch.tensor(scenario.displacement_choices_m, dtype=torch.float64)
        self._has_offsets = has_offsets().double()
        self._band = TargetBand(scenario)

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> AdaptiveMemory:
        """Particles all around the start."""
        streams = ChaseStreams.of(chase_keys(seed, num_chases, first_chase), "policy")
        towards = streams.standard_normal(3, NUM_PARTICLES)
        towards = towards / length(towards).clamp(min=1e-9)
        normal = streams.standard_normal(1, NUM_PARTICLES)
        start_m = self._scenario.start_distance_m
        is_as_told = torch.arange(NUM_PARTICLES) < SHELL_SHARE * NUM_PARTICLES
        distance_m = torch.where(is_as_told, start_m + SHELL_SPREAD_M * normal, start_m * (FREE_SPREAD * normal).exp())
        position_m = towards * distance_m.abs()
        position_m = self._band.inside_m(position_m)
        return AdaptiveMemory(
            position_m=position_m,
            log_weight=torch.full((num_chases, NUM_PARTICLES), -math.log(NUM_PARTICLES), dtype=torch.float64),
            log_density=torch.stack([self._log_prior(one) for one in position_m]),
            pair_share=torch.zeros(num_chases, len(PAIRS), dtype=torch.float64),
            field_log_odds=torch.full((num_chases, len(FIELDS)), LOG_FIELD - LOG_PLAIN, dtype=torch.float64),
            windows=no_windows(self._network, num_chases),
            exploration=no_exploration(num_chases),
            condition=torch.zeros(num_chases, dtype=torch.int64),
            streams=streams,
        )

    def decide(self, observation: Observation, memory: AdaptiveMemory) -> tuple[Action, AdaptiveMemory]:
        """Weigh the particles by all that was heard, move them, act on the belief."""
        observation = checked_observation(observation, self._scenario)
        center = center_m(observation)
        deaf = ~observation.rssi_dbm.isfinite().any(dim=2).any(dim=1)
        normal = memory.streams.standard_normal(SWEEPS, 3, NUM_PARTICLES)
        uniform = memory.streams.uniform(SWEEPS, 4, NUM_PARTICLES)
        place = memory.streams.uniform(1)
        with torch.inference_mode():
            windows = remembered(memory.windows, observation, self._network)
            beliefs = []
            # Chase by chase: a belief fits into the cache, and does not depend on the others of its batch.
            for row in range(len(deaf)):
                belief = _Belief(
                    memory.position_m[row],
                    memory.log_weight[row],
                    memory.log_density[row],
                    memory.pair_share[row],
                    memory.field_log_odds[row],
                )
                if not deaf[row]:
                    draws = _Draws(normal[row], uniform[row], place[row])
                    read = read_windows(windows, row, self._network)
                    belief = self._updated(belief, read, center[row].float(), draws)
                beliefs.append(belief)
        memory = AdaptiveMemory(
            position_m=torch.stack([belief.position_m for belief in beliefs]).clone(),
            log_weight=torch.stack([belief.log_weight for belief in beliefs]).clone(),
            log_density=torch.stack([belief.log_density for belief in beliefs]).clone(),
            pair_share=torch.stack([belief.pair_share for belief in beliefs]).clone(),
            field_log_odds=torch.stack([belief.field_log_odds for belief in beliefs]).clone(),
            windows=windows,
            exploration=memory.exploration,
            condition=torch.where(deaf, int(Condition.DEAF), int(Condition.TRACKING)),
            streams=memory.streams,
        )
        memory = replace(
            memory, exploration=explored(memory.exploration, center, self.belief(memory), self._drawn(memory, place))
        )
        return self._action(memory, center), memory

    def belief(self, memory: AdaptiveMemory) -> Belief:
        """As ``belief.Believing``."""
        return belief_of_particles(memory.position_m, memory.log_weight.exp())

    def explain(self, observation: Observation, memory: AdaptiveMemory) -> Explanation:
        """Particles in proportion to their weights, what each choice is worth to them, the channel as it is found."""
        cumulative = memory.log_weight[0].exp().cumsum(dim=0)
        at = (torch.arange(MOST_POINTS) + 0.5) / MOST_POINTS * cumulative[-1]
        chosen = torch.searchsorted(cumulative, at).clamp_(max=NUM_PARTICLES - 1)
        target_m = memory.position_m[0][:, chosen].T.contiguous()
        left_m = memory.position_m[0] - center_m(observation)[0].float()[:, None]
        savings = share_of_savings(self._scenario, left_m, memory.log_weight[0].exp())
        with torch.inference_mode():
            found = self._found(observation, memory)
        return Explanation(savings, target_m, found)

    def _updated(self, belief: _Belief, read: ReadWindows, center: Float[Tensor, "3"], draws: _Draws) -> _Belief:
        """The belief after all these windows."""
        place = _Places(self._scenario, read)
        heeded, pair_share, field_log_odds = self._models(belief, place)
        position_m, log_density = belief.position_m, self._log_density(place, heeded, belief.position_m)
        log_weight = belief.log_weight + log_density - belief.log_density
        log_weight = log_weight - log_weight.logsumexp(dim=0)
        if 1 / (2 * log_weight).exp().sum() < RESAMPLING_SHARE * NUM_PARTICLES:
            cumulative = log_weight.exp().cumsum(dim=0)
            at = (torch.arange(NUM_PARTICLES) + draws.place) / NUM_PARTICLES
            parent = torch.searchsorted(cumulative, at * cumulative[-1]).clamp_(max=NUM_PARTICLES - 1)
            position_m, log_density = position_m[:, parent], log_density[parent]
            log_weight = torch.full_like(log_weight, -math.log(NUM_PARTICLES))
        for normal, uniform in zip(draws.normal, draws.uniform, strict=True):
            proposed_m = _proposed(position_m, log_weight, center, self._scenario.start_distance_m, normal, uniform)
            proposed_density = self._log_density(place, heeded, proposed_m)
            is_accepted = uniform[3].log() < proposed_density - log_density
            position_m = torch.where(is_accepted, proposed_m, position_m)
            log_density = torch.where(is_accepted, proposed_density, log_density)
        return _Belief(position_m, log_weight, log_density, pair_share, field_log_odds)

    def _models(
        self, belief: _Belief, place: "_Places"
    ) -> tuple[_Heeded, Float[Tensor, "pair"], Float[Tensor, "field"]]:
        """The models that are worth heeding, how probable each pair is, and shadowing.

        Some particles probe all pairs, with and without shadowing as one of ``FIELDS``: another in each window.
        """
        turn = place.read.heard % len(FIELDS)
        probes = torch.arange(place.read.heard % PROBED_EVERY, NUM_PARTICLES, PROBED_EVERY)
        fading = Eliminated(FadingErrors(place.heard), LOG_PLAIN)
        field = Eliminated(place.field_errors(turn), LOG_FIELD)
        residual, slope = place.residual_and_slope(belief.position_m[:, probes])
        weight = (belief.log_weight - belief.log_density)[probes] + self._log_prior(belief.position_m[:, probes])
        plain, shadowed = (
            (models.log_likelihoods(residual, slope) + weight).logsumexp(dim=(1, 2)) for models in (fading, field)
        )
        field_log_odds = belief.field_log_odds.clone()
        field_log_odds[turn] = shadowed.logsumexp(dim=0) - plain.logsumexp(dim=0)
        best = int(field_log_odds.argmax())
        density = [fading.of(_worth_it(plain))]
        if field_log_odds[best] > LEAST_LOG_SHARE:
            field = field if best == turn else Eliminated(place.field_errors(best), LOG_FIELD)
            density.append(field.of(_worth_it(shadowed)))
        is_shadowed = len(density) > 1 and field_log_odds[best] > 0
        trust = 1 - (1 - FIELD_TRUST) * float(field_log_odds[best].sigmoid()) if len(density) > 1 else 1.0
        return _Heeded(density, trust), (shadowed if is_shadowed else plain).softmax(dim=0), field_log_odds

    def _log_density(
        self, place: "_Places", heeded: _Heeded, position_m: Float[Tensor, "3 particle"]
    ) -> Float[Tensor, "particle"]:
        residual, slope = place.residual_and_slope(position_m)
        likely = torch.cat([models.log_likelihoods(residual, slope).flatten(0, 1) for models in heeded.models])
        highest = likely.amax(dim=0)
        likely = (likely - highest).exp_().sum(dim=0).log_().add_(highest).double()
        return heeded.trust * likely + self._log_prior(position_m)

    def _log_prior(self, position_m: Float[Tensor, "3 particle"]) -> Float[Tensor, "particle"]:
        """Of places before anything was heard, from the distance to the start alone."""
        distance_m = length(position_m[None].double())[0, 0].clamp(min=NEAREST_M)
        start_m = self._scenario.start_distance_m
        as_told = ((distance_m - start_m) / SHELL_SPREAD_M).square() / -2 - math.log(SHELL_SPREAD_M)
        free = ((distance_m / start_m).log() / FREE_SPREAD).square() / -2 - (FREE_SPREAD * distance_m).log()
        both = torch.logaddexp(as_told + math.log(SHELL_SHARE), free + math.log(1 - SHELL_SHARE))
        is_too_high = (position_m[2] < self._band.lowest_m) | (position_m[2] > self._band.highest_m)
        return torch.where(is_too_high, OUTSIDE, both - 2 * distance_m.log())

    def _action(self, memory: AdaptiveMemory, center: Float[Tensor, "chase 3"]) -> Action:
        left_m = memory.position_m - center.float()[..., None]
        weight = memory.log_weight.exp()
        expected_m = torch.stack(
            [
                ((left_m - choice_m).abs() * weight[:, None]).sum(dim=2)
                for choice_m in self._displacement_choices_m.tolist()
            ],
            dim=2,
        )
        displacement_m = self._displacement_choices_m[expected_m.argmin(dim=2)]
        displacement_m = memory.exploration.instead_of(displacement_m, center, self._scenario)
        holds = (memory.condition == Condition.DEAF)[:, None]
        displacement_m = torch.where(
            holds, nearest_choice(self._scenario.displacement_choices_m, torch.zeros(1)), displacement_m
        )
        spacing_m = nearest_choice(self._scenario.spacing_choices_m, (length(left_m)[:, 0] * weight).sum(dim=1))
        number = memory.windows.heard
        calibrates = (number < CALIBRATION_WINDOWS) & (number % 2 == 1)
        calibrates &= memory.pair_share @ self._has_offsets > CALIBRATION_SHARE
        spacing_m = torch.where(calibrates, min(self._scenario.spacing_choices_m), spacing_m)
        return Action(spacing_m=spacing_m, displacement_m=displacement_m)

    def _drawn(self, memory: AdaptiveMemory, uniform: Float[Tensor, "chase 1"]) -> Float[Tensor, "chase 3"]:
        """A place out of each belief."""
        cumulative = memory.log_weight.exp().cumsum(dim=1)
        drawn = torch.searchsorted(cumulative, uniform.double() * cumulative[:, -1:]).clamp_(max=NUM_PARTICLES - 1)
        return memory.position_m.gather(2, drawn[:, None].expand(-1, 3, -1))[..., 0].double()

    def _found(self, observation: Observation, memory: AdaptiveMemory) -> FoundChannel | None:
        """What the first chase's windows say of everything but the target's place, if it is at the belief's mean."""
        if not memory.windows.number[0]:
            return None
        read = read_windows(memory.windows, 0, self._network)
        place = _Places(self._scenario, read)
        mean_m = memory.position_m[0].double() @ memory.log_weight[0].exp()
        best = int(memory.field_log_odds[0].argmax())
        is_shadowed = bool(memory.field_log_odds[0, best] > 0)
        models = Eliminated(place.field_errors(best) if is_shadowed else FadingErrors(place.heard), 0.0)
        residual, slope = place.residual_and_slope(mean_m.float()[:, None])
        share = models.log_likelihoods(residual, slope)[..., 0].flatten().softmax(dim=0).view(len(PAIRS), 2)
        level_db, exponent_error = models.found(residual, slope)
        power = power_db(level_db, models.pairs)
        wrong = wrong_receiver() @ share.sum(dim=1)
        is_silent = ~observation.rssi_dbm[0].isfinite().any(dim=0)
        return FoundChannel(
            power_db=float((share * power).sum()),
            exponent=self._scenario.path_loss_exponent + float((share * exponent_error).sum()),
            offset_db=tuple(((level_db - power[..., None]) * share[..., None]).sum(dim=(0, 1)).tolist()),
            left_out=reasons_left_out(is_silent, read.is_stuck, wrong > LEFT_OUT_SHARE),
            fading_db=float((read.law.apart_db.square().mean() + read.law.together_db.square().mean()).sqrt()),
            shadowing_db=FIELDS[best][1] if is_shadowed else 0.0,
        )


class _Places:
    """All that was heard, asked for places of the target."""

    def __init__(self, scenario: Scenario, read: ReadWindows) -> None:
        self.read = read
        law = read.law
        excess_db = read.level_dbm - reference_dbm(scenario) - law.mean_db
        self.heard = levels(excess_db, law.apart_db, law.together_db)
        self._scenario = scenario

    def field_errors(self, number: int) -> FieldErrors:
        """With shadowing as this one of ``FIELDS``."""
        return FieldErrors(self.heard, self.read.tracker_position_m, *FIELDS[number])

    def residual_and_slope(
        self, position_m: Float[Tensor, "3 place"]
    ) -> tuple[Float[Tensor, "window 6 place"], Float[Tensor, "window 6 place"]]:
        """As ``unknown_channel.residual_and_slope``, of the target at each place."""
        tracker_m = self.read.tracker_position_m
        squared_m2 = (position_m[0] - tracker_m[..., 0, None]).square_()
        for axis in (1, 2):
            squared_m2 += (position_m[axis] - tracker_m[..., axis, None]).square_()
        least_m2 = self._scenario.reference_distance_m**2
        log_distance = squared_m2.clamp_(min=least_m2).mul_(1 / least_m2).log10_().mul_(0.5)
        return residual_and_slope(self.heard, self._scenario.path_loss_exponent, log_distance)


def _proposed(
    position_m: Float[Tensor, "3 particle"],
    log_weight: Float[Tensor, "particle"],
    center: Float[Tensor, "3"],
    widest_m: float,
    normal: Float[Tensor, "3 particle"],
    uniform: Float[Tensor, "4 particle"],
) -> Float[Tensor, "3 particle"]:
    """A step for every particle, as likely there as back."""
    weight = log_weight.exp().float()
    apart_m = position_m - (position_m @ weight)[:, None]
    covariance_m2 = (apart_m * weight) @ apart_m.T
    least_m2 = max(LEAST_SPREAD_M**2, ROUNDING_SHARE * float(covariance_m2.trace()))
    covariance_m2 = covariance_m2 + least_m2 * torch.eye(3)
    length = (SHORTEST_STEP * (uniform[0] * math.log(LONGEST_STEP / SHORTEST_STEP)).exp()).float()
    stepped_m = position_m + length * (torch.linalg.cholesky(covariance_m2) @ normal)
    axis = (4 * uniform[2]).long()
    is_mirrored = (axis == torch.arange(3)[:, None]) | (axis == 3)
    mirrored_m = torch.where(is_mirrored, 2 * center[:, None] - position_m, position_m)
    proposed_m = torch.where(uniform[1] < MIRRORED_SHARE, mirrored_m, stepped_m)
    is_level = (uniform[2] < 0.5) & (torch.arange(3) == 2)[:, None]
    wide_m = torch.where(is_level, 0.0, widest_m ** uniform[0].float() * normal)
    return torch.where(uniform[1] > 1 - WIDE_SHARE, position_m + wide_m, proposed_m)


def _worth_it(log_share: Float[Tensor, "pair"]) -> Int[Tensor, "worthy"]:
    return (log_share > log_share.max() + LEAST_LOG_SHARE).nonzero()[:, 0]
