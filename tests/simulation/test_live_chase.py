"""``swarmchase live`` as people start it: a simulated site in real processes, in real time."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")
pytest.importorskip("mcap", reason="the live system needs: pip install 'swarmchase[live]'")

import swarmchase
from swarmchase import load_controller
from swarmchase.batch.streams import chase_keys
from swarmchase.cli import main
from swarmchase.live.link.keys import new_keys, write_keys
from swarmchase.live.log.recording import Recording, read_recording
from swarmchase.live.log.verification import verify
from swarmchase.processes.stop_request import StopRequest
from swarmchase.scenario import paper_scenario
from swarmchase.simulation.fault_plan import FaultPlan
from swarmchase.simulation.live_chase import StageProcess
from swarmchase.simulation.stage import Play
from swarmchase.simulation.tracker_processes import free_udp_ports
from swarmchase.world.environment import Environment

PATIENCE_S = 240.0
"""Nothing here takes a tenth of it, unless the machine is very busy with something else."""
FLIGHT = (Path(swarmchase.__file__).parent / "scenarios" / "flight.toml").read_text()
NEAR = "sampling_hz = 100\nspatial_correlation = 0.5\nstart_distance_m = 12\n"


class Live:
    """``swarmchase live --headless`` in a folder of its own."""

    def __init__(self, folder: Path, *words: str, scenario: str = NEAR) -> None:
        self.folder = folder
        self.temporary = folder / "tmp"
        self.temporary.mkdir()
        (folder / "scenario.toml").write_text(scenario)
        options = ["--headless", "--scenario", "scenario.toml", "--log", "chase.mcap", "--json"]
        self._told = open(folder / "told.txt", "wb")  # noqa: SIM115
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "swarmchase", "live", *options, *words],
            cwd=folder,
            env={**os.environ, "TMPDIR": str(self.temporary)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._told,
            text=True,
        )

    @property
    def told(self) -> str:
        return (self.folder / "told.txt").read_text()

    def wait_for(self, *lines: str) -> None:
        """One of them."""
        deadline_s = time.monotonic() + PATIENCE_S
        while not any(line in self.told for line in lines):
            assert time.monotonic() < deadline_s, self.told
            assert self.popen.poll() is None, self.told
            time.sleep(0.05)

    def end(self) -> tuple[int, str]:
        """Exit code and standard output."""
        output, _ = self.popen.communicate(timeout=PATIENCE_S)
        return self.popen.returncode, output

    def summary(self) -> dict[str, Any]:
        code, output = self.end()
        assert (code, output.count("\n")) == (0, 1), self.told
        summary: dict[str, Any] = json.loads(output)
        return summary

    def recording(self) -> Recording:
        return read_recording(self.folder / "chase.mcap")

    def stage(self) -> int:
        return next(child for child in _children(self.popen.pid) if len(_children(child)) == 6)

    def children(self) -> list[int]:
        """The stage, and the trackers below it."""
        found: list[int] = []
        waiting = [self.popen.pid]
        while waiting:
            below = _children(waiting.pop())
            found += below
            waiting += below
        return found

    def wait_until_nothing_is_left(self, processes: list[int]) -> None:
        """No process, and nothing in the temporary folder."""
        deadline_s = time.monotonic() + PATIENCE_S
        while any(map(_is_running, processes)) or list(self.temporary.iterdir()):
            assert time.monotonic() < deadline_s, (list(filter(_is_running, processes)), list(self.temporary.iterdir()))
            time.sleep(0.05)

    def close(self) -> None:
        for process in [self.popen.pid, *self.children()]:
            if _is_running(process):
                os.kill(process, signal.SIGKILL)
        self.popen.communicate()
        self._told.close()


def _children(process: int) -> list[int]:
    lists = Path(f"/proc/{process}/task").glob("*/children")
    return [int(number) for one in lists for number in one.read_text().split()]


def _is_running(process: int) -> bool:
    """A zombie that nobody has waited for is not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.fixture
def lives() -> Iterator[list[Live]]:
    started: list[Live] = []
    yield started
    for live in started:
        live.close()


