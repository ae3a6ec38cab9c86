"""``adaptive`` in flight: its parts by hand and against the same once more by other means, bad input, and flights."""

import dataclasses
import functools
import math

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from swarmchase.batch.selection import join_chases, pack, select_chases
from swarmchase.batch.streams import ChaseStreams, chase_keys
from swarmchase.channel.fading import fading_db
from swarmchase.channel.in_flight import InFlight
from swarmchase.controllers import load_controller
from swarmchase.controllers.adaptive_in_flight import NUM_PARTICLES, AdaptiveInFlightController
from swarmchase.controllers.condition import Condition
from swarmchase.controllers.level_residuals import LevelResiduals
from swarmchase.controllers.receiver_models import ReceiverModel, ReceiverModels
from swarmchase.controllers.resampling import FEWEST_SHARE, is_copy, parents, share_to_take
from swarmchase.controllers.shadow_models import ShadowModel, ShadowModels
from swarmchase.controllers.stuck_receivers import STUCK_AFTER, ReceiverLevels
from swarmchase.controllers.target_motion import (
    CHANGES_PER_S,
    FLEEING,
    MANOEUVRING,
    NEXT_SHARE,
    STEADY,
    STILL,
    TargetMotion,
)
from swarmchase.controllers.told_scenario import UNTOLD, as_told
from swarmchase.formation import tracker_position_m
from swarmchase.observation import Observation
from swarmchase.scenario import load_scenario
from swarmchase.world.environment import Environment

FLIGHT = load_scenario("flight")
FIELD = dataclasses.replace(load_scenario("field"), behaviour="waypoints")
NAN = math.nan


def at(center_m, samples=10, spacing_m=5.0):
    """Six trackers that hover around this place, [1, sample, 6, 3]."""
    center_m = torch.tensor([center_m], dtype=torch.float64)
    position_m = tracker_position_m(center_m, torch.full((1,), spacing_m).double())
    return position_m[:, None].expand(1, samples, 6, 3)


def unfaded_dbm(target_m, position_m):
    """23 dBm - 30 dB - 26 log10 d (Eqs. 1-2)."""
    distance_m = np.linalg.norm(np.asarray(position_m) - np.asarray(target_m), axis=-1)
    return 23 - 30 - 26 * np.log10(distance_m.clip(min=1))


def heard(levels_dbm, position_m, time_s=None):
    return Observation(torch.as_tensor(levels_dbm).float().expand(position_m.shape[:-1]), position_m, time_s)


def radius_m(memory):
    """Of the region that holds 95 % of the particles, around their mean."""
    left_m = memory.position_m.double() - memory.position_m.double().mean(dim=2, keepdim=True)
    return left_m.norm(dim=1).quantile(0.95, dim=1)


# What it is told.


def test_it_is_told_the_same_of_every_world_that_departs_from_flight_by_errors_alone():
    rough = dataclasses.replace(load_scenario("rough"), path_loss_exponent=2.6)
    assert as_told(FIELD) == as_told(rough) == as_told(FLIGHT)
    assert as_told(dataclasses.replace(FLIGHT, rician_k=1.0)) != as_told(FLIGHT)
    # Whatever a scenario may have that the paper's world has not is told, or stands in the list.
    told = {"pace", "decision_s", "tracker_acceleration_mps2", "carrier_hz", "farthest_start_m"}
    told |= {"highest_elevation_deg", "start_altitude_m", "lowest_altitude_m", "highest_altitude_m"}
    departs = {field.name for field in dataclasses.fields(FLIGHT) if "departs_from_paper" in field.metadata}
    assert departs - told <= set(UNTOLD)


def test_in_field_and_in_flight_it_decides_alike():
    told_flight, told_field = load_controller("adaptive", FLIGHT), load_controller("adaptive", FIELD)
    environment = Environment(FIELD)
    state, one, other = environment.reset(chase_keys(1, 2)), told_flight.begin(2, 1), told_field.begin(2, 1)
    for _ in range(4):
        action, one = told_flight.decide(state.observation(), one)
        same, other = told_field.decide(state.observation(), other)
        assert torch.equal(action.displacement_m, same.displacement_m)
        assert torch.equal(one.position_m, other.position_m)
        state, _ = environment.step(state, action)


