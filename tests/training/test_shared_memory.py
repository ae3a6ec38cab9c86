"""A machine with little of the memory that processes share, as containers are by default."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

LITTLE = "mount -t tmpfs -o size=1m tmpfs /dev/shm && exec "
ISOLATED = ["unshare", "--mount", *([] if os.geteuid() == 0 else ["--map-root-user"]), "sh", "-c"]


def test_little_shared_memory_is_one_line_and_leaves_no_process(tmp_path: Path) -> None:
    if shutil.which("unshare") is None or subprocess.run([*ISOLATED, f"{LITTLE}true"], check=False).returncode != 0:
        pytest.skip("this machine lets nobody mount a file system of one's own (unshare --mount)")
    words = f"{sys.executable} -m swarmchase train a3c --agents 1 --updates 1 --evaluation-chases 1 --folder run"
    ran = subprocess.run(
        [*ISOLATED, LITTLE + words], cwd=tmp_path, check=False, capture_output=True, text=True, timeout=120
    )
    assert ran.returncode == 2
    assert ran.stderr.startswith("swarmchase: no room for 6 MB of memory that processes share, in /dev/shm (1 MB free)")
    assert ran.stderr.endswith("train in one process: train batched, or train a3c --schedule deterministic\n")
    assert ran.stderr.count("\n") == 1
