"""How long a pursuer that knows where the target is takes to catch it, beside what another simulation found.

The pursuer is plain numpy: 10 m/s, 5 m/s2, and a decision every half second to fly where the target is now. The other
simulation's means are of 300 chases with their own starts: each is good for about a second, more where the spread is
larger. Their hovering targets took 19.2 s.
"""

import numpy as np
import pytest
import torch

from swarmchase.batch.streams import chase_keys
from swarmchase.flight import FLIGHT_STEP_S
from swarmchase.scenario import paper_scenario
from swarmchase.world.behaviours import Swarm, load_behaviour
from swarmchase.world.target import draw_start_m

NUM_CHASES = 300
LIMIT_S = 120.0
STEPS_A_DECISION = 10
OTHERS_HOVER_S = 19.2


def capture_s(behaviour_name: str, speed_mps: float, **changes: float) -> float:
    """The mean of all chases; one that is not over in two minutes counts as that."""
    scenario = paper_scenario(
        behaviour=behaviour_name,
        target_speed_mps=speed_mps,
        start_distance_m=60.0,
        farthest_start_m=300.0,
        highest_elevation_deg=30.0,
        lowest_altitude_m=5.0,
        highest_altitude_m=120.0,
        **changes,
    )
    keys = chase_keys(1, NUM_CHASES)
    behaviour = load_behaviour(scenario)
    target = behaviour.begin(keys, draw_start_m(scenario, keys))
    seconds = torch.full((NUM_CHASES,), FLIGHT_STEP_S, dtype=torch.float64)
    place_m, velocity_mps = np.zeros((NUM_CHASES, 3)), np.zeros((NUM_CHASES, 3))
    caught_s = np.full(NUM_CHASES, LIMIT_S)
    for step in range(round(LIMIT_S / FLIGHT_STEP_S)):
        offset_m = target.position_m.numpy() - place_m
        if step % STEPS_A_DECISION == 0:
            wanted_mps = 10 * offset_m / np.linalg.norm(offset_m, axis=1, keepdims=True)
        swarm = Swarm(torch.from_numpy(place_m), torch.from_numpy(velocity_mps))
        target = behaviour.fly(target, seconds, swarm)
        change_mps = wanted_mps - velocity_mps
        size_mps = np.linalg.norm(change_mps, axis=1, keepdims=True)
        after_mps = velocity_mps + change_mps * np.minimum(1, 5 * FLIGHT_STEP_S / np.maximum(size_mps, 1e-9))
        place_m = place_m + (velocity_mps + after_mps) / 2 * FLIGHT_STEP_S
        velocity_mps = after_mps
        nearest_m = nearest_to_nothing_m(offset_m, target.position_m.numpy() - place_m)
        caught_s = np.where(nearest_m <= 2, np.minimum(caught_s, (step + 1) * FLIGHT_STEP_S), caught_s)
        if (caught_s < LIMIT_S).all():
            break
    return float(caught_s.mean())


def nearest_to_nothing_m(before_m: np.ndarray, after_m: np.ndarray) -> np.ndarray:
    """Of the straight ways from ``before_m`` to ``after_m``."""
    way_m = after_m - before_m
    share = -(before_m * way_m).sum(axis=1) / np.maximum((way_m**2).sum(axis=1), 1e-12)
    return np.linalg.norm(before_m + np.clip(share, 0, 1)[:, None] * way_m, axis=1)


@pytest.fixture(scope="module")
def hovering_s() -> float:
    return capture_s("hover", 5.0)


def test_a_target_that_hovers_is_caught_at_10_m_a_second(hovering_s: float) -> None:
    """180 m on average, 2 m less, and a second lost to get going: 18.8 s, give or take 0.4 s."""
    assert hovering_s == pytest.approx(18.8, abs=0.8)


@pytest.mark.parametrize(
    ("behaviour_name", "speed_mps", "others_s"),
    [
        ("straight", 5.0, 27.1),
        ("wander", 5.0, 24.9),
        ("waypoints", 5.0, 24.3),
        ("waypoints", 8.0, 29.2),
        ("circle", 5.0, 24.3),
        ("circle", 8.0, 30.9),
        ("stop-and-go", 5.0, 21.2),
        ("flee", 5.0, 37.4),
        ("jink", 5.0, 40.6),
    ],
)
def test_capture_takes_as_long_as_in_another_simulation(
    behaviour_name: str, speed_mps: float, others_s: float, hovering_s: float
) -> None:
    longer_s = capture_s(behaviour_name, speed_mps) - hovering_s
    assert longer_s == pytest.approx(others_s - OTHERS_HOVER_S, abs=2.5)


@pytest.mark.parametrize(("speed_mps", "others_s"), [(5.0, 23.0), (8.0, 32.9)])
def test_one_that_notices_the_swarm_late_is_caught_sooner(speed_mps: float, others_s: float, hovering_s: float) -> None:
    longer_s = capture_s("flee", speed_mps, alert_distance_m=50.0) - hovering_s
    assert longer_s == pytest.approx(others_s - OTHERS_HOVER_S, abs=1.5)
