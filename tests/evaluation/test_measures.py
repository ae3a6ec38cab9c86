"""How long a target is followed and what a belief is worth, with a pencil and in real chases."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
import torch

from swarmchase.controllers import load_controller
from swarmchase.controllers.belief import GAUSSIAN_REACH, Belief
from swarmchase.controllers.oracle import OracleController
from swarmchase.evaluation.chases import ChaseResult, run_chases
from swarmchase.evaluation.measures import following_s
from swarmchase.evaluation.statistics import ratio_interval
from swarmchase.evaluation.table import Evaluation, evaluate
from swarmchase.scenario import load_scenario

FLIGHT = dataclasses.replace(load_scenario("flight"), start_distance_m=15.0, farthest_start_m=40.0)


@pytest.mark.parametrize(
    ("distance_m", "longest_s"),
    [
        ([30, 20, 11, 12], 0),  # never near
        ([5, 5, 5, 5], 3),  # always
        ([20, 0, 0, 20], 0.5 + 1 + 0.5),  # in and out, each half way through a second
        ([5, 15, 5, 5], 1.5),  # the second time is longer
        ([5, 5, 15, 5], 1.5),  # the first is
        ([10, 10, 11, 9], 1),  # on the edge is near
        ([30, 20, 10], 0),  # there for no time
        ([4], 0),
    ],
)
def test_the_longest_time_near_the_target(distance_m: list[float], longest_s: float) -> None:
    moment_s = 7.0 + np.arange(len(distance_m))
    assert following_s(moment_s, np.array(distance_m, dtype=np.float64)) == pytest.approx(longest_s)


def test_moments_need_not_be_evenly_spaced_and_may_come_twice() -> None:
    """The end of a movement is the beginning of the next: 4 s near, from 3 to 7."""
    moment_s = np.array([0.0, 2.0, 2.0, 4.0, 4.0, 6.0, 6.0, 8.0])
    distance_m = np.array([25.0, 15.0, 15.0, 5.0, 5.0, 5.0, 5.0, 15.0])
    assert following_s(moment_s, distance_m) == pytest.approx(4.0)


def test_a_chase_that_goes_on_has_the_same_row_and_follows() -> None:
    """Who knows where a target is that stands still reaches it, and is near it for a while."""
    ends = list(run_chases(FLIGHT, OracleController(FLIGHT), 5, range(6), 4))
    goes_on = dataclasses.replace(FLIGHT, follow_s=3.0)
    follows = list(run_chases(goes_on, OracleController(goes_on), 5, range(6), 4))
    by_number = {chase.chase: chase for chase in follows}
    for chase in ends:
        other = by_number[chase.chase]
        assert chase.following_s is None
        assert dataclasses.replace(other, following_s=None) == chase
        # It comes in and, at full speed, shoots past by up to 10 m: 8 m at 10 m/s before the capture and as many after.
        assert other.following_s is not None
        assert 1.6 <= other.following_s < 3.5 + 2.5


@pytest.mark.parametrize("pace", ["flight", "paper"])
def test_a_belief_is_the_same_in_any_batch(pace: str) -> None:
    """To the last bit, as all that is in a table."""
    near = {"start_distance_m": 15.0, "max_movements": 6, "follow_s": 1.0}
    scenario = dataclasses.replace(load_scenario(pace), **near)
    in_batches = [
        sorted(
            run_chases(scenario, load_controller("particle", scenario), 5, range(7), batch_size),
            key=lambda row: row.chase,
        )
        for batch_size in (1, 3, 7)
    ]
    assert in_batches[0] == in_batches[1] == in_batches[2]
    assert all(row.belief_error_m is not None for row in in_batches[0])


def test_who_is_cut_off_follows_nobody() -> None:
    lost = dataclasses.replace(FLIGHT, follow_s=100.0, max_movements=3, start_distance_m=40.0)
    summary = evaluate(lost, "random", episodes=3, seed=0).summary()
    assert (summary["success_rate"], summary["following_s_mean"], summary["followed_30_s"]) == (0, 0, 0)


class Stubborn(OracleController):
    """Believes that all targets are within about 30 m of the start, whatever it hears."""

    def belief(self, memory: Any) -> Belief:
        num_chases = len(memory.target_position_m)
        return Belief(
            mean_m=torch.zeros(num_chases, 3, dtype=torch.float64),
            covariance_m2=(30**2 / GAUSSIAN_REACH) * torch.eye(3, dtype=torch.float64).expand(num_chases, 3, 3),
            reach=torch.full((num_chases,), GAUSSIAN_REACH, dtype=torch.float64),
        )


def test_a_belief_is_held_against_where_the_target_was() -> None:
    """Targets that stand still: in the region at every decision or at none, and the error is their distance."""
    rows = list(run_chases(FLIGHT, Stubborn(FLIGHT), 3, range(12), 5))
    held = [row.belief_held == row.belief_decisions for row in rows]
    for row in rows:
        distance_m = math.dist((0, 0, 0), (row.target_x_m, row.target_y_m, row.target_z_m))
        assert row.belief_decisions == row.movements
        assert row.belief_held == (row.movements if distance_m <= 30 else 0)
        assert row.belief_error_m == pytest.approx(distance_m)
        assert row.belief_radius_m == pytest.approx(30.0)
        assert row.belief_error_20_m is None  # reached before
    assert 0 < sum(held) < len(rows)


def chase(number: int, decisions: int, held: int, error_m: float, after_10_m: float | None) -> ChaseResult:
    return ChaseResult(
        3, number, 0.0, 0.0, 0.0, decisions, True, 10.0, 5.0, 1.0,
        belief_decisions=decisions, belief_held=held, belief_radius_m=2 * error_m, belief_error_m=error_m,
        belief_error_10_m=after_10_m,
    )  # fmt: skip


def test_the_summary_of_three_beliefs_by_pencil() -> None:
    chases = [chase(0, 10, 10, 1.0, 4.0), chase(1, 20, 10, 2.0, None), chase(2, 10, 8, 3.0, 6.0)]
    row = Evaluation(FLIGHT, "particle", None, 3, chases).summary()
    assert row["belief_coverage_95"] == 28 / 40  # of decisions, not of chases
    # Apart from 70 %: 3, -4 and 1 decisions; 3 / 2 * (9 + 16 + 1) / 40^2.
    assert row["belief_coverage_95_ci95"] == pytest.approx([0.7 - 1.96 * 0.15612, 1.0], abs=1e-4)
    assert (row["belief_radius_m_p50"], row["belief_error_m_p50"]) == (4.0, 2.0)
    assert row["belief_error_m_p50_after"] == {"10": 4.0}
    assert "belief_coverage_95" not in Evaluation(FLIGHT, "oracle", None, 3, [*chases, OLD]).summary()


OLD = ChaseResult(3, 3, 0.0, 0.0, 0.0, 10, True, 10.0, 5.0, 1.0)
"""Of a table without beliefs."""


def test_the_interval_of_a_ratio_covers_it_where_decisions_of_a_chase_are_alike() -> None:
    """Long chases in which all decisions err together: a binomial interval would cover the truth in a third."""
    generator = np.random.default_rng(1)
    covered = []
    for _ in range(1500):
        whole = generator.integers(20, 200, size=80)
        part = whole * (generator.random(80) < 0.8)
        low, high = ratio_interval(part, whole) or (1, 0)
        covered.append(low <= 0.8 <= high)
    assert 0.92 <= np.mean(covered) <= 0.965
    assert ratio_interval(np.array([3]), np.array([4])) is None
