"""Fresh means fresh: what is held back, clocks that are wrong, the state file's lock, and keys that are taken away."""

import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pymavlink", reason="the MAVLink link needs pymavlink: pip install swarmchase[live]")

from live_bench import FLYING
from swarmchase.cli import main
from swarmchase.errors import InputError
from swarmchase.live.clock import VirtualClock
from swarmchase.live.link.keys import new_keys, read_keys, write_keys
from swarmchase.live.link.mavlink import ControllerMavlinkLink, TrackerMavlinkLink
from swarmchase.live.link.messages import Heartbeat, SetPoint, TrackerMode
from swarmchase.live.link.news import TOLD_AGAIN_S, LinkNews
from swarmchase.live.link.real_time import CONFIRMED_FOR_S
from swarmchase.live.link.state_file import CONTROLLER_FILE, tracker_file
from swarmchase.simulation.fault_plan import fault_plan
from swarmchase.simulation.virtual_chase import START_NS, SkewedClock
from swarmchase.simulation.virtual_network import CONTROLLER, VirtualNetwork

KEYS = new_keys()
SECOND_NS = 10**9
HOUR_S = 3600.0


class Air:
    """A controller and tracker 2 over a network on a made clock; each has a clock of its own for real time."""

    def __init__(self, folder: Path | None = None) -> None:
        self.clock = VirtualClock(START_NS)
        self.folder = folder
        self.network = VirtualNetwork(self.clock, fault_plan(""), "1")
        self.wall, self.tracker_wall = SkewedClock(self.clock), SkewedClock(self.clock)
        self.controller, self.tracker = self.new_controller(), self.new_tracker()

    def new_controller(self) -> ControllerMavlinkLink:
        return ControllerMavlinkLink(
            *CONTROLLER,
            KEYS,
            state_path=self.folder and self.folder / CONTROLLER_FILE,
            wall_time_ns=self.wall.now_ns,
            monotonic_ns=self.clock.now_ns,
            udp=self.network.controller,
        )

    def new_tracker(self) -> TrackerMavlinkLink:
        return TrackerMavlinkLink(
            2,
            *CONTROLLER,
            KEYS[2],
            state_path=self.folder and self.folder / tracker_file(2),
            wall_time_ns=self.tracker_wall.now_ns,
            monotonic_ns=self.clock.now_ns,
            udp=self.network.trackers[2],
        )

    def close(self) -> None:
        self.controller.close()
        self.tracker.close()

    def reports_arrive(self, held_s: float = 0.0) -> bool:
        """Whether the controller takes a report that comes so many seconds after it was sent."""
        self.tracker.send(Heartbeat(2, self.clock.now_ns() % 10**15, TrackerMode.HOLDING, FLYING))
        self.clock.advance(held_s)
        self.network.pass_on()
        return bool(self.controller.receive())

    def set_points_arrive(self, held_s: float = 0.0) -> bool:
        self.controller.send(SetPoint(2, self.clock.now_ns() % 10**15, 1, (0.0, 0.0, 0.0)))
        self.clock.advance(held_s)
        self.network.pass_on()
        return bool(self.tracker.receive())


@pytest.fixture
def air(tmp_path: Path) -> Iterator[Air]:
    made = Air(tmp_path)
    yield made
    made.close()


# Held back


@pytest.mark.parametrize("held_s", [0.0, 1.9])
def test_what_takes_less_than_two_seconds_counts(air: Air, held_s: float) -> None:
    assert air.reports_arrive(held_s)
    assert air.set_points_arrive(held_s)


@pytest.mark.parametrize("held_s", [2.1, 30.0])
def test_what_was_held_back_is_stale_at_both_ends(air: Air, held_s: float) -> None:
    assert air.reports_arrive()
    assert not air.reports_arrive(held_s)
    assert not air.set_points_arrive(held_s)
    assert air.controller.rejections.skew_s() == {"too old": {"tracker 2": pytest.approx(-held_s, abs=0.001)}}
    assert air.tracker.rejections.skew_s() == {"too old": {"the controller": pytest.approx(-held_s, abs=0.001)}}
    assert air.reports_arrive()
    assert air.set_points_arrive()


