"""Real files of every kind that the package reads, damaged at random, and read by the package itself.

    python tests/file_fuzz.py EXAMPLES SEED

damages each kind so many times. A read may give something or be refused by an ``InputError``; anything else ends the
process with what it was, and so does a read that takes 30 s or needs a gigabyte more than there was. Prints one JSON
object: how many of each kind were read and refused.
"""

import json
import random
import re
import resource
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import torch
from mcap.writer import Writer

from live_bench import Bench
from swarmchase.errors import InputError
from swarmchase.evaluation.chases import ChaseResult
from swarmchase.evaluation.comparison import Place, Result, read_results, save_results
from swarmchase.evaluation.table import Evaluation
from swarmchase.evaluation.tables import read_rows
from swarmchase.files import new_file
from swarmchase.live.events import Events
from swarmchase.live.frame import frame_of
from swarmchase.live.link.keys import new_keys, read_keys, write_keys
from swarmchase.live.log.entries import new_head
from swarmchase.live.log.file import LogFile
from swarmchase.live.log.mcap_messages import messages
from swarmchase.live.log.recording import read_recording
from swarmchase.live.service.chase_state import ChaseState, Decision, Transition
from swarmchase.live.service.safety import SafetyLimits
from swarmchase.live.service.state_folder import next_epoch
from swarmchase.live.tracker.sources.pcap import pcap_rows
from swarmchase.live.tracker.sources.replay import csv_rows, json_rows
from swarmchase.networks.fading import FadingNetwork
from swarmchase.networks.forms import new_networks
from swarmchase.networks.weights import load_weights, save_weights
from swarmchase.scenario import Scenario, paper_scenario
from swarmchase.training.agent import FinishedChase, LocalAgent
from swarmchase.training.evaluator import AuxiliaryEvaluation
from swarmchase.training.global_agent import SharedParameters
from swarmchase.training.parameters import FlatNetworks
from swarmchase.training.run_folder import LOG_FILE, RESUME_FILE, ResumePoint, RunFolder, TrainingLog, read_log
from swarmchase.training.settings import preset

READ_LIMIT_S = 30
MEMORY_BYTES = 2**30
LONGEST_REFUSAL = 2000
SHORT = paper_scenario(window_samples=2)
SETTINGS = replace(preset("recurrent"), num_agents=2, chases_per_agent=2)
RESULT = ChaseResult(7, 0, 1.0, 2.0, 3.0, 24, True, 99.5)
SPECIAL = """NaN Infinity -Infinity 1e999 -1 0 -0.0 2.5 1e-400 99999999999999999999999 null true [] {} "" "\\ud800" """
DEEP = ("[" * 50 + "]" * 50, "[" * 5000, '{"a":' * 500 + "1" + "}" * 500, "9" * 5000, "[" + "0," * 5000 + "0]")
TOKEN = re.compile(rb'-?\d+(?:\.\d+)?(?:[eE]-?\d+)?|"[^"]{0,40}"|true|false|null|nan')


# Real files


def scenario_file(path: Path) -> None:
    paper_scenario().save_toml(path)


def weights_file(path: Path) -> None:
    save_weights(path, FadingNetwork(torch.Generator().manual_seed(0)), {"action_choice": "greedy", "update": 5})


def resume_file(path: Path) -> None:
    parameters = SharedParameters.start(FlatNetworks(new_networks(SETTINGS, torch.Generator().manual_seed(0))).vector)
    agents = [LocalAgent(SHORT, SETTINGS, index).snapshot() for index in range(SETTINGS.num_agents)]
    best = AuxiliaryEvaluation(4, 30.5, 41.0, 1.0, [41.0])
    folder = RunFolder(path.parent, [SHORT], SETTINGS)
    folder.save(ResumePoint(parameters, agents, best, 1000, 60.5))
    folder.close()
    (path.parent / RESUME_FILE).rename(path)


def resumed(path: Path) -> None:
    """As a training does it."""
    path.rename(path.parent / RESUME_FILE)
    folder = RunFolder(path.parent, [SHORT], SETTINGS)
    try:
        point = folder.load()
        for index, snapshot in enumerate(point.agents):
            agent = LocalAgent(SHORT, SETTINGS, index)
            agent.restore(snapshot)
    finally:
        folder.close()


