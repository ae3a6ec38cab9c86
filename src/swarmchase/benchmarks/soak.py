"""A live chase that does not end, in real processes, with page and log: memory over time, and the time of decisions.

The target hovers at the scenario's distance; when the swarm has reached it nobody says so, and it goes on listening and
moving. Memory is what the system counts as each process's own (proportional set size where /proc tells it).
"""

import contextlib
import json
import platform
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, WorkerDiedError
from ..processes.children import child_command
from ..processes.temporary_folder import temporary_folder
from ..scenario import Scenario

if TYPE_CHECKING:
    from rich.table import Table

Waited = Callable[[int], None]
"""Is told the seconds that have passed."""

WARM_UP_S = 60.0
"""Memory is compared with that after so long, when all is loaded."""
MEMORY_PERIOD_S = 60.0
LOOK_S = 5.0
END_S = 60.0


def measure(scenario: Scenario, controller: str, seconds: float, faults: str, waited: Waited) -> dict[str, Any]:
    """Let a live chase run for so long.

    Raises:
        InputError: too short, or no /proc to read memory from.
        WorkerDiedError: it ended by itself.
    """
    if seconds <= WARM_UP_S:
        raise InputError(f"seconds = {seconds:g} is refused: the first {WARM_UP_S:g} are only to warm up")
    if not Path("/proc/self/smaps_rollup").exists():
        raise InputError("there is no /proc here to read the memory of processes from")
    with temporary_folder("swarmchase-soak-") as folder:
        scenario.save_toml(folder / "scenario.toml")
        words = ["live", "--scenario", "scenario.toml", "--controller", controller, "--reached-windows", "0"]
        words += ["--page", "127.0.0.1:0", "--log", "soak.mcap", "--faults", faults, "--json"]
        with open(folder / "told.txt", "wb") as told:
            process = subprocess.Popen(
                child_command(words),
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=told,
            )
        try:
            memory_mb = _watch(process, seconds, waited, folder)
            process.send_signal(signal.SIGTERM)  # SIGINT is ignored in a script's background job
            output, _ = process.communicate(timeout=END_S)
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
        log_mb = (folder / "soak.mcap").stat().st_size / 1e6
    return {
        "controller": controller,
        "sampling_hz": scenario.sampling_hz,
        "seconds": seconds,
        "faults": faults,
        "processor": platform.processor() or platform.machine(),
        "memory_mb": memory_mb,
        "log_mb": round(log_mb, 1),
        "chase": json.loads(output),
    }


def table(result: dict[str, Any]) -> "Table":
    """What people see."""
    from rich.table import Table

    shown = Table("Process", "MB after a minute", "MB at the end", title=f"{result['seconds']:g} s")
    for name, course in result["memory_mb"].items():
        shown.add_row(name, f"{course[0]:.1f}", f"{course[-1]:.1f}")
    chase = result["chase"]
    p50_ms, p99_ms = chase["decision_latency_p50_ms"], chase["decision_latency_p99_ms"]
    shown.caption = (
        f"{chase['movements']} movements; decisions p50 {p50_ms} ms, p99 {p99_ms} ms; log {result['log_mb']} MB"
    )
    return shown


def _watch(process: "subprocess.Popen[bytes]", seconds: float, waited: Waited, folder: Path) -> dict[str, list[float]]:
    """Megabytes of each process every ``MEMORY_PERIOD_S`` from ``WARM_UP_S`` on."""
    began_s = time.monotonic()
    course: dict[str, list[float]] = {}
    next_s = WARM_UP_S
    while (passed_s := time.monotonic() - began_s) < seconds:
        if process.poll() is not None:
            last = (folder / "told.txt").read_text(errors="replace").strip().splitlines()[-1:]
            raise WorkerDiedError(f"the live chase ended by itself after {passed_s:.0f} s: {' '.join(last)}")
        if passed_s >= next_s:
            next_s += MEMORY_PERIOD_S
            for name, megabytes in _memory_mb(process.pid).items():
                course.setdefault(name, []).append(round(megabytes, 1))
        waited(int(passed_s))
        time.sleep(LOOK_S)
    return course


def _memory_mb(service: int) -> dict[str, float]:
    """Of the service, the stage (the largest of its children) and the trackers (their sum)."""
    children = _children(service)
    stage = max(children, key=_proportional_mb, default=None)
    trackers = [] if stage is None else _children(stage)
    return {
        "service": _proportional_mb(service),
        "simulated site": 0.0 if stage is None else _proportional_mb(stage),
        "a tracker": sum(map(_proportional_mb, trackers)) / max(len(trackers), 1),
    }


def _children(parent: int) -> list[int]:
    found: list[int] = []
    for task in Path(f"/proc/{parent}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += [int(number) for number in task.read_text().split()]
    return found


def _proportional_mb(process: int) -> float:
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{process}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) / 1024
    return 0.0
