"""Where the trackers are and what a choice does, against hand-drawn situations (Sections II.A and III.A)."""

import dataclasses
import itertools
import math

import pytest
import torch

from swarmchase.formation import Action, action_from_choice, fastest_turn_rad_per_s, tracker_position_m
from swarmchase.scenario import load_scenario, paper_scenario


def test_trackers_sit_at_plus_and_minus_of_every_axis_around_their_own_centre():
    center_m = torch.tensor([[0.0, 0.0, 0.0], [10.0, -20.0, 30.0]], dtype=torch.float64)
    position_m = tracker_position_m(center_m, torch.tensor([1.0, 5.0], dtype=torch.float64))
    assert position_m.tolist() == [
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]],
        [[15, -20, 30], [5, -20, 30], [10, -15, 30], [10, -25, 30], [10, -20, 35], [10, -20, 25]],
    ]


@pytest.mark.parametrize(
    ("turned_rad", "first_m", "third_m"),
    [
        (0.0, (12, 0, 0), (10, 2, 0)),
        (math.pi / 2, (10, 2, 0), (8, 0, 0)),
        (-math.pi / 4, (10 + math.sqrt(2), -math.sqrt(2), 0), (10 + math.sqrt(2), math.sqrt(2), 0)),
    ],
)
def test_a_cross_turns_about_its_vertical_from_x_towards_y(turned_rad, first_m, third_m):
    center_m, spacing_m = torch.tensor([[10.0, 0.0, 0.0]]).double(), torch.tensor([2.0]).double()
    position_m = tracker_position_m(center_m, spacing_m, torch.tensor([turned_rad], dtype=torch.float64))[0]
    assert position_m[0].tolist() == pytest.approx(first_m, abs=1e-12)
    assert position_m[2].tolist() == pytest.approx(third_m, abs=1e-12)
    assert position_m.mean(dim=0).tolist() == pytest.approx([10, 0, 0], abs=1e-12)
    assert position_m[4:].tolist() == [[10, 0, 2], [10, 0, -2]]


def test_a_cross_that_has_not_turned_is_where_it_was_to_the_last_bit():
    center_m, spacing_m = torch.rand(4, 3, generator=torch.Generator().manual_seed(1)).double(), torch.ones(4).double()
    unturned = tracker_position_m(center_m, spacing_m, torch.zeros(4).double())
    assert torch.equal(unturned, tracker_position_m(center_m, spacing_m))


@pytest.mark.parametrize(
    ("acceleration_mps2", "rad_per_s"),
    # 5 m at 1 rad/s: 5 m/s2. Without a limit of it, 10 m/s: 2 rad/s. With 500 m/s2 still that.
    [(5.0, 1.0), (None, 2.0), (500.0, 2.0)],
)
def test_how_fast_a_cross_may_turn(acceleration_mps2, rad_per_s):
    scenario = dataclasses.replace(load_scenario("flight"), tracker_acceleration_mps2=acceleration_mps2)
    assert fastest_turn_rad_per_s(scenario) == pytest.approx(rad_per_s)


@pytest.mark.parametrize(
    ("choice", "spacing_m", "displacement_m"),
    [
        ([0, 0, 0, 0], 1, [-4, -4, -4]),
        ([4, 4, 4, 4], 5, [4, 4, 4]),
        ([2, 2, 2, 2], 3, [0, 0, 0]),
        ([1, 3, 2, 0], 2, [2, 0, -4]),  # each choice goes to its own network: d, x, y, z
    ],
)
def test_choices_mean_the_paper_s_action_sets_in_the_order_d_x_y_z(choice, spacing_m, displacement_m):
    action = action_from_choice(paper_scenario(), torch.tensor([choice]))
    assert action.spacing_m.tolist() == [spacing_m]
    assert action.displacement_m.tolist() == [displacement_m]


def test_all_625_choices_are_different_actions_of_the_paper_s_sets():
    choices = torch.tensor(list(itertools.product(range(5), repeat=4)))
    action = action_from_choice(paper_scenario(), choices)
    rows = torch.cat([action.spacing_m[:, None], action.displacement_m], dim=1).tolist()
    one_axis_m = [-4, -2, 0, 2, 4]
    assert sorted(map(tuple, rows)) == list(itertools.product([1, 2, 3, 4, 5], one_axis_m, one_axis_m, one_axis_m))


def test_other_action_sets_come_from_the_scenario():
    scenario = paper_scenario(spacing_choices_m=[0.5, 7.0], displacement_choices_m=[-1.0, 0.0, 3.0])
    action = action_from_choice(scenario, torch.tensor([[1, 0, 1, 2]]))
    assert isinstance(action, Action)
    assert action.spacing_m.tolist() == [7]
    assert action.displacement_m.tolist() == [[-1, 0, 3]]
