"""A temporary folder that goes away whatever kills the process that made it."""

import contextlib
import secrets
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ..errors import InputError

REMOVE_AT_THE_END = """
trap '' INT TERM HUP
read -r end
tries=100
while rm -rf -- "$1"; [ -e "$1" ] && [ $tries -gt 0 ]; do tries=$((tries - 1)); sleep 0.1; done
"""
"""For a shell: its input ends with the process that has the other end. Whoever dies with that process may still write a
moment longer."""


@contextlib.contextmanager
def temporary_folder(prefix: str) -> Iterator[Path]:
    """A folder for this user alone, removed at the block's end, and also when the process is killed inside it.

    A shell in a session of its own, which no signal to this process or its group reaches, waits for either and removes
    it: there is one way to go, and it is used every time.

    Raises:
        InputError: it cannot be made.
    """
    folder = Path(tempfile.gettempdir(), prefix + secrets.token_hex(8))
    remover = subprocess.Popen(
        ["/bin/sh", "-c", REMOVE_AT_THE_END, "sh", str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    with remover:  # at its end: its input is closed, and it is waited for
        try:
            folder.mkdir(mode=0o700)
        except OSError as error:
            raise InputError(f"cannot make the temporary folder {folder}: {error.strerror or error}") from error
        yield folder
