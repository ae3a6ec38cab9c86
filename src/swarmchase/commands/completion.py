"""``swarmchase completion``: what lets a shell complete commands and options."""

import contextlib
import dataclasses
import io
import sys
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union

import tyro
from tyro.conf import Positional, arg, subcommand

from .catalogue import COMMANDS, kind, members

Shell = Literal["bash", "zsh", "tcsh"]


@dataclass(frozen=True, kw_only=True)
class CompletionCommand:
    """Print the script with which a shell completes commands and options; docs/commands.md says where it goes."""

    shell: Positional[Shell]
    """Whose script."""

    def run(self) -> None:
        """Print it."""
        sys.stdout.write(completion_script(self.shell))
        sys.stdout.flush()


def completion_script(shell: Shell) -> str:
    """Of all commands, those of two words as commands in a command."""
    script = io.StringIO()
    with contextlib.redirect_stdout(script), contextlib.suppress(SystemExit):
        tyro.cli(_nested(), prog="swarmchase", args=["--tyro-print-completion", shell])
    return script.getvalue()


def _nested() -> Any:
    kinds = []
    for name in dict.fromkeys(name.split()[0] for name in COMMANDS):
        pairs = members(name)
        kinds.append(_named(name, _choice(name, pairs) if pairs else kind(name)))
    return Union[tuple(kinds)]  # noqa: UP007  # of what is found here


def _choice(group: str, names: list[str]) -> Any:
    one_of: Any = Union[tuple(_named(name.split()[1], kind(name)) for name in names)]  # noqa: UP007
    return dataclasses.make_dataclass(group, [("command", Annotated[one_of, arg(name="")])])


def _named(name: str, command: Any) -> Any:
    return Annotated[command, subcommand(name, prefix_name=False)]
