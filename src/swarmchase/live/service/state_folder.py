"""What outlives the processes of the live system: the link's timestamps and the controller's epoch."""

import os
import time
from collections.abc import Callable
from pathlib import Path

from ...errors import InputError
from ...files import write_text_atomically
from ...reading import read_bytes

UNIX_TIME_OF_2025_S = 1_735_689_600
LARGEST_EPOCH = 2**32 - 1
MOST_FILE_BYTES = 100


def default_state_folder() -> Path:
    """Where the XDG Base Directory Specification puts state: ``$XDG_STATE_HOME``, else ``~/.local/state``.

    Raises:
        InputError: the user has no home.
    """
    state_home = Path(os.environ.get("XDG_STATE_HOME", ""))
    try:
        # The specification has relative paths ignored.
        base = state_home if state_home.is_absolute() else Path.home() / ".local" / "state"
    except RuntimeError as error:
        raise InputError("there is no home folder for the state: give --state-folder") from error
    return base / "swarmchase"


def next_epoch(path: Path, wall_time_s: Callable[[], float] = time.time) -> int:
    """A number larger than any that it has given before: the seconds since 2025, or one more than the last, whichever
    is greater. The last is in the file.

    Raises:
        InputError: the file cannot be read or written, or holds no epoch.
    """
    epoch = max(int(wall_time_s()) - UNIX_TIME_OF_2025_S, _last_epoch(path) + 1)
    if epoch > LARGEST_EPOCH:
        raise InputError(f"there is no epoch after the one in {path}: remove it if the clock was wrong")
    write_text_atomically(path, f"{epoch}\n")
    return epoch


def _last_epoch(path: Path) -> int:
    if not os.path.lexists(path):
        return -1
    content = read_bytes(path, "epoch", MOST_FILE_BYTES).strip()
    if not content.isdigit():
        raise InputError(f"{path} holds no epoch: remove it to begin with the seconds since 2025")
    return int(content)
