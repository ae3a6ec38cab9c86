"""``swarmchase keys``, ``serve`` and ``tracker`` as people start them: real processes on the loopback interface."""

import contextlib
import dataclasses
import json
import os
import queue
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pymavlink", reason="the MAVLink link needs pymavlink: pip install swarmchase[live]")
pytest.importorskip("mcap", reason="the log needs mcap: pip install swarmchase[live]")
pytest.importorskip("uvicorn", reason="the page needs uvicorn: pip install swarmchase[live]")

from swarmchase.cli import main
from swarmchase.commands.keys import KeysCommand
from swarmchase.commands.live import LiveCommand
from swarmchase.commands.serve import ServeCommand, ready_controller
from swarmchase.commands.tracker import TrackerCommand
from swarmchase.controllers.adaptive import AdaptiveController
from swarmchase.live.link.keys import new_keys, read_keys, write_keys
from swarmchase.live.link.mavlink import ControllerMavlinkLink
from swarmchase.live.link.messages import Heartbeat, PositionReport, TrackerMode
from swarmchase.live.link.state_file import CONTROLLER_FILE, CONTROLLER_HEARS, TRACKER_HEARS, tracker_file
from swarmchase.live.link.timestamps import Timestamps
from swarmchase.live.log.recording import read_recording
from swarmchase.live.log.verification import verify
from swarmchase.live.service.loop import percentile_ms
from swarmchase.live.service.operator_words import OperatorWord, OperatorWords
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.live.service.settings import ServiceSettings
from swarmchase.live.service.state_folder import UNIX_TIME_OF_2025_S, default_state_folder, next_epoch
from swarmchase.live.ticker import next_moment_ns
from swarmchase.live.tracker.agent import AgentSettings
from swarmchase.live.tracker.sources.address import open_source
from swarmchase.live.tracker.sources.kind import SourceDetails
from swarmchase.live.tracker.vehicles.kind import VehicleDetails
from swarmchase.scenario import Scenario
from swarmchase.simulation.tracker_processes import free_udp_ports

PATIENCE_S = 120.0
"""Nothing here takes a tenth of it, unless the machine is very busy with something else."""
CENTER_M = (0.0, 0.0, 20.0)
PLACES_M = [(3, 0, 20), (-3, 0, 20), (0, 3, 20), (0, -3, 20), (0, 0, 23), (0, 0, 17)]
EAST_IS_LOUDER_DBM = [-60.0, -62.0, -61.0, -61.0, -61.0, -61.0]
"""The gradient controller goes east on these, and none is as loud as near the target."""
BESIDE_THE_TARGET_DBM = [-5.0] * 6
SHORT_WINDOWS = "sampling_hz = 50\nwindow_samples = 10\n"


class Process:
    """A command whose lines on standard error are read as they come."""

    def __init__(self, *words: str, environment: dict[str, str] | None = None) -> None:
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "swarmchase", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **(environment or {})},
        )
        self.told: list[str] = []
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.popen.stderr is not None
        for line in self.popen.stderr:
            self._lines.put(line.rstrip("\n"))
        self._lines.put(None)

    def wait_for(self, pattern: str) -> "re.Match[str]":
        """The first line, of those not looked at yet, in which the pattern is found."""
        deadline_s = time.monotonic() + PATIENCE_S
        while True:
            try:
                line = self._lines.get(timeout=max(deadline_s - time.monotonic(), 0))
            except queue.Empty:
                line = None
            if line is None:
                raise AssertionError(f"no {pattern!r} in {self.told}")
            self.told.append(line)
            if found := re.search(pattern, line):
                return found

    def say(self, word: str) -> None:
        assert self.popen.stdin is not None
        self.popen.stdin.write(word + "\n")
        self.popen.stdin.flush()

    def result(self) -> Any:
        """What it prints when it ends by itself, which must be well."""
        assert self.popen.stdout is not None
        output = self.popen.stdout.read()
        assert self.popen.wait(PATIENCE_S) == 0, self.told
        self._reader.join(PATIENCE_S)
        while (line := self._lines.get(timeout=PATIENCE_S)) is not None:
            self.told.append(line)
        assert output.count("\n") == 1
        return json.loads(output)

    def stop(self, number: int = signal.SIGTERM) -> Any:
        self.popen.send_signal(number)
        return self.result()

    def kill(self) -> None:
        self.popen.kill()
        self.popen.wait(PATIENCE_S)

    def close(self) -> None:
        self.kill()
        self._reader.join(PATIENCE_S)
        for pipe in (self.popen.stdin, self.popen.stdout, self.popen.stderr):
            assert pipe is not None
            with contextlib.suppress(OSError):
                pipe.close()