# How targets move on.


@pytest.mark.parametrize("mode", [STILL, STEADY, MANOEUVRING, FLEEING])
def test_modes_end_at_their_rates(mode):
    streams = ChaseStreams.of(chase_keys(3, 1), "policy")
    number = 20_000
    place_m, velocity_mps = torch.ones(1, 3, number) * 50, torch.ones(1, 3, number)
    center_m, modes = torch.zeros(1, 3).double(), torch.full((1, number), mode)
    _, after_mps, after = TargetMotion(FLIGHT).moved(
        place_m, velocity_mps, modes, center_m, torch.tensor([2.0]).double(), streams
    )
    ended = 1 - math.exp(-2 * CHANGES_PER_S[mode])
    for following in range(4):
        share = 1 - ended if following == mode else ended * NEXT_SHARE[mode][following]
        assert (after == following).double().mean().item() == pytest.approx(share, abs=0.012)
    assert (after_mps[:, :, after[0] == STILL] == 0).all()


def test_one_that_flees_turns_away_from_the_swarm_and_keeps_its_speed():
    streams = ChaseStreams.of(chase_keys(3, 1), "policy")
    place_m = torch.tensor([60.0, 80.0, 0.0])[None, :, None].repeat(1, 1, 2000)
    velocity_mps = torch.tensor([-5.0, 0.0, 0.0])[None, :, None].repeat(1, 1, 2000)
    mode = torch.full((1, 2000), FLEEING)
    center_m = torch.zeros(1, 3).double()
    _, after_mps, after = TargetMotion(FLIGHT).moved(
        place_m, velocity_mps, mode, center_m, torch.tensor([0.5]).double(), streams
    )
    fled_mps = after_mps[0][:, after[0] == FLEEING].mean(dim=1)
    assert fled_mps.tolist() == pytest.approx([3, 4, 0], abs=0.05)


# What is heard.


def test_nothing_is_left_at_the_true_place_of_one_that_flies_past():
    """10 m/s along x for half a second, 4 m beside a swarm that hovers, and an exponent of 3 that nobody told."""
    age_s = torch.arange(9, -1, -1)[None].double() / 20
    target_m = np.array([[2.5 - 10 * age, 4.0, 0.0] for age in age_s[0].tolist()])[:, None]
    distance_m = np.linalg.norm(at((0, 0, 0))[0].numpy() - target_m, axis=-1).clip(min=1)
    levels_dbm = torch.tensor(-7 - 30 * np.log10(distance_m))
    levels_dbm[:, 4] = NAN
    levels_dbm[::2, 1] = NAN
    place_m = torch.tensor([[2.5, 4.0, 0.0], [0.0, 4.0, 0.0], [2.5, 4.0, 0.0]]).T[None]
    velocity_mps = torch.tensor([[10.0, 0, 0], [0, 0, 0], [10.0, 0, 0]]).T[None]
    left_db = LevelResiduals(FLIGHT).residual_db(
        heard(levels_dbm, at((0, 0, 0))), place_m, velocity_mps, torch.tensor([[3.0, 3.0, 2.6]]), age_s
    )[0]
    # Five of ten samples stand for the whole interval at tracker 1.
    assert left_db[:, 0].abs().max() < 0.5
    assert left_db[:, 1].abs().max() > 2
    assert left_db[:, 2].abs().max() > 1
    assert left_db[4].tolist() == [0, 0, 0]


