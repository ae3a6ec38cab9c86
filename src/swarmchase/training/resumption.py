"""Whether a run is the one that lies in a folder: what is different, there and here."""

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..ranges import shown
from ..scenario import Scenario

OPTIONS = {"max_updates": "updates", "num_agents": "agents"}
"""What the command line calls these."""
PAPER = {field.name: field.default for field in dataclasses.fields(Scenario)}
"""Of a scenario only what departs from the paper is written, of most fields."""
MOST_TOLD = 6


def require_same_run(path: Path, there: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    """Refuse to go on with a run of other options.

    Args:
        there: what the resume file says of its run.
        here: what is asked for, as JSON holds it.

    Raises:
        InputError: they differ; it says where, and what is there and here.
    """
    found = [difference for name in here for difference in _differences(name, there.get(name), here[name])]
    if found:
        told = ", ".join(found[:MOST_TOLD]) + (f" and {len(found) - MOST_TOLD} more" if len(found) > MOST_TOLD else "")
        raise InputError(
            f"resume file {path} is of a run with other options: {told}; give the same, or choose another folder"
        )


def as_long(there: Any, here: dict[str, Any]) -> dict[str, Any]:
    """The settings ``here`` with the length that a run has ``there``, where it may be made as long as ``here``: nothing
    in it depends on its length but the end. With a final learning rate its learning rates do.
    """
    length = there.get("max_updates") if isinstance(there, dict) else None
    if here["final_learning_rate"] is None and isinstance(length, int) and length < here["max_updates"]:
        return {**here, "max_updates": length}
    return here


def _differences(name: str, there: Any, here: Any) -> Iterator[str]:
    if isinstance(there, dict) and isinstance(here, dict):
        for part in dict.fromkeys([*here, *there]):
            default = PAPER.get(part)
            yield from _differences(part, there.get(part, default), here.get(part, default))
    elif name == "scenarios" and isinstance(there, list) and len(there) == len(here):
        for number, (one, other) in enumerate(zip(there, here, strict=True), start=1):
            of = f" of setting {number}" if len(here) > 1 else ""
            yield from (f"{difference}{of}" for difference in _differences("scenario", one, other))
    elif name == "scenarios":
        yield f"{len(there) if isinstance(there, list) else 'no'} settings there and {len(here)} here"
    elif _plain(there) != _plain(here):
        yield f"{OPTIONS.get(name, name)} = {shown(there)} there and {shown(here)} here"


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
