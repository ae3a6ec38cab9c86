"""What every behaviour keeps to, and what each of them is."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmchase.batch.selection import join_chases, pack, select_chases, unpack
from swarmchase.batch.streams import chase_keys
from swarmchase.errors import InputError
from swarmchase.flight import FLIGHT_STEP_S
from swarmchase.scenario import paper_scenario
from swarmchase.world.behaviours import Behaviour, Swarm, behaviour_names, load_behaviour
from swarmchase.world.target import draw_start_m

WORLD = {
    "target_speed_mps": 5.0,
    "start_distance_m": 60.0,
    "farthest_start_m": 300.0,
    "highest_elevation_deg": 30.0,
    "lowest_altitude_m": 5.0,
    "highest_altitude_m": 120.0,
}
LOWEST_M, HIGHEST_M = 5 - 50, 120 - 50
"""Of the altitude band, above the swarm's start."""
ACCELERATION_MPS2 = 4.0
NAMES = ["hover", "straight", "waypoints", "wander", "circle", "stop-and-go", "flee", "jink"]


@pytest.fixture(scope="module")
def track(tmp_path_factory):
    """A square of 40 m, 10 s a side, and then 90 m up, which is over the altitude band."""
    path = tmp_path_factory.mktemp("tracks") / "square.csv"
    path.write_text("time_s,x_m,y_m,z_m\n0,0,0,0\n10,40,0,0\n20,40,40,0\n30,0,40,0\n40,0,0,0\n60,0,0,90\n")
    return str(path)


@pytest.fixture(params=[*NAMES, "track"])
def name(request, track):
    return track if request.param == "track" else request.param


@dataclass
class Swarming:
    """A swarm of 10 m/s that flies straight at the target and through it, over and over."""

    center_m: torch.Tensor

    def seen(self, target):
        offset_m = target.position_m - self.center_m
        velocity_mps = 10 * offset_m / offset_m.norm(dim=1, keepdim=True).clamp_min(1.0)
        swarm = Swarm(self.center_m, velocity_mps)
        self.center_m = self.center_m + velocity_mps * FLIGHT_STEP_S
        return swarm


def begun(behaviour_name, keys, **changes):
    scenario = paper_scenario(**WORLD | {"behaviour": behaviour_name} | changes)
    behaviour = load_behaviour(scenario)
    target = behaviour.begin(keys, draw_start_m(scenario, keys))
    return behaviour, target


def steps(number, seconds=FLIGHT_STEP_S):
    return torch.full((number,), seconds, dtype=torch.float64)


def flights(behaviour_name, num_chases=40, seconds=120.0, still_swarm=False, **changes):
    """Targets after every step: the start first."""
    behaviour, target = begun(behaviour_name, chase_keys(3, num_chases), **changes)
    swarming = Swarming(torch.zeros_like(target.position_m))
    targets = [target]
    for _ in range(round(seconds / FLIGHT_STEP_S)):
        swarm = Swarm(torch.zeros_like(target.position_m), torch.zeros_like(target.position_m))
        target = behaviour.fly(target, steps(num_chases), swarm if still_swarm else swarming.seen(target))
        targets.append(target)
    return targets


def places_m(targets):
    return torch.stack([target.position_m for target in targets], dim=1)


def velocities_mps(targets):
    return torch.stack([target.velocity_mps for target in targets], dim=1)


@pytest.mark.parametrize("speed_mps", [2.0, 12.0])
def test_no_limit_is_passed_in_a_minute(name, speed_mps):
    targets = flights(name, num_chases=40, seconds=60.0, target_speed_mps=speed_mps)
    position_m, velocity_mps = places_m(targets), velocities_mps(targets)
    assert velocity_mps.norm(dim=2).max() <= speed_mps + 1e-9
    assert velocity_mps.diff(dim=1).norm(dim=2).max() <= ACCELERATION_MPS2 * FLIGHT_STEP_S + 1e-9
    assert position_m[..., 2].min() >= LOWEST_M - 1e-9
    assert position_m[..., 2].max() <= HIGHEST_M + 1e-9
    # Velocity is what the places say: over a step it changes evenly, or less than that.
    mean_mps = position_m.diff(dim=1) / FLIGHT_STEP_S
    error_mps = mean_mps - (velocity_mps[:, 1:] + velocity_mps[:, :-1]) / 2
    assert error_mps.norm(dim=2).max() <= ACCELERATION_MPS2 * FLIGHT_STEP_S / 8 + 1e-9


