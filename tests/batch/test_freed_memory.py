"""Freed memory stays with the process."""

import subprocess
import sys

import pytest

RETURNED_MB = """
import sys
import torch
from swarmchase.batch.freed_memory import keep_freed_memory

def resident_mb():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 1e6

if sys.argv[1] == "kept":
    keep_freed_memory()
blocks = [torch.ones(4_000_000) for _ in range(10)]  # 16 MB each
before = resident_mb()
del blocks
print(before - resident_mb())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="it is for glibc")
def test_large_blocks_stay_with_the_process_when_they_are_freed() -> None:
    returned_mb = {
        how: float(subprocess.run([sys.executable, "-c", RETURNED_MB, how], capture_output=True, check=True).stdout)
        for how in ("returned", "kept")
    }
    assert returned_mb["returned"] > 140
    assert returned_mb["kept"] < 20
