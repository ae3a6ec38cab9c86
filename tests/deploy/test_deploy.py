"""What is shipped to install the live system with: units, configurations and a container that this version can run."""

import configparser
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from swarmchase.cli import main
from swarmchase.commands.catalogue import COMMANDS
from swarmchase.live.log.recorder import CLOSE_S as LOG_S
from swarmchase.live.outputs.publisher import CLOSE_S as OUTPUT_S
from swarmchase.live.service.loop import TOLD_S
from swarmchase.processes.stop_request import STOP_SIGNALS

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
UNITS = {"swarmchase-serve.service": "serve.toml", "swarmchase-tracker.service": "tracker.toml"}
PROGRAMS = {"/opt/swarmchase/bin/swarmchase": [], "/opt/swarmchase/bin/swarmchase-tracker": ["tracker"]}
"""What the units start, each with the command of ``swarmchase`` that it is by itself."""


def unit(name: str) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(interpolation=None, strict=True)
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read_string((DEPLOY / name).read_text())
    return parser


def printed(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    main(words)
    return capsys.readouterr().out


@pytest.mark.parametrize(("name", "configuration"), UNITS.items())
def test_a_unit_starts_a_command_that_this_version_takes(
    name: str, configuration: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the configuration that is shipped beside it, whole: every option of both is one."""
    program, *words = shlex.split(unit(name)["Service"]["ExecStart"])
    words = [*PROGRAMS[program], *words]
    values = {
        "${STATE_DIRECTORY}": str(tmp_path),
        "${INVOCATION_ID}": "0123456789abcdef",
        "/etc/swarmchase": str(DEPLOY),
    }
    for written, value in values.items():
        words = [word.replace(written, value) for word in words]
    options = printed([*words, "--print-config"], capsys)
    assert f'state_folder = "{tmp_path}"' in options
    for line in (DEPLOY / configuration).read_text().splitlines():
        if line and not line.startswith("#"):
            name, _, value = line.partition("#")[0].rstrip().partition(" = ")
            assert f"{name} = {value}" in options


@pytest.mark.parametrize("name", UNITS)
def test_a_unit_stops_and_restarts_as_the_command_ends(name: str) -> None:
    service = unit(name)["Service"]
    assert getattr(signal, service["KillSignal"]) in STOP_SIGNALS
    # A chase that a signal ended, or that came to its own end, ends with 0; bad input with 2: neither is repeated.
    assert (service["Restart"], service["RestartPreventExitStatus"]) == ("on-failure", "2")
    assert float(service["TimeoutStopSec"]) > TOLD_S + LOG_S + OUTPUT_S + 1
    assert float(service["RestartSec"]) <= 1


@pytest.mark.parametrize("name", UNITS)
def test_systemd_knows_every_line(name: str, tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("there is no systemd-analyze (Debian: apt-get install systemd)")
    text, program = (DEPLOY / name).read_text(), shlex.split(unit(name)["Service"]["ExecStart"])[0]
    assert text.count(program) == 1
    (tmp_path / name).write_text(text.replace(program, sys.executable))
    ran = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(tmp_path / name)], capture_output=True, text=True, check=False
    )
    assert (ran.returncode, [line for line in ran.stderr.splitlines() if name in line]) == (0, [])
    (tmp_path / name).write_text(text.replace(program, sys.executable).replace("RestartSec", "RestartSoon"))
    ran = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(tmp_path / name)], capture_output=True, text=True, check=False
    )
    assert "Unknown key" in ran.stderr  # it looks


def instructions() -> list[tuple[str, str]]:
    """Of the Containerfile, each with what follows."""
    lines = [line for line in (DEPLOY / "Containerfile").read_text().splitlines() if not line.startswith("#")]
    joined = "\n".join(lines).replace("\\\n", " ")
    return [(word, rest.strip()) for word, _, rest in (line.partition(" ") for line in joined.splitlines() if line)]


def test_the_container_has_what_it_installs_and_starts() -> None:
    """Nothing builds it here: what it copies is there, and what it starts is a command."""
    found = instructions()
    assert found[0][0] == "FROM"
    assert {word for word, _ in found} <= {
        *("FROM", "RUN", "WORKDIR", "COPY", "USER", "VOLUME", "EXPOSE", "STOPSIGNAL", "ENTRYPOINT", "CMD"),
    }
    said = dict(found)
    copied = [source for word, rest in found if word == "COPY" for source in rest.split()[:-1]]
    let_through = [
        line[1:] for line in (DEPLOY / "Containerfile.dockerignore").read_text().splitlines() if line[:1] == "!"
    ]
    assert sorted(copied) == sorted(let_through)
    assert all((ROOT / source).exists() for source in copied)
    assert {"src", "pyproject.toml", "README.md"} <= set(copied)  # hatchling reads these
    assert getattr(signal, said["STOPSIGNAL"]) in STOP_SIGNALS
    assert (said["ENTRYPOINT"], said["CMD"]) == ('["swarmchase"]', '["--help"]')  # a list: signals reach it, no shell
    extras = re.search(r"'\.\[([\w,]+)\]'", " ".join(rest for word, rest in found if word == "RUN"))
    assert extras
    declared = (ROOT / "pyproject.toml").read_text()
    assert all(re.search(rf"^{extra} = \[", declared, flags=re.MULTILINE) for extra in extras[1].split(","))


def test_its_head_starts_a_command_that_there_is() -> None:
    head = " ".join(line.strip("# \\") for line in (DEPLOY / "Containerfile").read_text().splitlines()[:6])
    command = re.search(r"swarmchase (serve .*)$", head)
    assert command
    assert command[1].split()[0] in COMMANDS


def test_the_document_has_every_file() -> None:
    text = (ROOT / "docs" / "outputs.md").read_text(encoding="utf-8")
    for path in DEPLOY.iterdir():
        assert f"deploy/{path.name}" in text or path.suffix == ".dockerignore", path.name