@given(
    altitude_m=st.floats(5.0, 120.0),
    speed_mps=st.floats(0.1, 60.0),
    acceleration_mps2=st.floats(0.5, 20.0),
    step_s=st.floats(0.001, 0.5),
    side=st.sampled_from([-1.0, 1.0]),
)
@settings(max_examples=40, deadline=None)
def test_who_flees_up_or_down_brakes_in_time(altitude_m, speed_mps, acceleration_mps2, step_s, side):
    scenario = paper_scenario(
        **WORLD | {"behaviour": "flee", "target_speed_mps": speed_mps, "target_acceleration_mps2": acceleration_mps2}
    )
    behaviour = load_behaviour(scenario)
    target = behaviour.begin([(0, 0)], torch.tensor([[90.0, 0.0, altitude_m - 50.0]], dtype=torch.float64))
    swarm = Swarm(target.position_m - torch.tensor([[1.0, 0.0, 5 * side]]), torch.zeros_like(target.position_m))
    for _ in range(60):
        following = behaviour.fly(target, steps(1, step_s), swarm)
        assert LOWEST_M - 1e-9 <= following.position_m[0, 2] <= HIGHEST_M + 1e-9
        change_mps = (following.velocity_mps - target.velocity_mps).norm()
        assert change_mps <= acceleration_mps2 * step_s + 1e-9
        assert following.velocity_mps.norm() <= speed_mps + 1e-9
        target = following


def test_without_a_band_a_target_flies_as_high_as_it_wants():
    position_m = places_m(flights("waypoints", lowest_altitude_m=None, highest_altitude_m=None, seconds=60.0))
    assert position_m[..., 2].max() > HIGHEST_M
    assert position_m[..., 2].min() < LOWEST_M


def everything(target):
    tensors, positions = pack(target, "target")
    return {name: tensor.numpy().tobytes() for name, tensor in tensors.items()}, positions


def test_a_chase_is_the_same_alone_and_among_others_that_fly_or_wait(name):
    """To the last bit, its random numbers included; and it does not matter how often it waited itself."""
    keys = chase_keys(3, 6)
    behaviour, among = begun(name, keys)
    _, alone = begun(name, keys[4:5])
    center_m = torch.tensor([[20.0, -10.0, 5.0]], dtype=torch.float64)
    swarm = Swarm(center_m, torch.zeros_like(center_m))
    swarms = Swarm(center_m.expand(6, -1), swarm.velocity_mps.expand(6, -1))
    for step in range(400):
        seconds = steps(6)
        seconds[: step % 4] = 0.0
        if step % 5 == 0:
            seconds[4] = 0.0
        before = select_chases(among, [0, 4])
        known = everything(before)
        among = behaviour.fly(among, seconds, swarms)
        if step % 4 > 0 and step % 5 == 0:
            assert everything(select_chases(among, [0, 4])) == known
        if step % 5 > 0:
            alone = behaviour.fly(alone, steps(1), swarm)
    assert everything(select_chases(among, [4])) == everything(alone)


