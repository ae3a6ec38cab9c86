"""When a target that flies counts as reached: a swarm that flies past at full speed, levels without fading."""

import math

import numpy as np
import pytest
import torch

from swarmchase.channel.propagation import unfaded_dbm
from swarmchase.controllers.belief import GAUSSIAN_REACH, Belief
from swarmchase.live.service.capture import CaptureJudge
from swarmchase.live.service.pace import Window
from swarmchase.live.service.safety import formation_m
from swarmchase.scenario import load_scenario

SCENARIO = load_scenario("flight")
PERIOD_S = 1 / SCENARIO.sampling_hz
ORIGIN_M = np.array([100.0, -50.0, 20.0])
"""Of the belief's frame, in that of the windows."""


def believed(mean_m: tuple[float, ...], spread_m: float, velocity_mps: tuple[float, ...] | None = None) -> Belief:
    return Belief(
        torch.tensor([mean_m], dtype=torch.float64),
        spread_m**2 * torch.eye(3, dtype=torch.float64)[None],
        torch.tensor([GAUSSIAN_REACH], dtype=torch.float64),
        None if velocity_mps is None else torch.tensor([velocity_mps], dtype=torch.float64),
    )


def heard(first: int, target_m: tuple[float, ...], low_db: tuple[float, ...] = (0.0,) * 6) -> Window:
    """Samples ``first`` to ``first + 9`` of a swarm that flies east at 10 m/s from the origin of the belief's frame."""
    time_s = PERIOD_S * (first + np.arange(10))
    center_m = 10.0 * time_s[:, None] * np.array([1.0, 0.0, 0.0])
    position_m = np.stack([formation_m(one_m, 5.0) for one_m in center_m])
    distance_m = np.linalg.norm(position_m - np.array(target_m), axis=2)
    rssi_dbm = unfaded_dbm(SCENARIO, torch.from_numpy(distance_m)).numpy() - np.array(low_db)
    return Window(rssi_dbm, position_m + ORIGIN_M, center_m[-1] + ORIGIN_M, time_s)


@pytest.mark.parametrize("spread_m", [1.0, 2.0, 4.0])
def test_what_a_long_way_through_the_middle_of_a_belief_passes(spread_m: float) -> None:
    """Beside the way the distance is Rayleigh distributed: 1 - exp(-r^2 / 2 s^2)."""
    way_m = torch.tensor([[[-100.0, 3.0, 1.0], [0.0, 3.0, 1.0], [100.0, 3.0, 1.0]]], dtype=torch.float64)
    share = believed((0.0, 3.0, 1.0), spread_m).share_passed(way_m, torch.zeros(1, 3, dtype=torch.float64), 2.0)
    # 500 points: 0.04 is two of their standard deviations.
    assert float(share[0]) == pytest.approx(1 - math.exp(-2.0 / spread_m**2), abs=0.04)


def test_a_target_that_has_flown_by_was_where_its_velocity_says() -> None:
    """The centre waits; the target is 10 m north of it now, and one second ago was 0 m or, standing, 10 m away."""
    way_m, age_s = torch.zeros(1, 2, 3, dtype=torch.float64), torch.tensor([[1.0, 0.0]], dtype=torch.float64)
    for velocity_mps, share in (((0.0, 10.0, 0.0), 1.0), ((0.0, -10.0, 0.0), 0.0), (None, 0.0)):
        belief = believed((0.0, 10.0, 0.0), 0.1, velocity_mps)
        assert float(belief.share_passed(way_m, age_s, 2.0)[0]) == share


@pytest.mark.parametrize(
    ("target_m", "low_db", "is_reached"),
    [
        ((2.0, 1.0, 0.0), (0.0,) * 6, True),  # passed at 1 m; at the end the centre is 2.7 m away
        ((2.0, 1.9, 0.0), (0.0,) * 6, True),
        ((2.0, 2.5, 0.0), (0.0,) * 6, False),  # passed at 2.5 m
        ((7.0, 0.0, 0.0), (0.0,) * 6, False),  # 2.5 m ahead
        ((-2.5, 0.0, 0.0), (0.0,) * 6, False),  # left behind before the window
        ((2.0, 1.0, 0.0), (0.0, 0.0, 60.0, 0.0, 0.0, 0.0), True),  # one may be deaf
        ((2.0, 1.0, 0.0), (0.0, 20.0, 20.0, 0.0, 0.0, 0.0), False),  # two may not: believed, not heard there
        ((2.0, 1.0, 0.0), (math.nan, math.nan, math.nan, 0.0, 0.0, 0.0), False),  # three are too few
    ],
)
def test_a_target_that_is_flown_past_is_reached(
    target_m: tuple[float, ...], low_db: tuple[float, ...], is_reached: bool
) -> None:
    judge = CaptureJudge(SCENARIO, decisions=1, minimum_trackers=4)
    assert judge.is_reached(heard(0, target_m, low_db), ORIGIN_M, believed(target_m, 0.05)) is is_reached


def test_the_way_from_window_to_window_counts_and_so_does_the_share_of_the_last() -> None:
    """The target is passed between the last sample of one window, at 4.5 m, and the first of the next, at 5 m."""
    target_m = (4.75, 1.99, 0.0)
    for decisions, words in ((1, [False, True]), (2, [False, True]), (3, [False, False]), (0, [False, False])):
        judge = CaptureJudge(SCENARIO, decisions, minimum_trackers=4)
        belief = believed(target_m, 1e-3)
        assert [judge.is_reached(heard(first, target_m), ORIGIN_M, belief) for first in (0, 10)] == words
    judge = CaptureJudge(SCENARIO, decisions=1, minimum_trackers=4)
    judge.is_reached(heard(0, target_m), ORIGIN_M, believed(target_m, 1e-3))
    judge.forget()
    assert not judge.is_reached(heard(10, target_m), ORIGIN_M, believed(target_m, 1e-3))