@pytest.mark.parametrize(("speed_mps", "most"), [(0.5, 1.2), (3.3, 1.35), (11.7, 1.25)])
@pytest.mark.parametrize("missing", [0, 5])
def test_the_noise_is_that_of_the_fading_in_flight(speed_mps, most, missing):
    """1,500 intervals of the simulator's own fading: bias, variance and what two trackers have in common, in dB."""
    process = InFlight(FLIGHT)
    time_s = ((torch.arange(10) + 1).double() / 20).expand(1500, -1)
    moved_m = torch.full((1500, 10, 6), speed_mps / 20, dtype=torch.float64)
    gain, _ = process.gain(process.begin(chase_keys(3, 1500)), time_s, moved_m)
    power = 10 ** (fading_db(gain).double() / 10)
    level_db = 10 * torch.log10(power[:, :, missing:].mean(dim=2))
    levels_dbm = torch.full((10, 6), -60.0)
    levels_dbm[:missing] = NAN
    velocity_mps = torch.tensor([0.0, speed_mps, 0.0])[None, :, None].repeat(1, 1, 5)
    age_s = torch.arange(9, -1, -1)[None].double() / 20
    far_m = torch.full((1, 3, 5), 500.0)
    noise = LevelResiduals(FLIGHT).noise(heard(levels_dbm, at((0, 0, 0))), far_m, velocity_mps, age_s)
    covariance_db2 = torch.cov(level_db.T)
    own = covariance_db2.diagonal().mean()
    common = (covariance_db2.sum() - covariance_db2.trace()) / 30
    told_own = noise.covariance_db2[0].diagonal().mean()
    told_common = (noise.covariance_db2[0].sum() - noise.covariance_db2[0].trace()) / 30
    assert 0.9 * own < told_own < most * own + 0.09
    assert told_common == pytest.approx(common.item(), rel=0.35)
    assert noise.bias_db.mean().item() == pytest.approx(level_db.mean().item(), abs=0.12)


def test_a_deaf_tracker_says_nothing():
    levels_dbm = torch.full((10, 6), -60.0)
    levels_dbm[:, 2] = NAN
    some_m = torch.full((1, 3, 5), 100.0)
    noise = LevelResiduals(FLIGHT).noise(
        heard(levels_dbm, at((0, 0, 0))), some_m, some_m / 20, torch.arange(9, -1, -1)[None].double() / 20
    )
    precision = torch.linalg.inv(noise.covariance_db2[0])
    assert precision[2].abs().max() < 1e-6
    assert noise.bias_db[0, 2] == 0


# Power, offsets and shadowing, against one Gaussian over all that was heard.

NOISE_DB2 = 0.8 * (0.5 * torch.eye(6, dtype=torch.float64) + 0.5)


def residuals_db(intervals, particles=3):
    return 3 * torch.randn(intervals, 1, 6, particles, generator=torch.Generator().manual_seed(4))


def test_the_evidence_for_constant_errors_is_that_of_one_gaussian():
    models = ReceiverModels(
        (ReceiverModel("a", 0.5, 2.0, (1.0,) * 6), ReceiverModel("b", 0.5, 7.0, (2.0, 20.0, 2.0, 2.0, 2.0, 2.0)))
    )
    inverse = torch.linalg.inv(NOISE_DB2)
    all_db = residuals_db(3)
    sums = sum(inverse.float() @ one_db for one_db in all_db)
    found = models.log_evidence(3 * inverse[None], sums)[0]
    for number, model in enumerate(models.models):
        prior_db2 = model.power_db**2 + np.diag(np.square(model.offset_db))
        together_db2 = np.kron(np.ones((3, 3)), prior_db2) + np.kron(np.eye(3), NOISE_DB2.numpy())
        for particle in range(3):
            value_db = all_db[:, 0, :, particle].flatten().double().numpy()
            alone = multivariate_normal(np.zeros(18), np.kron(np.eye(3), NOISE_DB2.numpy())).logpdf(value_db)
            together = multivariate_normal(np.zeros(18), together_db2).logpdf(value_db)
            assert found[number, particle].item() == pytest.approx(together - alone + math.log(0.5), abs=2e-3)


