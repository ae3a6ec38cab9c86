"""A recorded track: where the target is when, and files that are none."""

import pytest
import torch

from swarmchase.batch.streams import chase_keys
from swarmchase.errors import InputError
from swarmchase.flight import FLIGHT_STEP_S
from swarmchase.scenario import paper_scenario
from swarmchase.world.behaviours import Swarm, load_behaviour

START_M = torch.tensor([[100.0, 0.0, 0.0]], dtype=torch.float64)


def behaviour_of(path, **changes):
    return load_behaviour(paper_scenario(**{"behaviour": str(path), "target_speed_mps": 8.0} | changes))


def place_after_m(behaviour, seconds):
    """From its start."""
    target = behaviour.begin(chase_keys(0, 1), START_M)
    swarm = Swarm(torch.zeros_like(START_M), torch.zeros_like(START_M))
    for _ in range(round(seconds / FLIGHT_STEP_S)):
        target = behaviour.fly(target, torch.full((1,), FLIGHT_STEP_S, dtype=torch.float64), swarm)
    return (target.position_m - START_M)[0].tolist()


@pytest.mark.parametrize("header", ["time_s,x_m,y_m,z_m", "time_s,east_m,north_m,up_m"])
def test_a_target_is_where_the_track_is(tmp_path, header):
    """4 m/s east for 10 s, 3 m/s north for 10 s, and there it stays. Times and places begin anywhere."""
    path = tmp_path / "track.csv"
    path.write_text(f"{header},battery\n1000,7,5,20,9\n1010,47,5,20,8\n1020,47,35,20,7\n")
    behaviour = behaviour_of(path)
    for seconds, place_m in [(8, (32, 0, 0)), (18, (40, 24, 0)), (25, (40, 30, 0)), (90, (40, 30, 0))]:
        assert place_after_m(behaviour, seconds) == pytest.approx(place_m, abs=0.1)


def test_one_that_the_track_leaves_behind_catches_up(tmp_path):
    """10 m/s for 10 s is too much for 8 m/s; 10 s later it is there."""
    path = tmp_path / "track.csv"
    path.write_text("z_m,time_s,x_m,y_m\n0,0,0,0\n0,10,0,100\n0,30,0,100\n")
    assert place_after_m(behaviour_of(path), 10) == pytest.approx((0, 72, 0), abs=0.5)
    assert place_after_m(behaviour_of(path), 20) == pytest.approx((0, 100, 0), abs=0.1)


def test_a_track_that_leaves_the_altitude_band_is_followed_within_it(tmp_path):
    path = tmp_path / "track.csv"
    path.write_text("time_s,x_m,y_m,z_m\n0,0,0,0\n20,0,0,100\n")
    assert place_after_m(behaviour_of(path, highest_altitude_m=80.0), 40) == pytest.approx((0, 0, 30), abs=0.1)


def test_two_rows_of_one_moment_are_a_jump(tmp_path):
    path = tmp_path / "track.csv"
    path.write_text("time_s,x_m,y_m,z_m\n0,0,0,0\n5,0,0,0\n5,20,0,0\n6,20,0,0\n")
    assert place_after_m(behaviour_of(path), 4.9) == pytest.approx((0, 0, 0), abs=1e-9)
    assert place_after_m(behaviour_of(path), 20) == pytest.approx((20, 0, 0), abs=0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "track {} needs columns time_s,x_m,y_m,z_m or time_s,east_m,north_m,up_m: it has "),
        (
            "time_s,x_m,y_m\n0,0,0\n",
            "track {} needs columns time_s,x_m,y_m,z_m or time_s,east_m,north_m,up_m: it has time_s,x_m,y_m",
        ),
        ("time_s,x_m,y_m,z_m\n", "track {} has too few rows: 0, needed are at least 2"),
        ("time_s,x_m,y_m,z_m\n0,0,0,0\n", "track {} has too few rows: 1, needed are at least 2"),
        (
            "time_s,x_m,y_m,z_m\n0,0,0,0\n2,0,0,0\n1.5,0,0,0\n",
            "track {} goes back in time: row 3 is of 1.5 s, after 2 s",
        ),
        ("time_s,x_m,y_m,z_m\n0,0,0,0\n1,inf,0,0\n", "track {}: row 2 has x_m = 'inf'; a finite number is needed"),
        ("time_s,x_m,y_m,z_m\n0,0,0,0\nnan,0,0,0\n", "track {}: row 2 has time_s = 'nan'; a finite number is needed"),
        ("time_s,x_m,y_m,z_m\n0,0,0,up\n1,0,0,0\n", "track {}: row 1 has z_m = 'up'; a finite number is needed"),
        ("time_s,x_m,y_m,z_m\n0,0,0,0\n1,0\n", "track {}: row 2 has y_m = None; a finite number is needed"),
    ],
)
def test_a_file_that_is_no_track_is_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "track.csv"
    path.write_text(text)
    with pytest.raises(InputError) as refusal:
        behaviour_of(path)
    assert str(refusal.value) == message.format(path)


def test_a_track_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"^cannot read track .*lost\.csv: No such file or directory$"):
        behaviour_of(tmp_path / "lost.csv")
