"""The README's examples run as they stand, and its commands are taken as they stand."""

import re
import shlex
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest

from swarmchase import cli
from swarmchase.commands.catalogue import COMMANDS

README = Path(__file__).parent.parent / "README.md"
TEXT = README.read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
INDENTED = re.findall(r"^    (\S.*)$", re.sub(r"```.*?```", "", TEXT, flags=re.DOTALL), flags=re.MULTILINE)
ROWS = [[cell.strip() for cell in row.split("|")[1:-1]] for row in TEXT.splitlines() if row.startswith("| ")]
NEEDS = {"live": "live", "serve": "live", "tracker": "live", "replay": "live", "export": "onnx"}


@pytest.mark.parametrize("example", EXAMPLES)
def test_python_example_runs(example: str) -> None:
    names: dict[str, Any] = {}
    exec(compile(example, str(README), "exec"), names)
    if "outcome" in names:
        assert int(names["outcome"].reached.sum()) > 0, "after 20 movements some of 64 chases have ended"
    if "env" in names:
        assert names["rssi_dbm"].shape == (50, 6)
        names["env"].close()


def test_there_are_examples() -> None:
    assert len(EXAMPLES) == 2


@pytest.mark.parametrize("link", re.findall(r"\]\(([^)]+)\)", README.read_text(encoding="utf-8")))
def test_links_lead_somewhere(link: str) -> None:
    file, _, anchor = link.partition("#")
    assert (README.parent / file).exists()
    if anchor:
        headings = re.findall(r"^#+ (.*)$", (README.parent / file).read_text(encoding="utf-8"), re.MULTILINE)
        assert anchor in {heading.lower().replace(" ", "-") for heading in headings}


def commands_of(cell: str) -> list[str]:
    return re.findall(r"`(swarmchase [a-z][^`]*)`", cell)


@pytest.mark.parametrize("command", [command for _, cell, _ in ROWS for command in commands_of(cell)])
def test_a_command_is_taken_as_it_stands(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[object] = []
    monkeypatch.setattr(cli, "run", taken.append)
    cli.main(shlex.split(command)[1:])
    assert len(taken) == 1


def test_rows_name_the_extra_that_they_need() -> None:
    for _, cell, extra in ROWS[1:]:
        for command in commands_of(cell):
            needed = "cluster" if "--cluster" in command else NEEDS.get(command.split()[1], "")
            assert needed in extra, command
    [measures] = [cell for _, cell, _ in ROWS if "swarmchase benchmark" in cell]
    assert {f"benchmark {name}" for name in re.findall(r"`(?:swarmchase benchmark )?(\w+)`", measures)} <= set(COMMANDS)


def test_what_is_to_be_typed_in_a_clone_is_there() -> None:
    """Commands of make and pip; the shell knows the one that is left."""
    extras = tomllib.loads((README.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {command.split()[0] for command in INDENTED} == {"make", "pip", "."}
    for command in INDENTED:
        words = shlex.split(command)
        if words[0] == "make":
            made = subprocess.run([shutil.which("make") or "make", "-n", *words[1:]], cwd=README.parent, check=False)
            assert made.returncode == 0
        elif words[0] == "pip":
            place, _, extra = words[-1].partition("[")
            assert (README.parent / place / "pyproject.toml").is_file()
            assert not extra or extra.removesuffix("]") in extras["optional-dependencies"]
        else:
            assert words == [".", ".venv/bin/activate"]
    named = {extra for *_, cell in ROWS[1:] for extra in re.findall(r"`(\w+)`", cell)}
    assert named <= extras["optional-dependencies"].keys()


def test_words_are_said_before_they_are_used() -> None:
    for word, use in (("**F** is", "F = "), ("**rho** is", "rho = "), ("A **movement** is", " movements")):
        assert 0 < TEXT.index(word) < TEXT.index(use)
    assert TEXT.index("Chasing aircraft is regulated") < TEXT.index("## Two commands")
    assert TEXT.index("pip install -e '.[live]'") < TEXT.index("| extra |")
