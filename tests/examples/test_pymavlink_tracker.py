"""examples/pymavlink_tracker.py follows docs/link.md and knows nothing of the package; the real service commands it."""

import re
import runpy
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pymavlink", reason="the MAVLink link needs pymavlink: pip install swarmchase[live]")

from pymavlink import mavutil

from swarmchase import load_controller
from swarmchase.live.clock import MonotonicClock
from swarmchase.live.link.keys import new_keys, write_keys
from swarmchase.live.link.mavlink import ControllerMavlinkLink
from swarmchase.live.link.messages import RssiWindow, SetPoint, TrackerMode
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.live.service.service import ControllerService
from swarmchase.scenario import paper_scenario

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "examples" / "pymavlink_tracker.py"
KEYS = new_keys()
PATIENCE_S = 120.0
PLACES_M = [(3, 0, 20), (-3, 0, 20), (0, 3, 20), (0, -3, 20), (0, 0, 23), (0, 0, 17)]
EAST_IS_LOUDER_DBM = [-60, -62, -61, -61, -61, -61]
SCENARIO = paper_scenario(sampling_hz=50, window_samples=10)


def begun_service(link: ControllerMavlinkLink, epoch: int) -> ControllerService:
    controller, clock = load_controller("gradient", SCENARIO), MonotonicClock()
    service = ControllerService(SCENARIO, controller, link, clock, SafetyLimits(), lambda _: None, epoch)
    service.start()
    return service