def test_the_estimates_of_constant_errors_are_those_of_one_gaussian():
    """Six levels that are 8 dB too high, one of them 3 more."""
    models = ReceiverModels((ReceiverModel("a", 1.0, 7.0, (2.0,) * 6),))
    level_db = torch.tensor([11.0, 8, 8, 8, 8, 8]).double()
    inverse = torch.linalg.inv(NOISE_DB2)
    sums = (inverse @ level_db)[None, :, None].float().repeat(1, 1, 4)
    power_db, offset_db = models.estimates(inverse[None], sums, torch.ones(1, 1, 4).double())
    gain = np.linalg.inv(49 + 4 * np.eye(6) + NOISE_DB2.numpy())
    assert power_db.item() == pytest.approx(49 * (gain @ level_db.numpy()).sum(), abs=1e-3)
    assert offset_db[0].tolist() == pytest.approx(4 * gain @ level_db.numpy(), abs=1e-3)


def test_the_filter_of_shadowing_is_one_gaussian_over_all_that_was_heard():
    """Three intervals, 4 and 7 m flown between them: its densities are those of the levels given the earlier ones."""
    models = ShadowModels(5.0, (ShadowModel("a", 0.1, 5.0, 10.0),))
    trackers_m = at((0, 0, 0))[:, 0]
    all_db = residuals_db(3)
    mean_db, covariance_db2 = torch.zeros(1, 1, 12, 3), models.start_db2[None]
    found = []
    for moved_m, one_db in zip((1e9, 4.0, 7.0), all_db, strict=True):
        mean_db, covariance_db2, log_density = models.updated(
            mean_db, covariance_db2, torch.tensor([moved_m]).double(), trackers_m, one_db, NOISE_DB2[None]
        )
        found.append(log_density[0, 0])
    apart_m = torch.cdist(trackers_m[0], trackers_m[0]).numpy()
    error_db2 = 25 * (0.5 + 0.5 * np.exp(-apart_m / 10))
    constants_db2 = 49 + 4 * np.eye(6)
    kept = np.exp(-np.abs(np.subtract.outer([0, 4, 11], [0, 4, 11])) / 10)
    together_db2 = (
        np.kron(np.ones((3, 3)), constants_db2) + np.kron(kept, error_db2) + np.kron(np.eye(3), NOISE_DB2.numpy())
    )
    for particle in range(3):
        value_db = all_db[:, 0, :, particle].flatten().double().numpy()
        log_density = multivariate_normal(np.zeros(18), together_db2).logpdf(value_db) + 9 * math.log(2 * math.pi)
        assert sum(found)[particle].item() == pytest.approx(log_density, abs=2e-3)


def test_a_cross_that_turns_hears_the_field_that_it_has_heard():
    """At once what trackers hear is as likely as in the whole field; half a turn later opposite trackers have swapped,
    and what each has heard the other hears again.
    """
    models = ShadowModels(5.0, (ShadowModel("a", 0.1, 5.0, 10.0),))
    center_m, spacing_m = torch.zeros(1, 3).double(), torch.full((1,), 5.0).double()
    one_db = residuals_db(1)[0]
    for turned_rad in (0.3, math.pi / 4):
        trackers_m = tracker_position_m(center_m, spacing_m, torch.tensor([turned_rad]).double())
        mean_db, covariance_db2, log_density = models.updated(
            torch.zeros(1, 1, 12, 3),
            models.start_db2[None],
            torch.zeros(1).double(),
            trackers_m,
            one_db,
            NOISE_DB2[None],
        )
        error_db2 = 25 * (0.5 + 0.5 * np.exp(-torch.cdist(trackers_m[0], trackers_m[0]).numpy() / 10))
        law = multivariate_normal(np.zeros(6), 49 + 4 * np.eye(6) + error_db2 + NOISE_DB2.numpy())
        found = law.logpdf(one_db[0].T.double().numpy()) + 3 * math.log(2 * math.pi)
        np.testing.assert_allclose(log_density[0, 0], found, atol=2e-3)
    swapped = [1, 0, 3, 2, 4, 5]
    after_half = []
    for heard_db in (one_db, one_db[:, swapped]):
        mean_db, covariance_db2 = torch.zeros(1, 1, 12, 3), models.start_db2[None]
        for turned_rad, now_db in ((0.0, one_db), (math.pi, heard_db)):
            trackers_m = tracker_position_m(center_m, spacing_m, torch.tensor([turned_rad]).double())
            mean_db, covariance_db2, log_density = models.updated(
                mean_db, covariance_db2, torch.zeros(1).double(), trackers_m, now_db, NOISE_DB2[None]
            )
        after_half.append(log_density[0, 0])
    assert (after_half[1] > after_half[0]).all()


