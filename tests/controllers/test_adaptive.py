"""``adaptive``: it reaches its targets in worlds that nobody told it of, and what it says of them is true."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import pytest
import torch

from swarmchase import Environment, Observation, Scenario, load_controller, paper_scenario
from swarmchase.batch.selection import join_chases, select_chases
from swarmchase.batch.streams import chase_keys
from swarmchase.controllers import adaptive as adaptive_module
from swarmchase.controllers import unknown_channel
from swarmchase.controllers.adaptive import AdaptiveController, AdaptiveMemory, _proposed
from swarmchase.controllers.condition import Condition
from swarmchase.controllers.remembered_windows import MOST_WINDOWS
from swarmchase.evaluation.chases import run_chases
from swarmchase.evaluation.play import play
from swarmchase.formation import Action, tracker_position_m
from swarmchase.scenario import NUM_TRACKERS

DOCS = Path(__file__).parents[2] / "docs"
TOLD = paper_scenario(sampling_hz=10, spatial_correlation=0.5)


def adaptive(scenario: Scenario = TOLD) -> AdaptiveController:
    controller = load_controller("adaptive", scenario)
    assert isinstance(controller, AdaptiveController)
    return controller


@pytest.mark.parametrize(
    ("departure", "most_movements"),
    [
        ({}, 24),
        ({"transmit_power_dbm": 17.0, "path_loss_exponent": 3.0, "receiver_offset_db": 3.0}, 29),
        ({"wrong_trackers": 1}, 26),
        ({"stuck_trackers": 1, "missing_sample_share": 0.2}, 26),
        ({"rician_k": 0.0, "receiver_step_db": 1.0}, 28),
        ({"shadowing_db": 3.0}, 60),
    ],
    ids=["as told", "power, exponent and offsets", "one wrong", "one stuck", "no line of sight", "shadowing"],
)
def test_it_reaches_its_targets_whatever_the_world(departure: dict[str, Any], most_movements: float) -> None:
    """Mean movements of 8 chases; the means of 300 are at least two below the bounds."""
    rows = list(run_chases(dataclasses.replace(TOLD, **departure), adaptive(), 5, range(8)))
    assert all(row.reached for row in rows)
    assert sum(row.movements for row in rows) / 8 < most_movements


def test_a_chase_is_the_same_alone_and_in_any_batch() -> None:
    world = dataclasses.replace(TOLD, start_distance_m=30.0, receiver_offset_db=3.0)
    together = {row.chase: row.movements for row in run_chases(world, adaptive(), 1, range(4), batch_size=4)}
    alone = {row.chase: row.movements for row in run_chases(world, adaptive(), 1, range(4), batch_size=1)}
    assert together == alone


def observed(world: Scenario, seed: int, num_windows: int, wander_m: float = 4.0) -> list[Observation]:
    """Windows of one chase in which the swarm goes along +x, then +y, then +z whatever anybody thinks."""
    environment = Environment(world)
    state = environment.reset(chase_keys(seed, 1))
    seen = [state.observation()]
    for number in range(num_windows - 1):
        way_m = torch.zeros(1, 3, dtype=torch.float64)
        way_m[0, number % 3] = wander_m
        state, _ = environment.step(state, Action(torch.full((1,), 5.0, dtype=torch.float64), way_m))
        seen.append(state.observation())
    return seen


def followed(controller: AdaptiveController, windows: list[Observation]) -> AdaptiveMemory:
    memory = controller.begin(1, 3)
    for window in windows:
        _, memory = controller.decide(window, memory)
    return memory


def test_it_finds_out_power_exponent_and_offsets() -> None:
    """Beside the target, where levels differ most: the truth within 2 dB and 0.3 after 30 windows."""
    world = dataclasses.replace(
        TOLD, transmit_power_dbm=29.0, path_loss_exponent=2.2, receiver_offset_db=4.0, start_distance_m=25.0
    )
    told = dataclasses.replace(TOLD, start_distance_m=25.0)
    windows = observed(world, 8, 30)
    controller = adaptive(told)
    memory = followed(controller, windows)
    found = controller.explain(windows[-1], memory).found
    assert found is not None
    truth_m = Environment(world).reset(chase_keys(8, 1)).target_position_m[0]
    mean_m = memory.position_m[0].double() @ memory.log_weight[0].exp()
    assert torch.linalg.vector_norm(mean_m - truth_m) < 8
    assert found.exponent == pytest.approx(2.2, abs=0.3)
    offset_db = Environment(world).reset(chase_keys(8, 1)).radio.receivers.offset_db[0]
    assert found.power_db + torch.tensor(found.offset_db).mean() == pytest.approx(6 + float(offset_db.mean()), abs=2.5)
    apart_db = torch.tensor(found.offset_db) - torch.tensor(found.offset_db).mean()
    assert (apart_db - (offset_db - offset_db.mean())).abs().max() < 2
    assert found.left_out == (None,) * NUM_TRACKERS


@pytest.mark.parametrize(
    ("spoilt", "reason"),
    [
        (lambda rssi_dbm: rssi_dbm.fill_(math.nan), "silent"),
        (lambda rssi_dbm: rssi_dbm.fill_(-61.0), "stuck"),
        (lambda rssi_dbm: rssi_dbm.add_(22.0), "wrong"),
    ],
    ids=["silent", "stuck", "wrong"],
)
def test_who_is_left_out_is_named_with_the_reason(spoilt: Any, reason: str) -> None:
    windows = observed(dataclasses.replace(TOLD, start_distance_m=30.0), 4, 15)
    for window in windows:
        spoilt(window.rssi_dbm[:, :, 2])
    controller = adaptive(dataclasses.replace(TOLD, start_distance_m=30.0))
    found = controller.explain(windows[-1], followed(controller, windows)).found
    assert found is not None
    assert found.left_out == (None, None, reason, None, None, None)


def _belief_m(memory: AdaptiveMemory) -> float:
    """The longest half axis of the belief, one standard deviation."""
    weight = memory.log_weight[0].exp()
    apart_m = memory.position_m[0].double() - (memory.position_m[0].double() @ weight)[:, None]
    return float(torch.linalg.eigvalsh((apart_m * weight) @ apart_m.T)[-1].sqrt())


@pytest.mark.parametrize(
    "rssi_dbm",
    [
        torch.full((1, 50, 6), math.nan),
        torch.full((1, 50, 6), -200.0),
        torch.full((1, 50, 6), 49.0),
        torch.full((1, 50, 6), -60.0),
        torch.tensor([-20.0, -190.0, 40.0, -60.0, -100.0, 5.0]).expand(1, 50, 6),
        torch.where(torch.arange(50)[:, None] % 2 == 0, -20.0, -150.0).expand(1, 50, 6),
    ],
    ids=["nothing", "all weak", "all strong", "no fading", "six wrong receivers", "wild"],
)
def test_it_is_never_surer_than_it_may_be_of_nonsense(rssi_dbm: torch.Tensor) -> None:
    """Ten windows at one place say nothing of the direction: the belief stays tens of metres wide, and finite."""
    place_m = tracker_position_m(torch.zeros(1, 3).double(), torch.full((1,), 5.0).double())
    window = Observation(rssi_dbm=rssi_dbm, tracker_position_m=place_m[:, None].expand(1, 50, 6, 3).float())
    controller = adaptive()
    memory = followed(controller, [window] * 10)
    action, memory = controller.decide(window, memory)
    assert memory.position_m.isfinite().all()
    assert memory.log_weight.exp().sum() == pytest.approx(1)
    assert action.displacement_m.isfinite().all()
    assert _belief_m(memory) > 10
    if rssi_dbm.isnan().all():
        assert action.displacement_m.abs().max() == 0
        assert memory.condition.tolist() == [int(Condition.DEAF)]


def test_trackers_at_one_place_tell_the_distance_alone() -> None:
    windows = observed(TOLD, 2, 6, wander_m=0.0)
    at_one_place = [
        Observation(rssi_dbm=window.rssi_dbm, tracker_position_m=torch.zeros_like(window.tracker_position_m))
        for window in windows
    ]
    memory = followed(adaptive(), at_one_place)
    assert memory.position_m.isfinite().all()
    assert _belief_m(memory) > 30


def test_it_remembers_no_more_than_it_has_room_for_and_keeps_what_it_would_miss_most() -> None:
    windows = observed(dataclasses.replace(TOLD, start_distance_m=400.0), 1, 60)
    controller = adaptive()
    memory = followed(controller, windows)
    assert memory.windows.number.tolist() == [40]
    assert memory.windows.heard.tolist() == [60]
    kept_m = memory.windows.tracker_position_m[0].mean(dim=1)
    apart_m = torch.cdist(kept_m, kept_m).fill_diagonal_(math.inf).amin(dim=1)
    assert apart_m.min() > 3.9  # no two of one place


def test_a_memory_can_be_taken_apart_and_put_together() -> None:
    controller = adaptive()
    memory = controller.begin(3, 1)
    again = join_chases(select_chases(memory, [0]), select_chases(memory, [1, 2]))
    assert torch.equal(again.position_m, memory.position_m)
    assert torch.equal(again.windows.level_dbm.isnan(), memory.windows.level_dbm.isnan())


def test_particles_begin_as_the_prior_says() -> None:
    """Weighed by the prior they would have all the same weight if drawn anew: 70 % at the told distance."""
    memory = adaptive().begin(4, 1)
    distance_m = memory.position_m.norm(dim=1)
    assert ((distance_m - 100).abs() < 3).float().mean() == pytest.approx(0.7, abs=0.03)
    assert (distance_m > 150).float().mean() == pytest.approx(0.3 * 0.28, abs=0.03)


@pytest.mark.parametrize("departure", [{}, {"receiver_offset_db": 3.0}], ids=["as told", "offsets"])
def test_its_certainty_is_true(departure: dict[str, Any]) -> None:
    """The target is inside the 95 % region of a Gaussian with the belief's moments in most decisions of 8 chases."""
    inside: list[bool] = []
    controller = adaptive()
    for step in play(dataclasses.replace(TOLD, sampling_hz=100.0, **departure), _Told(controller), 5, range(8), 8):
        memory = _Told.last
        weight = memory.log_weight.exp()
        mean_m = (memory.position_m.double() * weight[:, None]).sum(dim=2)
        apart_m = memory.position_m.double() - mean_m[..., None]
        covariance_m2 = (apart_m * weight[:, None]) @ apart_m.mT + 1e-6 * torch.eye(3)
        error_m = step.before.target_position_m - mean_m
        squared = (error_m * torch.linalg.solve(covariance_m2, error_m)).sum(dim=1)
        inside += (squared < 7.815).tolist()
    assert 0.85 < sum(inside) / len(inside) < 0.995