def training_log(path: Path) -> None:
    log = TrainingLog(path.parent, 0)
    for number in range(20):
        log.chase(FinishedChase(0, number, number, 24, True, (0.5, 1.0, -1.0, 2.0)))
        log.fault(number, "node a is gone")
    log.close()
    (path.parent / LOG_FILE).rename(path)


def logged(path: Path) -> None:
    path.rename(path.parent / LOG_FILE)
    read_log(path.parent, "chase")


def table(path: Path) -> None:
    place = Place(SHORT, "as told", SHORT)
    chases = [replace(RESULT, chase=number) for number in range(50)]
    save_results(path.parent, [Result(place, Evaluation(SHORT, "oracle", None, 7, chases, SHORT))])
    (path.parent / "comparison.parquet").rename(path)


def tabled(path: Path) -> None:
    read_rows(path, "table")
    read_results(path)


def log_file(path: Path) -> None:
    bench = Bench()
    bench.run_until(ChaseState.MOVING)
    snapshot, events = bench.service.snapshot(), Events(lambda _snapshot: [])
    frame = frame_of(snapshot, 0, [(10.0, -20.0, 30.0)], [0.1] * 6, Counter(), 0.001, events)
    rssi_dbm, position_m = torch.full((2, 6), -60.5).double().numpy(), torch.zeros(2, 6, 3).double().numpy()
    with new_file(path, "log") as file:
        log = LogFile(file, new_head("gradient", SHORT, 4, 7, 3, SafetyLimits(), 5_000_000_000))
        for number in (1, 2):
            log.write(Transition(5_000_000_000 + number, ChaseState.MOVING, ChaseState.SAMPLING, "arrived"))
            log.write(frame)
            log.write(Decision(6_000_000_000 + number, number, rssi_dbm, position_m, 3.0, (4.0, -2.0, 0.0), ""))
            log.flush()
        log.finish()


def recorded(path: Path) -> None:
    for _ in read_recording(path).frames():
        pass


def csv_file(path: Path) -> None:
    path.write_text(
        "time_s,note,rssi_dbm\n" + "".join(f'{number / 10},"a ""b""",-6{number % 10}.5\n' for number in range(99))
    )


def json_file(path: Path) -> None:
    path.write_text(json.dumps({str(number): {"time": number / 10, "rssi": -60.5} for number in range(99)}))


def pcap_file(path: Path) -> None:
    """Radiotap with the antenna's signal alone, and the head of a beacon."""
    packet = bytes.fromhex("0000090020000000c4") + bytes.fromhex("80000000ffffffffffff0200000000010200000000010000")
    head = bytes.fromhex("d4c3b2a1020004000000000000000000000004007f000000")
    frames = (number.to_bytes(4, "little") + bytes(4) + 2 * len(packet).to_bytes(4, "little") for number in range(50))
    path.write_bytes(head + b"".join(frame + packet for frame in frames))


def epoch_file(path: Path) -> None:
    next_epoch(path)


# Damage


def cut(rng: random.Random, content: bytes) -> bytes:
    return content[: rng.randrange(len(content) + 1)]


def flipped(rng: random.Random, content: bytes) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 10))):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def overwritten(rng: random.Random, content: bytes) -> bytes:
    at, length = rng.randrange(len(content)), rng.choice((1, 2, 4, 8, 100))
    return (
        content[:at] + rng.choice((b"\xff" * length, b"\x00" * length, rng.randbytes(length))) + content[at + length :]
    )


def spliced(rng: random.Random, content: bytes) -> bytes:
    first, last = sorted((rng.randrange(len(content)), rng.randrange(len(content))))
    at = rng.randrange(len(content))
    return content[:at] + content[first:last] * rng.choice((0, 1, 1, 5)) + content[at + rng.choice((0, last - first)) :]


def another_token(rng: random.Random, content: bytes) -> bytes:
    """One number or text becomes what it should not be."""
    found = list(TOKEN.finditer(content))
    if not found:
        return flipped(rng, content)
    token = rng.choice(found)
    return content[: token.start()] + rng.choice((*SPECIAL.split(), *DEEP)).encode() + content[token.end() :]


DAMAGE = (cut, flipped, overwritten, spliced, another_token, another_token)


def damaged(rng: random.Random, content: bytes) -> bytes:
    for _ in range(rng.choice((1, 1, 1, 3))):
        content = rng.choice(DAMAGE)(rng, content) if content else rng.randbytes(20)
    return content


def anywhere(rng: random.Random, path: Path) -> None:
    path.write_bytes(damaged(rng, path.read_bytes()))