# Weights.


@pytest.mark.parametrize(
    ("log_weight", "share"),
    [
        ([0.0] * 100, 1.0),
        ([0.0] * 50 + [-1e4] * 50, 1.0),
        # One of 100 is e^d times as likely as each other: at d a with (e^da + 99)^2 / (e^2da + 99) = 15, e^da = 32.45.
        ([50.0] + [0.0] * 99, math.log(32.45) / 50),
        # Where even the least share leaves too few, it is the least.
        ([1e6] + [0.0] * 99, 0.01),
    ],
)
def test_so_much_of_an_interval_counts(log_weight, share):
    assert FEWEST_SHARE == 0.15
    found = share_to_take(torch.tensor([log_weight, [0.0] * 100]))
    assert found[0].item() == pytest.approx(share, rel=0.03)
    assert found[1].item() == 1


def test_as_many_copies_as_the_weights_say():
    weight = torch.tensor([[0.5, 0.0, 0.25, 0.125, 0.125, 0.0, 0.0, 0.0]])
    parent = parents(weight.log(), ChaseStreams.of(chase_keys(1, 1), "policy"))
    assert parent[0].tolist() == [0, 0, 0, 0, 2, 2, 3, 4]
    assert is_copy(parent)[0].tolist() == [False, True, True, True, False, True, False, False]


# Stuck receivers.


@pytest.mark.parametrize(
    ("levels_dbm", "flown_m", "stuck"),
    [
        ([-60.0] * 10, 2.0, True),
        ([-60.0, NAN] * 5, 2.0, True),
        # Who hovers may well hear the same for a while.
        ([-60.0] * 10, 0.0, False),
        ([-60.0] * 9 + [-61.0], 2.0, False),
        ([NAN] * 10, 2.0, False),
    ],
)
def test_a_receiver_is_stuck_whose_level_stays_while_it_flies(levels_dbm, flown_m, stuck):
    rssi_dbm = torch.full((1, 10, 6), -70.0) + torch.arange(10)[:, None]
    rssi_dbm[0, :, 3] = torch.tensor(levels_dbm)
    position_m = at((0, 0, 0)) + torch.linspace(0, flown_m, 10)[:, None, None].double()
    levels = ReceiverLevels.unheard(1)
    for number in range(STUCK_AFTER):
        assert not levels.stuck.any(), number
        levels = levels.after(Observation(rssi_dbm, position_m))
    assert levels.stuck.tolist() == [[False, False, False, stuck, False, False]]


def test_a_receiver_whose_level_moves_again_is_not_stuck():
    position_m = at((0, 0, 0)) + torch.linspace(0, 3, 10)[:, None, None].double()
    levels = ReceiverLevels(torch.full((1, 6), -60.0), torch.full((1, 6), STUCK_AFTER))
    unheard = levels.after(heard(torch.full((6,), NAN), position_m))
    assert unheard.stuck.all()
    assert not unheard.after(heard(torch.linspace(-60, -50, 10)[:, None], position_m)).stuck.any()


# Bad input.


def flown(scenario, decisions, change=None, seed=1, chases=1):
    """The controller and its memory after so many decisions, and what is heard next; what was heard is changed."""
    controller, environment = AdaptiveInFlightController(scenario), Environment(scenario)
    state, memory = environment.reset(chase_keys(seed, chases)), controller.begin(chases, seed)
    for _ in range(decisions):
        observation = state.observation() if change is None else change(state.observation())
        action, memory = controller.decide(observation, memory)
        state, _ = environment.step(state, action)
    return controller, memory, state.observation()


