"""The six tracker processes of a simulated live chase, and what happens to them."""

import contextlib
import itertools
import os
import signal
import subprocess
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from ..live.address import LOOPBACK
from ..live.link.udp_socket import bound_udp_socket
from ..processes.children import child_command
from ..processes.stop_request import STOPPED_CODES
from ..scenario import NUM_TRACKERS, Scenario
from .fault_plan import FaultPlan, ProcessFault
from .site import reporting_in

SLOW_PERIOD_S, SLOW_SHARE = 0.2, 0.1
"""A slow tracker runs for this share of each period."""
END_S = 5.0
"""So long a tracker may take to end when it is told to."""
LOWEST_PORT, NUM_PORTS, PORTS_APART = 15_000, 15_000, 15
"""Below those that Linux (from 32768) and others (from 49152) hand out."""
_STEPS = itertools.count()


@dataclass(frozen=True)
class TrackerPorts:
    """UDP ports of one tracker on this machine."""

    source: int
    """Where it hears its receiver."""
    vehicle: int
    """Where it hears its autopilot."""
    controller: int
    """What it dials."""


class TrackerProcesses:
    """Starts them and, in ``step``, does to them what the plan says.

    Args:
        folder: holds ``tracker-N.keys``; what they print goes to ``tracker-N.txt`` there.
    """

    def __init__(self, scenario: Scenario, plan: FaultPlan, ports: list[TrackerPorts], folder: Path) -> None:
        self._scenario, self._plan, self._ports, self._folder = scenario, plan, ports, folder
        self._reporting = reporting_in(scenario)
        self._running: dict[int, subprocess.Popen[bytes]] = {}
        for tracker in range(NUM_TRACKERS):
            self._start(tracker)

    def step(self, chase_s: float) -> None:
        """So many seconds into the chase."""
        for tracker in range(NUM_TRACKERS):
            faults = {fault.fault for fault in self._plan.of_process(tracker, chase_s)}
            if self._plan.is_dead(tracker, chase_s):
                self._kill(tracker)
            elif tracker not in self._running:
                self._start(tracker)
            else:
                is_slow = ProcessFault.SLOW in faults and chase_s % SLOW_PERIOD_S > SLOW_SHARE * SLOW_PERIOD_S
                stands_still = is_slow or ProcessFault.FROZEN in faults
                self._send(tracker, signal.SIGSTOP if stands_still else signal.SIGCONT)

    def died(self) -> dict[int, int]:
        """The trackers that have failed or were killed, not by the plan, with their exit codes."""
        return {tracker: code for tracker, code in self._ended().items() if code not in STOPPED_CODES}

    def any_was_stopped(self) -> bool:
        """Whether one was told to stop, and has."""
        return any(code in STOPPED_CODES for code in self._ended().values())

    def last_words(self, tracker: int) -> str:
        """The end of what it printed."""
        lines = self._output(tracker).read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""

    def close(self) -> None:
        """End them all: told first, killed if need be."""
        for tracker in self._running:
            self._send(tracker, signal.SIGCONT)
            self._send(tracker, signal.SIGTERM)
        for process in self._running.values():
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._running.clear()

    def _start(self, tracker: int) -> None:
        ports, folder = self._ports[tracker], self._folder
        words = [
            *("tracker", "--number", str(tracker)),
            *("--source", f"udp:{ports.source}", "--same-clock", "--sampling-hz", f"{self._scenario.sampling_hz:g}"),
            *("--vehicle", f"mavlink:{ports.vehicle}", "--autopilot-origin-m", "0", "0", "0"),
            *("--service", f"{LOOPBACK}:{ports.controller}", "--keys", str(folder / f"tracker-{tracker}.keys")),
            *("--window-hz", f"{self._reporting.window_hz:g}", "--position-hz", f"{self._reporting.position_hz:g}"),
            *("--state-folder", str(folder / "state")),
        ]
        with open(self._output(tracker), "ab") as output:
            # A group of its own: Ctrl-C is for the command that started all this, which then ends them.
            self._running[tracker] = subprocess.Popen(
                child_command(words), stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True
            )

    def _ended(self) -> dict[int, int]:
        codes = {tracker: process.poll() for tracker, process in self._running.items()}
        return {tracker: code for tracker, code in codes.items() if code is not None}

    def _kill(self, tracker: int) -> None:
        process = self._running.pop(tracker, None)
        if process is not None:
            process.kill()
            process.wait()

    def _send(self, tracker: int, number: int) -> None:
        process = self._running[tracker]
        if process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process.pid, number)

    def _output(self, tracker: int) -> Path:
        return self._folder / f"tracker-{tracker}.txt"


def free_udp_ports(number: int) -> list[int]:
    """Of this machine, for processes that will open them.

    Not of those that the system hands out: somebody who asks for any port would be given one before it is used. Where
    the search begins differs from process to process, so that two that search at once find others, and it goes on from
    where the last one ended.
    """
    search = (LOWEST_PORT + (PORTS_APART * os.getpid() + step) % NUM_PORTS for step in _STEPS)
    return list(itertools.islice(filter(_is_free, search), number))


def _is_free(port: int) -> bool:
    try:
        bound_udp_socket(LOOPBACK, port).close()
    except InputError:
        return False
    return True
