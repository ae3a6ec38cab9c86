"""Options from a TOML file, ``swarmchase serve --config FILE``; what the command line says as well counts."""

import dataclasses
import itertools
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import FlagCreatePairsOff

from ..errors import InputError
from ..ranges import meant, shown
from ..reading import Bounds, read_toml
from ..scenario import toml_value

BOUNDS = Bounds(most_bytes=100_000, most_values=1000, most_levels=4)


@dataclass(frozen=True, kw_only=True)
class ConfigurationOptions:
    """Of a command that is often started by no person."""

    config: Path | None = None
    """A TOML file with options by their names with underscores; what the command line says as well counts."""
    print_config: FlagCreatePairsOff[bool] = False
    """Print all options as such a file, and do nothing else."""


OWN_OPTIONS = [field.name for field in dataclasses.fields(ConfigurationOptions)]


def with_configuration(command: Callable[..., Any], words: Sequence[str]) -> list[str]:
    """The words of a command line, after those that its configuration file says.

    Raises:
        InputError: the file cannot be read, is no TOML, or holds what is no option.
    """
    path = configuration_path(command, words)
    if path is None:
        return list(words)
    known = [field.name for field in dataclasses.fields(command) if field.name not in OWN_OPTIONS]  # type: ignore[arg-type]
    document = read_toml(path, "configuration", BOUNDS)
    for name in document:
        if name not in known:
            raise InputError(f"cannot use configuration {path}: no option {shown(name)}{meant(name, known)}")
    return [word for name, value in document.items() for word in _words(path, name, value)] + list(words)


def configuration_path(command: Callable[..., Any], words: Sequence[str]) -> Path | None:
    """The file that a command line names, if the command takes one; the last counts, as of every option."""
    path = None
    if isinstance(command, type) and issubclass(command, ConfigurationOptions):
        for word, following in itertools.pairwise([*words, ""]):
            if word == "--config" and following:
                path = Path(following)
            elif word.startswith("--config="):
                path = Path(word.removeprefix("--config="))
    return path


def print_configuration(command: Any) -> None:
    """All options of a parsed command as TOML on standard output; those without a value as comments."""
    for field in dataclasses.fields(command):
        value = getattr(command, field.name)
        if field.name not in OWN_OPTIONS:
            print(f"# {field.name} =" if value is None else f"{field.name} = {_toml(value)}")
    sys.stdout.flush()


def _words(path: Path, name: str, value: Any) -> list[str]:
    """An option as a command line says it."""
    option = name.replace("_", "-")
    if isinstance(value, bool):
        return [f"--{option}" if value else f"--no-{option}"]
    values = value if isinstance(value, list) else [value]
    if any(not isinstance(one, str | int | float) or isinstance(one, bool) for one in values):
        raise InputError(f"cannot use configuration {path}: {name} = {shown(value)} is no text, number or list of them")
    return [f"--{option}", *map(str, values)]


def _toml(value: Any) -> str:
    return toml_value(str(value) if isinstance(value, Path) else value)
