"""Trackers that lie or fail in whole live chases: they are named, and the others reach the target without them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jaxtyping
import pytest

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")

from swarmchase import load_controller
from swarmchase.benchmarks import liars
from swarmchase.benchmarks.live import LiveWork
from swarmchase.levels import NoLevel
from swarmchase.live.alarms import Alarms
from swarmchase.live.chronicle import Chronicle
from swarmchase.live.events import Events
from swarmchase.live.service.chase_state import Snapshot
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.scenario import paper_scenario
from swarmchase.simulation.fault_plan import fault_plan
from swarmchase.simulation.virtual_chase import START_NS, VirtualChase

SCENARIO = paper_scenario(sampling_hz=100, spatial_correlation=0.9, start_distance_m=45, max_movements=25)
ASTRAY = "m from where the others say that it must be"
CONTRADICTS = "its level contradicts what the others hear"
NOT_FOLLOWED = "it has not followed for 2 movements"


@pytest.fixture(scope="module", autouse=True)
def _without_type_checks() -> Iterator[None]:
    """Of each call they would take ten times as long as the chases themselves."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", before)


@pytest.mark.parametrize(
    ("faults", "reasons"),
    [
        ("stays={0}@0", [ASTRAY, NOT_FOLLOWED]),
        ("fence={0}@0", [ASTRAY, NOT_FOLLOWED]),
        ("offset={0}@0,loud={1}@0", [f"it says that it is 29.9 {ASTRAY}", NoLevel.TOO_STRONG]),
    ],
)
def test_who_lies_is_named_and_the_others_reach_the_target(faults: str, reasons: list[str]) -> None:
    result = liars.fly(LiveWork(SCENARIO, "recurrent", 4, 3), faults)
    assert result.chase.reached
    assert result.chase.movements <= 18
    assert sorted(result.left_out) == list(result.liars)
    assert all(any(why.endswith(reason) for reason in reasons) for why in result.left_out.values())
    assert result.honest_separation_m >= SafetyLimits().minimum_separation_m


class Seen:
    """A chase as people see it: lines on the console, and frames."""

    def __init__(self, faults: str, **changes: Any) -> None:
        self.scenario = paper_scenario(sampling_hz=100, spatial_correlation=0.9, **changes)
        self.lines: list[str] = []
        self.frames: list[Any] = []
        controller = load_controller("recurrent", self.scenario)
        self.chase = VirtualChase(self.scenario, controller, 1, 0, fault_plan(faults), watch=self._watch)
        self.events = Events(Alarms(self.chase.link), [lambda event: self.lines.append(event.text)])
        self.chronicle = Chronicle(self.chase.link, START_NS, [self.frames.append], self.events)

    def _watch(self, snapshot: Snapshot) -> None:
        self.events(snapshot)
        self.chronicle(snapshot, None)


def test_who_is_left_out_is_told_on_the_console_and_in_every_frame_and_may_come_back() -> None:
    """Deaf for ten seconds: named after three windows, back after three that are no doubt."""
    seen = Seen("deaf=4@3-13", start_distance_m=45)
    seen.chase.run()
    assert [line for line in seen.lines if line.startswith("tracker 4")] == [
        "tracker 4 is there",
        f"tracker 4 is left out: {CONTRADICTS}",
        "tracker 4 is there",
    ]
    left_out = [frame["trackers"][4]["left_out"] for frame in seen.frames]
    assert set(left_out) == {"", CONTRADICTS}
    assert left_out[-1] == ""
    assert all(frame["trackers"][one]["left_out"] == "" for frame in seen.frames for one in (0, 1, 2, 3, 5))
    # It flies on with the others all the time.
    assert all(frame["trackers"][4]["set_point_m"] for frame in seen.frames[5:])


def test_the_log_holds_who_was_left_out(tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="the log needs: pip install 'swarmchase[live]'")
    from swarmchase.live.log.entries import new_head
    from swarmchase.live.log.recorder import ChaseRecorder
    from swarmchase.live.log.recording import read_recording

    seen = Seen("origin=2@0", start_distance_m=20)
    head = new_head("recurrent", seen.scenario, 1, 0, 1, SafetyLimits(), START_NS)
    with ChaseRecorder(tmp_path / "chase.mcap", head) as recorder:
        seen.chronicle = Chronicle(seen.chase.link, START_NS, [recorder.record_frame], seen.events)
        for _ in range(120):
            seen.chase.tick()
    *_, last = read_recording(tmp_path / "chase.mcap").frames()
    named = [tracker["left_out"] for tracker in last["trackers"]]
    assert named == ["", "", f"it says that it is 1000.0 {ASTRAY}", "", "", ""]
