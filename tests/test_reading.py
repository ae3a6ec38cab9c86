"""Files from outside are read within bounds: what is no regular file, too long, too deep or no number is one line."""

import json
import lzma
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from swarmchase.controllers import load_controller, require_controller, weights_sha256
from swarmchase.errors import InputError
from swarmchase.evaluation.comparison import read_results
from swarmchase.evaluation.reproduction import read_evaluations
from swarmchase.evaluation.tables import read_rows
from swarmchase.live.log.recording import read_recording
from swarmchase.live.service.state_folder import next_epoch
from swarmchase.live.tracker.sources.address import open_source
from swarmchase.live.tracker.sources.kind import SourceDetails
from swarmchase.live.tracker.sources.pcap import PcapSource, pcap_rows
from swarmchase.live.tracker.sources.replay import csv_rows, json_rows
from swarmchase.reading import (
    MOST_ROW_CHARACTERS,
    Bounds,
    DocumentError,
    opened_table,
    parsed_json,
    parsed_toml,
    read_bytes,
    read_json,
    read_unpacked,
)
from swarmchase.scenario import Scenario, paper_scenario
from swarmchase.training.run_folder import RunFolder, read_log
from swarmchase.training.settings import TrainingSettings

SMALL = Bounds(most_bytes=10_000, most_values=100, most_levels=4)


def resumed(path: Path) -> object:
    path.rename(path.parent / "resume.safetensors")
    return RunFolder(path.parent, [paper_scenario()], TrainingSettings()).load()


def logged(path: Path) -> object:
    path.rename(path.parent / "training.jsonl")
    return read_log(path.parent, "chase")


def with_token(path: Path) -> object:
    details = SourceDetails(transmitter_mac="02:00:00:00:00:01", kismet_token_file=path)
    return open_source("kismet:http://127.0.0.1:9", details)


READERS: dict[str, Callable[[Path], object]] = {
    "scenario": Scenario.load_toml,
    "weights": lambda path: load_controller(path.rename(path.with_suffix(".safetensors")), paper_scenario()),
    "weights checked": lambda path: require_controller(path.rename(path.with_suffix(".safetensors")), paper_scenario()),
    "weights told apart": lambda path: weights_sha256(path, paper_scenario()),
    "packed weights": lambda path: read_unpacked(path, "weights file", 100),
    "resume file": resumed,
    "training log": logged,
    "table": lambda path: read_rows(path, "table"),
    "comparison": read_results,
    "reproduction": read_evaluations,
    "log": read_recording,
    "CSV": lambda path: list(csv_rows(path)),
    "JSON": lambda path: list(json_rows(path)),
    "pcap": lambda path: list(pcap_rows(path)),
    "token": with_token,
    "epoch": next_epoch,
}
"""Everything in the package that reads a file that a person names, or that lies where a person can put something."""


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS.keys())
@pytest.mark.parametrize("kind", ["pipe without a writer", "folder", "device without an end"])
def test_what_is_no_regular_file_is_refused_at_once(
    kind: str, reader: Callable[[Path], object], tmp_path: Path
) -> None:
    path = tmp_path / "it"
    if kind == "folder":
        path.mkdir()
    elif kind == "device without an end":
        path.symlink_to("/dev/zero")
    else:
        os.mkfifo(path)
    with pytest.raises(InputError, match="no regular file") as refusal:
        reader(path)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("reader", [reader for name, reader in READERS.items() if name != "epoch"])
def test_what_is_not_there_is_said(reader: Callable[[Path], object], tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputError, match="No such file or directory"):
        reader(gone)


@pytest.mark.parametrize("place", ["folder", "/dev/zero"])
def test_a_capture_grows_in_a_file_or_a_pipe_and_nowhere_else(place: str, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot read capture"):
        PcapSource(tmp_path / place)
    os.mkfifo(tmp_path / "pipe")
    source = PcapSource(tmp_path / "pipe")
    assert source.read(0) == []
    source.close()


def test_a_file_is_read_whole_or_refused(tmp_path: Path) -> None:
    path = tmp_path / "it"
    path.write_bytes(b"x" * 100)
    assert read_bytes(path, "thing", 100) == b"x" * 100
    with pytest.raises(InputError, match=rf"^cannot read thing {path}: it has more than 99 bytes$"):
        read_bytes(path, "thing", 99)
    path.write_bytes(b"")
    assert read_bytes(path, "thing", 0) == b""


PACKED = lzma.compress(b"x" * 1000)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "it is damaged: it ends too early or too late"),
        (PACKED[:-1], "it is damaged: it ends too early or too late"),
        (PACKED + b"more", "it is damaged: it ends too early or too late"),
        (PACKED[:30] + b"?" + PACKED[31:], "it is damaged: "),
        (b"no such file" * 9, "it is damaged: Input format not supported by decoder"),
        (lzma.compress(bytes(10**6)), "it holds more than 1000 bytes"),
        (b"x" * 1001, "it has more than 1000 bytes"),
    ],
)
def test_a_packed_file_is_read_whole_or_refused(content: bytes, says: str, tmp_path: Path) -> None:
    path = tmp_path / "it.xz"
    path.write_bytes(PACKED)
    assert read_unpacked(path, "thing", 1000) == b"x" * 1000
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"^cannot read thing {path}: {says}"):
        read_unpacked(path, "thing", 1000)


