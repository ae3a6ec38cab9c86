"""A cross that turns in flight: as its controller says, as fast as those keep up that fly ahead of it."""

import itertools
import math

import numpy as np
import pytest
import torch

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from swarmchase.formation import Action
from swarmchase.live.service.chase_state import Snapshot
from swarmchase.live.service.settings import ServiceSettings
from swarmchase.observation import Observation
from swarmchase.scenario import Scenario, load_scenario
from swarmchase.simulation.fault_plan import fault_plan
from swarmchase.simulation.virtual_chase import VirtualChase

SCENARIO = Scenario.from_dict(load_scenario("flight").to_dict() | {"start_distance_m": 30.0, "farthest_start_m": 60.0})


class Turns:
    """A controller that flies this way and turns so far at each decision."""

    name = "turns"

    def __init__(self, way_m: tuple[float, float, float], turn_rad: float) -> None:
        spacing_m, turn = torch.tensor([5.0], dtype=torch.float64), torch.tensor([turn_rad], dtype=torch.float64)
        self.action = Action(spacing_m, torch.tensor([way_m], dtype=torch.float64), turn)
        self.centers_m: list[np.ndarray] = []
        self.heard: list[np.ndarray] = []

    def begin(self, num_chases: int, seed: int, first_chase: int = 0) -> None:
        pass

    def decide(self, observation: Observation, memory: None) -> tuple[Action, None]:
        self.centers_m.append(observation.tracker_position_m[0, -1].mean(dim=0).numpy())
        self.heard.append(observation.rssi_dbm[0].isfinite().all(dim=0).numpy())
        return self.action, None


@pytest.mark.parametrize(
    ("way_m", "turn_rad", "turns_rad_per_s"),
    [
        ((0.0, 0.0, 0.0), 0.1, 0.2),
        ((0.0, 0.0, 0.0), -0.5, -0.4),  # 2 m/s at 5 m
        ((5.0, 0.0, 0.0), 0.5, 0.4),
    ],
)
def test_the_cross_turns_and_keeps_its_form(
    way_m: tuple[float, float, float], turn_rad: float, turns_rad_per_s: float
) -> None:
    controller = Turns(way_m, turn_rad)
    snapshots: list[Snapshot] = []
    settings = ServiceSettings(reached_windows=0)
    chase = VirtualChase(SCENARIO, controller, 3, 1, settings=settings, watch=snapshots.append)
    least_m, angles_rad = math.inf, []
    while chase.site.flown_s is None or chase.site.flown_s < 10.0:
        chase.tick()
        place_m = np.array(chase.site.positions_m())
        least_m = min(least_m, *itertools.starmap(math.dist, itertools.combinations(place_m.tolist(), 2)))
        across_m = place_m[0] - place_m[1]
        angles_rad.append(math.atan2(across_m[1], across_m[0]))
    angle_rad = np.unwrap(angles_rad)
    # All have heard for two seconds before it turns; while the formation waits it does not.
    assert snapshots[-1].turned_rad == pytest.approx(8.0 * turns_rad_per_s, rel=0.12)
    assert angle_rad[-1] == pytest.approx(snapshots[-1].turned_rad, abs=0.5)
    assert least_m > 4.0
    # Nobody is taken for astray, and all are heard; the mean of the places is the centre.
    assert np.array(controller.heard).all()
    assert np.linalg.norm(controller.centers_m[-1] - place_m.mean(axis=0)) < 6.0
    assert np.linalg.norm(np.diff(np.array(controller.centers_m)[10:], axis=0), axis=1).mean() == pytest.approx(
        math.hypot(*way_m), abs=0.4
    )


def test_it_does_not_turn_while_somebody_is_without_news() -> None:
    """Over a link with bursts that is nearly always so."""
    controller = Turns((5.0, 0.0, 0.0), 0.5)
    settings = ServiceSettings(reached_windows=0)
    chase = VirtualChase(SCENARIO, controller, 3, 1, fault_plan("burst=0.15"), settings)
    while chase.site.flown_s is None or chase.site.flown_s < 10.0:
        chase.tick()
    assert chase.service.snapshot().movements > 10
    assert abs(chase.service.snapshot().turned_rad) < 0.1 * 8.0 * 0.4