def test_targets_can_be_picked_joined_and_filed(name):
    behaviour, target = begun(name, chase_keys(3, 5))
    swarm = Swarm(torch.ones_like(target.position_m), torch.zeros_like(target.position_m))
    for _ in range(10):
        target = behaviour.fly(target, steps(5), swarm)
    first, second = select_chases(target, [0, 1]), select_chases(target, [2, 3, 4])
    assert everything(join_chases(first, second)) == everything(target)
    _, like = begun(name, chase_keys(8, 5))
    filed = unpack(like, "target", *pack(target, "target"))
    for _ in range(100):
        target, filed = behaviour.fly(target, steps(5), swarm), behaviour.fly(filed, steps(5), swarm)
    assert everything(filed) == everything(target)


def test_only_hovering_is_still(name):
    behaviour, target = begun(name, chase_keys(0, 2))
    assert isinstance(behaviour, Behaviour)
    assert behaviour.is_still == (name == "hover")
    assert target.velocity_mps.count_nonzero() == 0
    assert target.position_m.dtype == target.velocity_mps.dtype == torch.float64
    flown_m = places_m(flights(name, num_chases=2, seconds=30.0)).diff(dim=1).norm(dim=2).sum(dim=1)
    assert (flown_m == 0).all() if name == "hover" else (flown_m > 1).all()


def test_straight_keeps_its_course():
    """At rest, then 1.25 s to 5 m/s: 5 m/s * (60 - 1.25 / 2) s. It climbs at most a tenth of its way."""
    position_m = places_m(flights("straight", seconds=60.0, lowest_altitude_m=None, highest_altitude_m=None))
    way_m = position_m[:, -1] - position_m[:, 0]
    assert way_m.norm(dim=1).tolist() == pytest.approx([296.875] * 40)
    assert (way_m[:, 2].abs() <= 0.1 * way_m[:, :2].norm(dim=1)).all()
    assert way_m[:, :2].sign().unique(dim=0).shape == (4, 2)


def test_waypoints_lie_in_their_box_and_are_reached():
    targets = flights("waypoints", num_chases=60)
    start_m = targets[0].position_m
    next_m = torch.stack([target.plan.next_m for target in targets[1:]], dim=1)
    from_home_m = next_m - start_m[:, None]
    assert (from_home_m.abs() <= torch.tensor([100.0, 100.0, 25.0]) + 1e-9).all()
    assert from_home_m[..., :2].abs().amax() > 95
    changes = (next_m.diff(dim=1) != 0).any(dim=2)
    # Places are 100 m apart, more or less: 20 s at 5 m/s.
    assert 4 < changes.sum(dim=1).double().mean() < 7
    nearness_m = (next_m[:, :-1] - places_m(targets)[:, 1:-1]).norm(dim=2)
    assert nearness_m[changes].max() <= 5
    # Nobody misses a place by more than it takes to turn.
    assert ((places_m(targets) - start_m[:, None]).abs().amax(dim=(0, 1)) <= torch.tensor([103.0, 103.0, 28.0])).all()


def test_the_velocity_in_mind_of_one_that_wanders_is_an_ornstein_uhlenbeck_process():
    """1.5 times the speed on each level axis, half of it in height; correlation exp(-t / 5 s)."""
    targets = flights("wander", num_chases=600, seconds=15.0, still_swarm=True)
    wanted_mps = torch.stack([target.plan.wanted_mps for target in targets[1::10]], dim=1).numpy()
    assert np.sqrt((wanted_mps**2).mean(axis=(0, 1))) == pytest.approx([7.5, 7.5, 2.5], rel=0.05)
    for lag in (1, 10, 20):  # half a second each
        correlation = (wanted_mps[:, lag:] * wanted_mps[:, :-lag]).mean() / (wanted_mps**2).mean()
        assert correlation == pytest.approx(math.exp(-lag / 10), abs=0.05)
    speed_mps = velocities_mps(targets)[:, 100:].norm(dim=2)
    assert speed_mps.mean() == pytest.approx(4.5, abs=0.3)


