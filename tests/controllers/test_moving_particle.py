"""``particle`` in flight: by hand, and in flights."""

import dataclasses
import functools
import math

import numpy as np
import pytest
import torch

from swarmchase.batch.selection import join_chases, pack, select_chases
from swarmchase.batch.streams import chase_keys
from swarmchase.channel.fading import fading_db
from swarmchase.channel.in_flight import InFlight
from swarmchase.controllers import load_controller, moving_particle
from swarmchase.controllers.condition import Condition
from swarmchase.controllers.moving_particle import (
    CHANGES_PER_S,
    MANOEUVRING,
    NUM_PARTICLES,
    STEADY,
    STILL,
    SURPRISES,
    MovingParticleController,
)
from swarmchase.controllers.particle import ParticleController
from swarmchase.controllers.target_motion import FASTEST_MPS
from swarmchase.evaluation.chases import run_chases
from swarmchase.evaluation.play import play
from swarmchase.formation import tracker_position_m
from swarmchase.observation import Observation
from swarmchase.scenario import load_scenario, paper_scenario
from swarmchase.world.environment import Environment

FLIGHT = load_scenario("flight")
FLEEING = dataclasses.replace(FLIGHT, behaviour="flee", target_speed_mps=5.0)
NAN = math.nan


def at(center_m, samples=10):
    """Six trackers that hover 5 m around this place, [1, sample, 6, 3]."""
    position_m = tracker_position_m(torch.tensor([center_m], dtype=torch.float64), torch.full((1,), 5.0).double())
    return position_m[:, None].expand(1, samples, 6, 3)


def unfaded_dbm(target_m, position_m):
    """23 dBm - 30 dB - 26 log10 d (Eqs. 1-2)."""
    distance_m = np.linalg.norm(np.asarray(position_m) - np.asarray(target_m), axis=-1)
    return 23 - 30 - 26 * np.log10(distance_m.clip(min=1))


def heard(levels_dbm, position_m, time_s=None):
    return Observation(torch.as_tensor(levels_dbm).float().expand(position_m.shape[:-1]), position_m, time_s)


def belief_of(position_m, velocity_mps=(0.0, 0.0, 0.0), mode=STILL, scenario=FLIGHT, time_s=0.0):
    """A controller, and a memory whose particles are here in turn."""
    controller = MovingParticleController(scenario)
    memory = controller.begin(1, 0)
    place = torch.arange(NUM_PARTICLES) % len(position_m)
    velocity = torch.tensor(velocity_mps, dtype=torch.float32)[None, :, None].expand(1, 3, NUM_PARTICLES)
    return controller, dataclasses.replace(
        memory,
        position_m=torch.tensor(position_m, dtype=torch.float32)[place].T[None].contiguous(),
        velocity_mps=velocity.contiguous(),
        mode=torch.full((1, NUM_PARTICLES), mode),
        time_s=torch.tensor([time_s], dtype=torch.float64),
    )


def test_the_name_particle_means_the_filter_for_the_pace():
    assert isinstance(load_controller("particle", FLIGHT), MovingParticleController)
    assert isinstance(load_controller("particle", paper_scenario()), ParticleController)
    assert load_controller("particle", FLIGHT).name == "particle"


# How particles move.


@pytest.mark.parametrize(
    ("mode", "velocity_mps", "seconds", "moved_m", "spread_mps"),
    [
        (STILL, (0, 0, 0), 0.5, (0, 0, 0), (0, 0, 0)),
        # 0.3 m/s2 for half a second, and twice that for four times as long.
        (STEADY, (4, -2, 1), 0.5, (2, -1, 0.5), (0.15, 0.15, 0.06)),
        (STEADY, (4, -2, 1), 2.0, (8, -4, 2), (0.3, 0.3, 0.12)),
        (MANOEUVRING, (4, -2, 1), 0.5, (2, -1, 0.5), (1.5, 1.5, 0.6)),
    ],
)
def test_a_target_that_keeps_its_mode(monkeypatch, mode, velocity_mps, seconds, moved_m, spread_mps):
    monkeypatch.setattr(moving_particle, "CHANGES_PER_S", (0.0, 0.0, 0.0))
    controller, memory = belief_of([(100, 50, 0)], velocity_mps, mode)
    later = controller._predicted(memory, torch.tensor([[seconds]]))
    assert (later.mode == mode).all()
    error_m = 4 * max(spread_mps) * seconds / math.sqrt(NUM_PARTICLES) + 1e-4
    assert (later.position_m - memory.position_m)[0].mean(dim=1).tolist() == pytest.approx(moved_m, abs=error_m)
    assert later.velocity_mps[0].std(dim=1).tolist() == pytest.approx(spread_mps, rel=0.08)


