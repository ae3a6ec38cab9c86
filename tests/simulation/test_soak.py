"""A live chase that goes on and on holds no more than it did. ``swarmchase benchmark soak`` watches it for an hour."""

import dataclasses
import gc
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from swarmchase import load_controller, paper_scenario
from swarmchase.benchmarks.soak import END_S, _watch, endless
from swarmchase.errors import WorkerDiedError
from swarmchase.live.alarms import Alarms
from swarmchase.live.chronicle import Chronicle
from swarmchase.live.events import Events
from swarmchase.live.link.messages import FARTHEST_M
from swarmchase.live.service.settings import ServiceSettings
from swarmchase.scenario import load_scenario
from swarmchase.simulation.fault_plan import fault_plan
from swarmchase.simulation.site import site_limits
from swarmchase.simulation.virtual_chase import START_NS, VirtualChase

WARM_UP_S, SOAK_S = 40.0, 80.0
MOST_GROWTH_BLOCKS = 1000
"""Of Python's memory. Ten messages a second of six trackers, kept by mistake, would be 2,400 and more."""


def test_what_a_chase_holds_does_not_grow() -> None:
    scenario = paper_scenario(sampling_hz=10, spatial_correlation=0.9, start_distance_m=20.0)
    controller = load_controller("gradient", scenario)
    settings = ServiceSettings(reached_windows=0)  # nobody ever says that it is reached
    plan = fault_plan("loss=0.1,duplicate=0.1,replay=0.1,forge=20")
    chase = VirtualChase(scenario, controller, 0, 0, plan, settings)
    events = Events(Alarms(chase.link))
    chronicle = Chronicle(chase.link, START_NS, [lambda _frame: None], events)
    chase._recorder = events.record
    chase._watch = lambda snapshot: (events(snapshot), chronicle(snapshot, None))[0]

    def held_after(seconds: float) -> int:
        while chase.clock.now_ns() < START_NS + seconds * 1e9:
            chase.tick()
        gc.collect()
        return sys.getallocatedblocks()

    before = held_after(WARM_UP_S)
    movements = chase.service.snapshot().movements
    growth = held_after(SOAK_S) - before
    assert chase.service.snapshot().movements > movements + 4
    assert growth < MOST_GROWTH_BLOCKS


def test_nothing_ends_a_flight_within_the_time_and_its_target_stays_inside_the_fence() -> None:
    scenario = dataclasses.replace(load_scenario("flight"), follow_s=30.0)
    flies = endless(scenario, 3600.0)
    # It is still flying while it is told to end.
    assert flies.max_movements * flies.decision_s == 3600 + END_S
    assert flies.follow_s == 0
    limits = site_limits(flies)
    assert scenario.farthest_start_m is not None
    assert -limits.fence_west_m == limits.fence_east_m == 3660 * scenario.target_speed_mps + scenario.farthest_start_m
    assert site_limits(scenario).fence_east_m == 1800  # two minutes at 5 m/s are less
    assert site_limits(endless(scenario, 1e6)).fence_east_m == FARTHEST_M  # no place further away can be told


def test_a_chase_that_dies_at_the_very_end_is_told_of_with_what_it_said(tmp_path: Path) -> None:
    """Between the last look and the end: else its memory would be nothing, and its result no JSON."""
    (tmp_path / "told.txt").write_text("it goes on\nout of memory\n")
    with subprocess.Popen(["sleep", "60"]) as process:

        def dies(_passed_s: int) -> None:
            process.kill()
            process.wait()

        with pytest.raises(WorkerDiedError, match=r"^the live chase ended by itself after 0 s: out of memory$"):
            _watch(process, 0.2, dies, tmp_path)