def test_without_faults_it_is_the_evaluated_chase(tmp_path: Path, lives: list[Live]) -> None:
    """Movement by movement: windows, places, actions. And asked again, the controller says the same, bit for bit."""
    live = Live(tmp_path, "--seed", "5", "--chase", "2", "--controller", "particle", scenario=NEAR.replace("12", "8"))
    lives.append(live)
    summary = live.summary()
    assert summary.keys() >= {"state", "reached", "movements", "seconds", "decision_latency_p99_ms", "rejected"}
    assert (summary["state"], summary["reached"]) == ("reached", True), live.told
    assert summary["distance_m"] <= 2
    recording = live.recording()
    assert recording.movements == summary["movements"] == len(recording.decisions) > 0
    assert not recording.is_cut
    scenario = recording.head.scenario
    environment, controller = Environment(scenario), load_controller("particle", scenario)
    state, memory = environment.reset(chase_keys(5, 1, 2)), controller.begin(1, 5, 2)
    near = []
    for decision in recording.decisions:
        observation = state.observation()
        action, memory = controller.decide(observation, memory)
        assert decision.rssi_dbm == pytest.approx(observation.rssi_dbm[0].double().numpy(), abs=2e-3)
        assert decision.tracker_position_m == pytest.approx(observation.tracker_position_m[0].numpy(), abs=1e-3)
        assert (decision.spacing_m, *decision.displacement_m) == (
            action.spacing_m.item(),
            *action.displacement_m[0].tolist(),
        )
        state, outcome = environment.step(state, action)
        near.append(bool(outcome.reached))
    assert summary["movements_to_target"] == near.index(True) + 1
    assert verify(recording).is_same
    targets = {tuple(frame["target_m"] or ()) for frame in recording.frames()}
    assert targets == {tuple(np.round(state.target_position_m[0].numpy(), 3))}


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="no /proc here to find processes in")
def test_in_flight_it_pursues_a_target_that_flies_until_a_tracker_is_told_to_end(
    tmp_path: Path, lives: list[Live]
) -> None:
    """Which ends the whole command and keeps the log. Asked again, the controller says the same, bit for bit.

    The swarm begins within the success radius, and nobody says so: it has captured the target, and does not follow it.
    """
    near = ("--start-distance-m", "1.5", "--farthest-start-m", "1.6", "--reached-windows", "0")
    live = Live(tmp_path, "--behaviour", "waypoints", *near, scenario=FLIGHT)
    lives.append(live)
    live.wait_for("connecting -> pursuing")
    children = live.children()
    while not (live.folder / "chase.mcap").exists() or live.recording().movements < 6:
        assert live.popen.poll() is None, live.told
        time.sleep(0.2)
    os.kill(_children(live.stage())[3], signal.SIGHUP)
    summary = live.summary()
    assert (summary["controller"], summary["state"], summary["reached"]) == ("adaptive", "aborted", False), live.told
    assert 0 <= summary["capture_s"] < 1
    assert (summary["following_share"], summary["true_following_share"]) == (None, None)
    live.wait_until_nothing_is_left(children)
    recording = live.recording()
    assert recording.state.value == "aborted"
    assert recording.movements == len(recording.decisions) == summary["movements"] >= 6
    assert verify(recording).is_same
    # The target flies.
    assert len({tuple(frame["target_m"] or ()) for frame in recording.frames()}) > 5


def test_through_faults_of_every_kind_it_arrives(tmp_path: Path, lives: list[Live]) -> None:
    """Processes are stopped and killed for real, and the link loses, repeats and forges real datagrams."""
    faults = "loss=0.1,delay=0.02,jitter=0.01,duplicate=0.05,replay=0.05,forge=200"
    faults += ",silent=0@1-5,garbage=1@1,restart=3@2,frozen=4@4-6,slow=2@0-8,kill=5@5"
    words = ("--seed", "1", "--faults", faults, "--controller", "particle")
    live = Live(tmp_path, *words, scenario=NEAR.replace("12", "14"))
    lives.append(live)
    live.wait_for("tracker 3 is lost")
    summary = live.summary()
    # Which samples come through is up to the processes' timing: five trackers' levels do not always tell 2 m from 3 m.
    assert summary["state"] == "reached", live.told
    assert summary["distance_m"] <= 2 * 2, live.told
    assert {"replayed", "wrong key", "unsigned", "giant", "truncated"} <= summary["rejected"].keys()
    told = live.told
    assert "tracker 0 is silent" in told
    assert told.index("tracker 3 is lost") < told.rindex("tracker 3 is there")
    assert "tracker 4 is lost" in told
    assert told.rindex("tracker 5 is lost") > told.rfind("tracker 5 is there")
    recording = live.recording()
    assert verify(recording).is_same
    # What a broken receiver says never counts.
    levels_dbm = np.concatenate([decision.rssi_dbm[:, 1] for decision in recording.decisions])
    assert not (levels_dbm > 50).any()
    fence_m = recording.head.limits
    for frame in recording.frames():
        for tracker in frame["trackers"]:
            if tracker["set_point_m"] is not None:
                assert (fence_m.low_m <= tracker["set_point_m"]).all()
                assert (tracker["set_point_m"] <= fence_m.high_m).all()


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="no /proc here to find processes in")
def test_signals_to_all_as_systemd_sends_them_end_every_process_and_keep_the_log(
    tmp_path: Path, lives: list[Live]
) -> None:
    """SIGTERM, as often as it likes."""
    live = Live(tmp_path, "--controller", "gradient", scenario=NEAR.replace("12", "100"))
    lives.append(live)
    live.wait_for("-> moving: movement 1")
    children = live.children()
    assert len(children) >= 7
    assert [path.name[:16] for path in live.temporary.iterdir()] == ["swarmchase-live-"]
    for process in 2 * [*children, live.popen.pid]:
        os.kill(process, signal.SIGTERM)
    summary = live.summary()
    assert (summary["state"], summary["reached"]) == ("aborted", False)
    live.wait_until_nothing_is_left(children)
    assert live.recording().state.value == "aborted"