def test_what_was_sure_widens_while_nothing_is_heard_for_a_minute():
    controller, memory, observation = flown(FLIGHT, 30)
    before_m = radius_m(memory).item()
    silent = dataclasses.replace(observation, rssi_dbm=torch.full_like(observation.rssi_dbm, NAN))
    for second in range(60):
        silent = dataclasses.replace(silent, time_s=observation.time_s + 1 + second)
        action, memory = controller.decide(silent, memory)
        assert memory.condition.tolist() == [Condition.DEAF]
        assert action.displacement_m.isfinite().all()
    assert radius_m(memory).item() > before_m + 60


def test_a_jump_in_time_of_a_minute_is_as_wide():
    controller, memory, observation = flown(FLIGHT, 30)
    before_m = radius_m(memory).item()
    later = dataclasses.replace(
        observation, time_s=observation.time_s + 1e6, rssi_dbm=torch.full_like(observation.rssi_dbm, NAN)
    )
    _, memory = controller.decide(later, memory)
    assert radius_m(memory).item() > before_m + 60


def at_one_place(observation):
    center_m = observation.tracker_position_m.mean(dim=2, keepdim=True)
    return dataclasses.replace(observation, tracker_position_m=center_m.expand_as(observation.tracker_position_m))


def random_levels(observation):
    """Six receivers that hear something else, each sample of its own."""
    drawn = torch.rand(
        observation.rssi_dbm.shape, generator=torch.Generator().manual_seed(int(observation.time_s[0, -1] * 2))
    )
    return dataclasses.replace(observation, rssi_dbm=-90 + 40 * drawn)


@pytest.mark.parametrize("change", [at_one_place, random_levels])
def test_it_is_not_sure_of_what_it_cannot_know(change):
    _, memory, _ = flown(FLIGHT, 40, change)
    assert memory.position_m.isfinite().all()
    assert radius_m(memory).item() > 20


LEVELS_DBM = [NAN, math.inf, -math.inf, 3e38, -400.0, 0.0, -60.0, -61.0, -199.0]


@pytest.mark.parametrize("far_m", [0.0, 1e4, 1e9])
def test_nothing_makes_it_nan(far_m):
    generator = np.random.default_rng(5)
    controller = AdaptiveInFlightController(FLIGHT)
    memory = controller.begin(4, 2)
    for step in range(12):
        levels_dbm = torch.tensor(generator.choice(LEVELS_DBM, size=(4, 10, 6)))
        times_s = torch.tensor(generator.choice([NAN, -1e9, 1e9, 0.0, step / 2], size=(4, 10)))
        position_m = at((far_m, -far_m, 0)).expand(4, -1, -1, -1)
        time_s = None if step % 3 == 0 else times_s
        action, memory = controller.decide(Observation(levels_dbm.float(), position_m, time_s), memory)
        assert action.displacement_m.isfinite().all()
        assert (action.displacement_m.norm(dim=1) <= 5 + 1e-6).all()
        tensors, _ = pack(memory, "memory")
        for name, tensor in tensors.items():
            if name not in ("memory.time_s", "memory.receivers.level_dbm"):
                assert tensor.isfinite().all(), name
        belief, _ = pack(controller.belief(memory), "belief")
        found, _ = pack(controller.findings(memory), "found")
        for name, tensor in (belief | found).items():
            assert tensor.isfinite().all(), name


@pytest.mark.parametrize(
    "changes",
    [{"spatial_correlation": 1.0}, {"rician_k": 1e12}, {"los_phase": "independent"}, {"wrong_trackers": 6}],
)
def test_any_channel_gives_a_belief(changes):
    _, memory, _ = flown(dataclasses.replace(FLIGHT, **changes), 8, chases=2)
    assert memory.position_m.isfinite().all()


# Batches.


