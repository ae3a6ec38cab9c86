"""``swarmchase COMMAND --help``: its options by subject, the command's own first.

What the options are, tyro knows: its help is read from a line as wide as need be, and set again in groups.
"""

import contextlib
import inspect
import io
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator
from typing import Any, NamedTuple

import tyro

from .terminal import Page

WIDE = 4000
"""Columns in which no help is wrapped."""
WIDEST = 100
"""Longer lines are hard to read."""
OWN = "Options"
WORLD = "World"
SUBJECTS = {
    # Class that has the options: what they are about.
    "ClusterOptions": "Many machines",
    "_TrainOptions": "Training",
    "LinkOptions": "Link and keys",
    "OperatorSettings": "How the chase is flown",
    "LimitValues": "Limits",
    "OutputOptions": "Where else it is shown",
    "ConfigurationOptions": "Options from a file",
}
"""Options of other classes are the command's own."""
FIELD_SUBJECTS = {
    WORLD: "scenario",
    # Fields of a scenario.
    "World: radio channel": (
        "transmit_power_dbm reference_distance_m reference_path_loss_db path_loss_exponent rician_k doppler_spread_hz "
        "spatial_correlation los_phase continuity carrier_hz transmit_power_error_db path_loss_exponent_error "
        "shadowing_db shadowing_distance_m shadowing_common_share ground_reflection"
    ),
    "World: what is sent and heard": (
        "window_samples sampling_hz transmit_duty frame_s silence_s between_silences_s silence_at_s "
        "missing_burst_s receiver_offset_db missing_sample_share silent_trackers receiver_step_db "
        "receiver_floor_dbm receiver_ceiling_dbm wrong_trackers stuck_trackers garbage_share"
    ),
    "World: target": (
        "behaviour target_speed_mps target_acceleration_mps2 alert_distance_m start_distance_m farthest_start_m "
        "highest_elevation_deg start_altitude_m lowest_altitude_m highest_altitude_m"
    ),
    "World: swarm and chase": (
        "pace decision_s tracker_speed_mps tracker_acceleration_mps2 spacing_choices_m displacement_choices_m "
        "initial_spacing_m success_radius_m max_movements follow_s"
    ),
}
SUBJECT_OF_FIELD = {name: subject for subject, names in FIELD_SUBJECTS.items() for name in names.split()}
ORDER = [OWN, *dict.fromkeys(SUBJECTS.values()), *FIELD_SUBJECTS]
ENTRY = re.compile(r"(-{1,2}\w.*?|[A-Z{]\S*)(?:\s{2,}(.*))?")
"""An option, and what is said of it on the same line."""
ENTRY_INDENT = 2
"""What is further in belongs to the option before."""


class Option(NamedTuple):
    """As help shows it."""

    name: str
    """Its field's; nothing of what is no field."""
    words: str
    """``--seed INT``, or what is given without a name."""
    about: str


def print_options(program: str, command: Any) -> None:
    """Of one command, on standard output."""
    page = Page(width=min(shutil.get_terminal_size().columns, WIDEST))
    usage, options = _told_by_tyro(program, command)
    page.print(usage, markup=False, soft_wrap=True)
    about = " ".join((inspect.getdoc(command) or "").split())
    page.print(f"\n{about}", markup=False)
    for subject in ORDER:
        its = [option for option in options if _subject(command, option.name) == subject]
        if its:
            page.print(f"\n[bold]{subject}[/bold]")
        for option in its:
            page.print(f"  {option.words}", style="cyan", markup=False, soft_wrap=True)
            for line in textwrap.wrap(option.about, page.width - 6, break_on_hyphens=False):
                page.print(f"      {line}", markup=False, soft_wrap=True)
    sys.stdout.flush()


def _told_by_tyro(program: str, command: Any) -> tuple[str, list[Option]]:
    """The usage and the options."""
    told = io.StringIO()
    with (
        _columns(WIDE),
        contextlib.redirect_stdout(told),
        contextlib.suppress(SystemExit),
    ):
        tyro.cli(command, prog=program, args=["--help"])
    lines = re.sub(r"\x1b\[[0-9;]*m", "", told.getvalue()).splitlines()
    return lines[0], list(_options(lines))


@contextlib.contextmanager
def _columns(number: int) -> Iterator[None]:
    """A terminal so wide, to whoever asks."""
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = str(number)
    try:
        yield
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before


def _options(lines: list[str]) -> Iterator[Option]:
    entry: tuple[str, str] | None = None
    for line in [*lines, ""]:
        inside = re.sub("[│╭╰╮╯─]", " ", line)
        text, is_further_in = inside.strip(), len(inside) - len(inside.lstrip()) > ENTRY_INDENT
        if entry is not None and text and is_further_in:
            entry = entry[0], f"{entry[1]} {text}"
            continue
        if entry is not None:
            yield _option(*entry)
        begins = ENTRY.fullmatch(text) if inside.startswith(" ") and not is_further_in else None
        entry = None if begins is None else (begins[1], begins[2] or "")


def _option(words: str, about: str) -> Option:
    """Without what says nothing: that an option that need not be given is None."""
    words = re.sub(r"\{None\}\||None,", "", words)
    about = re.sub(r"\s*\(default: None\)", "", about).strip()
    # Aliases come first, and the other side of a switch last.
    name = re.match(r"--(?:no-)?([\w-]+)", words.split(", ")[-1])
    return Option("" if name is None else name[1].replace("-", "_"), words, about)


def _subject(command: Any, name: str) -> str:
    """What an option is about: by its field, or by the first class of the command that has it."""
    if name in SUBJECT_OF_FIELD:
        return SUBJECT_OF_FIELD[name]
    owners = [one for one in inspect.getmro(command) if name in inspect.get_annotations(one)]
    return SUBJECTS.get(owners[0].__name__, OWN) if owners else OWN