def test_a_signal_to_the_stage_is_meant_for_the_whole_command(tmp_path: Path) -> None:
    """Which hears of it, as of a tracker's, and ends: the stage goes on until then."""
    for tracker, key in new_keys().items():
        write_keys(tmp_path / f"tracker-{tracker}.keys", {tracker: key})
    (port,) = free_udp_ports(1)
    request = StopRequest()
    stage = StageProcess(Play(paper_scenario(sampling_hz=100), 0, 0, FaultPlan(), port, tmp_path), request)
    try:
        stage.wait()
        assert not request.made
        pid = stage._process.pid
        assert pid is not None
        os.kill(pid, signal.SIGINT)
        deadline_s = time.monotonic() + PATIENCE_S
        while not request.made:
            assert time.monotonic() < deadline_s
            stage._hear(0.1)
        assert stage._process.is_alive()
    finally:
        stage.close()


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="no /proc here to find processes in")
def test_a_site_that_dies_is_a_clear_line(tmp_path: Path, lives: list[Live]) -> None:
    live = Live(tmp_path, "--controller", "gradient", scenario=NEAR.replace("12", "100"))
    lives.append(live)
    live.wait_for("-> moving: movement 1")
    children = live.children()
    assert len(children) >= 7
    os.kill(live.stage(), signal.SIGKILL)
    code, output = live.end()
    assert (code, output) == (1, "")
    assert live.told.rstrip().endswith("swarmchase: the simulated site has died with exit code -9 (a negative one is "
                                       "the signal that killed it)")  # fmt: skip
    assert live.recording().movements == 1
    live.wait_until_nothing_is_left(children)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="no /proc here to find processes in")
def test_a_killed_chase_leaves_a_log_and_nothing_else(tmp_path: Path, lives: list[Live]) -> None:
    """One of its trackers stands still: nothing but the kernel can end it."""
    live = Live(tmp_path, "--controller", "gradient", "--faults", "frozen=2@0.5", scenario=NEAR.replace("12", "100"))
    lives.append(live)
    live.wait_for("tracker 2 is lost", "tracker 2 has not come")  # the latter where the machine is slow
    children = live.children()
    live.popen.kill()
    live.wait_until_nothing_is_left(children)
    assert live.recording().is_cut


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("--faults rain=1", "fault 'rain=1' is refused: there are loss=SHARE"),
        ("--faults loss=2", "fault 'loss=2' is refused: loss = 2.0 is refused: allowed is between 0 and 1"),
        ("--faults kill=6@3", "fault 'kill=6@3' is refused"),
        ("--controller oracle", "the oracle knows where a simulated target is"),
        ("--controller nobody", "no controller 'nobody'"),
        ("--scenario flight", "gradient is refused in flight: it has no belief to judge by"),
        ("--scenario flight --continuity independent", "continuity = 'independent' is refused in flight"),
        ("--scenario flight --decision-s 0.06", "decision_s = 0.06 is refused: a live chase needs at least 0.1"),
        ("--scenario flight --controller robust", "robust needs windows of 50 samples; the scenario has 10"),
        ("--behaviour flee --target-speed-mps 5", "behaviour = 'flee' is refused: the simulated site has the paper's"),
        ("--seed -1", "seed = -1, chase = 0 is refused"),
        ("--minimum-trackers 9", "minimum_trackers = 9 is refused"),
        ("--reached-windows -1", "reached_windows = -1 is refused"),
        ("--log there.mcap", "cannot write the log there.mcap: it exists already"),
        ("--log there.mcap/chase.mcap", "cannot write to folder there.mcap: File exists"),
        ("--page 127.0.0.1:TAKEN", "cannot serve a page on 127.0.0.1:"),
        ("--output cot-udp:127.0.0.1:1 --global-origin 48 11 500 --page 127.0.0.1:TAKEN", "cannot serve a page on"),
        ("--page nonsense", "--page 'nonsense' is refused: allowed is HOST:PORT"),
    ],
)
def test_bad_input_is_one_line(
    words: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there.mcap").touch()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        options = [
            "live",
            "--controller",
            "gradient",
            "--page",
            "127.0.0.1:0",
            *words.replace("TAKEN", str(taken.getsockname()[1])).split(),
        ]
        with pytest.raises(SystemExit) as end:
            main(options)
    captured = capsys.readouterr()
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["there.mcap"]
    told = [one for one in captured.err.splitlines() if one.startswith("swarmchase: ")]
    assert (end.value.code, captured.out) == (2, "")
    assert len(told) == 1
    assert told[0].removeprefix("swarmchase: ").startswith(line)
    assert not re.search("is shown at|The page is at|The log is", captured.err)