def test_a_chase_is_the_same_alone_and_in_any_batch():
    controller, environment = AdaptiveInFlightController(FIELD), Environment(FIELD)

    def after(numbers, steps=10):
        """The chases with these numbers, in one batch."""
        state = functools.reduce(join_chases, [environment.reset(chase_keys(1, 1, number)) for number in numbers])
        memory = functools.reduce(join_chases, [controller.begin(1, 1, number) for number in numbers])
        for _ in range(steps):
            action, memory = controller.decide(state.observation(), memory)
            state, _ = environment.step(state, action)
        return memory

    together = after([3, 0, 2, 1])
    for row, number in enumerate([3, 0, 2]):
        alone, _ = pack(after([number]), "memory")
        in_batch, _ = pack(select_chases(together, [row]), "memory")
        for name, tensor in alone.items():
            assert torch.equal(tensor.nan_to_num(), in_batch[name].nan_to_num()), name


# In flight.


def test_its_95_percent_region_holds_the_target_and_it_gets_there():
    """Of 8 flights; decisions of one flight are not independent, so the band is wide."""
    controller, environment = AdaptiveInFlightController(FIELD), Environment(FIELD)
    inside, reached, memory = [], 0, controller.begin(8, 1)
    state, running = environment.reset(chase_keys(1, 8)), torch.ones(8, dtype=torch.bool)
    for _ in range(140):
        action, memory = controller.decide(state.observation(), memory)
        belief = controller.belief(memory)
        inside += belief.holds(state.target_position_m)[running].tolist()
        state, outcome = environment.step(state, action)
        reached += int((outcome.reached & running).sum())
        running &= ~outcome.reached
        if not running.any():
            break
    assert 0.8 <= np.mean(inside) <= 0.995
    assert reached >= 7


def test_it_finds_out_the_power_and_which_receiver_is_wrong():
    """Where it knows the place: power 8 dB up, receiver 2 20 dB too high, receiver 5 stuck."""
    controller = AdaptiveInFlightController(FLIGHT)
    memory = controller.begin(1, 1)
    target_m = torch.tensor([120.0, -40.0, 5.0])
    memory = dataclasses.replace(
        memory,
        position_m=target_m[None, :, None].repeat(1, 1, NUM_PARTICLES),
        velocity_mps=torch.zeros(1, 3, NUM_PARTICLES),
        mode=torch.zeros(1, NUM_PARTICLES, dtype=torch.int64),
        exponent=torch.full((1, NUM_PARTICLES), 2.6),
    )
    generator = torch.Generator().manual_seed(3)
    for number in range(20):
        way_m = torch.linspace(0, 5, 10)[:, None, None].double() * torch.tensor([1.0, 0, 0]) + 5 * number
        position_m = at((0, 0, 0)) + way_m
        levels_dbm = torch.tensor(unfaded_dbm(target_m.numpy(), position_m[0].numpy())) + 8
        levels_dbm += 2.5 * torch.randn(10, 6, generator=generator).double()
        levels_dbm[:, 1] += 20
        levels_dbm[:, 4] = -55
        time_s = (number / 2 + torch.arange(1, 11) / 20)[None].double()
        _, memory = controller.decide(heard(levels_dbm, position_m, time_s), memory)
    found = controller.findings(memory)
    assert found.is_wrong.tolist() == [[False, True, False, False, False, False]]
    assert found.power_db.item() == pytest.approx(8, abs=2.5)
    assert found.offset_db[0, 1].item() == pytest.approx(20, abs=3)
    assert found.model_share.sum().item() == pytest.approx(1, abs=1e-3)
    names = controller.model_names
    assert names[found.model_share.argmax()] == "tracker 2 wrong"
    explanation = controller.explain(heard(levels_dbm, position_m), memory)
    assert explanation.target_m.shape == (200, 3)
    assert explanation.choice_share.sum(dim=1).tolist() == pytest.approx([1] * 4, abs=1e-5)
    assert explanation.found is not None
    assert explanation.found.left_out == (None, "wrong", None, None, "stuck", None)
    assert explanation.velocity_mps is not None
    assert explanation.velocity_mps.norm() < 10
