"""A command's help: options by subject, the command's own first, at the terminal's width."""

import dataclasses
import re

import pytest

from swarmchase.cli import main
from swarmchase.commands.catalogue import kind
from swarmchase.commands.help import FIELD_SUBJECTS, ORDER, SUBJECT_OF_FIELD
from swarmchase.scenario import Scenario

WITH_ALL_KINDS = ["evaluate", "train batched", "serve", "tracker", "keys", "completion", "benchmark live"]
"""Commands that have every kind of option between them, and every class that several commands share."""


def lines_of(command: str, capsys: pytest.CaptureFixture[str]) -> list[str]:
    with pytest.raises(SystemExit) as ended:
        main([*command.split(), "--help"])
    assert ended.value.code == 0
    return capsys.readouterr().out.splitlines()


def groups_of(lines: list[str]) -> dict[str, list[str]]:
    """The options under each title."""
    groups: dict[str, list[str]] = {}
    for line in lines:
        if line in ORDER:
            groups[line] = []
        elif groups and re.match(r"  \S", line):
            groups[next(reversed(groups))].append(line.strip())
    return groups


@pytest.mark.parametrize("command", WITH_ALL_KINDS)
def test_every_option_stands_once_and_fits_80_columns(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = lines_of(command, capsys)
    options = [word for group in groups_of(lines).values() for line in group for word in re.findall(r"--[\w-]+", line)]
    fields = [field.name.replace("_", "-") for field in dataclasses.fields(kind(command))]  # type: ignore[arg-type]
    positional = [line for group in groups_of(lines).values() for line in group if not line.startswith("-")]
    assert len(options) == len(set(options))
    assert len([name for name in fields if f"--{name}" in options]) + len(positional) == len(fields)
    about = [line for line in lines if line.startswith("      ")]
    assert len(about) >= len(fields)
    assert max(map(len, about)) <= 80
    assert "None" not in " ".join(line for group in groups_of(lines).values() for line in group)


def test_subjects_come_in_order_the_commands_own_first(capsys: pytest.CaptureFixture[str]) -> None:
    groups = groups_of(lines_of("train batched", capsys))
    assert list(groups) == ["Options", "Training", *FIELD_SUBJECTS]
    assert "--preset STR" in groups["Options"]
    assert "--learning-rate FLOAT" in groups["Training"]
    assert "--rician-k FLOAT" in groups["World: radio channel"]


def test_every_field_of_a_scenario_has_a_subject() -> None:
    assert {field.name for field in dataclasses.fields(Scenario)} | {"scenario"} == set(SUBJECT_OF_FIELD)


@pytest.mark.parametrize("name", ["--episodes", "--chases"])
def test_the_number_of_chases_has_one_name_and_the_old_one_is_heard(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["benchmark", "live", name, "1"])
    assert ended.value.code == 2
    assert "episodes must be at least 2" in capsys.readouterr().err
