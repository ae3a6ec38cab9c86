"""A3C with real processes and signals: one worker equals the deterministic schedule, and no end is a silent one."""

import contextlib
import dataclasses
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from swarmchase.cli import main
from swarmchase.scenario import paper_scenario
from swarmchase.training.a3c import train_a3c
from swarmchase.training.processes import WorkerDiedError, _WatchedLock
from swarmchase.training.run_folder import read_log
from swarmchase.training.settings import TrainingSettings

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc to know a run's processes")

WAIT_S = 60
WORLD = paper_scenario(window_samples=3, start_distance_m=8.0, max_movements=12)
SETTINGS = TrainingSettings(
    num_agents=1, learning_rate=1e-3, max_updates=20, seed=5, evaluation_interval=30, evaluation_chases=4
)
ENDLESS = 100_000


def left_behind(folder):
    """All that a run leaves, but for the wall-clock seconds."""
    with safe_open(folder / "resume.safetensors", framework="pt") as file:
        document = json.loads(file.metadata()["swarmchase"])
        tensors = {name: file.get_tensor(name).numpy().tobytes() for name in file.keys()}  # noqa: SIM118
    log = {kind: read_log(folder, kind) for kind in ("chase", "evaluation")}
    for line in [document, *log["evaluation"]]:
        del line["seconds"]
    return tensors, document, log, (folder / "best.safetensors").read_bytes()


def command(folder, **changes):
    WORLD.save_toml(folder.with_suffix(".toml"))
    options = {
        "folder": folder,
        "scenario": folder.with_suffix(".toml"),
        "schedule": "processes",
        "learning-rate": SETTINGS.learning_rate,
        "agents": 1,
        "updates": ENDLESS,
        "seed": SETTINGS.seed,
        "evaluation-interval": 10,
        "evaluation-chases": 2,
        "checkpoint-interval": 10,
        **changes,
    }
    return ["train", "a3c", *(word for name, value in options.items() for word in (f"--{name}", str(value)))]


def workers(pid):
    """The processes that a run has spawned for its agents."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            words = (entry / "cmdline").read_bytes()
            parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
        except (OSError, ValueError, IndexError):
            continue
        if parent == pid and b"multiprocessing-fork" in words:
            found.append(int(entry.name))
    return sorted(found)


def wait_until(condition, what):
    end_s = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end_s, f"waited {WAIT_S} s in vain: {what}"
        time.sleep(0.01)


def is_gone(pid):
    """No such process, or nothing of it left but its exit code."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def one_line(capsys):
    """Of a refusal, which says it is ours."""
    _, line = capsys.readouterr().err.split("swarmchase: ")
    return " ".join(line.split())