@pytest.mark.parametrize(("speed_mps", "held_mps"), [(5.0, (5.0, 5.0)), (14.0, (72**0.5, 14.0))])
def test_a_circle_has_its_radius(speed_mps, held_mps):
    """At 4 m/s2, nine tenths of them for the circle, 20 m allow sqrt(3.6 * 20) m/s and 60 m more than 14 m/s."""
    targets = flights("circle", num_chases=60, target_speed_mps=speed_mps, seconds=60.0)
    plan = targets[0].plan
    offset_m = places_m(targets)[:, 200:] - plan.center_m[:, None]
    assert (offset_m[..., :2].norm(dim=2) - plan.radius_m[:, None]).abs().max() < 0.1
    assert offset_m[..., 2].abs().max() < 1e-9
    assert 20 <= plan.radius_m.min() < 23
    assert 57 < plan.radius_m.max() <= 60
    speeds_mps = velocities_mps(targets)[:, 200:].norm(dim=2)
    assert speeds_mps.min() == pytest.approx(held_mps[0], rel=0.05)
    assert speeds_mps.max() == pytest.approx(held_mps[1], rel=0.01)
    turned = torch.linalg.cross(offset_m[:, 0], velocities_mps(targets)[:, 200])[:, 2].sign()
    assert torch.equal(turned, plan.turning)
    assert 15 < (turned > 0).sum() < 45


def test_stop_and_go_stops_half_of_the_time_for_5_to_15_s():
    targets = flights("stop-and-go", num_chases=200)
    is_going = torch.stack([target.plan.is_going for target in targets[1:]], dim=1)
    assert is_going.double().mean() == pytest.approx(0.5, abs=0.04)
    assert is_going[:, 0].double().mean() == pytest.approx(0.5, abs=0.12)
    changes = is_going.diff(dim=1).nonzero()
    legs_s = torch.cat([changes[changes[:, 0] == chase, 1].diff() for chase in range(200)]) * FLIGHT_STEP_S
    assert 5 - FLIGHT_STEP_S <= legs_s.min() < 5.2
    assert 14.8 < legs_s.max() <= 15 + FLIGHT_STEP_S
    speed_mps = velocities_mps(targets)[:, 1:].norm(dim=2)
    # 1.25 s to get going and as much to stop, in 10 s.
    assert (speed_mps < 1e-9).double().mean() == pytest.approx(0.5 * (1 - 0.125), abs=0.04)
    assert (speed_mps > 5 - 1e-9).double().mean() == pytest.approx(0.5 * (1 - 0.125), abs=0.04)


def test_who_flees_flies_straight_away():
    targets = flights("flee", seconds=20.0, still_swarm=True, lowest_altitude_m=None, highest_altitude_m=None)
    start_m, end_m = targets[0].position_m, targets[-1].position_m
    gain_m = 5 * (20 - 1.25 / 2)
    assert torch.allclose(end_m, start_m * (1 + gain_m / start_m.norm(dim=1, keepdim=True)))


def test_who_jinks_turns_off_by_at_most_70_degrees_every_1_5_to_4_s():
    targets = flights("jink", num_chases=100, seconds=60.0, still_swarm=True, lowest_altitude_m=None)
    turn_deg = torch.stack([target.plan.turn_rad for target in targets[1:]], dim=1).rad2deg()
    assert -70 <= turn_deg.min() < -68
    assert 68 < turn_deg.max() <= 70
    climb = torch.stack([target.plan.climb for target in targets[1:]], dim=1)
    assert 0.29 < climb.abs().max() <= 0.3
    changes = turn_deg.diff(dim=1).nonzero()
    turns_s = torch.cat([changes[changes[:, 0] == chase, 1].diff() for chase in range(100)]) * FLIGHT_STEP_S
    assert 1.5 - FLIGHT_STEP_S <= turns_s.min() < 1.6
    assert 3.9 < turns_s.max() <= 4 + FLIGHT_STEP_S
    # What it flies is what it has in mind, seconds after it has changed it: seen from the swarm, which stands still.
    position_m, velocity_mps = places_m(targets)[:, 1:, :2], velocities_mps(targets)[:, 1:, :2]
    flown_deg = bearing_deg(velocity_mps) - bearing_deg(position_m)
    flown_deg = (flown_deg + 180) % 360 - 180
    assert flown_deg[:, 40:].abs().max() < 75
    settled = (turn_deg[:, 60:] == turn_deg[:, :-60]) & (turn_deg[:, 60:] == turn_deg[:, 30:-30])
    assert (flown_deg[:, 60:] - turn_deg[:, 60:])[settled].abs().max() < 5


