"""The two controllers that do not listen: the oracle's optimality and the random controller's distribution."""

import itertools

import numpy as np
import pytest
import torch

from swarmchase.batch.streams import chase_keys
from swarmchase.controllers.condition import Condition
from swarmchase.controllers.oracle import OracleController
from swarmchase.controllers.random import RandomController
from swarmchase.evaluation.chases import run_chases
from swarmchase.evaluation.play import play
from swarmchase.evaluation.statistics import nearest_rank_percentile
from swarmchase.formation import tracker_position_m
from swarmchase.observation import Observation
from swarmchase.scenario import paper_scenario
from swarmchase.world.environment import Environment
from swarmchase.world.target import draw_start_m


def observation_at(center_m, spacing_m=3.0):
    """A window of silence, heard around each of these centres."""
    centers_m = torch.tensor(center_m, dtype=torch.float64)
    position_m = tracker_position_m(centers_m, torch.full((len(centers_m),), spacing_m, dtype=torch.float64))
    rssi_dbm = torch.full((len(centers_m), 2, 6), float("nan"))
    return Observation(rssi_dbm, position_m[:, None].expand(-1, 2, -1, -1))


@pytest.mark.parametrize(
    ("center_m", "target_m", "displacement_m"),
    [
        ((0, 0, 0), (60, -80, 0), (4, -4, 0)),  # far away: as fast as it goes, on both sides
        ((0, 0, 0), (2.9, -3.1, 1.1), (2, -4, 2)),  # to the nearest of -4, -2, 0, 2, 4
        ((10, 20, -30), (10.9, 20.5, -33.2), (0, 0, -4)),  # the centre counts, not the origin
        ((0, 0, 0), (-0.9, 0.9, 0.1), (0, 0, 0)),  # there
        ((56, -80, 0), (60, -80, 7), (4, 0, 4)),  # an axis that has arrived rests
    ],
)
def test_oracle_takes_the_move_that_leaves_least_on_every_axis(center_m, target_m, displacement_m):
    target_position_m = torch.tensor([target_m], dtype=torch.float64)
    oracle = OracleController(paper_scenario())
    action, memory = oracle.decide(observation_at([center_m]), oracle.told(oracle.begin(1, 0), target_position_m))
    assert action.displacement_m.tolist() == [list(displacement_m)]
    assert action.spacing_m.tolist() == [5]
    assert memory.target_position_m is target_position_m
    assert memory.condition.tolist() == [Condition.TRACKING]


def test_oracle_holds_still_where_nobody_has_told_it():
    oracle = OracleController(paper_scenario())
    target_m = torch.tensor([[60.0, -80, 0], [torch.nan] * 3], dtype=torch.float64)
    untold = oracle.begin(2, seed=8, first_chase=5)
    for memory, displacement_m, condition in (
        (untold, [[0, 0, 0]] * 2, [Condition.DEAF] * 2),
        (oracle.told(untold, target_m), [[4, -4, 0], [0, 0, 0]], [Condition.TRACKING, Condition.DEAF]),
    ):
        action, after = oracle.decide(observation_at([(0, 0, 0)] * 2), memory)
        assert action.displacement_m.tolist() == displacement_m
        assert action.spacing_m.tolist() == [5, 5]
        assert after.condition.tolist() == condition


def test_playing_tells_the_oracle_the_target_of_the_run():
    oracle, told_m = OracleController(paper_scenario()), []
    tell = oracle.told
    oracle.told = lambda memory, target_m, velocity_mps: told_m.append(target_m) or tell(memory, target_m, velocity_mps)
    next(play(paper_scenario(), oracle, 8, range(5, 8), 3))
    state = Environment(paper_scenario()).reset(chase_keys(8, 3, 5))
    assert torch.equal(told_m[0], state.target_position_m)


def fewest_movements(target_m, success_radius_m):
    """By trying every place that every sequence of movements can lead to."""
    places_m = {(0.0, 0.0, 0.0)}
    for movements in itertools.count(1):
        places_m = {
            tuple(np.add(place_m, displacement_m))
            for place_m in places_m
            for displacement_m in itertools.product([-4.0, -2.0, 0.0, 2.0, 4.0], repeat=3)
        }
        if min(np.linalg.norm(np.subtract(place_m, target_m)) for place_m in places_m) <= success_radius_m:
            return movements
    raise AssertionError


@pytest.mark.parametrize("start_distance_m", [1.5, 5.9, 6.5, 8.0])
def test_no_sequence_of_movements_is_sooner_than_the_oracle(start_distance_m):
    scenario = paper_scenario(start_distance_m=start_distance_m, window_samples=1)
    results = sorted(run_chases(scenario, OracleController(scenario), 3, range(6)), key=lambda result: result.chase)
    targets_m = draw_start_m(scenario, chase_keys(3, 6)).tolist()
    needed = [fewest_movements(target_m, scenario.success_radius_m) for target_m in targets_m]
    assert [result.movements for result in results] == needed


def test_oracle_needs_as_many_movements_as_the_paper_s_geometry_says():
    """From 100 m: 20.8 on average, median 21, 90th percentile 24; at most 25, since an axis takes (100 - 2) / 4."""
    scenario = paper_scenario(window_samples=1)  # the oracle does not listen
    results = list(run_chases(scenario, OracleController(scenario), 0, range(3000), batch_size=1000))
    movements = [result.movements for result in results]
    assert all(result.reached for result in results)
    assert np.mean(movements) == pytest.approx(20.8, abs=0.15)
    assert nearest_rank_percentile(movements, 50) == 21
    assert nearest_rank_percentile(movements, 90) == 24
    assert max(movements) <= 25


def drawn_actions(controller, memory, num_movements):
    """[movement, chase, (spacing, x, y, z)] of a controller that hears silence at the origin."""
    actions = []
    for _ in range(num_movements):
        action, memory = controller.decide(observation_at([(0, 0, 0)]), memory)
        actions.append(torch.cat([action.spacing_m[:, None], action.displacement_m], dim=1))
    return torch.stack(actions)


def test_random_chooses_uniformly_and_independently():
    controller = RandomController(paper_scenario())
    actions = drawn_actions(controller, controller.begin(500, seed=1), 240).reshape(-1, 4)
    assert len(actions) == 120_000
    action_sets_m = [[1, 2, 3, 4, 5]] + 3 * [[-4, -2, 0, 2, 4]]
    chosen = [
        torch.stack([actions[:, column] == choice_m for choice_m in choices_m]).double()
        for column, choices_m in enumerate(action_sets_m)
    ]
    for one in chosen:
        assert one.mean(dim=1).tolist() == pytest.approx([0.2] * 5, abs=0.006)
    for one, other in itertools.combinations(chosen, 2):
        assert (one @ other.T / len(actions) - 0.04).abs().max() < 0.003


def test_random_draws_of_a_chase_are_its_own():
    controller = RandomController(paper_scenario())
    batch = drawn_actions(controller, controller.begin(5, seed=2, first_chase=10), 8)
    again = drawn_actions(controller, controller.begin(5, seed=2, first_chase=10), 8)
    alone = drawn_actions(controller, controller.begin(1, seed=2, first_chase=13), 8)
    other_run = drawn_actions(controller, controller.begin(5, seed=3, first_chase=10), 8)
    assert torch.equal(batch, again)
    assert torch.equal(batch[:, 3:4], alone)
    assert not torch.equal(batch[:, 0], batch[:, 1])
    assert not torch.equal(batch, other_run)