def test_a_huge_file_costs_no_memory(tmp_path: Path) -> None:
    """A hole of a terabyte: nothing of it is read."""
    with open(tmp_path / "it", "wb") as file:
        file.truncate(2**40)
    program = (
        "import resource, sys\n"
        "from pathlib import Path\n"
        "from swarmchase.errors import InputError\n"
        "from swarmchase.live.tracker.sources.replay import csv_rows, json_rows\n"
        "from swarmchase.scenario import Scenario\n"
        "resource.setrlimit(resource.RLIMIT_AS, (2**28, 2**28))\n"
        "for read in (Scenario.load_toml, csv_rows, json_rows):\n"
        "    try:\n"
        "        list(read(Path(sys.argv[1])))\n"
        "    except InputError as error:\n"
        "        print(str(error).replace(sys.argv[1], 'it'))\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "it")], capture_output=True, text=True, check=True
    )
    assert ran.stdout.splitlines() == [
        "cannot read scenario it: it has more than 65536 bytes",
        f"cannot read recording it: a row has more than {MOST_ROW_CHARACTERS} characters",
        "cannot read recording it: it has more than 67108864 bytes",
    ]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"[[[[1]]]]", "values within values on more than 4 levels"),
        (b'{"a": {"b": {"c": {"d": 1}}}}', "values within values on more than 4 levels"),
        (b"[" * 90, "no JSON"),
        (b"[" * 9000, "more than 100 values"),
        (b"[" + b"0," * 101 + b"0]", "more than 100 values"),
        (b" " * 10_001, "more than 10000 bytes"),
        (b"[NaN]", "nan, which is no finite number"),
        (b"-1e999", "-inf, which is no finite number"),
        (b"18446744073709551616", "a whole number of more than 64 bits"),
        (b"9" * 5000, "no JSON: Exceeds the limit"),
        (b'"\\ud800"', "a text that is no Unicode"),
        (b'{"\\udfff": 1}', "a text that is no Unicode"),
        (b"\xff", "no JSON"),
        (b"", "no JSON"),
    ],
)
def test_json_beyond_its_bounds_is_refused(content: bytes, says: str) -> None:
    with pytest.raises(DocumentError, match=says) as refusal:
        parsed_json(content, SMALL)
    assert len(str(refusal.value)) < 200


def test_json_within_its_bounds_is_read(tmp_path: Path) -> None:
    path = tmp_path / "it.json"
    path.write_text('{"a": [[18446744073709551615, -1.5, null]], "\\u20ac": "\\ud83d\\ude00"}')
    assert read_json(path, "thing", SMALL) == {"a": [[2**64 - 1, -1.5, None]], "€": "😀"}
    path.write_text("[[[[[]]]]]")
    with pytest.raises(InputError, match=rf"^cannot read thing {path}: it has values within values"):
        read_json(path, "thing", SMALL)


def test_brackets_beyond_pythons_own_recursion_are_one_line() -> None:
    deep = Bounds(most_bytes=10**6, most_values=10**6)
    for parse, content in ((parsed_json, b"[" * 200_000), (parsed_toml, b"a = " + b"[" * 200_000)):
        with pytest.raises(DocumentError, match="too many brackets within brackets"):
            parse(content, deep)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"a = " + b"[" * 5 + b"]" * 5, "values within values on more than 4 levels"),
        (b"a.b.c.d.e = 1", "values within values on more than 4 levels"),
        (b".".join([b"a"] * 300) + b" = 1", "a line has more than 256 dots"),
        (b"[" + b".".join([b"a"] * 300) + b"]", "a line has more than 256 dots"),
        (b"a = inf", "inf, which is no finite number"),
        (b"a = " + b"9" * 5000, "no TOML: Exceeds the limit"),
        (b"a = 0x" + b"f" * 5000, "a whole number of more than 64 bits"),
        (b"a = 2026-02-30", "no TOML"),
        (b"\xff", "no TOML"),
        (b" " * 10_001, "more than 10000 bytes"),
    ],
)
def test_toml_beyond_its_bounds_is_refused(content: bytes, says: str) -> None:
    with pytest.raises(DocumentError, match=says):
        parsed_toml(content, SMALL)


def test_a_row_of_a_table_has_only_so_many_characters_however_many_lines(tmp_path: Path) -> None:
    path = tmp_path / "it.csv"
    path.write_text("time_s,rssi_dbm\n1,-60\n" + '"x\n",' * MOST_ROW_CHARACTERS)

    def rows() -> list[Any]:
        with opened_table(path, "recording") as table:
            return [next(table), next(table)]

    with pytest.raises(InputError, match="a row has more than"):
        rows()


def test_a_long_table_of_short_rows_is_read(tmp_path: Path) -> None:
    path = tmp_path / "it.csv"
    count = MOST_ROW_CHARACTERS // 10
    path.write_text("time_s,rssi_dbm\n" + "".join(f"{second},-60.000000\n" for second in range(count)))
    assert sum(1 for _ in csv_rows(path)) == count


def test_real_files_damaged_at_random_are_read_or_refused_and_nothing_else() -> None:
    """More: python tests/file_fuzz.py EXAMPLES SEED, or FILE_FUZZ_EXAMPLES=1000 for this test."""
    examples = int(os.environ.get("FILE_FUZZ_EXAMPLES", "40"))
    program = Path(__file__).with_name("file_fuzz.py")
    ran = subprocess.run(
        [sys.executable, str(program), str(examples), "0"], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    assert all(sum(counts.values()) == examples for counts in found.values())
    # The damage is neither so small that all is read nor so large that nothing but the first byte is looked at.
    assert all(counts.get("refused", 0) > 0 for kind, counts in found.items() if kind not in {"csv", "pcap"})
    assert all(found[kind].get("read", 0) > 0 for kind in ("weights", "training log", "log", "csv", "json", "pcap"))
