"""Processes of real commands stopped and killed at random moments: whether all of a command's end, what was done can be
read, and nothing is left behind.

A live chase, a training with two agents and an evaluation with two processes, none of which ends by itself. A signal
goes to the command's first process, to one of the processes that it started, or to its group, as from a terminal.
Processes are found in /proc by a variable that only they have in their environment.
"""

import contextlib
import json
import os
import platform
import random
import secrets
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..processes.children import child_command
from ..processes.stop_request import STOP_SIGNALS
from ..processes.temporary_folder import temporary_folder

if TYPE_CHECKING:
    from rich.table import Table

SIGNALS = ("INT", "TERM", "HUP", "KILL")
VICTIMS: dict[str, tuple[str, ...]] = {
    "live": ("main", "stage", "tracker", "group"),
    "train": ("main", "worker", "group"),
    "evaluate": ("main", "worker", "group"),
}
SHARES = {"live": 60, "train": 20, "evaluate": 20}
"""How often each is drawn."""
LATEST_S = 12.0
"""After so long all is at work."""
START_S = 120.0
"""For a process to be there, on a busy machine."""
HANG_S = 90.0
"""A command that has not ended so long after a signal hangs: a training may take 60 s to its last evaluation."""
ORPHAN_S = 10.0
"""A process that lives so long after its command is an orphan."""
LOOK_S = 0.05
MARK = "SWARMCHASE_KILLS"
CACHE = "torchinductor_"
"""PyTorch makes an empty one for each user, whoever imports it, and finds it again."""
NEAR = "sampling_hz = 100\nspatial_correlation = 0.5\nstart_distance_m = {distance_m}\nmax_movements = {movements}\n"
WORDS = {
    "live": "live --headless --controller gradient --log chase.mcap",
    "train": "train a3c --folder run --agents 2 --updates 1000000 --checkpoint-interval 10 --evaluation-interval 20 "
    "--evaluation-chases 2",
    "evaluate": "evaluate --controller random --episodes 2000000 --processes 2 --table table.parquet",
}
Finished = Callable[[int], None]
"""Is told the number of kills that are over."""


@dataclass(frozen=True)
class Kill:
    """What happens to one run."""

    command: str
    signal: str
    """INT, TERM, HUP or KILL."""
    victim: str
    """``main``, ``group``, or a process that main, or ``stage``, has started."""
    after_s: float
    """Since the victim is there."""
    which: int = 0
    """Of several."""


@dataclass(frozen=True)
class Outcome:
    """What became of it."""

    exit_code: int | None
    """None: it hung."""
    ended_s: float
    """After the signal, of the command,"""
    all_ended_s: float | None
    """and of the last of its processes; None where one is left."""
    printed: bool
    """One JSON value on standard output."""
    unreadable: str | None
    """Why what it has written cannot be read."""
    left: list[str]
    """In its temporary folder."""
    traceback: str | None
    """The last line of one on standard error."""


def measure(kills: int, seed: int, finished: Finished) -> dict[str, Any]:
    """So many runs, one after another.

    Raises:
        InputError: none, or no /proc to find processes in.
    """
    if kills < 1:
        raise InputError(f"kills = {kills} is refused: allowed is at least 1")
    if not Path("/proc/self/environ").exists():
        raise InputError("there is no /proc here to find processes in")
    results: list[tuple[Kill, Outcome]] = []
    with _nothing_ignored():
        for number, kill in enumerate(drawn_kills(kills, seed), start=1):
            with temporary_folder("swarmchase-kills-") as folder:
                results.append((kill, one_kill(kill, folder)))
            finished(number)
    return _summary(results, seed)


@contextlib.contextmanager
def _nothing_ignored() -> Iterator[None]:
    """What this process ignores, as a script's background job ignores SIGINT, those that it starts would ignore, too;
    what it handles they would not.
    """
    ignored = [number for number in STOP_SIGNALS if signal.getsignal(number) is signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, lambda _number, _frame: None)
    try:
        yield
    finally:
        for number in ignored:
            signal.signal(number, signal.SIG_IGN)


def drawn_kills(number: int, seed: int) -> list[Kill]:
    """Every command, signal, victim and moment at random."""
    draw = random.Random(seed)
    commands = draw.choices(list(SHARES), list(SHARES.values()), k=number)
    return [
        Kill(
            one,
            draw.choice(SIGNALS),
            draw.choice(VICTIMS[one]),
            round(draw.uniform(0, LATEST_S), 2),
            draw.randrange(6),
        )
        for one in commands
    ]


def one_kill(kill: Kill, folder: Path) -> Outcome:
    """Start the command in an empty folder, and see what becomes of it."""
    (folder / "tmp").mkdir()
    is_live = kill.command == "live"
    scenario = NEAR.format(distance_m=100 if is_live else 20, movements=500 if is_live else 20)
    (folder / "scenario.toml").write_text(scenario)
    mark = secrets.token_hex(8)
    words = [*WORDS[kill.command].split(), "--scenario", "scenario.toml", "--json"]
    with open(folder / "printed.txt", "wb") as printed, open(folder / "told.txt", "wb") as told:
        process = subprocess.Popen(
            child_command(words),
            cwd=folder,
            env={**os.environ, "TMPDIR": str(folder / "tmp"), MARK: mark},
            stdin=subprocess.DEVNULL,
            stdout=printed,
            stderr=told,
            start_new_session=True,
        )
    try:
        _send(kill, process.pid, mark)
        return _outcome(kill, process, mark, folder)
    finally:
        for one in _marked(mark):
            with contextlib.suppress(ProcessLookupError):
                os.kill(one, signal.SIGKILL)
        process.wait()