class _Told:
    """The controller, whose last memory can be looked at."""

    last: AdaptiveMemory

    def __init__(self, controller: AdaptiveController) -> None:
        self._controller = controller
        self.name = controller.name

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> AdaptiveMemory:
        return self._controller.begin(num_chases, seed, first_chase)

    def decide(self, observation: Observation, memory: AdaptiveMemory) -> Any:
        action, memory = self._controller.decide(observation, memory)
        type(self).last = memory
        return action, memory


def test_the_documents_state_the_constants() -> None:
    method, guide = (
        " ".join((DOCS / name).read_text(encoding="utf-8").split()) for name in ("method.md", "controllers.md")
    )
    (told_db, power_db), off_db = unknown_channel.POWER_SPREADS_DB, unknown_channel.OFFSET_SPREADS_DB
    *fields, last = (f"{length_m:g} m and {spread_db:g} dB" for length_m, spread_db in unknown_channel.FIELDS)
    share = f"{100 * unknown_channel.TOLD_SHARE:.0f} %"
    for words in (
        f"P is {told_db:g} or {power_db:g} dB (as told with {share})",
        f"O is {off_db[0]:g} ({share}), {off_db[1]:g}, {off_db[2]:g} or {off_db[3]:g} dB for all receivers, "
        f"or {unknown_channel.WRONG_BY_DB:g} dB for one of them beside {off_db[0]:g} or {off_db[1]:g} dB",
        f"shadowing has {100 * math.exp(unknown_channel.LOG_FIELD):.0f} %, "
        f"with l and S of {', '.join(fields)} or {last}",
        f"counts to the power {unknown_channel.FIELD_TRUST:g}",
        f"Student's t with {unknown_channel.DEGREES_OF_FREEDOM:.0f} degrees of freedom",
        f"{100 * adaptive_module.SHELL_SHARE:.0f} %: at the told distance within {adaptive_module.SHELL_SPREAD_M:g} m",
        f"e^{adaptive_module.LEAST_LOG_SHARE:g} of the best one's evidence",
        f"up to {NUM_TRACKERS * MOST_WINDOWS} levels",
    ):
        assert words in method, words
    for words in (
        f"{adaptive_module.NUM_PARTICLES} places of the target",
        f"{2 * len(unknown_channel.PAIRS)} models",
        f"one of {('six',)[len(unknown_channel.FIELDS) - 6]} kinds",
        f"up to {MOST_WINDOWS} windows",
    ):
        assert words in guide, words


def test_a_belief_of_two_places_a_kilometre_apart_can_be_stepped_from() -> None:
    """A line of no width: single precision rounds its covariance by more than the least spread."""
    log_weight = torch.full((1000,), 1e-12, dtype=torch.float64)
    log_weight[[3, 500]] = 0.5 - 499e-12
    log_weight = log_weight.log()
    for seed in range(20):
        generator = torch.Generator().manual_seed(seed)
        position_m = 1000 * torch.randn(3, 1000, generator=generator)
        normal, uniform = torch.randn(3, 1000, generator=generator), torch.rand(4, 1000, generator=generator).double()
        assert _proposed(position_m, log_weight, torch.zeros(3), 50.0, normal, uniform).isfinite().all()
