"""``particle`` in flight against the particle filter of another library, stonesoup, on the same flights.

Motion and likelihood are written here once more, in plain numpy and from their description: every sample at its own
time and place, without pieces. Prediction, weights and resampling are stonesoup's, a bootstrap filter of many
particles. It has no kernel, so ours is given a narrow one.
"""

import contextlib
import dataclasses
import datetime

import numpy as np
import pytest
import torch
from scipy.special import j0
from scipy.stats import multivariate_normal

from swarmchase.batch.streams import chase_keys
from swarmchase.controllers import moving_particle
from swarmchase.controllers.moving_particle import MovingParticleController
from swarmchase.observation import Observation
from swarmchase.scenario import load_scenario
from swarmchase.world.environment import Environment

pytest.importorskip("stonesoup", reason="stonesoup, the independent particle filter, comes with the dev extra")

from stonesoup.base import Property
from stonesoup.models.measurement import MeasurementModel
from stonesoup.models.transition import TransitionModel
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import ParticleState
from stonesoup.updater.particle import ParticleUpdater

SCENARIO = dataclasses.replace(load_scenario("flight"), behaviour="flee", target_speed_mps=5.0, farthest_start_m=100.0)
NUM_DECISIONS = 8
NUM_ORACLES, ORACLE_PARTICLES = 4, 10_000
NUM_FILTERS = 16
STANDARD_ERRORS = 4
NARROW_KERNEL = 0.1
NARROW_BIAS = 0.05
"""What it, pieces and float32 may add to the Monte-Carlo error, in the units below."""
CORRELATION = (0.5**2 + 6 * 0.5) / 7
"""Of two trackers' powers: rho = 0.5, K = 3."""
AXIS_SHARE = np.array([[1], [1], [0.4]])


def limited(velocity_mps):
    """To 10 m/s."""
    return velocity_mps * (10 / np.linalg.norm(velocity_mps, axis=0).clip(min=10))


class ThreeModes(TransitionModel):
    """Still, steady or manoeuvring for half a second; the state is place, velocity and mode."""

    generator: np.random.Generator = Property()
    ndim_state = 7
    mapping = tuple(range(7))

    def function(self, state, noise=True, **kwargs):
        vector = np.asarray(state.state_vector, dtype=float)
        place_m, velocity_mps, mode = vector[:3], vector[3:6], vector[6].astype(int)
        changes = self.generator.random(len(mode)) < 1 - np.exp(-0.5 * np.array([0.05, 0.2, 0.4])[mode])
        likely = self.generator.random(len(mode)) < 0.75
        following = np.where(likely, np.array([1, 2, 1])[mode], np.array([2, 0, 0])[mode])
        following = np.where(changes, following, mode)
        spread_mps = np.where(changes & (mode == 0), 4, 0.5 * np.array([0, 0.3, 3])[following])
        gained_mps = spread_mps * AXIS_SHARE * self.generator.standard_normal(place_m.shape)
        new_mps = limited(velocity_mps + gained_mps) * (following > 0)
        place_m = place_m + 0.5 * (velocity_mps + new_mps) / 2
        place_m[2] = place_m[2].clip(-45, 70)
        return StateVectors(np.concatenate([place_m, new_mps, following[None]]))

    def rvs(self, num_samples=1, **kwargs):
        raise NotImplementedError

    def pdf(self, state1, state2, **kwargs):
        raise NotImplementedError


class Levels(MeasurementModel):
    """The levels of six trackers, sample by sample (Eqs. 1-2), and the law of the fading's mean in each."""

    tracker_m: np.ndarray = Property(doc="[sample, tracker, 3]")
    sample_s: np.ndarray = Property()
    ndim_state: int = Property(default=7)
    mapping: tuple = Property(default=tuple(range(7)))
    ndim_meas = 60

    def logpdf(self, state1, state2, **kwargs):
        level_dbm = np.asarray(state1.state_vector, dtype=float).reshape(self.tracker_m.shape[:2])
        vector = np.asarray(state2.state_vector, dtype=float)
        place_m, velocity_mps = vector[:3].T, vector[3:6].T
        number = len(self.sample_s)
        fading = 0
        for sample in range(number):
            then_m = place_m - velocity_mps * (self.sample_s[-1] - self.sample_s[sample])
            distance_m = np.linalg.norm(then_m[:, None] - self.tracker_m[sample], axis=2).clip(min=1)
            fading = fading + 10 ** ((level_dbm[sample] - 23 + 30 + 26 * np.log10(distance_m)) / 10) / number
        swarm_mps = (self.tracker_m[-1] - self.tracker_m[0]).mean(axis=0) / (self.sample_s[-1] - self.sample_s[0])
        doppler_hz = np.maximum(np.linalg.norm(velocity_mps - swarm_mps, axis=1) * 10, 1)
        lag_s = np.arange(1, number) / 20
        bessel = j0(2 * np.pi * doppler_hz[:, None] * lag_s)
        alike = ((bessel**2 + 6 * bessel) / 7 @ (number - np.arange(1, number))) / (number * (number - 1) / 2)
        variance = 7 / 16 * (1 + (number - 1) * alike.clip(0)) / number
        normal = (np.cbrt(fading) - 1 + variance[:, None] / 9) * 3 / np.sqrt(variance)[:, None]
        six = multivariate_normal(np.zeros(6), (1 - CORRELATION) * np.eye(6) + CORRELATION)
        return six.logpdf(normal) + (np.log(fading) / 3).sum(axis=1) - 3 * np.log(variance)

    def function(self, state, noise=False, **kwargs):
        raise NotImplementedError

    def rvs(self, num_samples=1, **kwargs):
        raise NotImplementedError

    def pdf(self, state1, state2, **kwargs):
        return np.exp(self.logpdf(state1, state2))


