"""Where the trackers are and what a choice does, against hand-drawn situations (Sections II.A and III.A)."""

import itertools

import pytest
import torch

from swarmchase.formation import Action, action_from_choice, tracker_position_m
from swarmchase.scenario import paper_scenario


def test_trackers_sit_at_plus_and_minus_of_every_axis_around_their_own_centre():
    center_m = torch.tensor([[0.0, 0.0, 0.0], [10.0, -20.0, 30.0]], dtype=torch.float64)
    position_m = tracker_position_m(center_m, torch.tensor([1.0, 5.0], dtype=torch.float64))
    assert position_m.tolist() == [
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]],
        [[15, -20, 30], [5, -20, 30], [10, -15, 30], [10, -25, 30], [10, -20, 35], [10, -20, 25]],
    ]


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
