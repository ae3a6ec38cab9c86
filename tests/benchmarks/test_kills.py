"""``swarmchase benchmark kills``, a few of them; the hundred are in benchmarks/kills.json."""

from pathlib import Path

import pytest

pytest.importorskip("mcap", reason="the live system needs: pip install 'swarmchase[live]'")

from swarmchase.benchmarks.kills import SIGNALS, VICTIMS, Kill, drawn_kills, one_kill, unreadable

pytestmark = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="finds processes in /proc")


def test_a_hundred_are_of_every_kind_and_the_same_for_a_seed() -> None:
    kills = drawn_kills(100, 0)
    assert kills == drawn_kills(100, 0) != drawn_kills(100, 1)
    every = {(command, signal) for command in VICTIMS for signal in SIGNALS}
    assert {(kill.command, kill.signal) for kill in kills} == every
    assert {(kill.command, kill.victim) for kill in kills} == {(one, it) for one, its in VICTIMS.items() for it in its}


@pytest.mark.parametrize(
    ("kill", "exit_code"),
    [
        (Kill("train", "KILL", "group", after_s=3.0), -9),
        (Kill("train", "KILL", "worker", after_s=1.0, which=2), 1),
        (Kill("evaluate", "KILL", "main", after_s=4.0), -9),
    ],
    ids=str,
)
def test_a_kill_leaves_nothing_behind_but_what_can_be_read(kill: Kill, exit_code: int, tmp_path: Path) -> None:
    outcome = one_kill(kill, tmp_path)
    assert (outcome.exit_code, outcome.printed, outcome.unreadable, outcome.left) == (exit_code, False, None, [])
    assert outcome.all_ended_s is not None
    assert outcome.traceback is None


@pytest.mark.parametrize(
    ("command", "file"),
    [("live", "chase.mcap"), ("train", "run/resume.safetensors"), ("evaluate", "table.parquet")],
)
def test_what_cannot_be_read_is_seen(command: str, file: str, tmp_path: Path) -> None:
    assert unreadable(command, tmp_path) is None
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_bytes(b"half of it")
    assert unreadable(command, tmp_path)