class Receivers:
    """Sends levels to the trackers' UDP sources, from a thread, 50 times a second."""

    def __init__(self, rssi_dbm: list[float]) -> None:
        self.ports = free_udp_ports(len(rssi_dbm))
        self._rssi_dbm = rssi_dbm
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._thread.start()

    def _send(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            while not self._closing.wait(0.02):
                for port, rssi_dbm in zip(self.ports, self._rssi_dbm, strict=True):
                    with contextlib.suppress(OSError):
                        udp.sendto(json.dumps({"rssi_dbm": rssi_dbm}).encode(), ("127.0.0.1", port))

    def close(self) -> None:
        self._closing.set()
        self._thread.join()


class Site:
    """A folder with keys and a scenario, and the processes that were started there."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.keys = folder / "keys"
        (self.port,) = free_udp_ports(1)
        write_keys(self.keys, new_keys())
        self._to_close: list[Process | Receivers] = []

    def serve(self, *words: str, scenario: str = SHORT_WINDOWS) -> Process:
        (self.folder / "scenario.toml").write_text(scenario)
        options = f"--controller gradient --listen 127.0.0.1:{self.port} --keys {self.keys} --json".split()
        options += ["--scenario", str(self.folder / "scenario.toml"), "--state-folder", str(self.folder / "state")]
        process = Process("serve", *options, *words)
        self._to_close.append(process)
        return process

    def receivers(self, rssi_dbm: list[float]) -> Receivers:
        receivers = Receivers(rssi_dbm)
        self._to_close.append(receivers)
        return receivers

    def tracker(self, number: int, source: str, *words: str, keys: Path | None = None) -> Process:
        options = f"--number {number} --service 127.0.0.1:{self.port} --keys {keys or self.keys} --json".split()
        options += f"--source {source} --vehicle simulated --sampling-hz 50 --position-m".split()
        options += [*map(str, PLACES_M[number]), "--state-folder", str(self.folder / "state")]
        process = Process("tracker", *options, *words)
        self._to_close.append(process)
        return process

    def swarm(self, rssi_dbm: list[float]) -> list[Process]:
        """Six trackers that hear these levels; returns when each flies or holds."""
        ports = self.receivers(rssi_dbm).ports
        trackers = [self.tracker(number, f"udp:{ports[number]}", "--window-hz", "20") for number in range(6)]
        for number, tracker in enumerate(trackers):
            tracker.wait_for(rf"tracker {number} (holds|flies), at \(")
        return trackers

    def close(self) -> None:
        for thing in reversed(self._to_close):
            thing.close()


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    site = Site(tmp_path)
    try:
        yield site
    finally:
        site.close()


def refusal(words: str, capsys: pytest.CaptureFixture[str]) -> str:
    """The one line that these words end in; exit code 2 and a silent standard output are checked."""
    with pytest.raises(SystemExit) as end:
        main(words.split())
    output = capsys.readouterr()
    assert (end.value.code, output.out, output.err.count("\n")) == (2, "", 1)
    return output.err.removeprefix("swarmchase: ").rstrip("\n")


# --- a chase ---------------------------------------------------------------------------------------------------------


def test_a_chase_outlives_a_killed_service(site: Site) -> None:
    log = site.folder / "killed.mcap"
    first = site.serve("--log", str(log))
    epoch = int(first.wait_for(r"Listening on 127.0.0.1:\d+, controller gradient, epoch (\d+)")[1])
    trackers = site.swarm(EAST_IS_LOUDER_DBM)
    first.say("start")
    # Where the machine is slow, a movement may take its longest time, or a tracker join late: more states in between.
    first.wait_for("idle -> connecting: the operator starts")
    first.wait_for(r"connecting -> sampling: \d trackers are there")
    first.wait_for("sampling -> moving: movement 1")
    first.wait_for("moving -> sampling: arrived")
    first.wait_for(r"sampling -> moving: movement \d+")
    first.kill()
    for number, tracker in enumerate(trackers):
        tracker.wait_for(f"tracker {number} holds")
    center_m = center_where_all_stand_still(site)
    assert center_m[0] > CENTER_M[0] + 2  # each movement takes them 4 m east
    assert abs(center_m[1] - CENTER_M[1]) < 0.5

    recording = read_recording(log)
    assert recording.is_cut
    assert recording.movements >= 1
    assert len(list(recording.frames())) >= 10
    assert verify(recording).is_same

    second = site.serve("--start", scenario=SHORT_WINDOWS + "max_movements = 2\n")
    assert int(second.wait_for(r"epoch (\d+)")[1]) > epoch
    second.wait_for("sampling -> moving: movement 1")
    second.wait_for("sampling -> lost: 2 movements are spent")
    summary = second.result()
    latencies = {"decision_latency_p50_ms", "decision_latency_p99_ms", "following_share"}
    assert summary.keys() == {"state", "reason", "movements", "seconds", "rejected", "rejected_skew_s"} | latencies
    assert (summary["state"], summary["movements"]) == ("lost", 2)
    assert 0 < summary["decision_latency_p99_ms"] < 1000 * summary["seconds"]
    # What was under way at the start, or waited for a slow machine; nothing else is there.
    assert set(summary["rejected"]) <= {"replayed", "too old", "overflow"}
    for number, tracker in enumerate(trackers):
        told = tracker.stop()
        assert (told["tracker"], told["mode"]) == (number, "holding")
        assert told["position_m"][0] > PLACES_M[number][0] + 4
        assert told["levels"] > 20
        assert set(told["ignored"]) <= {"not newer than the last", "too long under way"}


def center_where_all_stand_still(site: Site) -> tuple[float, ...]:
    """Listens at the dead service's address until each tracker has reported one place five times while it held."""
    link = ControllerMavlinkLink("127.0.0.1", site.port, read_keys(site.keys))
    places: dict[int, list[tuple[float, float, float]]] = {number: [] for number in range(6)}
    holds: set[int] = set()
    deadline_s = time.monotonic() + PATIENCE_S
    try:
        while not all(number in holds and len(places[number]) >= 5 for number in range(6)):
            assert time.monotonic() < deadline_s, (holds, places)
            for message in link.receive():
                if isinstance(message, Heartbeat):
                    (holds.add if message.mode == TrackerMode.HOLDING else holds.discard)(message.tracker)
                elif isinstance(message, PositionReport):
                    if message.position_m not in places[message.tracker]:
                        places[message.tracker].clear()
                    places[message.tracker].append(message.position_m)
            time.sleep(0.02)
    finally:
        link.close()
    return tuple(sum(places[number][-1][axis] for number in range(6)) / 6 for axis in range(3))


def test_reached_by_signal_strength_and_a_stranger_is_counted(site: Site) -> None:
    write_keys(site.folder / "other-keys", new_keys())
    log = site.folder / "chase.mcap"
    service = site.serve("--start", "--log", str(log), "--page", "127.0.0.1:0")
    page = service.wait_for(r"The page is at (http://127.0.0.1:\d+/)")[1]
    service.wait_for("Listening")
    with urllib.request.urlopen(page, timeout=PATIENCE_S) as answer:
        assert (answer.status, answer.headers.get_content_type()) == (200, "text/html")
    stranger = site.tracker(5, "simulated:-60", "--state-folder", str(site.folder), keys=site.folder / "other-keys")
    service.wait_for("rejected a datagram in the name of tracker 5: wrong key")
    assert stranger.stop(signal.SIGINT)["mode"] == "holding"
    site.swarm(BESIDE_THE_TARGET_DBM)
    service.wait_for("-> reached: the levels are those of a target within")
    summary = service.result()
    assert summary["state"] == "reached"
    assert summary["rejected"]["wrong key"] > 0
    assert service.told[-1].startswith("Ended reached after ")
    recording = read_recording(log)
    assert (recording.is_cut, recording.state.value) == (False, "reached")
    assert [frame["state"] for frame in recording.frames()][-1] == "reached"


def test_the_operators_words(site: Site) -> None:
    service = site.serve("--stay")
    service.wait_for("Waiting for the word start")
    site.swarm(EAST_IS_LOUDER_DBM)
    service.say("fly")
    service.wait_for("no word 'fly'; there are start, override, hold, resume, reached, abort, quit")
    service.say("start")
    service.wait_for("-> moving: movement 1")
    service.say("hold")
    service.wait_for("-> holding: the operator holds")
    service.say("resume")
    service.wait_for("-> moving: the cause of holding is gone|-> sampling: the cause of holding is gone")
    service.say("reached")
    service.wait_for("-> reached: the operator says so")
    service.say("hold")  # too late: nothing comes of it
    service.say("nonsense")
    service.wait_for("no word 'nonsense'")  # it stays
    service.say("abort")
    service.wait_for("reached -> aborted: the operator aborts")
    assert service.result()["state"] == "aborted"


def test_nobody_reads_what_it_prints(site: Site) -> None:
    """More than a pipe holds: the loop goes on, obeys and ends."""
    words = f"serve --controller gradient --listen 127.0.0.1:0 --unsigned --json --state-folder {site.folder}".split()
    reader, writer = os.pipe()
    try:
        ran = subprocess.run(
            [sys.executable, "-m", "swarmchase", *words],
            input=("x" * 900 + "\n") * 500 + "start\nquit\n",
            stdout=subprocess.PIPE,
            stderr=writer,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
        assert (ran.returncode, json.loads(ran.stdout)["state"]) == (0, "aborted")
        assert 4096 < len(os.read(reader, 1_000_000)) < 400_000  # of 450,000 and more: it was full indeed
    finally:
        os.close(reader)
        os.close(writer)


def test_ctrl_c_aborts_and_trackers_are_told_to_hold(site: Site) -> None:
    service = site.serve("--start")
    trackers = site.swarm(EAST_IS_LOUDER_DBM)
    service.wait_for("-> moving: movement 1")
    assert service.popen.stdin is not None
    service.popen.stdin.close()  # no more words: it goes on
    summary = service.stop(signal.SIGINT)
    assert (summary["state"], summary["reason"]) == ("aborted", "the operator aborts")
    for number, tracker in enumerate(trackers):
        tracker.wait_for(f"tracker {number} holds")


def test_no_second_sigterm_forces(site: Site) -> None:
    service = site.serve("--stay", "--start")
    service.wait_for("idle -> connecting")
    service.popen.send_signal(signal.SIGHUP)
    service.wait_for("connecting -> aborted")
    for number in (signal.SIGTERM, signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        service.popen.send_signal(number)
    assert service.stop(signal.SIGHUP)["state"] == "aborted"


def test_a_second_ctrl_c_ends_at_once(site: Site) -> None:
    service = site.serve("--stay", "--start")
    service.wait_for("idle -> connecting")
    service.popen.send_signal(signal.SIGINT)
    service.wait_for("connecting -> aborted")
    service.popen.send_signal(signal.SIGINT)
    service.wait_for("swarmchase: interrupted")
    assert service.popen.wait(PATIENCE_S) == 130


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc here to read the memory from")
def test_the_tracker_is_small(site: Site) -> None:
    """The whole command at work, and the most memory it ever held."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller:
        controller.bind(("127.0.0.1", site.port))
        controller.settimeout(PATIENCE_S)
        tracker = site.tracker(2, "simulated:-60")
        for _ in range(20):
            assert controller.recv(1000)
    process = Path(f"/proc/{tracker.popen.pid}")
    status = dict(line.split(":", 1) for line in (process / "status").read_text().splitlines())
    assert int(status["VmHWM"].split()[0]) < 80 * 1024
    libraries = (process / "maps").read_text()
    assert "libpython" in libraries or "python" in libraries  # the file says something
    assert not re.search(r"/(torch|numpy|scipy)/", libraries)
    assert tracker.stop()["position_m"] == list(map(float, PLACES_M[2]))


# --- keys ------------------------------------------------------------------------------------------------------------


def test_keys_are_written_once_and_for_their_owner(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "keys"
    main(["keys", str(file), "--json"])
    output = capsys.readouterr().out
    assert json.loads(output) == {"file": str(file), "trackers": [0, 1, 2, 3, 4, 5]}
    keys = read_keys(file)
    assert len(keys) == 6
    assert not any(key.hex() in output for key in keys.values())
    assert file.stat().st_mode & 0o777 == 0o600
    assert "exists already" in refusal(f"keys {file}", capsys)
    assert read_keys(file) == keys


def test_a_clock_behind_what_was_signed_last_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each end's own file: an hour ahead, it has signed one packet. After a reset the next refusal is another."""
    serve = f"serve --controller gradient --unsigned --listen 127.0.0.1:0 --page nowhere --state-folder {tmp_path}"
    tracker = f"tracker --number 3 --unsigned --source udp:0 --vehicle balloon --state-folder {tmp_path}"
    for words, sender, file, heard in (
        (serve, "controller", CONTROLLER_FILE, CONTROLLER_HEARS),
        (tracker, "3", tracker_file(3), TRACKER_HEARS),
    ):
        with contextlib.closing(
            Timestamps(heard, tmp_path / file, lambda: time.time_ns() + 3600 * 10**9)
        ) as an_hour_ahead:
            an_hour_ahead.next_to_send()
        assert re.match(
            r"this machine's clock is 3\d{3}\.\d s behind what this end has signed last: set it; if it is right now "
            r"and was ahead then, swarmchase keys reset forgets that \(docs/link\.md\)$",
            refusal(words, capsys),
        )
        main(["keys", "reset", sender, "--state-folder", str(tmp_path)])
        assert "Forgotten: when" in capsys.readouterr().err
        assert re.match("--page 'nowhere' is refused|vehicle 'balloon' is refused", refusal(words, capsys))


# --- bad input -------------------------------------------------------------------------------------------------------

SERVE = "serve --controller gradient --state-folder state"
TRACKER = "tracker --number 3 --state-folder state --unsigned --service 127.0.0.1:9 --sampling-hz 50"


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (SERVE, "give one of --keys FILE and --unsigned"),
        (f"{SERVE} --unsigned --keys whole", "give one of --keys FILE and --unsigned"),
        (f"{SERVE} --keys gone", "cannot read key file gone: No such file or directory"),
        (f"{SERVE} --keys open", "key file open is open to others (mode 0640): run chmod 600 open"),
        (f"{SERVE} --keys whole --listen 127.0.0.1:TAKEN", "cannot bind UDP port"),
        (f"{SERVE} --keys whole --listen nowhere", "--listen 'nowhere' is refused: allowed is HOST:PORT"),
        (f"{SERVE} --unsigned --listen 0.0.0.0:0", "without keys only the loopback interface is allowed"),
        (f"{SERVE} --unsigned --listen 127.0.0.1:0 --minimum-trackers 7", "minimum_trackers = 7 is refused"),
        (f"{SERVE} --unsigned --listen 127.0.0.1:0 --highest-speed-mps 0", "highest_speed_mps = 0.0 is refused"),
        (f"{SERVE} --unsigned --listen 127.0.0.1:0 --fence-west-m 500", "the fence is refused"),
        ("serve --controller oracle --unsigned --state-folder state", "the oracle knows where a simulated target is"),
        ("serve --controller nobody --unsigned --state-folder state", "no controller 'nobody'"),
        ("serve --controller gradient --unsigned --scenario flight", "gradient is refused in flight: it has no belief"),
        (
            "serve --controller gradient --unsigned --listen 127.0.0.1:0 --state-folder broken",
            "broken/controller.epoch",
        ),
        ("serve --controller gradient --unsigned --state-folder whole", "cannot write to folder whole"),
        ("serve", "give one of --keys FILE and --unsigned"),
        ("tracker", "Missing from swarmchase tracker: --number INT, --source STR, --vehicle STR; see: swarmchase "),
        ("tracker --number 3 --source simulated:-60", "Missing from swarmchase tracker: --vehicle STR"),
        (
            f"{TRACKER} --source simulated:-60 --vehicle balloon",
            "vehicle 'balloon' is refused: allowed is one of simul",
        ),
        (f"{TRACKER} --source simulated:-60 --vehicle simulated", "a simulated vehicle starts somewhere"),
        (f"{TRACKER} --source simulated:-60 --vehicle mavlink:0", "an autopilot needs one of --autopilot-origin-m"),
        (f"{TRACKER} --source simulated:-60 --vehicle simulated --position-m 0 0 nan", "position_m = (0.0, 0.0, nan)"),
        (f"{TRACKER} --source ears --vehicle simulated --position-m 0 0 0", "source 'ears' is refused: allowed is"),
        (f"{TRACKER} --source simulated:loud --vehicle simulated --position-m 0 0 0", "level 'loud' is refused"),
        (f"{TRACKER} --source replay:whole --vehicle simulated --position-m 0 0 0", "cannot replay whole: allowed are"),
        (f"{TRACKER} --source udp:TAKEN --vehicle simulated --position-m 0 0 0", "cannot listen on 127.0.0.1:"),
        (f"{TRACKER} --source kismet:http://x --vehicle simulated --position-m 0 0 0", "Kismet hears many devices"),
        (f"{TRACKER} --source serial:gone --vehicle simulated --position-m 0 0 0", "cannot open gone"),
        (
            f"{TRACKER} --source simulated:-60 --vehicle simulated --position-m 0 0 0 --number 6",
            "tracker = 6 is refused",
        ),
        (f"{TRACKER} --source simulated:-60 --vehicle simulated --position-m 0 0 0 --window-hz 0", "window_hz = 0.0"),
        (
            f"{TRACKER.replace('--unsigned', '--keys alone')} --source udp:0 --vehicle simulated",
            "key file alone holds no",
        ),
        (
            f"{TRACKER.replace('127.0.0.1', '192.0.2.1')} --source udp:0 --vehicle simulated",
            "without keys only the loop",
        ),
    ],
)
def test_bad_input_is_one_line(
    words: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_keys(Path("whole"), new_keys())
    write_keys(Path("open"), new_keys())
    Path("open").chmod(0o640)
    write_keys(Path("alone"), {2: bytes(range(32))})
    Path("broken").mkdir()
    Path("broken/controller.epoch").write_text("soon\n")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        told = refusal(words.replace("TAKEN", str(taken.getsockname()[1])), capsys)
    assert told.startswith(line)


# --- the parts -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "kind"),
    [
        (ServeCommand(), SafetyLimits),
        (TrackerCommand(number=0, source="", vehicle=""), AgentSettings),
        (TrackerCommand(number=0, source="", vehicle=""), SourceDetails),
        (TrackerCommand(number=0, source="", vehicle=""), VehicleDetails),
    ],
)
def test_options_offer_what_the_parts_know(command: Any, kind: Any) -> None:
    """Written twice where importing them would need torch or numpy for --help."""
    for field in dataclasses.fields(kind):
        assert getattr(command, field.name) == field.default, field.name


def test_serve_passes_its_options_on() -> None:
    assert ServeCommand().limits() == SafetyLimits()
    assert ServeCommand().settings() == ServiceSettings()
    assert ServeCommand(lowest_altitude_m=2.0).limits().lowest_altitude_m == 2.0
    assert ServeCommand(reached_windows=0).settings().reached_windows == 0


def test_whoever_does_not_choose_gets_one_that_needs_to_be_told_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert ServeCommand().controller == LiveCommand().controller == "adaptive"
    assert isinstance(ready_controller(ServeCommand().controller, Scenario(), 0), AdaptiveController)
    assert capsys.readouterr().err == ""


def test_the_pace_neither_drifts_nor_bursts() -> None:
    """Period 10: early, in time, late by less than a period, after a stall."""
    assert next_moment_ns(100, 10, now_ns=103) == 110
    assert next_moment_ns(100, 10, now_ns=110) == 110
    assert next_moment_ns(100, 10, now_ns=117) == 110
    last_ns = next_moment_ns(100, 10, now_ns=1234)
    assert last_ns == 1230  # at once
    assert next_moment_ns(last_ns, 10, now_ns=1235) == 1240  # and once


@pytest.mark.parametrize(("clock_s", "epoch"), [(50.0, 50), (7.0, 8), (-1e9, 8), (7.9, 8)])
def test_an_epoch_is_larger_than_the_last_whatever_the_clock_says(clock_s: float, epoch: int, tmp_path: Path) -> None:
    path = tmp_path / "epoch"
    assert next_epoch(path, lambda: UNIX_TIME_OF_2025_S + 7.0) == 7
    assert next_epoch(path, lambda: UNIX_TIME_OF_2025_S + clock_s) == epoch
    assert path.read_text() == f"{epoch}\n"
    assert [file.name for file in tmp_path.iterdir()] == ["epoch"]


def test_the_state_is_where_it_belongs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert default_state_folder() == tmp_path / "swarmchase"
    monkeypatch.setenv("XDG_STATE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert default_state_folder() == tmp_path / "home" / ".local" / "state" / "swarmchase"


def test_words_come_whole_and_end_with_the_input() -> None:
    reader, writer = os.pipe()
    words = OperatorWords(reader)
    assert words.read() == []
    os.write(writer, b"start\n\n  hold \nres")
    assert words.read() == ["start", "hold"]
    os.write(writer, b"ume\nabort")
    assert words.read() == ["resume"]
    os.close(writer)
    assert words.read() == ["abort"]
    assert words.read() == []
    os.close(reader)


def test_help_and_document_name_every_word() -> None:
    document = (Path(__file__).parents[2] / "docs" / "live.md").read_text()
    for word in OperatorWord:
        assert re.search(rf"\b{word}\b", ServeCommand.__doc__ or ""), word
        assert f"`{word}`" in document, word
        if word is not OperatorWord.START:  # a simulated chase starts by itself
            assert re.search(rf"\b{word}\b", LiveCommand.__doc__ or ""), word


def test_percentiles_are_by_nearest_rank() -> None:
    assert percentile_ms([], 99) is None
    assert percentile_ms([0.5], 99) == 500
    hundred_to_one_s = [number / 1000 for number in range(100, 0, -1)]
    assert [percentile_ms(hundred_to_one_s, percent) for percent in (50, 99, 100)] == [50, 99, 100]


def test_recordings_are_told_apart_by_their_ending(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("seconds,level\n0,-61\n1,-62\n")
    (tmp_path / "log.json").write_text('[{"seconds": 0, "level": -63}]')
    details = SourceDetails(rssi_column="level", time_column="seconds")
    for name, level_dbm in (("log.csv", -61.0), ("log.json", -63.0)):
        source = open_source(f"replay:{tmp_path / name}", details)
        assert source.read(1000) == [(1000, level_dbm)]
        source.close()


# --- who reads it ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("words", [["serve", "--help"], ["--help"]])
def test_help_that_nobody_reads_to_its_end_is_silent(words: list[str]) -> None:
    """As in ``swarmchase serve --help | head -1``, with a reader that has gone before the first line."""
    reader, writer = os.pipe()
    os.close(reader)
    try:
        program = [sys.executable, "-m", "swarmchase"]
        ran = subprocess.run([*program, *words], stdout=writer, stderr=subprocess.PIPE, timeout=PATIENCE_S, check=False)
    finally:
        os.close(writer)
    assert (ran.returncode, ran.stderr) == (128 + signal.SIGPIPE, b"")


def test_another_broken_pipe_is_a_failure_and_not_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(command: KeysCommand) -> None:
        raise BrokenPipeError(32, "of a worker")

    monkeypatch.setattr(KeysCommand, "run", breaks)
    with open(os.devnull, "w") as output:
        monkeypatch.setattr(sys, "stdout", output)
        with pytest.raises(BrokenPipeError, match="of a worker"):
            main(["keys", "file"])
