"""When a swarm explores, where to, and when it ends; with a pencil."""

import math

import pytest
import torch

from swarmchase.controllers.belief import GAUSSIAN_REACH, Belief
from swarmchase.controllers.exploration import PATIENCE, WIDE_M, Exploration, explored, no_exploration
from swarmchase.scenario import paper_scenario

GOAL_M = torch.tensor([[20.0, 0.0, 0.0]], dtype=torch.float64)


def belief(radius_m: float) -> Belief:
    variance_m2 = radius_m**2 / GAUSSIAN_REACH * torch.eye(3, dtype=torch.float64)[None]
    return Belief(torch.zeros(1, 3).double(), variance_m2, torch.tensor([GAUSSIAN_REACH]).double())


def after(places_m: list[float], radius_m: float) -> Exploration:
    """Having been at these places on the x axis."""
    exploration = no_exploration(1)
    for place_m in places_m:
        center_m = torch.tensor([[place_m, 0.0, 0.0]], dtype=torch.float64)
        exploration = explored(exploration, center_m, belief(radius_m), GOAL_M)
    return exploration


@pytest.mark.parametrize(
    ("places_m", "radius_m", "explores"),
    [
        ([0.0] * (PATIENCE - 1), 30.0, False),
        ([0.0] * PATIENCE, 30.0, True),
        ([0.0, 2.0, 0.0], 30.0, True),  # to and fro
        ([0.0] * PATIENCE, WIDE_M - 0.1, False),  # it is sure
        ([0.0, 4.0, 8.0, 12.0], 30.0, False),  # it gets on
        ([0.0, 0.0, 0.0, 4.0, 8.0], 30.0, True),  # on its way
        ([0.0, 0.0, 0.0, 4.0, 8.0, 12.0, 16.0, 18.0], 30.0, False),  # it is there
    ],
)
def test_who_gets_nowhere_and_is_not_sure_explores(places_m: list[float], radius_m: float, explores: bool) -> None:
    exploration = after(places_m, radius_m)
    assert math.isfinite(exploration.goal_m[0, 0]) == explores
    held = torch.zeros(1, 3, dtype=torch.float64)
    center_m = torch.tensor([[places_m[-1], 0.0, 0.0]], dtype=torch.float64)
    moved_m = exploration.instead_of(held, center_m, paper_scenario())
    assert moved_m.tolist() == [[4.0, 0.0, 0.0] if explores else [0.0, 0.0, 0.0]]


def test_who_is_stopped_on_its_way_takes_another_goal_at_once() -> None:
    exploration = after([0.0, 0.0, 0.0, 4.0], 30.0)
    other_m = torch.tensor([[0.0, 20.0, 0.0]], dtype=torch.float64)
    at_the_fence_m = torch.tensor([[4.5, 0.0, 0.0]], dtype=torch.float64)
    assert explored(exploration, at_the_fence_m, belief(30.0), other_m).goal_m.tolist() == other_m.tolist()


def test_a_belief_that_becomes_sure_ends_it() -> None:
    exploration = after([0.0, 0.0, 0.0, 4.0], 30.0)
    center_m = torch.tensor([[8.0, 0.0, 0.0]], dtype=torch.float64)
    assert explored(exploration, center_m, belief(1.0), GOAL_M).goal_m.isnan().all()