@pytest.mark.parametrize(
    ("mode", "likely", "rare"),
    [(STILL, STEADY, MANOEUVRING), (STEADY, MANOEUVRING, STILL), (MANOEUVRING, STEADY, STILL)],
)
def test_modes_end_at_their_rates(mode, likely, rare):
    controller, memory = belief_of([(100, 50, 0)], (1, 1, 0), mode)
    later = controller._predicted(memory, torch.tensor([[2.0]]))
    ended = 1 - math.exp(-2 * CHANGES_PER_S[mode])
    for following, share in ((mode, 1 - ended), (likely, 0.75 * ended), (rare, 0.25 * ended)):
        error = 4 * math.sqrt(share * (1 - share) / NUM_PARTICLES)
        assert (later.mode == following).double().mean().item() == pytest.approx(share, abs=error)
    assert (later.velocity_mps[0, :, later.mode[0] == STILL] == 0).all()
    flies = later.velocity_mps.square().sum(dim=1) > 0
    assert (flies | (later.mode == STILL)).all()


def test_no_target_leaves_its_altitudes_or_is_faster_than_any():
    """From 5 to 120 m, the swarm's start being at 50 m."""
    controller, memory = belief_of([(100, 50, -45), (0, 0, 70)], (9, 0, 4), MANOEUVRING)
    for _ in range(4):
        memory = controller._predicted(memory, torch.tensor([[1.0]]))
        assert -45 <= memory.position_m[:, 2].min() < memory.position_m[:, 2].max() <= 70
        assert memory.velocity_mps.square().sum(dim=1).max() <= FASTEST_MPS**2 + 1e-3


# What is heard.


@pytest.mark.parametrize("target_m", [(60, 0, 0), (0, -25, 5), (-12, 9, -3), (150, 200, 40), (3, 0, 1)])
def test_the_likelihood_prefers_the_true_place(target_m):
    others_m = [tuple(-np.array(target_m)), tuple(2 * np.array(target_m)), tuple(0.5 * np.array(target_m))]
    controller, memory = belief_of([target_m, *others_m])
    observation = heard(unfaded_dbm(target_m, at((0, 0, 0))), at((0, 0, 0)))
    log_weight, improbable, deaf = controller._weighed(memory, observation, torch.zeros(1, 10).double())
    assert log_weight[0, :4].argmax() == 0
    assert not improbable.item()
    assert not deaf.item()


def test_a_target_that_flies_past_is_heard_where_it_was():
    """10 m/s along x for half a second, 4 m beside a swarm that hovers: a standing one is told from it."""
    age_s = torch.arange(9, -1, -1)[None].double() / 20
    target_m = np.array([[2.5 - 10 * age, 4.0, 0.0] for age in age_s[0].tolist()])[:, None]
    observation = heard(unfaded_dbm(target_m, at((0, 0, 0))[0].numpy()), at((0, 0, 0)))
    left_np = []
    for velocity_mps, place_m in (((10, 0, 0), (2.5, 4, 0)), ((-10, 0, 0), (-2.5, 4, 0)), ((0, 0, 0), (0, 4, 0))):
        controller, memory = belief_of([place_m], velocity_mps, STEADY)
        excess_np = controller._fading_np(memory, observation, age_s, torch.full((1, 6), 10))[0, :, 0]
        left_np.append(excess_np.abs().max().item())
    # What is left of the path loss, in nepers: 0.23 are a decibel.
    assert left_np[0] < 0.04
    assert left_np[1] > 0.2
    assert left_np[2] > 0.2