def test_nothing_counts_where_all_is_held_back_from_the_start(air: Air) -> None:
    """For a minute: every report comes, in order, thirty seconds after it was sent."""
    sent: list[tuple[bytes, Any]] = []
    pass_on = air.network.controller.put
    air.network.controller.put = lambda *datagram: sent.append(datagram)  # type: ignore[method-assign]
    for second in range(60):
        air.reports_arrive(held_s=1.0)
        if second >= 30:
            pass_on(*sent[second - 30])
            assert not air.controller.receive()
    assert air.controller.rejected == {"too old": 30}


# Wrong clocks


def test_a_packet_from_the_far_future_locks_nobody_out(air: Air) -> None:
    """The tracker's clock is wrong for one packet, which it signs with its true key; also after a restart."""
    assert air.reports_arrive()
    air.tracker.close()
    air.tracker_wall.ahead_ns = round(HOUR_S * SECOND_NS)
    ahead = TrackerMavlinkLink(
        2, *CONTROLLER, KEYS[2], wall_time_ns=air.tracker_wall.now_ns, udp=air.network.trackers[2]
    )
    ahead.send(Heartbeat(2, 1, TrackerMode.HOLDING, FLYING))
    air.network.pass_on()
    assert not air.controller.receive()
    assert air.controller.rejections.skew_s() == {"too far ahead": {"tracker 2": pytest.approx(HOUR_S, abs=1)}}
    air.tracker_wall.ahead_ns = 0
    air.tracker = air.new_tracker()
    assert air.reports_arrive()
    air.controller.close()
    air.controller = air.new_controller()
    assert air.reports_arrive()


@pytest.mark.parametrize("ahead_s", [-59.0, -2.1, 2.1, 59.0])
def test_clocks_that_do_not_agree_are_told_with_the_seconds(ahead_s: float) -> None:
    """One end or the other says it, whichever is the one that hears less than it should."""
    air = Air()
    air.tracker_wall.ahead_ns = round(ahead_s * SECOND_NS)
    assert air.reports_arrive() is (ahead_s > 0)
    lines = LinkNews(air.controller).lines()
    seconds = f"{abs(ahead_s):.1f} s"
    if ahead_s < 0:
        assert lines == [
            f"rejected a datagram in the name of tracker 2: too old: its clock is {seconds} behind, or it was held up "
            "so long"
        ]
    else:
        assert lines == [f"the clock of tracker 2 is {seconds} ahead: it takes what it is sent for too old"]
        assert not air.set_points_arrive()
        assert LinkNews(air.tracker).lines() == [
            "rejected a datagram in the name of the controller: too old: its clock is "
            f"{seconds} behind, or it was held up so long"
        ]
    air.close()


def test_what_goes_on_is_told_again_after_a_pause_with_its_rate() -> None:
    air = Air()
    air.tracker_wall.ahead_ns = round(HOUR_S * SECOND_NS)
    news = LinkNews(air.controller, lambda: (air.clock.now_ns() - START_NS) / 1e9)
    told: list[tuple[float, str]] = []
    for _ in range(round(2 * TOLD_AGAIN_S)):
        assert not air.reports_arrive(0.5)
        assert not air.reports_arrive(0.5)
        told += [(round((air.clock.now_ns() - START_NS) / 1e9), line) for line in news.lines()]
    words = " in the name of tracker 2: too far ahead: its clock is 3599.5 s ahead, or ours so much behind"
    assert told == [(1, f"rejected a datagram{words}"), (61, f"rejected 120 more (2.0 a second){words}")]
    air.close()


@pytest.mark.parametrize("step_s", [-HOUR_S, 5.0, HOUR_S])
@pytest.mark.parametrize("of_tracker", [False, True])
def test_a_step_of_a_clock_in_flight_parts_nobody(step_s: float, of_tracker: bool) -> None:
    """Once both ends have shown that they agree. After a minute in which nothing came the clock is believed again."""
    air = Air()
    assert air.reports_arrive()
    assert air.set_points_arrive()
    (air.tracker_wall if of_tracker else air.wall).ahead_ns = round(step_s * SECOND_NS)
    for _ in range(200):
        assert air.reports_arrive(1.0)
        assert air.set_points_arrive(1.0)
    air.clock.advance(CONFIRMED_FOR_S + 1)
    assert not (air.reports_arrive() and air.set_points_arrive())
    (air.tracker_wall if of_tracker else air.wall).ahead_ns = 0
    assert air.reports_arrive()
    assert air.set_points_arrive()
    air.close()