def _send(kill: Kill, main: int, mark: str) -> None:
    number = signal.Signals[f"SIG{kill.signal}"]
    deadline_s = time.monotonic() + START_S
    while not (victims := _victims(kill.victim, main, mark)):
        if time.monotonic() > deadline_s:
            raise InputError(f"no process {kill.victim} of {kill.command} within {START_S:g} s")
        time.sleep(LOOK_S)
    time.sleep(kill.after_s)
    victims = _victims(kill.victim, main, mark) or victims
    with contextlib.suppress(ProcessLookupError):
        if kill.victim == "group":
            os.killpg(main, number)
        else:
            os.kill(victims[kill.which % len(victims)], number)


def _victims(victim: str, main: int, mark: str) -> list[int]:
    if victim in {"main", "group"}:
        return [main]
    sign = b"--number" if victim == "tracker" else b"--multiprocessing-fork"
    return [one for one in _marked(mark) if sign in _file(one, "cmdline").split(b"\0")]


def _marked(mark: str) -> list[int]:
    """Processes with this mark that have not ended."""
    sign = f"{MARK}={mark}".encode()
    numbers = [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit()]
    return sorted(one for one in numbers if sign in _file(one, "environ").split(b"\0"))


def _file(process: int, name: str) -> bytes:
    """Empty where the process has ended."""
    try:
        return Path(f"/proc/{process}/{name}").read_bytes()
    except OSError:
        return b""


def _outcome(kill: Kill, process: "subprocess.Popen[bytes]", mark: str, folder: Path) -> Outcome:
    began_s = time.monotonic()
    try:
        exit_code = process.wait(HANG_S)
    except subprocess.TimeoutExpired:
        exit_code = None
    ended_s = time.monotonic()
    while (alive := _marked(mark)) and time.monotonic() < ended_s + ORPHAN_S:
        time.sleep(LOOK_S)
    all_ended_s = None if alive else round(time.monotonic() - began_s, 2)
    told = (folder / "told.txt").read_text(errors="replace").strip()
    return Outcome(
        exit_code,
        round(ended_s - began_s, 2),
        all_ended_s,
        _is_json((folder / "printed.txt").read_text()),
        unreadable(kill.command, folder),
        sorted(path.name for path in (folder / "tmp").iterdir() if not path.name.startswith(CACHE)),
        told.splitlines()[-1] if "Traceback" in told else None,
    )


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except ValueError:
        return False
    return True


def unreadable(command: str, folder: Path) -> str | None:
    """What the command would be asked to read again: the chase's log; the run's log and resume file. An evaluation that
    has not ended leaves no table."""
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    from ..live.log.recording import read_recording
    from ..training.run_folder import LOG_FILE, read_log

    try:
        if command == "live" and (log := folder / "chase.mcap").exists():
            for _ in read_recording(log).frames():
                pass
        if command == "train" and (run := folder / "run").exists():
            if (run / LOG_FILE).exists():
                read_log(run, "chase")
            if (resume := run / "resume.safetensors").exists():
                load_file(resume)
    except (SafetensorError, ValueError) as error:
        return str(error)
    return "there is a table" if (folder / "table.parquet").exists() else None


def _summary(results: list[tuple[Kill, Outcome]], seed: int) -> dict[str, Any]:
    endings = Counter(f"{kill.command} {kill.signal} {one.exit_code}" for kill, one in results)
    return {
        "benchmark": "kills",
        "processor": platform.processor() or platform.machine(),
        "seed": seed,
        "kills": len(results),
        "hangs": sum(one.exit_code is None for _, one in results),
        "orphans": sum(one.all_ended_s is None for _, one in results),
        "unreadable": sum(one.unreadable is not None for _, one in results),
        "left_in_temporary_folders": sum(bool(one.left) for _, one in results),
        "tracebacks": sum(one.traceback is not None for _, one in results),
        "most_s_until_ended": max(one.ended_s for _, one in results),
        "most_s_until_all_ended": max(one.all_ended_s or 0.0 for _, one in results),
        "endings": dict(sorted(endings.items())),
        "runs": [asdict(kill) | asdict(one) for kill, one in results],
    }


def table(result: dict[str, Any]) -> "Table":
    """What people see."""
    from rich.table import Table

    shown = Table("", "of", title=f"{result['kills']} kills, seed {result['seed']}")
    for name in ("hangs", "orphans", "unreadable", "left_in_temporary_folders", "tracebacks"):
        shown.add_row(name.replace("_", " "), str(result[name]))
    shown.caption = (
        f"commands ended within {result['most_s_until_ended']:g} s, the last of their processes within "
        f"{result['most_s_until_all_ended']:g} s"
    )
    return shown