def in_the_header(rng: random.Random, path: Path) -> None:
    """Of a safetensors file, whose length then is right again; half of the time anywhere."""
    content = path.read_bytes()
    end = 8 + int.from_bytes(content[:8], "little")
    if rng.random() < 0.5:
        anywhere(rng, path)
        return
    header = damaged(rng, content[8:end])
    if rng.random() < 0.5:  # what looks like tensors of other types and shapes
        header = header.replace(
            b'"F32"', rng.choice((b'"F8_E5M2"', b'"C64"', b'"I64"', b'"BOOL"', b'"U16"', b'"F4"')), 1
        )
    path.write_bytes(len(header).to_bytes(8, "little") + header + content[end:])


def in_a_message(rng: random.Random, path: Path) -> None:
    """Of a log that is whole all the same; half of the time anywhere."""
    if rng.random() < 0.5:
        anywhere(rng, path)
        return
    found = list(messages(path))
    chosen = rng.randrange(len(found))
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        for number, message in enumerate(found):
            channel = writer.register_channel(message.topic, "json", 0)
            data = damaged(rng, message.data) if number == chosen else message.data
            writer.add_message(channel, message.log_time_ns, data, message.log_time_ns, number)
        writer.finish()


def in_a_column(rng: random.Random, path: Path) -> None:
    """Of a table that is Parquet all the same, or in what it says of itself; half of the time anywhere."""
    if rng.random() < 0.5:
        anywhere(rng, path)
        return
    found = pq.read_table(path)
    rows, document = found.num_rows, found.schema.metadata[b"swarmchase"]
    odd: list[Any] = [None, "x", [1], 2**60, {"a": 1}, -1, 0.5]
    column = rng.randrange(found.num_columns)
    if rng.random() < 0.5:
        found = found.set_column(column, found.column_names[column], pa.array([rng.choice(odd)] * rows))
    else:
        document = damaged(rng, document)
    pq.write_table(found.replace_schema_metadata({b"swarmchase": document}), path)


@dataclass(frozen=True)
class Kind:
    write: Callable[[Path], None]
    read: Callable[[Path], object]
    damage: Callable[[random.Random, Path], None] = anywhere


KINDS = {
    "scenario": Kind(scenario_file, Scenario.load_toml),
    "weights": Kind(weights_file, load_weights, in_the_header),
    "resume": Kind(resume_file, resumed, in_the_header),
    "training log": Kind(training_log, logged),
    "table": Kind(table, tabled, in_a_column),
    "log": Kind(log_file, recorded, in_a_message),
    "csv": Kind(csv_file, lambda path: list(csv_rows(path))),
    "json": Kind(json_file, lambda path: list(json_rows(path))),
    "pcap": Kind(pcap_file, lambda path: list(pcap_rows(path))),
    "epoch": Kind(epoch_file, next_epoch),
    "keys": Kind(lambda path: write_keys(path, new_keys()), read_keys),
}


def outcome(kind: Kind, content: bytes, rng: random.Random, folder: Path) -> str:
    """What became of one damaged file."""
    path = folder / "it"
    path.write_bytes(content)
    path.chmod(0o600)
    kind.damage(rng, path)
    signal.alarm(READ_LIMIT_S)
    try:
        kind.read(path)
    except InputError as error:
        if len(str(error)) > LONGEST_REFUSAL:
            raise AssertionError("a refusal that nobody reads") from error
        return "refused"
    finally:
        signal.alarm(0)
    return "read"


def fuzz(examples: int, seed: int, folder: Path) -> dict[str, Counter[str]]:
    """Each kind so many times."""
    found: dict[str, Counter[str]] = {}
    for name, kind in KINDS.items():
        home = folder / name.replace(" ", "-")
        home.mkdir()
        kind.write(home / "whole")
        content = (home / "whole").read_bytes()
        kind.read(home / "whole")
        found[name] = Counter()
        for number in range(examples):
            place = f"{name}, example {number} of seed {seed}"
            try:
                found[name][outcome(kind, content, random.Random(f"{seed} {name} {number}"), home)] += 1
            except BaseException as error:
                raise AssertionError(f"{place}: {type(error).__name__}") from error
    return found


if __name__ == "__main__":
    now_bytes = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now_bytes + MEMORY_BYTES,) * 2)
    with tempfile.TemporaryDirectory() as temporary:
        print(json.dumps(fuzz(int(sys.argv[1]), int(sys.argv[2]), Path(temporary))))