@pytest.mark.parametrize("sampling_hz", [20.0, 100.0])
@pytest.mark.parametrize(
    ("speed_mps", "most"),
    # At 5 m/s one sample is half a cycle after another: they are correlated negatively, which counts as not at all.
    [(0.0, 1.1), (0.5, 1.1), (3.3, 1.4), (5.0, 1.5), (11.7, 1.25)],
)
def test_the_variance_of_a_mean_power_is_that_of_the_fading_in_flight(sampling_hz, speed_mps, most):
    """1,500 intervals of the simulator's own fading, of which this knows nothing but the scenario."""
    scenario = dataclasses.replace(FLIGHT, sampling_hz=sampling_hz)
    samples = round(0.5 * sampling_hz)
    process = InFlight(scenario)
    time_s = ((torch.arange(samples) + 1).double() / sampling_hz).expand(1500, -1)
    moved_m = torch.full((1500, samples, 6), speed_mps / sampling_hz, dtype=torch.float64)
    gain, _ = process.gain(process.begin(chase_keys(3, 1500)), time_s, moved_m)
    power = (10 ** (fading_db(gain).double() / 10)).mean(dim=2)
    variance = (power.var(dim=0) / power.mean(dim=0).square()).mean().item()
    controller, memory = belief_of([(60, 0, 0)], (0, speed_mps, 0), STEADY, scenario)
    age_s = torch.arange(samples - 1, -1, -1)[None].double() / sampling_hz
    observation = heard(torch.full((6,), -60.0), at((0, 0, 0), samples))
    told = controller._variance(memory, observation, age_s, torch.full((1, 6), samples))
    assert 0.9 * variance < told[0, 0, 0].item() < most * variance
    # And the correlation of two trackers' powers.
    correlation = np.corrcoef(power.T.numpy())[np.triu_indices(6, 1)].mean()
    assert controller._correlation == pytest.approx(correlation, abs=0.06)


def test_missing_samples_do_not_count():
    levels_dbm = unfaded_dbm((60, 0, 0), at((0, 0, 0))[0].numpy())
    with_gaps = torch.tensor(levels_dbm)
    with_gaps[::2, 1] = NAN
    with_gaps[:, 4] = NAN
    controller, memory = belief_of([(60, 0, 0), (70, 0, 0)])
    age_s = torch.arange(9, -1, -1)[None].double() / 20
    number = torch.tensor([[10, 5, 10, 10, 0, 10]])
    excess_np = controller._fading_np(memory, heard(with_gaps, at((0, 0, 0))), age_s, number)
    all_heard_np = controller._fading_np(memory, heard(levels_dbm, at((0, 0, 0))), age_s, torch.full((1, 6), 10))
    kept = [0, 1, 2, 3, 5]
    torch.testing.assert_close(excess_np[:, kept], all_heard_np[:, kept], rtol=0, atol=1e-4)
    log_weight, _, deaf = controller._weighed(memory, heard(with_gaps, at((0, 0, 0))), age_s)
    assert log_weight.isfinite().all()
    assert log_weight[0, 0] > log_weight[0, 1]
    assert not deaf.item()


def test_without_any_sample_the_belief_goes_on_by_itself():
    controller, memory = belief_of([(60, 0, 0)], (0, 4, 0), STEADY)
    action, after = controller.decide(heard(torch.full((6,), NAN), at((0, 0, 0))), memory)
    assert after.condition.tolist() == [Condition.DEAF]
    assert after.position_m.mean(dim=2)[0].tolist() == pytest.approx([60, 2, 0], abs=0.5)
    # Nothing was learnt, so nothing is resampled: no two particles are copies.
    assert action.displacement_m[0].tolist() == pytest.approx([5, 0.17, 0], abs=0.05)
    assert action.spacing_m.tolist() == [5]


def test_it_begins_anew_where_everything_contradicts_it():
    """It is sure of 60 m and hears 3 m."""
    controller, memory = belief_of([(60, 0, 0), (61, 0, 0)])
    observation = heard(unfaded_dbm((3, 0, 0), at((0, 0, 0))[0].numpy()), at((0, 0, 0)))
    conditions = []
    for _ in range(SURPRISES):
        _, memory = controller.decide(observation, memory)
        conditions.append(memory.condition.item())
    assert conditions == [*[Condition.TRACKING] * (SURPRISES - 1), Condition.LOST]
    distance_m = memory.position_m.square().sum(dim=1).sqrt()
    assert distance_m.min() < 2
    assert distance_m.max() > 200
    for _ in range(4):
        _, memory = controller.decide(observation, memory)
    assert memory.condition.tolist() == [Condition.TRACKING]
    assert memory.position_m.mean(dim=2).norm(dim=1).item() < 6


LEVELS_DBM = [NAN, math.inf, -math.inf, 3e38, -400.0, 0.0, -60.0, -61.0, -199.0]


