"""The preflight: check by check, and that nobody is led before it has passed or was overridden."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from live_bench import CONNECTING, SAMPLING, Bench, FakeTracker
from swarmchase.live.link.messages import TrackerMode, VehicleState
from swarmchase.live.service.limit_values import LimitValues
from swarmchase.live.service.preflight import beyond_the_fence, failing
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.scenario import paper_scenario

REAL = VehicleState(is_armed=True, is_airborne=True, is_simulated=False)
OWN_LIMITS = SafetyLimits(fence_east_m=150.0, lowest_altitude_m=-90.0)
"""Of the place: the bench's formation, 30 m up, and its target have room in it."""


def failed(bench: Bench) -> list[tuple[int | None, str]]:
    return [(one.tracker, one.name) for one in bench.service.snapshot().preflight if one.passed is False]


def flown_by(bench: Bench, vehicle: VehicleState) -> Bench:
    for tracker in bench.trackers:
        tracker.vehicle = vehicle
    return bench


def test_six_simulated_vehicles_pass_at_once() -> None:
    bench = Bench()
    assert bench.run_until(SAMPLING) <= 0.2
    assert bench.service.snapshot().preflight == ()


def test_real_vehicles_pass_once_their_positions_have_come_for_a_moment() -> None:
    bench = flown_by(Bench(limits=OWN_LIMITS), REAL)
    bench.run(0.1)
    assert failed(bench) == [(number, "positions") for number in range(6)]
    assert bench.run_until(SAMPLING) <= 0.5
    assert bench.reason == "6 trackers are there"


def silenced(tracker: FakeTracker) -> None:
    tracker.hears = False


def on_the_ground(tracker: FakeTracker) -> None:
    tracker.vehicle = VehicleState(is_armed=True, is_airborne=False, is_simulated=False)


def not_armed(tracker: FakeTracker) -> None:
    tracker.vehicle, tracker.mode = VehicleState(False, False, False), TrackerMode.MANUAL


def of_a_pilot(tracker: FakeTracker) -> None:
    tracker.mode = TrackerMode.MANUAL


def away(tracker: FakeTracker) -> None:
    tracker.position_m = tracker.target_m = tracker.position_m + np.array([0.0, 12.0, 0.0])


def outside(tracker: FakeTracker) -> None:
    tracker.position_m = tracker.target_m = tracker.position_m + np.array([200.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("wrong", "names"),
    [
        (silenced, ["levels"]),
        (on_the_ground, ["airborne"]),
        (not_armed, ["armed", "airborne", "mode"]),
        (of_a_pilot, ["mode"]),
        (away, ["place"]),
        (outside, ["inside the fence", "place"]),
    ],
)
def test_what_is_wrong_with_one_is_named_and_holds_all_until_it_is_overridden(
    wrong: Callable[[FakeTracker], None], names: list[str]
) -> None:
    bench = flown_by(Bench(limits=OWN_LIMITS), REAL)
    wrong(bench.trackers[4])
    bench.run(10)
    assert bench.service.state is CONNECTING
    assert failed(bench) == [(4, name) for name in names]
    bench.service.override()
    bench.run_until(SAMPLING)
    begun, *said = bench.reason.split("; ")
    assert begun in {"5 trackers are there", "6 trackers are there"}
    assert said[0].startswith(f"overridden: tracker 4 {names[0]} (")


def test_slow_telemetry_holds_it_up() -> None:
    """Positions every .6 s, which is what a fourth stream rate of an autopilot gives."""
    bench = flown_by(Bench(limits=OWN_LIMITS), REAL)
    slow = bench.trackers[1]
    every = slow.reports

    def seldom(now_ns: int, sampling_hz: float) -> list[object]:
        said = every(now_ns, sampling_hz)
        return said if now_ns // 50_000_000 % 12 == 0 else [said[0], *said[2:]]

    slow.reports = seldom  # type: ignore[method-assign, assignment]
    bench.run(5)
    assert failed(bench) == [(1, "positions")]


def test_a_clock_that_is_ahead_holds_it_up() -> None:
    bench = flown_by(Bench(limits=OWN_LIMITS), REAL)
    bench.link.clocks_ahead_s = lambda: [0.0, 0.2, 1.4, -0.1, None, 0.0]  # type: ignore[method-assign]
    bench.run(5)
    assert failed(bench) == [(2, "clock")]


@pytest.mark.parametrize(
    ("limits", "named"),
    [
        (SafetyLimits(), "real vehicles need --fence-..-m and --lowest-altitude-m"),
        (SafetyLimits(fence_north_m=90.0), "real vehicles need --lowest-altitude-m"),
        (SafetyLimits(lowest_altitude_m=10.0), "real vehicles need --fence-..-m"),
        (SafetyLimits(lowest_altitude_m=10.0, fence_west_m=-90.0), None),
    ],
)
def test_limits_that_nobody_gave_cannot_be_overridden(limits: SafetyLimits, named: str | None) -> None:
    bench = flown_by(Bench(limits=limits), REAL)
    bench.service.override()
    bench.run(5)
    assert (bench.service.state is CONNECTING) == (named is not None)
    if named is not None:
        still = failing(bench.service.snapshot().preflight, overridden=True)
        assert [(one.name, one.text) for one in still] == [("limits", named)]


def test_one_that_does_not_say_whether_it_flies_holds_up_nothing() -> None:
    bench = flown_by(Bench(limits=OWN_LIMITS), VehicleState(is_armed=True, is_airborne=None, is_simulated=False))
    bench.run_until(SAMPLING)
    assert bench.reason.startswith("6 trackers are there")


def test_override_counts_before_the_start_alone() -> None:
    bench = Bench()
    bench.run_until(SAMPLING)
    bench.service.override()
    bench.service.hold()
    assert bench.service.snapshot().preflight == ()


@pytest.mark.parametrize(
    ("start_distance_m", "center_m", "limits", "words"),
    [
        (100, (0.0, 0.0, 0.0), LimitValues(), ""),
        (
            250,
            (0.0, 0.0, 0.0),
            LimitValues(),
            "200 m west, 200 m east, 200 m south, 200 m north, 150 m below, 150 m above",
        ),
        (100, (120.0, 0.0, 0.0), LimitValues(), "80 m east"),
        # Within the success radius of 2 m of the fence it is still reached.
        (100, (102.0, 0.0, 0.0), LimitValues(), ""),
        (100, (0.0, 0.0, 30.0), LimitValues(lowest_altitude_m=5.0), "25 m below"),
    ],
)
def test_how_far_a_target_may_be_beyond_the_limits(
    start_distance_m: float, center_m: tuple[float, float, float], limits: LimitValues, words: str
) -> None:
    told = beyond_the_fence(paper_scenario(start_distance_m=float(start_distance_m)), limits, center_m)
    assert told == (f"the target may be {start_distance_m} m away, and the limits end {words}" if words else "")


def test_the_start_says_that_the_target_may_be_out_of_reach() -> None:
    scenario = paper_scenario(window_samples=10, start_distance_m=250.0)
    bench = Bench(scenario)
    bench.run_until(SAMPLING)
    assert bench.reason.startswith("6 trackers are there; the target may be 250 m away, and the limits end 210 m west")
    assert math.isfinite(bench.service.snapshot().trackers[0].position_age_s)
