"""Children of real processes that are killed, and folders that these leave."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from swarmchase.processes.temporary_folder import temporary_folder

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc to know who lives")

PATIENCE_S = 60.0
"""Nothing here takes a tenth of it, unless the machine is very busy with something else."""
COMMAND = """
import subprocess, sys
from swarmchase.processes.children import child_command
words = child_command(["chase"])
words[1:3] = ["-c", sys.argv[1]]
child = subprocess.Popen(words, stdout=subprocess.PIPE)
print(child.pid, child.stdout.readline().decode().strip(), flush=True)
child.wait()
"""
BY_THE_KERNEL = """
import sys, time
from swarmchase.processes.children import end_with
end_with(int(sys.argv[1]))
print("ready", flush=True)
time.sleep(1000)
"""
BY_A_WATCH = BY_THE_KERNEL.replace(
    "end_with(int", "import swarmchase.processes.children as children\nchildren._kernel_ends_it = bool\nend_with(int"
)
OF_MULTIPROCESSING = """
import multiprocessing, os, signal, time
from swarmchase.processes.children import begin_child, starting_children
if __name__ == "__main__":
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    with starting_children():
        first = context.Process(target=begin_child)
        first.start()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(first.pid, number)
        # What it inherits: held back until it says so itself.
        print(open(f"/proc/{first.pid}/status").read().split("SigBlk:")[1].split()[0], flush=True)
    first.join()
    print(first.exitcode, flush=True)
"""
HELPER = """
import os, signal
from multiprocessing import resource_tracker
from swarmchase.processes.children import start_helper
start_helper()
helper = resource_tracker._resource_tracker._pid
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    os.kill(helper, number)
os.close(resource_tracker._resource_tracker._fd)  # it ends with the last of these
print(os.waitpid(helper, 0)[1], signal.pthread_sigmask(signal.SIG_BLOCK, []), flush=True)
os._exit(0)
"""
FOLDER = """
import sys, time
from swarmchase.processes.temporary_folder import temporary_folder
with temporary_folder("swarmchase-test-") as folder:
    (folder / "below").mkdir()
    (folder / "below" / "tracker-0.keys").write_text("secret")
    print(folder, flush=True)
    time.sleep(1000)
"""


@contextlib.contextmanager
def parent(program: str, *words: str, **how: str) -> Iterator["subprocess.Popen[str]"]:
    """In a group of its own."""
    with subprocess.Popen(
        [sys.executable, "-c", program, *words],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, **how},
    ) as process:
        try:
            yield process
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def first_line(process: "subprocess.Popen[str]") -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def state(pid: int) -> str:
    """A letter as in ps; Z, too, where nothing is left."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return "Z"


def wait_until_gone(pid: int) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while state(pid) != "Z":
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


@pytest.mark.parametrize(
    "child", [pytest.param(BY_THE_KERNEL, id="by the kernel"), pytest.param(BY_A_WATCH, id="by a watch")]
)
def test_a_child_ends_with_its_killed_parent(child: str) -> None:
    with parent(COMMAND, child) as process:
        pid, word = first_line(process).split()
        assert word == "ready"
        if child is BY_THE_KERNEL and sys.platform == "linux":
            os.kill(int(pid), signal.SIGSTOP)  # as a frozen tracker stands still
        assert state(int(pid)) != "Z"
        process.kill()
        wait_until_gone(int(pid))


def test_a_child_whose_parent_is_gone_already_ends_at_once() -> None:
    """It was killed while the child began."""
    ran = subprocess.run(
        [sys.executable, "-c", BY_THE_KERNEL, "1"], capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    assert (ran.returncode, ran.stdout) == (1, "")


def test_signals_are_held_back_while_a_child_begins_and_noted_afterwards() -> None:
    """The very first, too, with which Python's own helper process comes."""
    with parent(OF_MULTIPROCESSING) as process:
        blocked = int(first_line(process), 16)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            assert blocked & 1 << (number - 1)
        assert first_line(process) == "0"


def test_a_temporary_folder_is_for_its_owner_and_goes_with_the_block() -> None:
    with temporary_folder("swarmchase-test-") as folder:
        assert folder.stat().st_mode & 0o777 == 0o700
        (folder / "file").touch()
    assert not folder.exists()


@pytest.mark.parametrize("to_the_group", [True, False])
def test_a_temporary_folder_goes_with_a_killed_process(to_the_group: bool, tmp_path: Path) -> None:
    with parent(FOLDER, TMPDIR=str(tmp_path)) as process:
        folder = Path(first_line(process))
        assert (folder / "below" / "tracker-0.keys").exists()
        assert folder.parent == tmp_path
        (os.killpg if to_the_group else os.kill)(process.pid, signal.SIGKILL)
        deadline_s = time.monotonic() + PATIENCE_S
        while list(tmp_path.iterdir()):
            assert time.monotonic() < deadline_s
            time.sleep(0.02)


def test_a_signal_to_the_whole_group_does_not_end_pythons_helper() -> None:
    """Without it the command that it helps would end with a traceback."""
    words = [sys.executable, "-c", HELPER]
    ran = subprocess.run(words, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "0 set()\n", "")