@pytest.mark.parametrize("far_m", [0.0, 1e4, 1e9])
def test_nothing_makes_it_nan(far_m):
    generator = np.random.default_rng(5)
    controller = MovingParticleController(FLIGHT)
    memory = controller.begin(4, 2)
    for step in range(12):
        levels_dbm = torch.tensor(generator.choice(LEVELS_DBM, size=(4, 10, 6)))
        times_s = torch.tensor(generator.choice([NAN, -1e9, 1e9, 0.0, step / 2], size=(4, 10)))
        position_m = at((far_m, -far_m, 0)).expand(4, -1, -1, -1)
        time_s = None if step % 3 == 0 else times_s
        action, memory = controller.decide(Observation(levels_dbm.float(), position_m, time_s), memory)
        assert action.displacement_m.isfinite().all()
        assert (action.displacement_m.norm(dim=1) <= 5 + 1e-6).all()
        assert memory.position_m.isfinite().all()
        assert memory.velocity_mps.isfinite().all()


@pytest.mark.parametrize("changes", [{"spatial_correlation": 1.0}, {"rician_k": 1e12}, {"los_phase": "independent"}])
def test_any_channel_gives_a_belief(changes):
    scenario = dataclasses.replace(FLIGHT, **changes)
    for step in play(scenario, MovingParticleController(scenario), 1, range(2), 2):
        assert step.action.displacement_m.isfinite().all()
        if step.after.movements.max() >= 10:
            break


# Batches.


def test_a_chase_is_the_same_alone_and_in_any_batch():
    controller, environment = MovingParticleController(FLEEING), Environment(FLEEING)

    def flown(numbers, steps=12):
        """The chases with these numbers, in one batch, which is taken apart and put together on the way."""
        states = [environment.reset(chase_keys(1, 1, number)) for number in numbers]
        memories = [controller.begin(1, 1, number) for number in numbers]
        state, memory = functools.reduce(join_chases, states), functools.reduce(join_chases, memories)
        for _ in range(steps):
            action, memory = controller.decide(state.observation(), memory)
            state, _ = environment.step(state, action)
        return memory

    together = flown([3, 0, 2, 1, 5])
    for row, number in enumerate([3, 0, 2, 1, 5]):
        alone, _ = pack(flown([number]), "memory")
        in_batch, _ = pack(select_chases(together, [row]), "memory")
        for name, tensor in alone.items():
            assert torch.equal(tensor, in_batch[name]), name


def test_a_run_is_the_same_for_any_batch_size():
    scenario = dataclasses.replace(FLEEING, max_movements=25)
    one, other = (
        sorted(run_chases(scenario, MovingParticleController(scenario), 1, range(5), size), key=lambda row: row.chase)
        for size in (1, 4)
    )
    assert one == other


# In flight.


@pytest.mark.parametrize(("behaviour", "speed_mps"), [("hover", 0.0), ("waypoints", 5.0), ("flee", 5.0)])
def test_its_95_percent_region_holds_the_target_and_it_gets_there(behaviour, speed_mps):
    """Of 16 flights, from the fifth second on; decisions of one flight are not independent, so the band is wide."""
    scenario = dataclasses.replace(FLIGHT, behaviour=behaviour, target_speed_mps=speed_mps)
    controller = MovingParticleController(scenario)
    inside, reached, memory = [], 0, controller.begin(16, 1)
    state = Environment(scenario).reset(chase_keys(1, 16))
    for number in range(140):
        action, memory = controller.decide(state.observation(), memory)
        left_m = memory.position_m.double() - memory.position_m.double().mean(dim=2, keepdim=True)
        radius_m = left_m.norm(dim=1).quantile(0.95, dim=1)
        off_m = (memory.position_m.double().mean(dim=2) - state.target_position_m).norm(dim=1)
        if number >= 10:
            inside += (off_m <= radius_m).tolist()
        state, outcome = Environment(scenario).step(state, action)
        reached += int(outcome.reached.sum())
        # Nobody needs what is heard after the end.
        under_way = (~outcome.reached).nonzero().flatten().tolist()
        if not under_way:
            break
        state, memory = select_chases(state, under_way), select_chases(memory, under_way)
    assert 0.85 <= np.mean(inside) <= 0.99
    assert reached >= (12 if behaviour == "flee" else 15)


def test_it_explains_itself():
    controller = MovingParticleController(FLIGHT)
    observation = Environment(FLIGHT).reset(chase_keys(1, 1)).observation()
    _, memory = controller.decide(observation, controller.begin(1, 1))
    explanation = controller.explain(observation, memory)
    assert explanation.target_m.shape == (200, 3)
    assert explanation.choice_share.sum(dim=1).tolist() == pytest.approx([1] * 4, abs=1e-5)
    apart_m = explanation.target_m.mean(dim=0) - memory.position_m[0].mean(dim=1)
    assert apart_m.norm() < 0.2 * explanation.target_m.std(dim=0).norm()
