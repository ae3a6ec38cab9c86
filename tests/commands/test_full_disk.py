"""On a disk that is really full every command that finds something out says it first, then what cannot be written."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

CAN_MOUNT = (
    subprocess.run(
        ["unshare", "--user", "--map-root-user", "--mount", "mount", "-t", "tmpfs", "tmpfs", "/mnt"],
        capture_output=True,
        check=False,
    ).returncode
    == 0
    if Path("/usr/bin/unshare").exists()
    else False
)

WORLD = "start_distance_m = 8.0\nmax_movements = 2\nwindow_samples = 50\n"
SHORT = "--scenario ../short.toml"
COMMANDS = {
    "evaluate": f"evaluate --controller random --episodes 3 {SHORT} --table table.parquet --json",
    "chase": f"chase --controller random {SHORT} --folder . --json",
    "compare": f"compare --controllers random oracle --episodes 2 --processes 1 {SHORT} --folder . --json",
    "reproduce": "reproduce --episodes 1 --processes 1 --folder . --json",
}
PROGRAM = """
import contextlib, io, json, sys
from pathlib import Path
from swarmchase.cli import main
from swarmchase.evaluation import reproduction
from swarmchase.evaluation.reproduction import Cell

reproduction.cells = lambda: [Cell("oracle", 10, 0.9)]  # the paper's twelve settings take longer
with open("filler", "wb", buffering=0) as filler, contextlib.suppress(OSError):
    while filler.write(bytes(4096)):
        pass
found = {}
for name, words in json.loads(sys.argv[1]).items():
    printed, told = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(told):
        try:
            main(words.split())
            code = 0
        except SystemExit as ending:
            code = ending.code
    left = sorted(path.name for path in Path().rglob("*") if path.is_file())
    found[name] = [code, printed.getvalue(), told.getvalue(), left]
json.dump(found, sys.__stdout__)
"""


@pytest.fixture(scope="module")
def on_a_full_disk(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str, str, list[str]]]:
    """Exit code, standard output, standard error and what lies on the disk then, of every command."""
    home = tmp_path_factory.mktemp("home")
    (home / "short.toml").write_text(WORLD)
    (home / "disk").mkdir()
    inside = 'mount -t tmpfs -o size=256k tmpfs "$1" && cd "$1" && exec "$2" -c "$3" "$4"'
    ran = subprocess.run(
        [
            *("unshare", "--user", "--map-root-user", "--mount", "sh", "-c", inside, "sh"),
            *(str(home / "disk"), sys.executable, PROGRAM, json.dumps(COMMANDS)),
        ],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "COLUMNS": "500"},
    )
    assert ran.returncode == 0, ran.stderr
    found: dict[str, tuple[int, str, str, list[str]]] = json.loads(ran.stdout)
    return found


@pytest.mark.skipif(not CAN_MOUNT, reason="makes a small disk of its own, which this system does not permit")
@pytest.mark.parametrize("name", COMMANDS)
def test_what_was_found_out_is_printed_before_the_disk_is_full(
    name: str, on_a_full_disk: dict[str, tuple[int, str, str, list[str]]]
) -> None:
    code, printed, told, left = on_a_full_disk[name]
    assert code == 2
    assert told.splitlines()[-1].startswith("swarmchase: cannot write ")
    assert told.splitlines()[-1].endswith("No space left on device")
    assert "Traceback" not in told
    assert left == ["filler"]
    result = json.loads(printed)
    if name == "evaluate":
        assert result["episodes"] == 3
    elif name == "chase":
        assert result["controller"] == "random"
        assert "Movements" in told
    elif name == "compare":
        assert [row["controller"] for row in result] == ["random", "oracle"]
        assert "movements" in told
    else:
        assert [row["episodes"] for row in result["summaries"]] == [1]
        assert "Fig" in told or "oracle" in told
