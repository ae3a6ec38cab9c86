"""A belief's region and radius with a pencil, and that it holds as much as it says."""

import math
from dataclasses import replace

import pytest
import torch
from scipy.stats import chi2

from swarmchase.controllers import load_controller
from swarmchase.controllers.belief import (
    GAUSSIAN_REACH,
    Belief,
    Believing,
    belief_of_particles,
)
from swarmchase.scenario import load_scenario, paper_scenario


def test_the_region_of_a_gaussian_belief_by_pencil() -> None:
    """Standard deviations 2, 1 and 1 m around (1, 0, 0): half axes of 5.59 and 2.80 m."""
    assert chi2.ppf(0.95, 3) == pytest.approx(GAUSSIAN_REACH, abs=1e-6)
    variance_m2 = torch.tensor([4.0, 1.0, 1.0], dtype=torch.float64)
    belief = Belief(
        mean_m=torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64).expand(4, 3),
        covariance_m2=variance_m2.diag().expand(4, 3, 3),
        reach=torch.full((4,), GAUSSIAN_REACH, dtype=torch.float64),
    )
    half_m = math.sqrt(GAUSSIAN_REACH)
    places_m = [
        [1 + 2 * half_m - 0.01, 0, 0],
        [1 + 2 * half_m + 0.01, 0, 0],
        [1, half_m - 0.01, 0],
        [1, 0, half_m + 0.01],
    ]
    target_m = torch.tensor(places_m, dtype=torch.float64)
    assert belief.holds(target_m).tolist() == [True, False, True, False]
    assert belief.radius_m.tolist() == pytest.approx([2 * half_m] * 4)
    assert belief.error_m(target_m).tolist() == pytest.approx(
        [2 * half_m - 0.01, 2 * half_m + 0.01, half_m - 0.01, half_m + 0.01]
    )


def spread(shape: str, number: int, generator: torch.Generator) -> torch.Tensor:
    """[1, 3, number] in metres: a cigar far away, or all around at 100 m, which no Gaussian is like."""
    normal = torch.randn(1, 3, number, generator=generator)
    if shape == "cigar":
        return torch.tensor([300.0, -50.0, 20.0])[:, None] + torch.tensor([[8.0], [2.0], [0.5]]) * normal
    return 100 * normal / normal.norm(dim=1, keepdim=True) + torch.randn(1, 3, number, generator=generator)


@pytest.mark.parametrize(("shape", "reach", "radius_m"), [("cigar", GAUSSIAN_REACH, 8 * 2.7955), ("shell", 3.1, 102.0)])
def test_the_region_holds_95_percent_of_what_is_believed(shape: str, reach: float, radius_m: float) -> None:
    """Of others drawn alike: the target of a belief that is right is one of them."""
    generator = torch.Generator().manual_seed(1)
    belief = belief_of_particles(spread(shape, 3000, generator))
    assert belief.reach.item() == pytest.approx(reach, rel=0.08)
    assert belief.radius_m.item() == pytest.approx(radius_m, rel=0.06)
    others_m = spread(shape, 20_000, generator)[0].T.double()
    everywhere = replace(
        belief,
        mean_m=belief.mean_m.expand(20_000, 3),
        covariance_m2=belief.covariance_m2.expand(20_000, 3, 3),
        reach=belief.reach.expand(20_000),
    )
    assert everywhere.holds(others_m).double().mean().item() == pytest.approx(0.95, abs=0.02)


def test_a_belief_in_one_place_is_a_millimetre_wide() -> None:
    belief = belief_of_particles(torch.full((1, 3, 50), 7.0))
    assert belief.mean_m[0].tolist() == pytest.approx([7, 7, 7])
    assert belief.radius_m.item() < 0.003


def test_two_particles_far_apart_that_weigh_nearly_all_are_a_belief() -> None:
    """So it is after a window that says much to one that has lost its target: a line of no width, seen from far."""
    weight = torch.full((1, 1000), 1e-12, dtype=torch.float64)
    weight[0, [3, 500]] = 0.5 - 499e-12
    for seed in range(20):
        drawn_m = torch.randn(1, 3, 1000, generator=torch.Generator().manual_seed(seed))
        position_m = 300 * drawn_m + torch.tensor([900.0, -400.0, 100.0])[:, None]
        belief = belief_of_particles(position_m, weight)
        apart_m = float((position_m[0, :, 3] - position_m[0, :, 500]).double().norm())
        # Of two points the variance is that of half their distance; the region reaches to both.
        assert float(belief.radius_m[0]) == pytest.approx(apart_m / 2, rel=1e-3)
        assert bool(belief.holds(belief.mean_m)[0])


def test_particles_count_as_much_as_they_weigh() -> None:
    """Those that weigh nothing are as good as not there; one that weighs three counts as three."""
    generator = torch.Generator().manual_seed(2)
    position_m = spread("cigar", 4000, generator)
    weight = torch.tensor([0.0, 1.0, 3.0, 2.0]).repeat(1, 1000).double()
    weighed = belief_of_particles(position_m, weight / weight.sum())
    repeated = belief_of_particles(position_m.repeat_interleave(weight[0].long(), dim=2))
    assert torch.allclose(weighed.mean_m, repeated.mean_m, atol=1e-4)
    assert torch.allclose(weighed.covariance_m2, repeated.covariance_m2, rtol=1e-3, atol=1e-3)
    assert weighed.reach.item() == pytest.approx(repeated.reach.item(), rel=0.02)


def test_who_has_a_belief_says_it() -> None:
    """Before anything is heard: all around, in flight from 60 to 300 m away and no higher than targets fly."""
    for scenario, farthest_m in ((paper_scenario(), 100.0), (load_scenario("flight"), 300.0)):
        controller = load_controller("particle", scenario)
        assert isinstance(controller, Believing)
        belief = controller.belief(controller.begin(3, 1))
        assert belief.error_m(torch.zeros(3, 3, dtype=torch.float64)).max().item() < 0.15 * farthest_m
        assert (belief.radius_m > 0.9 * farthest_m).all()
    for name in ("oracle", "gradient", "paper"):
        assert not isinstance(load_controller(name, paper_scenario()), Believing)