@contextlib.contextmanager
def seeded(seed):
    """Stonesoup draws from numpy's global generator: it gets its state back."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        yield np.random.default_rng(seed)
    finally:
        np.random.set_state(before)  # noqa: NPY002


def prior(generator, timestamp):
    """60 to 100 m away, as evenly in height as a sphere is; a third of the modes each, about."""
    number = ORACLE_PARTICLES
    radius_m, bearing_rad = generator.uniform(60, 100, number), generator.uniform(0, 2 * np.pi, number)
    height_m = generator.uniform(np.maximum(-radius_m / 2, -45), np.minimum(radius_m / 2, 70))
    level_m = np.sqrt(radius_m**2 - height_m**2)
    mode = generator.choice(3, number, p=[0.3, 0.4, 0.3])
    velocity_mps = limited(4 * AXIS_SHARE * generator.standard_normal((3, number))) * (mode > 0)
    place_m = [level_m * np.cos(bearing_rad), level_m * np.sin(bearing_rad), height_m]
    vectors = StateVectors(np.stack([*place_m, *velocity_mps, mode]))
    return ParticleState(vectors, log_weight=np.full(number, -np.log(number)), timestamp=timestamp)


def oracle_belief(observations, seed):
    """Mean place, mean velocity and the logarithm of the place's spread, [decision, 7]."""
    beliefs = []
    with seeded(seed) as generator:
        now = datetime.datetime(2025, 1, 1, tzinfo=datetime.UTC)
        state = prior(generator, now)
        predictor, updater = ParticlePredictor(ThreeModes(generator)), ParticleUpdater(None, SystematicResampler())
        for one in observations:
            now += datetime.timedelta(seconds=0.5)
            model = Levels(one.tracker_position_m[0].numpy(), one.time_s[0].numpy())
            levels = StateVector(one.rssi_dbm[0].double().numpy().ravel())
            detection = Detection(levels, timestamp=now, measurement_model=model)
            state = updater.update(SingleHypothesis(predictor.predict(state, timestamp=now), detection))
            vector = np.asarray(state.state_vector, dtype=float)
            spread_m = np.sqrt(vector[:3].var(axis=1).sum())
            beliefs.append([*vector[:6].mean(axis=1), np.log(spread_m)])
    return np.array(beliefs)


def particle_beliefs(controller, observations):
    """The same of ``NUM_FILTERS`` filters with random numbers of their own, [filter, decision, 7]."""
    memory, beliefs = controller.begin(NUM_FILTERS, 2), []
    for one in observations:
        everyone = Observation(
            one.rssi_dbm.expand(NUM_FILTERS, -1, -1),
            one.tracker_position_m.expand(NUM_FILTERS, -1, -1, -1),
            one.time_s.expand(NUM_FILTERS, -1),
        )
        _, memory = controller.decide(everyone, memory)
        place_m, velocity_mps = memory.position_m.double(), memory.velocity_mps.double()
        log_spread = place_m.var(dim=2).sum(dim=1).log() / 2
        beliefs.append(torch.cat([place_m.mean(dim=2), velocity_mps.mean(dim=2), log_spread[:, None]], dim=1))
    return torch.stack(beliefs, dim=1).numpy()


@pytest.mark.parametrize("chase", [0, 1])
def test_with_a_narrow_kernel_it_is_stonesoup_s_filter(monkeypatch, chase):
    """Place, velocity and spread, after each decision. The Monte-Carlo error is that of the two means: what filters
    with random numbers of their own differ by, over the root of how many there are.
    """
    monkeypatch.setattr(moving_particle, "KERNEL_WIDTH", NARROW_KERNEL)
    controller, environment = MovingParticleController(SCENARIO), Environment(SCENARIO)
    state, memory = environment.reset(chase_keys(1, 1, chase)), controller.begin(1, 1, chase)
    observations = []
    for _ in range(NUM_DECISIONS):
        observations.append(state.observation())
        action, memory = controller.decide(observations[-1], memory)
        state, _ = environment.step(state, action)
    oracle = np.stack([oracle_belief(observations, seed) for seed in range(NUM_ORACLES)])
    found = particle_beliefs(controller, observations)
    difference = found.mean(axis=0) - oracle.mean(axis=0)
    error = np.sqrt(found.var(axis=0, ddof=1) / NUM_FILTERS + oracle.var(axis=0, ddof=1) / NUM_ORACLES)
    spread_m = np.exp(oracle[..., 6].mean(axis=0))[:, None]
    # Velocities spread by about 4 m/s, at first and after four seconds.
    unit = np.concatenate(
        [spread_m.repeat(3, axis=1), np.full((NUM_DECISIONS, 3), 4.0), np.ones_like(spread_m)], axis=1
    )
    np.testing.assert_array_less(np.abs(difference) / unit, STANDARD_ERRORS * error / unit + NARROW_BIAS)
    # Not for want of precision.
    assert np.median(STANDARD_ERRORS * error / unit) < 0.2
