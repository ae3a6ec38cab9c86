"""docs/sources.md has every source, with a command that the command line takes and lines that are understood."""

import re
import shlex
import struct
from pathlib import Path

import pytest

from swarmchase.cli import main
from swarmchase.live.tracker.sources.address import KINDS
from swarmchase.live.tracker.sources.sketch_text import heard_in

DOCUMENT = (Path(__file__).parents[3] / "docs" / "sources.md").read_text(encoding="utf-8")


def rows(head: str) -> list[list[str]]:
    """The cells of the table that begins so."""
    table = DOCUMENT.partition(f"| {head} |")[2].partition("\n\n")[0]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in table.splitlines()[2:]]


COMMANDS = [re.findall(r"`(.*)`", row[2])[0] for row in rows("address")]
BEGINNING = re.findall(r"^    (swarmchase tracker .*)$", DOCUMENT, flags=re.MULTILINE)[0]


def test_every_source_has_a_row() -> None:
    addresses = [row[0].strip("`") for row in rows("address")]
    assert addresses == [kind.form for kind in KINDS]
    assert [command.split()[1].partition(":")[0] for command in COMMANDS] == [kind.scheme for kind in KINDS]


@pytest.mark.parametrize("command", COMMANDS)
def test_its_command_is_understood(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = shlex.split(f"{BEGINNING} {command}")
    assert words.pop(0) == "swarmchase"
    main([*words, "--print-config"])
    output = capsys.readouterr()
    assert output.err == ""
    assert f'source = "{words[words.index("--source") + 1]}"' in output.out


@pytest.mark.parametrize("line", [re.findall(r"`(.*)`", row[0])[0] for row in rows("line")])
def test_its_lines_of_sketches_are_understood(line: str) -> None:
    heard = heard_in(line)
    assert heard is not None
    assert heard.rssi_dbm == -61
    assert heard.mac == ("02:00:00:00:00:07" if "02:" in line else None)
    assert heard.name == ("hall" if "hall" in line else None)


def test_a_capture_of_many_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two senders, a frame each: file header, then packet header, radiotap with the signal alone, data frame."""
    frames = [
        bytes.fromhex("0000090020000000c4" + "08000000ffffffffffff" + address + "0000")
        for address in ("02" * 6, "04" * 6)
    ]
    packets = [struct.pack("<IIII", 1, 0, len(frame), len(frame)) + frame for frame in frames]
    (tmp_path / "hall.pcap").write_bytes(
        struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 127) + b"".join(packets)
    )
    for scheme in ("pcap", "replay"):
        with pytest.raises(SystemExit) as end:
            main(
                [
                    *shlex.split(BEGINNING)[1:],
                    "--state-folder",
                    str(tmp_path),
                    "--source",
                    f"{scheme}:{tmp_path}/hall.pcap",
                ]
            )
        output = capsys.readouterr()
        assert (end.value.code, output.out, output.err.count("\n")) == (2, "", 1)
        assert "hall.pcap has 2 transmitters: say which one is chased with --transmitter-mac or" in output.err
        assert output.err.endswith("'02:02:02:02:02:02' (-60 dBm), '04:04:04:04:04:04' (-60 dBm)\n")