@pytest.fixture
def running():
    """Starts the real command in a process group of its own, as a terminal does, and leaves none behind."""
    started = []

    def start(words):
        program = [str(Path(sys.executable).with_name("swarmchase")), *words]
        process = subprocess.Popen(
            program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        started.append(process)
        return process

    yield start
    for process in started:
        # The group outlives its leader where a test fails and agents are left; they would hold the pipes open, too.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate(timeout=WAIT_S)


def test_one_worker_process_is_the_deterministic_schedule_bit_for_bit(tmp_path):
    """The auxiliary agent only reads, and makes its last evaluation before the run ends."""
    results = [train_a3c(WORLD, SETTINGS, tmp_path / schedule, schedule) for schedule in ("processes", "deterministic")]
    assert [result.updates for result in results] == [20, 20]
    # The last networks are evaluated whatever the interval.
    assert [line["update"] for line in read_log(tmp_path / "processes", "evaluation")] == [20]
    # The last part is the best weights' file, which names its schedule.
    assert left_behind(tmp_path / "processes")[:-1] == left_behind(tmp_path / "deterministic")[:-1]
    weights = [load_file(tmp_path / schedule / "best.safetensors") for schedule in ("processes", "deterministic")]
    assert all(torch.equal(tensor, weights[1][name]) for name, tensor in weights[0].items())
    assert len(read_log(tmp_path / "processes", "chase")) >= 3
    assert results[0].best == results[1].best
    assert multiprocessing.active_children() == []


def test_a_run_killed_and_resumed_is_the_undisturbed_one_bit_for_bit(tmp_path, running, capsys):
    changes = {"schedule": "deterministic", "agents": 2, "updates": 40}
    killed = running(command(tmp_path / "killed", **changes))
    wait_until(lambda: (tmp_path / "killed" / "resume.safetensors").exists() or killed.poll() is not None, "checkpoint")
    # While it is at work nobody else is let in, neither to go on nor to begin, and what it does goes on.
    killed.send_signal(signal.SIGSTOP)
    before = {path.name: path.read_bytes() for path in (tmp_path / "killed").iterdir() if path.is_file()}
    for words in ([], ["--resume"]):
        with pytest.raises(SystemExit) as ending:
            main([*command(tmp_path / "killed", **changes), *words])
        assert ending.value.code == 2
        assert "in use by another training: wait for it, or choose another folder" in one_line(capsys)
    assert {path.name: path.read_bytes() for path in (tmp_path / "killed").iterdir() if path.is_file()} == before
    killed.kill()
    killed.communicate()
    assert killed.returncode == -signal.SIGKILL
    assert 10 <= load_file(tmp_path / "killed" / "resume.safetensors")["global.updates"].item() < 40
    main([*command(tmp_path / "killed", **changes), "--resume"])
    main(command(tmp_path / "undisturbed", **changes))
    assert left_behind(tmp_path / "killed") == left_behind(tmp_path / "undisturbed")


@pytest.mark.parametrize(
    ("moment", "number", "sent_to"),
    [
        ("while its agents start", signal.SIGINT, "the group"),
        ("in the middle", signal.SIGTERM, "the group"),
        ("in the middle", signal.SIGHUP, "an agent"),
    ],
)
def test_a_signal_stops_cleanly_and_what_was_done_can_be_resumed(tmp_path, running, moment, number, sent_to):
    folder = tmp_path / "run"
    process = running(command(folder))
    wait_until(lambda: len(workers(process.pid)) == 2 or process.poll() is not None, "agents")
    agents = workers(process.pid)
    if moment == "in the middle":
        wait_until(lambda: (folder / "resume.safetensors").exists() or process.poll() is not None, "checkpoint")
    if sent_to == "an agent":
        os.kill(agents[0], number)
    else:
        os.killpg(process.pid, number)
        if number != signal.SIGINT:
            os.killpg(process.pid, number)  # as often as it likes
    standard_output, standard_error = process.communicate(timeout=WAIT_S)
    assert process.returncode == 0, standard_error
    assert "Training interrupted" in standard_error
    assert "Traceback" not in standard_error
    assert standard_output == ""
    assert all(is_gone(pid) for pid in agents)
    assert len(agents) == 2
    updates = int(load_file(folder / "resume.safetensors")["global.updates"])
    assert updates == 0 or moment == "in the middle"
    # It goes on from there, under either schedule, until the next Ctrl-C.
    settings = dataclasses.replace(
        SETTINGS, max_updates=ENDLESS, evaluation_interval=10, evaluation_chases=2, checkpoint_interval=10
    )

    interrupted = []

    def stop_later(status):
        if status.updates == updates + 2 and not interrupted:  # a second one would end it at once
            interrupted.append(status)
            signal.raise_signal(signal.SIGINT)

    result = train_a3c(WORLD, settings, folder, "deterministic", resume=True, progress=stop_later)
    assert (result.updates, result.stopped) == (updates + 2, "interrupted")


def test_a_killed_agent_ends_the_run_with_its_exit_code_and_no_orphans(tmp_path, running):
    folder = tmp_path / "run"
    process = running(command(folder))
    wait_until(lambda: (folder / "resume.safetensors").exists() or process.poll() is not None, "checkpoint")
    local_agent, auxiliary_agent = workers(process.pid)
    os.kill(local_agent, signal.SIGKILL)
    _, standard_error = process.communicate(timeout=WAIT_S)
    assert process.returncode == 1
    assert "local agent 0 ended with exit code -9 (killed)" in standard_error
    assert is_gone(auxiliary_agent)


def test_agents_leave_with_a_killed_run(tmp_path, running):
    process = running(command(tmp_path / "run"))
    wait_until(lambda: (tmp_path / "run" / "resume.safetensors").exists() or process.poll() is not None, "checkpoint")
    agents = workers(process.pid)
    assert len(agents) == 2
    os.kill(process.pid, signal.SIGKILL)
    wait_until(lambda: all(is_gone(pid) for pid in agents), "orphans")
    process.communicate(timeout=WAIT_S)
    assert process.returncode == -signal.SIGKILL


def test_an_agent_that_raises_ends_the_run_with_its_traceback(tmp_path):
    """Its snapshot in the resume file lacks a part."""
    settings = dataclasses.replace(SETTINGS, max_updates=ENDLESS)
    train_a3c(WORLD, settings, tmp_path, "deterministic", progress=lambda _: signal.raise_signal(signal.SIGINT))
    path = tmp_path / "resume.safetensors"
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    tensors = load_file(path)
    del tensors["agent0.state.center_m"]
    save_file(tensors, path, metadata)
    with pytest.raises(WorkerDiedError, match=r"(?s)local agent 0 ended with an error:\nTraceback.*center_m"):
        train_a3c(WORLD, settings, tmp_path, "processes", resume=True)
    assert multiprocessing.active_children() == []


def test_an_agent_killed_with_the_lock_in_its_hands_does_not_hold_up_the_run():
    lock = multiprocessing.get_context("spawn").Lock()
    agents = {"local agent 0": SimpleNamespace(exitcode=None), "local agent 1": SimpleNamespace(exitcode=-9)}
    with _WatchedLock(lock, agents):
        assert not lock.acquire(block=False)
        with pytest.raises(WorkerDiedError, match="local agent 1 ended with exit code -9"), _WatchedLock(lock, agents):
            pass
    assert lock.acquire(block=False)