@pytest.mark.parametrize("wrong_s", [-10 * 365 * 86_400, -HOUR_S, HOUR_S, 10 * 365 * 86_400])
def test_a_clock_that_is_set_before_anybody_answers_counts_at_once(wrong_s: float) -> None:
    """A small computer without a battery for its clock: it boots years behind or in the future, and GPS sets it."""
    air = Air()
    air.tracker_wall.ahead_ns = round(wrong_s * SECOND_NS)
    assert not air.reports_arrive(1.0)
    air.tracker_wall.ahead_ns = 0
    assert air.reports_arrive()
    air.close()


# At the start


def test_a_clock_behind_what_was_signed_last_is_refused_with_the_seconds(air: Air) -> None:
    assert air.reports_arrive()
    air.tracker.close()
    air.tracker_wall.ahead_ns = -SECOND_NS
    air.tracker = air.new_tracker()
    air.tracker.close()
    air.tracker_wall.ahead_ns = round(-HOUR_S * SECOND_NS)
    told = r"this machine's clock is 3600\.0 s behind what this end has signed last: set it; .* swarmchase keys reset"
    for _ in range(2):
        with pytest.raises(InputError, match=told):
            air.new_tracker()
    air.tracker_wall.ahead_ns = 0
    air.tracker = air.new_tracker()
    assert air.reports_arrive()


def test_a_clock_behind_what_was_accepted_is_refused_with_the_seconds(air: Air) -> None:
    """A service that has only listened so far."""
    assert air.reports_arrive()
    air.controller.close()
    air.wall.ahead_ns = -50 * SECOND_NS
    air.new_controller().close()
    air.wall.ahead_ns = -100 * SECOND_NS
    with pytest.raises(InputError, match=r"clock is 100\.0 s behind what tracker 2 has signed last: set it"):
        air.new_controller()


def reset(words: str, capsys: pytest.CaptureFixture[str]) -> Any:
    main(["keys", "reset", *words.split(), "--json"])
    return json.loads(capsys.readouterr().out)