def bearing_deg(vector):
    return torch.atan2(vector[..., 1], vector[..., 0]).rad2deg()


@pytest.mark.parametrize("fleeing", ["flee", "jink"])
def test_who_does_not_notice_the_swarm_hovers(fleeing):
    behaviour, target = begun(fleeing, chase_keys(0, 3), alert_distance_m=50.0)
    nothing = torch.zeros_like(target.position_m)
    towards = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    start_m = target.position_m
    for distance_m, flies in ((50.1, False), (49.9, True)):
        target = behaviour.begin(chase_keys(0, 3), start_m)
        target = behaviour.fly(target, steps(3), Swarm(start_m + distance_m * towards, nothing))
        assert (target.velocity_mps.norm(dim=1) > 0).tolist() == [flies] * 3
    # It has noticed it and loses it again: it comes to rest, 4 m/s2.
    for _ in range(200):
        target = behaviour.fly(target, steps(3), Swarm(target.position_m + 90.0 * towards, nothing))
    assert target.velocity_mps.norm(dim=1).max() < 1e-9


def test_the_names():
    assert [name for name in behaviour_names() if name in NAMES] == NAMES
    assert all("_" not in name for name in NAMES)


@pytest.mark.parametrize(
    ("given_name", "message"),
    [
        (
            "waypoint",
            "no behaviour 'waypoint' (did you mean waypoints?); there are hover, straight, waypoints, wander, ",
        ),
        ("stop_and_go", "no behaviour 'stop_and_go' (did you mean stop-and-go?); there are "),
        ("xyz", "no behaviour 'xyz'; there are hover, straight, waypoints, wander, circle, stop-and-go, flee, jink"),
    ],
)
def test_a_name_that_nobody_knows_is_refused(given_name, message):
    with pytest.raises(InputError) as refusal:
        load_behaviour(paper_scenario(behaviour=given_name))
    assert str(refusal.value).startswith(message)
    assert str(refusal.value).endswith(", or give the path of a track (.csv)")
    assert "\n" not in str(refusal.value)


def test_a_behaviour_that_flies_needs_a_speed():
    assert load_behaviour(paper_scenario(behaviour="hover")).is_still
    with pytest.raises(InputError, match=r"^behaviour = 'flee' needs a target_speed_mps that is greater than 0$"):
        load_behaviour(paper_scenario(behaviour="flee"))


@pytest.fixture
def plug_in(tmp_path, monkeypatch):
    """Another package that is installed and offers three behaviours: one is not there, and one is none."""
    (tmp_path / "spirals.py").write_text(
        "from swarmchase.world.behaviours.hover import Hover\n\n\nclass Spiral(Hover):\n    is_still = False\n"
    )
    about = tmp_path / "spirals-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: spirals\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[swarmchase.behaviours]\nspiral = spirals:Spiral\nlost = nowhere:Lost\nnone = builtins:slice\n"
    )
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("plug_in")
def test_other_packages_can_bring_behaviours():
    assert behaviour_names()[-3:] == ["lost", "none", "spiral"]
    assert not load_behaviour(paper_scenario(behaviour="spiral")).is_still
    with pytest.raises(InputError, match=r"^behaviour 'lost' of nowhere:Lost cannot be loaded: No module named"):
        load_behaviour(paper_scenario(behaviour="lost"))
    with pytest.raises(InputError, match=r"^behaviour 'none' of builtins:slice has not all of begin, fly, is_still$"):
        load_behaviour(paper_scenario(behaviour="none"))
