"""Options of either end of the live link. A tracker's computer has no more of this package's options."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..files import require_writable_folder


@dataclass(frozen=True, kw_only=True)
class LinkOptions:
    """How either end of the live link is secured."""

    keys: Path | None = None
    """The key file; swarmchase keys makes one."""
    unsigned: bool = False
    """Do without keys; on the loopback interface only."""
    state_folder: Path | None = None
    """Remembers over restarts what must only rise; default is $XDG_STATE_HOME/swarmchase or
    ~/.local/state/swarmchase."""

    def read_keys(self) -> Mapping[int, bytes] | None:
        """The keys by tracker, None where there are to be none.

        Raises:
            InputError: the key file is refused, or there is not exactly one of keys and ``unsigned``.
        """
        from ..live.link.keys import read_keys

        if (self.keys is None) != self.unsigned:
            raise InputError("give one of --keys FILE and --unsigned, which is for the loopback interface only")
        return None if self.keys is None else read_keys(self.keys)

    def folder(self) -> Path:
        """The state folder, made if need be.

        Raises:
            InputError: it cannot be written.
        """
        from ..live.service.state_folder import default_state_folder

        folder = default_state_folder() if self.state_folder is None else self.state_folder
        require_writable_folder(folder)
        return folder


def fields_from(command: Any, kind: Any) -> dict[str, Any]:
    """The values of those options that are fields of the dataclass ``kind``, which has the same names."""
    return {field.name: getattr(command, field.name) for field in dataclasses.fields(kind)}