def run_until(service: ControllerService, link: ControllerMavlinkLink, is_so: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < deadline_s, (service.snapshot(), link.rejected)
        service.step()
        link.wait(0.05)


def center_east_m(service: ControllerService) -> float:
    places_m = [tracker.position_m for tracker in service.snapshot().trackers]
    return sum(float(place_m[0]) for place_m in places_m if place_m is not None) / 6


@pytest.fixture
def swarm(tmp_path: Path) -> Iterator[tuple[ControllerMavlinkLink, Path]]:
    """Six of them, and the link that they dial."""
    write_keys(tmp_path / "keys", KEYS)
    link = ControllerMavlinkLink("127.0.0.1", 0, KEYS, state_path=tmp_path / "state")
    words = f"--keys {tmp_path / 'keys'} --service 127.0.0.1:{link.address[1]} --sampling-hz 50".split()
    trackers = []
    for number, (place_m, level_dbm) in enumerate(zip(PLACES_M, EAST_IS_LOUDER_DBM, strict=True)):
        own = ["--number", str(number), "--place", *map(str, place_m), f"--level-dbm={level_dbm}"]
        trackers.append(subprocess.Popen([sys.executable, "-I", str(SCRIPT), *words, *own]))
    try:
        yield link, tmp_path / "state"
    finally:
        for tracker in trackers:
            tracker.kill()
            tracker.wait()


def test_it_obeys_and_outlives_the_service(swarm: tuple[ControllerMavlinkLink, Path]) -> None:
    link, state_path = swarm
    port = link.address[1]
    with closing(link):
        service = begun_service(link, epoch=1)
        run_until(service, link, lambda: center_east_m(service) > 2)  # one movement takes them 4 m east
        assert {tracker.mode for tracker in service.snapshot().trackers} == {TrackerMode.FOLLOWING}
        east_m = center_east_m(service)
    link = ControllerMavlinkLink("127.0.0.1", port, KEYS, state_path=state_path)
    with closing(link):
        service = begun_service(link, epoch=2)
        run_until(service, link, lambda: center_east_m(service) > east_m + 2)
        assert service.snapshot().movements == 1
        assert set(link.rejected) <= {"too old", "overflow"}  # what was under way at the start
        assert {round(abs(skew_s)) for skew_s in link.skew_s.values()} == {0}


class Example:
    """One tracker of the example in this process, at a controller whose clock is put anywhere."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("MAVLINK20", "1")
        self.ahead_s = 0.0
        clocks: Any = dict.fromkeys(("wall_time_ns", "monotonic_ns"), self._real_time_ns)
        self.link = ControllerMavlinkLink("127.0.0.1", 0, KEYS, **clocks)
        kind: Any = runpy.run_path(str(SCRIPT))["Tracker"]
        address = f"127.0.0.1:{self.link.address[1]}"
        self.tracker = kind(2, KEYS[2], address, (0.0, 0.0, 20.0), -60.0, 50.0)

    def _real_time_ns(self) -> int:
        return time.time_ns() + round(self.ahead_s * 1e9)

    def obeys(self, ahead_s: float, east_m: float, key: bytes | None = None) -> bool:
        """Whether it takes a set-point that is signed so long ahead, here with another key than its own."""
        self.tracker.report()
        while not self.link.receive():
            self.link.wait(0.05)
        self.ahead_s = ahead_s
        if key is not None:
            self.link._keys = {**self.link._keys, 2: key}
        self.link.send(SetPoint(2, 10**9, 1, (east_m, 0.0, 20.0)))
        self.link._keys, self.ahead_s = KEYS, 0.0
        assert select.select([self.tracker.link.port], [], [], PATIENCE_S)[0]
        self.tracker.listen()
        return bool(self.tracker.goal == (east_m, 0.0, 20.0))

    def close(self) -> None:
        self.tracker.link.close()
        self.link.close()


def test_it_neither_takes_what_is_old_nor_is_silenced_by_a_forgery(monkeypatch: pytest.MonkeyPatch) -> None:
    with closing(Example(monkeypatch)) as example:
        assert example.obeys(0.0, 1.0)
        assert not example.obeys(1000.0, 2.0, key=bytes(range(32)))
        assert example.obeys(0.0, 3.0)
    with closing(Example(monkeypatch)) as example:
        assert not example.obeys(-3.0, 1.0)
        assert not example.obeys(61.0, 2.0)


def test_on_its_way_it_goes_on_without_news_and_says_what_it_has_obeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    with closing(Example(monkeypatch)) as example:
        assert example.obeys(0.0, 0.0)
        example.tracker.report()
        while not (heard := [one for one in example.link.receive() if isinstance(one, RssiWindow)]):
            example.link.wait(0.05)
        assert heard[-1].obeyed_ms == 1000
        tracker, now_s = example.tracker, time.monotonic()
        for told_s, valid_s, east_m in ((0.2, 1.5, 0.4), (1.2, 1.5, 2.4), (1.7, 1.5, None), (0.9, 0.2, 0.4)):
            tracker.goal, tracker.place, tracker.moves_mps = (0.0, 0.0, 20.0), (0.0, 0.0, 20.0), (2.0, 0.0, 0.0)
            tracker.told_s, tracker.valid_s = now_s - told_s, valid_s
            monkeypatch.setattr(time, "monotonic", lambda: now_s)
            tracker.fly()
            # It flies half a metre in a step, and no further than to where that place has moved.
            assert tracker.place[0] == pytest.approx(0.0 if east_m is None else min(east_m, 0.5))


def test_it_uses_nothing_of_the_package() -> None:
    assert not re.search(r"^\s*(from|import) +swarmchase", SCRIPT.read_text(encoding="utf-8"), re.MULTILINE)


def test_plain_pymavlink_is_locked_out_and_the_two_lines_cure_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The lines are those of docs/link.md. That time has passed is told to the controller's clocks."""
    monkeypatch.setenv("MAVLINK20", "1")
    passed_s = 0.0

    def real_time_ns() -> int:
        return time.time_ns() + round(passed_s * 1e9)

    with closing(
        ControllerMavlinkLink("127.0.0.1", 0, KEYS, wall_time_ns=real_time_ns, monotonic_ns=real_time_ns)
    ) as link:
        connection: Any = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{link.address[1]}", source_system=3, source_component=191, dialect="common"
        )
        connection.setup_signing(KEYS[2], link_id=0)

        def is_heard() -> bool:
            before = link.rejected.total()
            connection.mav.heartbeat_send(18, 8, 17, 0, 4)
            for _ in range(int(PATIENCE_S / 0.05)):
                link.wait(0.05)
                if heard := link.receive():
                    return len(heard) == 1
                if link.rejected.total() > before:
                    return False
            raise AssertionError("nothing has come")

        assert is_heard()
        passed_s = 1000.0
        assert not is_heard()
        assert link.rejected == {"too old": 1}
        assert link.rejections.skew_s()["too old"]["tracker 2"] == pytest.approx(-1000, abs=10)
        code = re.search(r"^    signed = .*\n    connection.*\n", (ROOT / "docs" / "link.md").read_text(), re.MULTILINE)
        assert code
        lines = "\n".join(line.strip() for line in code[0].splitlines())
        shifted = type("time", (), {"time": staticmethod(lambda: time.time() + passed_s)})
        names: dict[str, Any] = {"connection": connection, "time": shifted, "signed": 0}
        for _ in range(3):
            exec(lines, names)
            assert is_heard()
        connection.close()
