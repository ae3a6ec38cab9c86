"""A live chase that does not end, in real processes, with page and log: memory over time, and the time of decisions.

A target that stands does so at the scenario's distance; when the swarm has reached it nobody says so, and it goes on
listening and moving. One that flies is followed, and looked for where it is lost: for how much of the time the swarm
was with it, and how often it lost and found it, is measured, too. Memory is what the system counts as each process's
own (proportional set size where /proc tells it).
"""

import contextlib
import dataclasses
import json
import math
import platform
import signal
import subprocess
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, WorkerDiedError
from ..live.log.recording import read_recording
from ..live.service.chase_state import ChaseState, Transition
from ..live.service.following import FOLLOWING_M
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
"""So long a chase that is told to end may take for it."""
MOST_MOVEMENTS = 1_000_000
"""Of a swarm that stops to listen: more than anybody waits for."""


def measure(scenario: Scenario, controller: str, seconds: float, faults: str, waited: Waited) -> dict[str, Any]:
    """Let a live chase run for so long.

    Args:
        seconds: As ``require_seconds`` admits.

    Raises:
        InputError: there is no /proc to read memory from.
        WorkerDiedError: it ended by itself.
    """
    if not Path("/proc/self/smaps_rollup").exists():
        raise InputError("there is no /proc here to read the memory of processes from")
    flies = scenario.pace == "listen_in_flight"
    with temporary_folder("swarmchase-soak-") as folder:
        endless(scenario, seconds).save_toml(folder / "scenario.toml")
        words = ["live", "--scenario", "scenario.toml", "--controller", controller]
        words += ["--follow"] if flies else ["--reached-windows", "0"]
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
            if not output:
                raise _death(seconds, folder)
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
        chase = json.loads(output)
        if chase["state"] != ChaseState.ABORTED.value:
            raise WorkerDiedError(
                f"the live chase was {chase['state']} after {chase['seconds']:.0f} s: {chase['reason']}"
            )
        log_mb = (folder / "soak.mcap").stat().st_size / 1e6
        hourly = {"log_mb_an_hour": round(log_mb * 3600 / chase["seconds"], 1)}
        transitions = read_recording(folder / "soak.mcap").transitions if flies else ()
    flown = {"behaviour": scenario.behaviour, **hourly, **of_the_target(transitions)} if flies else {}
    return {
        "controller": controller,
        "sampling_hz": scenario.sampling_hz,
        "seconds": seconds,
        "faults": faults,
        "processor": platform.processor() or platform.machine(),
        "memory_mb": memory_mb,
        "log_mb": round(log_mb, 1),
        **flown,
        "chase": chase,
    }


def require_seconds(seconds: float) -> None:
    """Refuse what is no time to measure for.

    Raises:
        InputError: it is no finite number, or too short.
    """
    if not math.isfinite(seconds):
        raise InputError(f"seconds = {seconds:g} is refused: it must be a finite number")
    if seconds <= WARM_UP_S:
        raise InputError(f"seconds = {seconds:g} is refused: the first {WARM_UP_S:g} are only to warm up")


def endless(scenario: Scenario, seconds: float) -> Scenario:
    """The same with a chase that nothing ends within this time, and until it was told to end. Its movements in flight
    are those of the time, by which a simulated site's fence is as wide as its target gets.
    """
    if scenario.pace == "stop_and_listen":
        return dataclasses.replace(scenario, max_movements=MOST_MOVEMENTS)
    movements = math.ceil((seconds + END_S) / scenario.decision_s)
    return dataclasses.replace(scenario, max_movements=movements, follow_s=0.0)


def of_the_target(transitions: Iterable[Transition]) -> dict[str, Any]:
    """How often a target in flight was reached, lost and found again, and for how long it was looked for."""
    reached = lost = found = 0
    searched_ns = since_ns = 0
    for one in transitions:
        # After a hold the search goes on for the same target.
        reached += one.after is ChaseState.FOLLOWING and one.before is ChaseState.PURSUING
        lost += one.after is ChaseState.SEARCHING and one.before is not ChaseState.HOLDING
        found += one.before is ChaseState.SEARCHING and one.after is ChaseState.PURSUING
        if one.before is ChaseState.SEARCHING:
            searched_ns += one.time_ns - since_ns
        since_ns = one.time_ns
    return {
        "times_reached": reached,
        "times_lost": lost,
        "times_found": found,
        "searched_s": round(searched_ns / 1e9, 1),
    }


def table(result: dict[str, Any]) -> "Table":
    """What people see."""
    from rich.table import Table

    shown = Table("Process", "MB after a minute", "MB at the end", title=f"{result['seconds']:g} s")
    for name, course in result["memory_mb"].items():
        shown.add_row(name, f"{course[0]:.1f}", f"{course[-1]:.1f}")
    shown.caption = "\n".join(_caption(result))
    return shown


def _caption(result: dict[str, Any]) -> list[str]:
    chase = result["chase"]
    p50_ms, p99_ms = chase["decision_latency_p50_ms"], chase["decision_latency_p99_ms"]
    lines = [f"{chase['movements']} movements; decisions p50 {p50_ms} ms, p99 {p99_ms} ms; log {result['log_mb']} MB"]
    if "behaviour" not in result:
        return lines
    lines[0] += f", {result['log_mb_an_hour']} MB an hour"
    share = chase["true_following_share"]
    followed = (
        "never within the success radius"
        if share is None
        else f"within {FOLLOWING_M:g} m for {share:.1%} of the time since"
    )
    since = "" if chase["capture_s"] is None else f"first after {chase['capture_s']:.1f} s; "
    lines.append(f"{result['behaviour']}: {since}{followed}")
    times = ", ".join(f"{word} {result[f'times_{word}']} times" for word in ("reached", "lost", "found"))
    lines.append(f"{times}; searched for {result['searched_s']:.0f} s")
    return lines


def _watch(process: "subprocess.Popen[bytes]", seconds: float, waited: Waited, folder: Path) -> dict[str, list[float]]:
    """Megabytes of each process every ``MEMORY_PERIOD_S`` from ``WARM_UP_S`` on, and at the end."""
    began_s = time.monotonic()
    course: dict[str, list[float]] = {}
    next_s = WARM_UP_S
    while True:
        passed_s = time.monotonic() - began_s
        if process.poll() is not None:
            raise _death(passed_s, folder)
        if passed_s >= seconds:
            _note(course, process.pid)
            return course
        if passed_s >= next_s:
            next_s += MEMORY_PERIOD_S
            _note(course, process.pid)
        waited(int(passed_s))
        time.sleep(min(LOOK_S, seconds - passed_s))


def _death(after_s: float, folder: Path) -> WorkerDiedError:
    """Of a chase that has ended by itself, with the last that it said."""
    last = (folder / "told.txt").read_text(errors="replace").strip().splitlines()[-1:]
    return WorkerDiedError(f"the live chase ended by itself after {after_s:.0f} s: {' '.join(last)}")


def _note(course: dict[str, list[float]], service: int) -> None:
    for name, megabytes in _memory_mb(service).items():
        course.setdefault(name, []).append(round(megabytes, 1))


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