def test_a_clock_that_was_ahead_is_forgotten_by_a_reset(
    air: Air, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both ends were an hour ahead, and agreed. Then the clocks are right: neither end starts before its reset."""
    air.close()
    air.wall.ahead_ns = air.tracker_wall.ahead_ns = round(HOUR_S * SECOND_NS)
    air.controller, air.tracker = air.new_controller(), air.new_tracker()
    assert air.reports_arrive()
    assert air.set_points_arrive()
    with pytest.raises(SystemExit) as end:
        main(["keys", "reset", "2", "--state-folder", str(tmp_path)])
    assert end.value.code == 2
    assert "in use by another process" in capsys.readouterr().err
    air.close()
    air.wall.ahead_ns = air.tracker_wall.ahead_ns = 0
    files = [str(tmp_path / CONTROLLER_FILE), str(tmp_path / tracker_file(2))]
    assert reset(f"2 --state-folder {tmp_path}", capsys) == {"sender": "tracker 2", "files": files}
    for new in (air.new_controller, air.new_tracker):
        with pytest.raises(InputError, match=r"3600\.0 s behind what (this end|the controller) has signed last"):
            new()
    assert reset(f"controller --state-folder {tmp_path}", capsys) == {"sender": "the controller", "files": files}
    air.controller, air.tracker = air.new_controller(), air.new_tracker()
    assert air.reports_arrive()
    assert air.set_points_arrive()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("reset 6", "sender '6' is refused: allowed is one of 0, 1, 2, 3, 4, 5, controller"),
        ("reset 4 --state-folder empty", "no state file in empty holds anything of tracker 4"),
        ("reset 4 --state-folder broken", "state file broken/controller.timestamps is broken or of another end"),
        ("renew none 2", "cannot read key file none: No such file or directory"),
        ("renew keys 6", "tracker 6 is refused: allowed is 0 to 5"),
        ("revoke keys 5", "key file keys holds no key of tracker 5"),
        ("revoke one 3", "tracker 3 is the only one in key file one: remove the file instead"),
    ],
)
def test_bad_input_of_keys_is_one_line(
    words: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_keys(Path("keys"), {tracker: KEYS[tracker] for tracker in range(5)})
    write_keys(Path("one"), {3: KEYS[3]})
    for folder in ("empty", "broken"):
        Path(folder).mkdir()
    Path("broken/controller.timestamps").write_text("no timestamps\n")
    with pytest.raises(SystemExit) as end:
        main(["keys", *words.split()])
    output = capsys.readouterr()
    assert (end.value.code, output.out, output.err.count("\n")) == (2, "", 1)
    assert output.err.startswith(f"swarmchase: {line}")
    assert read_keys(Path("keys")) == {tracker: KEYS[tracker] for tracker in range(5)}


# Keys of one tracker


def test_a_renewed_key_counts_and_a_revoked_one_does_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Through a link to the file, as a folder of releases has it; nobody else can read it at any moment."""
    (tmp_path / "real").mkdir()
    file, link = tmp_path / "real" / "keys", tmp_path / "keys"
    write_keys(file, KEYS)
    link.symlink_to(file)
    main(["keys", "renew", str(link), "2", "--json"])
    main(["keys", "revoke", str(link), "4", "--json"])
    output = capsys.readouterr().out
    told = [json.loads(line) for line in output.splitlines()]
    assert [one["trackers"] for one in told] == [[0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 5]]
    keys = read_keys(file)
    assert link.is_symlink()
    assert file.stat().st_mode & 0o777 == 0o600
    assert [entry.name for entry in (tmp_path / "real").iterdir()] == ["keys"]
    assert not any(key.hex() in output for key in (*keys.values(), *KEYS.values()))
    assert {tracker: key == KEYS[tracker] for tracker, key in keys.items()} == {0: 1, 1: 1, 2: 0, 3: 1, 5: 1}

    clock = VirtualClock(START_NS)
    network = VirtualNetwork(clock, fault_plan(""), "1")
    controller = ControllerMavlinkLink(*CONTROLLER, keys, wall_time_ns=clock.now_ns, udp=network.controller)
    with ExitStack() as opened:
        opened.enter_context(closing(controller))
        for tracker, key in [(2, KEYS[2]), (2, keys[2]), (4, KEYS[4]), (5, KEYS[5])]:
            end = TrackerMavlinkLink(
                tracker, *CONTROLLER, key, wall_time_ns=clock.now_ns, udp=network.trackers[tracker]
            )
            opened.enter_context(closing(end))
            end.send(Heartbeat(tracker, 1, TrackerMode.HOLDING, FLYING))
        network.pass_on()
        assert [message.tracker for message in controller.receive()] == [2, 5]
        assert controller.rejected == {"wrong key": 1, "unknown sender": 1}


def test_the_file_may_be_named_like_a_word_and_make_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for words in (["./renew"], ["make", "made"]):
        main(["keys", *words])
    assert len(read_keys(Path("renew"))) == len(read_keys(Path("made"))) == 6
    assert re.search("Keys of 6 trackers are in made", capsys.readouterr().err)


# The lock

TAKERS = 6
ROUNDS = 40
TAKER = """
import sys
from pathlib import Path
from swarmchase.errors import InputError
from swarmchase.live.link.timestamps import Timestamps

print("ready", flush=True)
for line in sys.stdin:
    try:
        held = Timestamps([1, 2], Path(line.strip()) / "controller.timestamps")
        print("taken", flush=True)
    except InputError as error:
        print(error, flush=True)
"""


def test_of_processes_that_start_at_once_one_gets_a_new_state_folder(tmp_path: Path) -> None:
    """Real ones, let loose together, in a folder that is not there yet; forty times."""
    takers = [
        subprocess.Popen(
            [sys.executable, "-c", TAKER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        for _ in range(TAKERS)
    ]
    try:
        for taker in takers:
            assert taker.stdout is not None
            assert taker.stdout.readline() == "ready\n"
        for number in range(ROUNDS):
            folder = tmp_path / str(number)
            folder.mkdir()
            for taker in takers:
                assert taker.stdin is not None
                taker.stdin.write(f"{folder}\n")
                taker.stdin.flush()
            told = Counter(taker.stdout.readline().rstrip() for taker in takers if taker.stdout)
            path = folder / CONTROLLER_FILE
            assert told == {"taken": 1, f"state file {path} is in use by another process": TAKERS - 1}
            assert sorted(entry.name for entry in folder.iterdir()) == [path.name, f"{path.name}.lock"]
    finally:
        for taker in takers:
            taker.kill()
            taker.communicate()
